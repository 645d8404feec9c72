from pathlib import Path

import pytest

from tests.support.command import verify
from tests.support.simulated import MINIMAL, SMALL_BOARDS
from verify.cli.simulate import simulate
from verify.errors import InputError


@pytest.fixture
def scenario(tmp_path: Path) -> str:
    path = tmp_path / "mine.toml"
    path.write_text(MINIMAL)
    return str(path)


def test_the_command_writes_a_session(scenario: str, tmp_path: Path) -> None:
    assert verify("simulate", scenario, "-o", tmp_path / "out", "--seed", "3").status == 0
    assert (tmp_path / "out" / "left.mkv").exists()
    assert "seed 3" in (tmp_path / "out" / "README.md").read_text()


def test_a_folder_that_is_not_empty_is_refused_without_force(scenario: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "precious.txt").write_text("mine")
    with pytest.raises(InputError, match="not empty"):
        simulate(scenario, out)
    assert [p.name for p in out.iterdir()] == ["precious.txt"]
    simulate(scenario, out, force=True)
    assert (out / "precious.txt").read_text() == "mine"
    assert (out / "session.toml").exists()


def test_nothing_of_another_recording_stays_beside_the_new_one(tmp_path: Path) -> None:
    """Fewer pictures than were there, or a recording of another kind: refused, all as it was."""
    out, boards, session = tmp_path / "out", tmp_path / "boards.toml", tmp_path / "session.toml"
    boards.write_text(SMALL_BOARDS.format(pairs=2))
    session.write_text(MINIMAL)
    simulate(str(boards), out)
    simulate(str(boards), out, force=True)  # as many again
    before = {file: file.read_bytes() for file in out.rglob("*.*")}
    boards.write_text(SMALL_BOARDS.format(pairs=1))
    for scenario, remains in ((boards, "left/000001.png"), (session, "board.toml")):
        with pytest.raises(InputError, match=f"{out / remains}: would stay"):
            simulate(str(scenario), out, force=True)
    assert {file: file.read_bytes() for file in out.rglob("*.*")} == before


@pytest.mark.parametrize(
    ("line", "instead", "words"),
    [
        ('robot = "iust_6r"', 'robot = "iust_5r"', "robot.*iust_6r"),
        ("home_deg = [30.0,", "home_deg = [300.0,", "mine.toml, motion.*joint 1"),
    ],
)
def test_a_scenario_that_cannot_be_played_leaves_nothing_behind(
    tmp_path: Path, line: str, instead: str, words: str
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(MINIMAL.replace(line, instead))
    with pytest.raises(InputError, match=words):
        simulate(str(path), tmp_path / "out")
    assert [p.name for p in tmp_path.iterdir()] == ["mine.toml"]
