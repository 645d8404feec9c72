"""A batch from end to end: measure what is missing, report the progress, write the tables."""

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from verify.core.records import Progress
from verify.errors import InputError, one_line
from verify.fleet.batch.cluster import Cluster
from verify.fleet.batch.records import (
    COPY,
    KILLED,
    MAX_ATTEMPTS,
    REFUSED,
    BatchOptions,
    SessionFailure,
    SessionLocation,
    SessionResults,
    Task,
    WorkerDied,
    printable_path,
)
from verify.fleet.batch.store import ResultStore
from verify.fleet.batch.tasks import CompareTask, MeasureTask, ReportTask
from verify.fleet.batch.workers import ProcessPool
from verify.io.files import FolderTakenError

WorkerPool = ProcessPool | Cluster


@dataclass(slots=True)
class BatchProgress:
    """Counts; `watch` is called after each change."""

    sessions: int  # that were found
    kept: int = 0  # from an earlier batch
    again: list[str] = field(default_factory=list)  # measured again: their inputs have changed
    measured: int = 0
    pairs: int = 0  # measured now
    failures: list[SessionFailure] = field(default_factory=list)
    begun: float = field(default_factory=time.monotonic)  # s

    @property
    def done(self) -> int:
        """Sessions of which nothing more is to come."""
        return self.kept + self.measured + len(self.failures)

    @property
    def pairs_a_second(self) -> float | None:
        """Pairs a second since work began; None before the first."""
        spent = time.monotonic() - self.begun
        return self.pairs / spent if self.pairs and spent > 0 else None

    @property
    def time_left(self) -> float | None:
        """Seconds until the last session, if the rest is like those measured now."""
        worked = self.measured + len(self.failures)
        if not worked:
            return None
        return (time.monotonic() - self.begun) / worked * (self.sessions - self.done)


ProgressCallback = Callable[[BatchProgress], None]


@dataclass(frozen=True, slots=True)
class BatchResult:
    """What a batch has come to."""

    kept: list[tuple[str, Path]]  # measured sessions by name, and where their results are
    failures: list[SessionFailure]  # by name; with the copies, of kind COPY
    progress: BatchProgress

    @property
    def failed(self) -> list[SessionFailure]:
        """Failures without the copies."""
        return [failure for failure in self.failures if failure.kind != COPY]


def measure_all(
    found: Sequence[SessionLocation],
    failures: Sequence[SessionFailure],
    out: Path,
    options: BatchOptions,
    pool: WorkerPool,
    watch: ProgressCallback,
) -> BatchResult:
    """Measure every session that is not done yet; each is kept in `out` as soon as it is done.

    `failures` are what could not even be looked into; `watch` is called after every session.

    Raises:
        InputError: `out` cannot be written.
    """
    work = _TaskQueue(ResultStore(out), options, BatchProgress(len(found) + len(failures)))
    work.progress.failures += failures
    for one in found:
        work.begin(one)
    watch(work.progress)
    if work.waiting:
        pool.ready()
    work.progress.begun = time.monotonic()  # loading says nothing of what is to come
    for task, outcome in pool.run(work.waiting):
        work.take(task, outcome)
        watch(work.progress)
    first: dict[frozenset[str], str] = {}
    copies = []
    for session, inputs in sorted(work.done.items()):
        recorded = frozenset(was for name, was in inputs.items() if not name.endswith(".toml"))
        if (original := first.setdefault(recorded, session)) != session:
            why = f"{session}: holds the same recording as {original}, and is not counted again."
            copies.append(SessionFailure(session, COPY, one_line(f"{why} Delete one of them.")))
    kept = [(session, work.store.place(session)) for session in sorted(first.values())]
    return BatchResult(kept, sorted([*work.progress.failures, *copies]), work.progress)


def report_all(batch: BatchResult, pool: WorkerPool, watch: Progress) -> None:
    """Write the own report of each session that has none yet, by a pool on this machine.

    `watch` is called with the number written and the number of all.
    """
    missing = [place for _, place in batch.kept if not (place / "report.pdf").exists()]
    waiting: deque[Task] = deque(ReportTask(str(place)) for place in missing)
    for number, _ in enumerate(pool.run(waiting), start=1):
        watch(number, len(missing))


class _TaskQueue:
    """What is to be done, and what each outcome leads to."""

    def __init__(self, store: ResultStore, options: BatchOptions, progress: BatchProgress) -> None:
        self.store, self.options, self.progress = store, options, progress
        self.waiting: deque[Task] = deque()
        self.done: dict[str, dict[str, str]] = {}  # inputs by session

    def begin(self, one: SessionLocation) -> None:
        """Take a session up: measure it, or see whether what was kept still holds."""
        kept = self.store.kept(one.session)
        if kept is not None and kept.options == self.options.described:
            self.waiting.append(CompareTask(one, kept.inputs))
            return
        if kept is not None:
            again = f"{one.session}: was measured with other options or another version"
            self.progress.again.append(again)
        self.waiting.append(MeasureTask(one, self.options))

    def take(self, task: Task, outcome: Any) -> None:
        """Act on what came of a task."""
        found: SessionLocation = task.found  # type: ignore[attr-defined]  # all tasks here are a session's
        if isinstance(outcome, SessionResults):
            self._keep(outcome)
        elif isinstance(task, CompareTask) and isinstance(outcome, list):
            self._compared(task, outcome)
        else:
            self.progress.failures.append(
                _worker_failure(found) if isinstance(outcome, WorkerDied) else outcome
            )

    def _keep(self, measured: SessionResults) -> None:
        try:
            self.store.keep(measured, self.options)
        except FolderTakenError as taken:
            found = f"another batch has written its results to {taken.place} meanwhile"
            expected = "results of the same options and files are shared"
            why = str(InputError(measured.session, found, expected, "Give each batch its own -o."))
            failure = SessionFailure(measured.session, REFUSED, printable_path(why))
            self.progress.failures.append(failure)
            return
        self.progress.measured += 1
        self.progress.pairs += measured.pairs
        self.done[measured.session] = measured.inputs

    def _compared(self, task: CompareTask, changed: list[str]) -> None:
        if not changed:
            self.progress.kept += 1
            self.done[task.found.session] = task.inputs
            return
        self.progress.again.append(f"{task.found.session}: changed since: {', '.join(changed)}")
        self.waiting.append(MeasureTask(task.found, self.options))


def _worker_failure(found: SessionLocation) -> SessionFailure:
    why = (
        f"{found.session}: the process that measured it was killed {MAX_ATTEMPTS} times; it may "
        "need more memory than there is. Measure it alone with `verify run`."
    )
    return SessionFailure(found.session, KILLED, printable_path(one_line(why)))
