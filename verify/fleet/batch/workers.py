"""Processes on this machine, one a worker: a killed one costs its own task and nothing else.

Where workers come from: copies of one process that has everything loaded, on Linux.

Several workers load nothing twice, share what they do not change, and one that dies is replaced at
once. The process is a fresh interpreter: threads and open videos of this one stay out of it.
Elsewhere libraries of the system do not bear being copied: each worker is a fresh interpreter.
"""

import os
import signal
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from multiprocessing import get_context, parent_process
from multiprocessing.context import BaseContext
from typing import Any, Protocol

import cv2

from verify.fleet.batch.records import Task, WorkerDied

PRELOAD_MODULE = "verify.fleet.batch.preload"


def worker_context() -> BaseContext:
    """Give what starts workers."""
    if sys.platform != "linux":
        return get_context("spawn")
    chosen = get_context("forkserver")
    chosen.set_forkserver_preload(["__main__", PRELOAD_MODULE])
    return chosen


def prepare() -> None:
    """Have everything loaded for workers to come, while this process does other things.

    Of the main thread alone.
    """
    if sys.platform != "linux":
        return
    worker_context()
    from multiprocessing import forkserver  # not everywhere

    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the one who started it
    try:
        forkserver.ensure_running()
    finally:
        signal.signal(signal.SIGINT, before)


MAX_ATTEMPTS = 3  # of a task whose worker dies: the first, and twice again
MAX_STARTS, RESTART_DELAY = 100, 0.1  # of a worker at most, and s in between


class WorkerPool(Protocol):
    """Workers, wherever they are."""

    def ready(self, tasks: int) -> None:
        """Wait until somebody can begin with so many tasks, 1 at least."""

    def run(self, tasks: deque[Task]) -> Iterator[tuple[Task, Any]]:
        """Have tasks done, taking from the left, until none is left or under way.

        Whoever reads may append further ones meanwhile. As many are under way as there are
        workers, or few more: memory follows the workers, not the tasks.

        Yields:
            Each task with what came of it, as they finish; `WorkerDied` where its worker died each time.
        """

    def close(self) -> None:
        """Send the workers home; what they were at is dropped."""


class ProcessPool:
    """A crew of processes on this machine.

    Args:
        workers: how many.
    """

    def __init__(self, workers: int) -> None:
        self._crowded = workers >= available_cpus()
        self._idle: list[_Worker] = [_Worker(self._crowded) for _ in range(workers)]
        self._busy: dict[Future[Any], tuple[_Worker, Task]] = {}

    def ready(self, tasks: int) -> None:
        """Start as many workers as there are tasks for; wait until the first one has loaded all."""
        starting = self._idle[-tasks:]
        for worker in starting:
            worker.begin()
        starting[-1].wait()

    def run(self, tasks: deque[Task]) -> Iterator[tuple[Task, Any]]:
        """Have tasks done; see `WorkerPool`."""
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
                    if died[id(task)] < MAX_ATTEMPTS:
                        tasks.appendleft(task)
                        self._idle.append(worker)
                        continue
                    outcome = WorkerDied(MAX_ATTEMPTS)
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
            self._pool, self._process = _start_worker(self._crowded)
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


def _start_worker(crowded: bool) -> tuple[ProcessPoolExecutor, Future[int]]:
    """Start a process; it will tell its number."""
    tries = 0
    while True:
        pool = ProcessPoolExecutor(1, worker_context(), _initialise_worker, (crowded,))
        try:
            return pool, pool.submit(os.getpid)
        except (EOFError, ConnectionError):  # where workers come from is dying this moment
            pool.shutdown(wait=False)
            tries += 1
            if tries == MAX_STARTS:
                raise
            time.sleep(RESTART_DELAY)


def _initialise_worker(crowded: bool) -> None:
    """Leave Ctrl-C to the one who started us, and go when that one is gone."""
    # crowded: the others have the other processors; decoding heeds it too
    cv2.setNumThreads(1 if crowded else available_cpus())
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _exit)
    threading.Thread(target=_exit_with_parent, daemon=True).start()


def _exit(_signal: int, _frame: object) -> None:
    raise SystemExit(1)  # what was fetched to this machine is removed on the way out


def _exit_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def available_cpus() -> int:
    """Count the processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
