"""Processes on this machine, one a worker: a killed one costs its own task and nothing else."""

import os
import signal
import threading
import time
from collections import Counter, deque
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from multiprocessing import parent_process
from typing import Any, Protocol

import cv2

from verify.batch.nursery import context
from verify.batch.records import Lost, Task

TRIES = 3  # of a task whose worker dies: the first, and twice again
STARTS, PAUSE = 100, 0.1  # of a worker at most, and s in between


class Crew(Protocol):
    """Workers, wherever they are."""

    def ready(self, tasks: int) -> None:
        """Wait until somebody can begin with so many tasks, 1 at least."""

    def run(self, tasks: deque[Task]) -> Iterator[tuple[Task, Any]]:
        """Have tasks done, taking from the left, until none is left or under way.

        Whoever reads may append further ones meanwhile. As many are under way as there are
        workers, or few more: memory follows the workers, not the tasks.

        Yields:
            Each task with what came of it, as they finish; `Lost` where its worker died each time.
        """

    def close(self) -> None:
        """Send the workers home; what they were at is dropped."""


class Processes:
    """A crew of processes on this machine.

    Args:
        workers: how many.
    """

    def __init__(self, workers: int) -> None:
        self._crowded = workers >= processors()
        self._idle: list[_Worker] = [_Worker(self._crowded) for _ in range(workers)]
        self._busy: dict[Future[Any], tuple[_Worker, Task]] = {}

    def ready(self, tasks: int) -> None:
        """Start as many workers as there are tasks for; wait until the first one has loaded all."""
        starting = self._idle[-tasks:]
        for worker in starting:
            worker.begin()
        starting[-1].wait()

    def run(self, tasks: deque[Task]) -> Iterator[tuple[Task, Any]]:
        """Have tasks done; see `Crew`."""
        died: Counter[int] = Counter()
        while tasks or self._busy:
            self._set_to_work(tasks)
            finished = []
            for future in wait(self._busy, return_when=FIRST_COMPLETED).done:
                worker, task = self._busy.pop(future)
                try:
                    outcome = future.result()
                except BrokenProcessPool:
                    worker.close()
                    worker = _Worker(self._crowded)
                    died[id(task)] += 1
                    if died[id(task)] < TRIES:
                        tasks.appendleft(task)
                        self._idle.append(worker)
                        continue
                    outcome = Lost(TRIES)
                died.pop(id(task), None)
                self._idle.append(worker)
                finished.append((task, outcome))
            self._set_to_work(tasks)  # nobody waits until what was done is put away
            yield from finished

    def _set_to_work(self, tasks: deque[Task]) -> None:
        while tasks and self._idle:
            worker, task = self._idle.pop(), tasks.popleft()
            self._busy[worker.start(task)] = worker, task

    def close(self) -> None:
        """Send the workers home; what they were at is dropped."""
        for worker in [*self._idle, *(worker for worker, _ in self._busy.values())]:
            worker.close()
        self._idle, self._busy = [], {}


class _Worker:
    """One process, started when it is needed; crowded: there are as many as processors."""

    def __init__(self, crowded: bool) -> None:
        self._crowded = crowded
        self._pool: ProcessPoolExecutor | None = None
        self._process: Future[int] | None = None

    def begin(self) -> ProcessPoolExecutor:
        if self._pool is None:
            self._pool, self._process = _begun(self._crowded)
        return self._pool

    def wait(self) -> None:
        if self._process is not None:
            with suppress(BrokenProcessPool):  # its first task will have another one
                self._process.result()

    def start(self, task: Task) -> Future[Any]:
        try:
            return self.begin().submit(task.perform)
        except BrokenProcessPool:  # it died while there was nothing to do
            self.close()
            return self.begin().submit(task.perform)

    def close(self) -> None:
        if self._pool is None:
            return
        self._pool.shutdown(wait=False, cancel_futures=True)
        if self._process is not None and self._process.done():
            with suppress(ProcessLookupError, BrokenProcessPool):  # it died before
                os.kill(self._process.result(), signal.SIGTERM)
        self._pool = None


def _begun(crowded: bool) -> tuple[ProcessPoolExecutor, Future[int]]:
    """Start a process; it will tell its number."""
    tries = 0
    while True:
        pool = ProcessPoolExecutor(1, context(), _settle, (crowded,))
        try:
            return pool, pool.submit(os.getpid)
        except (EOFError, ConnectionError):  # where workers come from is dying this moment
            pool.shutdown(wait=False)
            tries += 1
            if tries == STARTS:
                raise
            time.sleep(PAUSE)


def _settle(crowded: bool) -> None:
    """Leave Ctrl-C to the one who started us, and go when that one is gone."""
    # crowded: the others have the other processors; decoding heeds it too
    cv2.setNumThreads(1 if crowded else processors())
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _leave)
    threading.Thread(target=_leave_with_parent, daemon=True).start()


def _leave(_signal: int, _frame: object) -> None:
    raise SystemExit(1)  # what was fetched to this machine is removed on the way out


def _leave_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def processors() -> int:
    """Count the processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
