"""Which work a batch does, with a crew that works in this process."""

import shutil
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import fsspec
import pytest

from tests.support.fleets import PAIRS, record
from verify.analysis.session import analyse
from verify.cli.options import ToleranceOptions
from verify.fleet.batch import tasks
from verify.fleet.batch.finding import find_sessions
from verify.fleet.batch.records import COPY, DEFECT, KILLED, BatchOptions, Task, WorkerDied
from verify.fleet.batch.run import BatchResult, measure_all
from verify.fleet.batch.store import ResultStore
from verify.io.results import read_results
from verify.io.session.session import open_session

OPTIONS = BatchOptions(ToleranceOptions(None, None, None), "1.0")


class Inline:
    """Does each task at once; loses those whose kind is named."""

    def __init__(self, lost: str = "") -> None:
        self.lost = lost
        self.kinds: list[str] = []
        self.loaded = False

    def ready(self) -> None:
        self.loaded = True

    def run(self, waiting: deque[Task]) -> Iterator[tuple[Task, Any]]:
        while waiting:
            task = waiting.popleft()
            kind = type(task).__name__
            self.kinds.append(kind)
            yield task, WorkerDied() if kind == self.lost else task.perform()

    def close(self) -> None:
        """Nobody to send home."""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lab")
    record(folder / "one", 1)
    return folder


@pytest.fixture
def lab(recorded: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(recorded, tmp_path / "lab"))


def batch(
    root: Path | str, out: Path, crew: Inline, options: BatchOptions = OPTIONS
) -> BatchResult:
    found, failures = find_sessions([str(root)], out)
    counts: list[int] = []
    watch = lambda progress: counts.append(progress.done)  # noqa: E731
    done = measure_all(found, failures, out, options, crew, watch)
    assert counts == sorted(counts)
    assert counts[-1] == len(found) + len(failures)
    return done


def test_a_rate_counts_from_when_a_worker_could_begin(
    lab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    crew, hour = Inline(), 3600.0
    late = SimpleNamespace(monotonic=lambda: time.monotonic() + hour * crew.loaded)
    monkeypatch.setattr("verify.fleet.batch.run.time", late)
    rate = batch(lab, tmp_path / "out", crew).progress.pairs_a_second
    assert rate > PAIRS / hour


def test_a_second_run_measures_only_changed_sessions(lab: Path, tmp_path: Path) -> None:
    shutil.copytree(lab / "one", lab / "two")
    out = tmp_path / "out"
    batch(lab, out, first := Inline())
    assert first.kinds == ["MeasureTask", "MeasureTask"]
    again = batch(lab, out, second := Inline())
    assert second.kinds == ["CompareTask", "CompareTask"]
    assert again.progress.kept == 2
    readings = lab / "two" / "encoders.csv"
    readings.write_text(readings.read_text().rsplit("\n", 2)[0] + "\n")
    (lab / "one" / "truth.csv").write_text("never read")
    changed = batch(lab, out, third := Inline())
    assert sorted(third.kinds) == ["CompareTask", "CompareTask", "MeasureTask"]
    assert changed.progress.again == [f"{lab}/two: changed since: encoders.csv"]
    other = BatchOptions(ToleranceOptions("0.5", None, None), "1.0")
    redone = batch(lab, out, fourth := Inline(), other)
    assert fourth.kinds == ["MeasureTask", "MeasureTask"]
    assert all("other options" in line for line in redone.progress.again)


def test_a_copy_is_named_and_not_counted_again(lab: Path, tmp_path: Path) -> None:
    shutil.copytree(lab / "one", lab / "two")
    settings = lab / "two" / "session.toml"
    settings.write_text(settings.read_text() + "# copied\n")
    rig = lab / "two" / "rig.toml"  # nor is it another recording by another calibration
    rig.write_text(rig.read_text() + "# calibrated again\n")
    for _ in range(2):  # measured, and kept from before
        done = batch(lab, tmp_path / "out", Inline())
        assert [name for name, _ in done.kept] == [f"{lab}/one"]
        (copy,) = done.failures
        assert copy.kind == COPY
        assert copy.why.startswith(f"{lab}/two: holds the same recording as {lab}/one")
        assert not done.failed


def test_dead_workers_are_reported_and_a_program_error_does_not_stop_the_others(
    lab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = batch(lab, tmp_path / "lost", Inline(lost="MeasureTask"))
    assert not done.kept
    (failure,) = done.failures
    assert failure.kind == KILLED
    assert "killed 3 times" in failure.why
    shutil.copytree(lab / "one", lab / "two")
    plain = tasks.analyse

    def broken(session: Any, **options: Any) -> Any:
        if session.name == "one":
            raise ZeroDivisionError("nobody\nthought of it")
        return plain(session, **options)

    monkeypatch.setattr(tasks, "analyse", broken)
    done = batch(lab, tmp_path / "out", Inline())
    assert [name for name, _ in done.kept] == [f"{lab}/two"]
    assert done.failures[0].kind == DEFECT
    assert "\n" not in done.failures[0].why


def test_the_same_results_of_another_batch_are_left(
    lab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, crew = tmp_path / "out", Inline()
    entry = ResultStore(out).place(f"{lab}/one") / "entry.json"
    theirs: list[int] = []

    def overtaken(waiting: deque[Task]) -> Iterator[tuple[Task, Any]]:
        task = waiting.popleft()
        batch(lab, out, Inline())
        theirs.append(entry.stat().st_ino)
        yield task, task.perform()

    monkeypatch.setattr(crew, "run", overtaken)
    assert [name for name, _ in batch(lab, out, crew).kept] == [f"{lab}/one"]
    assert theirs == [entry.stat().st_ino]


@pytest.mark.parametrize("tolerance", [None, "0.5"], ids=["same options", "other options"])
def test_another_batch_that_writes_a_session_first_does_not_stop_this_one(
    tolerance: str | None, lab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, plain = tmp_path / "out", ResultStore._remove

    def overtaken(store: ResultStore, folder: Path) -> None:
        plain(store, folder)
        monkeypatch.setattr(ResultStore, "_remove", plain)
        options = BatchOptions(ToleranceOptions(tolerance, None, None), "1.0")
        batch(lab, out, Inline(), options)

    monkeypatch.setattr(ResultStore, "_remove", overtaken)
    done = batch(lab, out, Inline())
    if tolerance is None:
        assert [name for name, _ in done.kept] == [f"{lab}/one"]
    else:
        (failure,) = done.failures
        assert failure.why.startswith(f"{lab}/one: another batch has written its results to {out}")


def test_a_session_behind_a_url_gives_the_same_figures_under_its_own_name(
    lab: Path, tmp_path: Path
) -> None:
    storage = fsspec.filesystem("memory")
    try:
        storage.put(str(lab / "one"), "/lab/one", recursive=True)
        out = tmp_path / "out"
        ((name, place),) = batch("memory://lab", out, Inline()).kept
        assert name.startswith("memory://")
        kept, plain = read_results(place), analyse(open_session(lab / "one"))
        assert kept.summary["joints"] == plain.summary["joints"]
        assert not any(str(tmp_path) in text or "/tmp" in text for text in kept.summary["warnings"])
        assert batch("memory://lab", out, second := Inline()).progress.kept == 1
        assert second.kinds == ["CompareTask"]
        storage.pipe("/lab/one/encoders.csv", b"t_s\n")
        failed = batch("memory://lab", out, Inline())
        assert failed.failures[0].why.startswith(f"{name}/encoders.csv")
    finally:
        storage.rm("/lab", recursive=True)
