"""Processes on this machine: tasks are done once each, and a killed one costs itself alone."""

import multiprocessing
import os
import signal
import subprocess
import sys
from collections import deque
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support.processes import running, wait_until
from verify.fleet.batch import workers
from verify.fleet.batch.records import MAX_ATTEMPTS, Task, WorkerDied
from verify.fleet.batch.workers import ProcessPool


@dataclass(frozen=True)
class Square:
    number: int

    def perform(self) -> int:
        return self.number**2


@dataclass(frozen=True)
class Pid:
    number: int

    def perform(self) -> int:
        return os.getpid()


@dataclass(frozen=True)
class Dies:
    """Kills its own process the first so many times; a file remembers how often."""

    memory: str
    times: int

    def perform(self) -> str:
        tally = Path(self.memory)
        before = len(tally.read_text()) if tally.exists() else 0
        tally.write_text("x" * (before + 1))
        if before < self.times:
            os.kill(os.getpid(), signal.SIGKILL)
        return f"alive after {before}"


@pytest.fixture(autouse=True)
def _empty_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    """These tasks need nothing of what takes a worker seconds to load."""
    monkeypatch.setattr(workers, "_load", int)


@pytest.fixture
def pool() -> Iterator[ProcessPool]:
    pool = ProcessPool(2)
    yield pool
    pool.close()


def test_every_task_is_done_once_and_tasks_may_be_added(pool: ProcessPool) -> None:
    tasks: deque[Task] = deque(Square(n) for n in range(4))
    outcomes = []
    for _task, outcome in pool.run(tasks):
        if outcome == 4:
            tasks.append(Square(10))
        outcomes.append(outcome)
    assert sorted(outcomes) == [0, 1, 4, 9, 100]


def test_workers_continue_while_results_are_stored(tmp_path: Path) -> None:
    tasks = [Dies(f"{tmp_path}/{name}", 0) for name in "ab"]
    with closing(ProcessPool(1)) as pool:
        outcomes = pool.run(deque(tasks))
        assert next(outcomes) == (tasks[0], "alive after 0")
        wait_until((tmp_path / "b").exists)  # though nobody has asked for it yet
        assert next(outcomes) == (tasks[1], "alive after 0")


def test_a_worker_loads_nothing_that_it_may_never_need() -> None:
    late = ("matplotlib", "plotly", "typst", "jinja2", "av", "scipy.stats", "scipy.optimize")
    code = f"import sys, verify.fleet.batch.tasks; print([m for m in {late} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.slow
def test_a_task_whose_process_is_killed_is_tried_again_then_given_up(
    pool: ProcessPool, tmp_path: Path
) -> None:
    twice, always = Dies(f"{tmp_path}/a", 2), Dies(f"{tmp_path}/b", 99)
    tasks: deque[Task] = deque([twice, always, *(Square(n) for n in range(3))])
    outcomes = {task: outcome for task, outcome in pool.run(tasks)}  # noqa: C416
    assert outcomes[twice] == "alive after 2"
    assert outcomes[always] == WorkerDied()
    assert [outcomes[Square(n)] for n in range(3)] == [0, 1, 4]
    assert (tmp_path / "b").read_text() == "x" * MAX_ATTEMPTS


def test_inner_loops_are_compiled_before_workers_would(monkeypatch: pytest.MonkeyPatch) -> None:
    others, during = len(multiprocessing.active_children()), []

    def compiled() -> None:
        during.append(len(multiprocessing.active_children()))

    monkeypatch.setattr(workers, "library_folder", compiled)
    with closing(ProcessPool(2)):
        assert during == [others]


@pytest.mark.slow
def test_a_process_that_is_killed_while_it_has_nothing_to_do_is_replaced() -> None:
    with closing(ProcessPool(1)) as pool:
        pool.ready()
        ((_, pid),) = pool.run(deque([Pid(0)]))
        os.kill(pid, signal.SIGKILL)
        wait_until(lambda: not running(pid))
        signal.sigtimedwait([signal.SIGUSR2], 0.5)  # until the pool's own thread has noticed
        ((_, other),) = pool.run(deque([Pid(1)]))
    assert other != pid


@pytest.mark.slow
def test_closing_sends_every_process_home(pool: ProcessPool) -> None:
    tasks: deque[Task] = deque([Pid(0), Pid(1)])
    pids = [outcome for _, outcome in pool.run(tasks)]
    pool.close()
    for pid in pids:
        wait_until(lambda pid=pid: not running(pid))


def test_a_worker_that_ends_already_removes_what_it_fetched_whatever_ends_it() -> None:
    code = """
import atexit, os, signal, weakref
from verify.fleet.batch import workers
class Session: pass
fetched = Session()
weakref.finalize(fetched, print, "removed")
weakref.finalize(fetched, os.kill, os.getpid(), signal.SIGTERM)  # the last one made runs first
signal.signal(signal.SIGTERM, workers._exit)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "removed\n", "")
