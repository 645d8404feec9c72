"""Who computes when and where: pictures for lookers-on may be late, a measurement may not."""

import os
import sys
from contextlib import suppress

NICENESS = 10


def stand_back() -> None:
    """Let others have the processor first, from now on, in this thread and those it starts.

    Where niceness belongs to the whole process, which is everywhere but on Linux, nothing changes.
    """
    if sys.platform == "linux":
        os.nice(NICENESS)


def keep_apart(other: int) -> None:
    """Give this thread one half of the processors, and another process (its id) the other half.

    A process that is asked something tends to be woken where the one who asks runs; two that are
    to work at once then take turns, until the scheduler notices.
    """
    if sys.platform != "linux":
        return
    usable = sorted(os.sched_getaffinity(0))
    if len(usable) < 2:
        return
    half = len(usable) // 2
    with suppress(ProcessLookupError, PermissionError):
        os.sched_setaffinity(other, usable[half:])
        os.sched_setaffinity(0, usable[:half])
