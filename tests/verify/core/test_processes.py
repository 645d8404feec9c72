import ctypes
import os
import platform
import re
import subprocess
import sys
import threading

import pytest

from verify.core.processes import (
    ATTRIBUTES,
    NICENESS,
    SCHED_SETATTR,
    SHORT_SLICE_NS,
    lower_priority,
    request_short_slice,
    split_processors,
)

pytestmark = pytest.mark.realtime

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
@pytest.mark.parametrize("processors", [1, None])
def test_two_processes_share_no_processor_if_there_are_two(processors: int | None) -> None:
    everything = os.sched_getaffinity(0)
    usable = set(sorted(everything)[:processors])
    os.sched_setaffinity(0, usable)  # the other one inherits it
    with subprocess.Popen(["sleep", "60"]) as other:
        try:
            split_processors(other.pid)
            mine, theirs = os.sched_getaffinity(0), os.sched_getaffinity(other.pid)
            assert mine
            assert theirs
            assert mine | theirs == usable
            assert bool(mine & theirs) == (len(usable) == 1)
        finally:
            os.sched_setaffinity(0, everything)
            other.kill()
    split_processors(other.pid)  # who is gone needs none
    assert os.sched_getaffinity(0) == everything


def turn_of_this_thread() -> tuple[int, int]:
    """Niceness and length of a turn (ns), as the system tells them: sched_getattr."""
    number = SCHED_SETATTR[os.uname().machine] + 1
    output = ctypes.create_string_buffer(ATTRIBUTES.size)
    assert ctypes.CDLL(None).syscall(number, 0, output, ATTRIBUTES.size, 0) == 0
    _, _, _, niceness, _, turn, _, _ = ATTRIBUTES.unpack(output.raw)
    return niceness, turn


@linux
def test_a_thread_gets_a_short_time_slice_from_linux_6_12_on() -> None:
    seen: list[tuple[int, int]] = []
    taken: list[bool] = []

    def work() -> None:
        request_short_slice(
            wanted=False
        )  # whoever started this thread may have had them, and hands them on
        seen.append(turn_of_this_thread())
        taken.append(request_short_slice())
        seen.append(turn_of_this_thread())
        taken.append(request_short_slice(wanted=False))
        seen.append(turn_of_this_thread())

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    version = re.match(r"(\d+)\.(\d+)", platform.release())
    assert version is not None
    grants = (int(version[1]), int(version[2])) >= (6, 12)
    usual, short, again = seen
    assert taken == [True, True]
    assert usual == again
    assert short == (usual[0], SHORT_SLICE_NS if grants else usual[1])
    assert short[1] < usual[1] or not grants


def test_outside_linux_no_priority_is_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    before = turn_of_this_thread() if sys.platform == "linux" else None
    monkeypatch.setattr(sys, "platform", "darwin")
    for name in ("nice", "sched_setscheduler", "sched_setaffinity", "uname"):
        monkeypatch.delattr(os, name, raising=False)
    lower_priority()
    split_processors(os.getpid())
    assert not request_short_slice()
    monkeypatch.undo()
    assert before is None or turn_of_this_thread() == before
