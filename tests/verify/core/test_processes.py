"""Child processes: ready, asked, late, failed, lost, stopped; and their priority."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import pytest

from tests.support.processes import running, wait_until
from verify.core.processes import (
    NICENESS,
    READY,
    ChildFailedError,
    ChildLateError,
    ChildLostError,
    ChildProcess,
    ParentLine,
    answer_requests,
    lower_priority,
    wait_for_any,
)

pytestmark = pytest.mark.realtime

LIMIT = 60.0  # s for a start on a busy machine
STARTS_A_CHILD = """
import sys
from tests.verify.core.test_processes import sleeping
if __name__ == "__main__":
    child = sleeping()
    print(child._process.pid, flush=True)
    sys.stdin.read()
"""


def root(number: float) -> float:
    if number < 0:
        raise ValueError(f"{number:g} has none")
    return float(number**0.5)


def talk_before_ready(line: ParentLine, text: str) -> None:
    line.send("note", text)
    line.send(READY, len(text))
    line.send("note", line.receive())


def start_slowly(line: ParentLine, computing: bool) -> None:
    until = time.monotonic() + 4.0
    while time.monotonic() < until:
        time.sleep(0.0 if computing else 0.1)
    line.send(READY, "late")


def sleep_for_ever(line: ParentLine) -> None:
    line.send(READY)
    time.sleep(1000.0)


def sleeping() -> ChildProcess[None, None]:
    child: ChildProcess[None, None] = ChildProcess(sleep_for_ever, name="sleeps")
    child.wait_until_ready(LIMIT)
    return child


@pytest.fixture
def roots() -> Iterator[ChildProcess[float, float]]:
    child: ChildProcess[float, float] = ChildProcess(answer_requests, root, name="roots")
    yield child
    child.stop()


def test_requests_are_answered_and_a_failure_costs_only_its_own_request(
    roots: ChildProcess[float, float],
) -> None:
    assert roots.ask(4.0, LIMIT) == 2.0
    with pytest.raises(ChildFailedError, match="ValueError: -1 has none"):
        roots.ask(-1.0, LIMIT)
    assert roots.ask(9.0, LIMIT) == 3.0
    assert roots.is_ready()


def test_a_start_is_waited_for_while_it_computes_and_not_where_it_hangs() -> None:
    busy: ChildProcess[None, None] = ChildProcess(start_slowly, True, name="busy")
    hung: ChildProcess[None, None] = ChildProcess(start_slowly, False, name="hung")
    try:
        time.sleep(2.0)  # while it imports it computes too
        with pytest.raises(ChildLateError, match="no answer"):
            hung.wait_until_ready(1.5)
        assert busy.wait_until_ready(2.5) == "late"
    finally:
        busy.stop(0.0)
        hung.stop(0.0)


def test_a_late_answer_is_not_taken_for_the_next_one(roots: ChildProcess[float, float]) -> None:
    roots.wait_until_ready(LIMIT)
    os.kill(roots._process.pid, signal.SIGSTOP)
    for number in (4.0, 9.0):
        with pytest.raises(ChildLateError, match="no answer within"):
            roots.ask(number, 0.01)
    os.kill(roots._process.pid, signal.SIGCONT)
    assert wait_for_any([roots]) == [roots]
    assert roots.answered()
    assert roots.ask(16.0, LIMIT) == 4.0


def test_a_child_process_that_is_killed_or_cannot_start_is_lost() -> None:
    child = sleeping()
    os.kill(child._process.pid, signal.SIGKILL)
    with pytest.raises(ChildLostError, match="ended"):
        child.receive(LIMIT)
    child.stop()
    broken: ChildProcess[float, float] = ChildProcess(answer_requests, root, root, name="broken")
    with pytest.raises(ChildFailedError, match="TypeError"):
        broken.wait_until_ready(LIMIT)
    broken.stop()


def test_messages_before_it_is_ready_are_kept() -> None:
    child: ChildProcess[str, None] = ChildProcess(talk_before_ready, "early", name="talks")
    assert child.wait_until_ready(LIMIT) == len("early")
    child.send("late")
    assert [child.receive(LIMIT), child.receive(LIMIT)] == [("note", "early"), ("note", "late")]
    child.stop()


def test_stopping_terminates_what_does_not_end_by_itself() -> None:
    child = sleeping()
    child.stop(0.1)
    assert not running(child._process.pid)


linux = pytest.mark.skipif(sys.platform != "linux", reason="a matter of Linux")


@linux
def test_one_thread_has_low_priority_and_the_others_do_not() -> None:
    before, seen = os.getpriority(os.PRIO_PROCESS, 0), []

    def work() -> None:
        lower_priority()
        seen.append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id()))
        seen.append(os.sched_getscheduler(0))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [min(before + NICENESS, 19), os.SCHED_BATCH]
    assert os.sched_getscheduler(0) == os.SCHED_OTHER
    assert os.getpriority(os.PRIO_PROCESS, 0) == before


@linux
def test_a_child_process_ends_with_the_process_that_started_it() -> None:
    command = [sys.executable, "-c", STARTS_A_CHILD]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as parent:
        child = int(parent.stdout.readline())
        parent.kill()
    wait_until(lambda: not running(child), LIMIT)


def test_outside_linux_no_priority_is_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    for name in ("nice", "sched_setscheduler"):
        monkeypatch.delattr(os, name, raising=False)
    lower_priority()
