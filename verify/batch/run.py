"""A batch from end to end: what is missing is measured, then everything goes into tables."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from verify.batch import tables
from verify.batch.crew import Crew
from verify.batch.progress import Progress
from verify.batch.records import KILLED, Failure, Found, Lost, Measured, Options, Task, named
from verify.batch.store import Store
from verify.batch.tasks import Compare, Measure, Report
from verify.errors import one_line

Watch = Callable[[Progress], None]


@dataclass(frozen=True, slots=True)
class Batch:
    """What a batch has come to."""

    kept: list[tuple[str, Path]]  # measured sessions by name, and where their results are
    failures: list[Failure]  # by name
    progress: Progress


def measure_all(
    found: Sequence[Found],
    failures: Sequence[Failure],
    out: Path,
    options: Options,
    crew: Crew,
    watch: Watch,
) -> Batch:
    """Measure every session that is not done yet; each is kept in `out` as soon as it is done.

    Args:
        found: sessions, by name.
        failures: what could not even be looked into.
        out: the batch's folder.
        options: what the figures depend on beside the inputs.
        crew: who does it.
        watch: told after every session.

    Raises:
        InputError: `out` cannot be written.
    """
    work = _Work(Store(out), options, Progress(len(found) + len(failures)))
    work.progress.failures += failures
    for one in found:
        work.begin(one)
    watch(work.progress)
    if work.waiting:
        crew.ready(len(work.waiting))
    work.progress.begin()
    for task, outcome in crew.run(work.waiting):
        work.take(task, outcome)
        watch(work.progress)
    sessions = sorted(work.done)
    kept = [(session, work.store.place(session)) for session in sessions]
    return Batch(kept, sorted(work.progress.failures), work.progress)


def report_all(batch: Batch, crew: Crew, watch: Callable[[int, int], None]) -> None:
    """Write the own report of each session that has none yet.

    Args:
        batch: what was measured.
        crew: on this machine.
        watch: told how many of how many are written.
    """
    missing = [place for _, place in batch.kept if not (place / "report.pdf").exists()]
    waiting: deque[Task] = deque(Report(str(place)) for place in missing)
    for number, _ in enumerate(crew.run(waiting), start=1):
        watch(number, len(missing))


def write_tables(batch: Batch, folder: Path) -> None:
    """Write the tables of all measured sessions; failures.csv alone where there are none."""
    if batch.kept:
        tables.write(folder, batch.kept, batch.failures)
    else:
        tables.write_failures(folder, batch.failures)


class _Work:
    """What is to be done, and what each outcome leads to."""

    def __init__(self, store: Store, options: Options, progress: Progress) -> None:
        self.store, self.options, self.progress = store, options, progress
        self.waiting: deque[Task] = deque()
        self.done: list[str] = []

    def begin(self, one: Found) -> None:
        """Take a session up: measure it, or see whether what was kept still holds."""
        kept = self.store.kept(one.session)
        if kept is not None and kept.options == self.options.described:
            self.waiting.append(Compare(one, kept.inputs))
            return
        if kept is not None:
            again = f"{one.session}: was measured with other options or another version"
            self.progress.again.append(again)
        self.waiting.append(Measure(one, self.options))

    def take(self, task: Task, outcome: Any) -> None:
        """Act on what came of a task."""
        found: Found = task.found  # type: ignore[attr-defined]  # all tasks here are a session's
        if isinstance(outcome, Measured):
            self.store.keep(outcome, self.options)
            self.progress.measured += 1
            self.progress.pairs += outcome.pairs
            self.done.append(found.session)
        elif isinstance(task, Compare) and isinstance(outcome, list):
            self._compared(task, outcome)
        else:
            self.progress.failures.append(
                _killed(found, outcome) if isinstance(outcome, Lost) else outcome
            )

    def _compared(self, task: Compare, changed: list[str]) -> None:
        if not changed:
            self.progress.kept += 1
            self.done.append(task.found.session)
            return
        self.progress.again.append(f"{task.found.session}: changed since: {', '.join(changed)}")
        self.waiting.append(Measure(task.found, self.options))


def _killed(found: Found, lost: Lost) -> Failure:
    why = (
        f"{found.session}: the process that measured it was killed {lost.times} times; it may need "
        "more memory than there is. Measure it alone with `verify run`."
    )
    return Failure(found.session, KILLED, named(one_line(why)))
