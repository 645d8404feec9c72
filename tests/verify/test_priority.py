import os
import subprocess
import sys
import threading

import pytest

from verify.priority import NICENESS, keep_apart, stand_back

linux = pytest.mark.skipif(sys.platform != "linux", reason="a matter of Linux")


@linux
def test_one_thread_stands_back_and_the_others_do_not() -> None:
    before, seen = os.getpriority(os.PRIO_PROCESS, 0), []

    def work() -> None:
        stand_back()
        seen.append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id()))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [min(before + NICENESS, 19)]
    assert os.getpriority(os.PRIO_PROCESS, 0) == before


@linux
def test_two_that_work_at_once_share_no_processor() -> None:
    usable = os.sched_getaffinity(0)
    if len(usable) < 2:
        pytest.skip("there is one processor")
    with subprocess.Popen(["sleep", "60"]) as other:
        try:
            keep_apart(other.pid)
            mine, theirs = os.sched_getaffinity(0), os.sched_getaffinity(other.pid)
            assert mine
            assert theirs
            assert mine | theirs == usable
            assert not mine & theirs
        finally:
            os.sched_setaffinity(0, usable)
            other.kill()
    keep_apart(other.pid)  # who is gone needs none
    assert os.sched_getaffinity(0) == usable
