"""What `make bench` keeps: goals that can fail, figures that reach the page as measured."""

import json
from pathlib import Path

import pytest

from tests.bench import store
from tests.bench.__main__ import main
from tests.bench.goals import Figure

MARKS = "\n".join(
    f"{store.BEGIN.format(name)}\nstale\n{store.END.format(name)}"
    for name in ("machine", "goals", "growth", "figures")
)


@pytest.mark.parametrize(
    ("value", "most", "least", "holds"),
    [
        (1.0, None, None, None),
        (1.0, 1.0, None, True),
        (1.01, 1.0, None, False),
        (1.8, None, 1.8, True),
        (1.7, None, 1.8, False),
        (float("nan"), 1.0, None, False),
        (float("nan"), None, 1.0, False),
    ],
)
def test_a_goal_holds_or_fails(
    value: float, most: float | None, least: float | None, holds: bool | None
) -> None:
    figure = Figure("a task", value, "ms", most, least)
    assert figure.holds is holds
    assert figure.record()["holds"] is holds
    word = {True: "; holds)", False: "; FAILS)", None: ""}[holds]
    assert str(figure).endswith(word or "ms")


def test_a_goal_that_is_just_missed_is_not_printed_as_met() -> None:
    assert "1.254 (goal: at most 1.25; FAILS)" in str(Figure("decoding", 1.254, most=1.25))


def test_what_was_measured_reaches_the_page_between_its_marks(tmp_path: Path) -> None:
    path, page = tmp_path / "bench.json", tmp_path / "page.md"
    page.write_text(f"before\n{MARKS}\nafter\n")
    store.keep(path, "chain", [Figure("stale", 9.0)])
    store.keep(path, "chain", [Figure("a pair", 0.98, "ms", most=1.0), Figure("all", 250.0, "s")])
    store.keep(path, "growth", [Figure("a pair", 3.0, "ms", along="LEDs", at=6.0)])
    store.keep(path, "batch", [Figure("two cores", 1.7, least=1.8)])
    for _ in range(2):
        store.write_page(path, page)
    text = page.read_text()
    assert text.startswith("before\n")
    assert text.endswith("\nafter\n")
    assert "stale" not in text
    assert text.count("| a pair | 0.98 ms | at most 1 ms | yes |") == 1
    assert "| two cores | 1.7 | at least 1.8 | **no** |" in text
    assert "| all | 250 s |" in text
    assert "| a pair | LEDs | 6 | 3 ms |" in text
    assert f"{store.machine()['cores']} cores" in text


def test_another_machine_s_figures_are_not_mixed_in(tmp_path: Path) -> None:
    path = tmp_path / "bench.json"
    store.keep(path, "chain", [Figure("a pair", 1.0)])
    path.write_text(path.read_text().replace('"cores": ', '"cores": 1'))
    store.keep(path, "ik", [Figure("a pose", 1.0)])
    assert list(json.loads(path.read_text())["benches"]) == ["ik"]


def test_a_name_that_is_no_benchmark_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["nonsense"]) == 2
    assert "no benchmark is called nonsense" in capsys.readouterr().out


def test_the_page_has_every_mark() -> None:
    text = store.PAGE.read_text()
    for name in ("machine", "goals", "growth", "figures"):
        assert text.count(store.BEGIN.format(name)) == text.count(store.END.format(name)) == 1
