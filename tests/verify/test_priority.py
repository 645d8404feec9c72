"""Who has the processor first: what the system says of a thread afterwards."""

import os
import re
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from verify.priority import NICENESS, SHORT, come_soon, stand_back

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="threads have priorities on Linux")


def seen_in_a_thread(*acts: Callable[[], None]) -> list[tuple[float, int, int]]:
    """Length of a turn (ns), policy and niceness after each act; the turn nan if not told."""
    seen = []

    def work() -> None:
        for act in acts:
            act()
            told = Path(f"/proc/self/task/{threading.get_native_id()}/sched")
            turn = re.search(r"se\.slice\s*:\s*(\d+)", told.read_text() if told.exists() else "")
            length = float(turn[1]) if turn else float("nan")
            seen.append((length, os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0)))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    return seen


def nothing() -> None:
    """Leave the thread as it is."""


def test_a_thread_that_stands_back_does_so_alone() -> None:
    before = os.getpriority(os.PRIO_PROCESS, 0)
    (_, policy, niceness), (_, other, unchanged) = (
        seen_in_a_thread(stand_back)[0],
        seen_in_a_thread(nothing)[0],
    )
    assert (policy, niceness) == (os.SCHED_BATCH, before + NICENESS)
    assert (other, unchanged) == (os.SCHED_OTHER, before)


def test_a_thread_that_comes_soon_has_short_turns_until_it_wants_them_no_more() -> None:
    usual, short, again = seen_in_a_thread(nothing, come_soon, lambda: come_soon(wanted=False))
    if usual[0] != usual[0] or usual[0] == short[0]:
        pytest.skip("this system tells no turns, or grants none")
    assert short[0] == SHORT < usual[0] == again[0]
    assert usual[1:] == short[1:] == again[1:]  # share and policy are as they were
