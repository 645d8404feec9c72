"""Worker processes on this machine: a killed one costs its own task another attempt, no more."""

import os
import signal
import sys
import threading
from collections import Counter, deque
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from typing import Any

from verify.core import processes
from verify.core.native import library_folder
from verify.fleet.batch.records import MAX_ATTEMPTS, Task, WorkerDied, perform

Worker = processes.ChildProcess[Task, Any]


class ProcessPool:
    """Worker processes on this machine; they start at once."""

    def __init__(self, workers: int) -> None:
        library_folder()  # or each would compile the inner loops
        self._workers = workers
        self._idle: list[Worker] = [self._start() for _ in range(workers)]
        self._busy: dict[Worker, Task] = {}

    def ready(self) -> None:
        """Wait until the first worker is ready."""
        with suppress(processes.ChildLostError):  # it is replaced when it gets its first task
            self._idle[-1].wait_until_ready()

    def run(self, tasks: deque[Task]) -> Iterator[tuple[Task, Any]]:
        """Perform tasks, taken from the left; yield each with its outcome, as they finish.

        It ends when none is left or under way; the caller may append further ones meanwhile. As
        many are under way as there are workers, or few more: memory follows the workers, not the
        tasks. The outcome is `WorkerDied` where its worker died each time.
        """
        died: Counter[int] = Counter()
        while tasks or self._busy:
            self._hand_out(tasks)
            finished = []
            for worker in processes.wait_for_any(self._busy):
                try:
                    if not worker.answered():  # it has only become ready
                        continue
                    outcome = worker.finish(0.0)
                    self._idle.append(worker)
                except processes.ChildFailedError:
                    raise
                except processes.ChildLostError:
                    worker.stop(0.0)
                    died[id(self._busy[worker])] += 1
                    if died[id(self._busy[worker])] < MAX_ATTEMPTS:
                        tasks.appendleft(self._busy.pop(worker))
                        continue
                    outcome = WorkerDied()
                task = self._busy.pop(worker)
                died.pop(id(task), None)
                finished.append((task, outcome))
            self._hand_out(tasks)  # workers go on while the caller stores what was done
            yield from finished

    def _hand_out(self, tasks: deque[Task]) -> None:
        while tasks and len(self._busy) < self._workers:
            worker = self._idle.pop() if self._idle else self._start()
            try:
                worker.begin(tasks[0])
            except processes.ChildLostError:  # it died while it had nothing to do
                worker.stop(0.0)
                continue
            self._busy[worker] = tasks.popleft()

    def close(self) -> None:
        """End the workers; tasks under way are dropped."""
        for worker in [*self._idle, *self._busy]:
            worker.stop(0.0)
        self._idle, self._busy = [], {}

    def _start(self) -> Worker:
        threads = 1 if self._workers >= available_cpus() else available_cpus()
        return processes.ChildProcess(
            processes.answer_requests, perform, partial(_load, threads), name="batch worker"
        )


def _load(threads: int) -> None:
    """Load all that measuring takes, in a worker; so many threads decode."""
    signal.signal(signal.SIGTERM, _exit)
    import cv2

    from verify.fleet.batch import tasks  # noqa: F401  its libraries are loaded with it
    from verify.measurement.chain import warm_up

    cv2.setNumThreads(threads)
    with suppress(Exception):  # whatever is wrong, the first session's failure says it better
        warm_up()


def _exit(_signal: int, _frame: object) -> None:
    """End, unless it ends already: fetched sessions are removed on the way out."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    if threading.main_thread().is_alive():
        sys.exit(1)


def available_cpus() -> int:
    """Count the processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
