"""Who computes when and where: pictures for lookers-on may be late, a measurement may not."""

import ctypes
import os
import struct
import sys
from contextlib import suppress
from functools import lru_cache

NICENESS = 10
SHORT, USUAL = 100_000, 0  # ns of a turn: the shortest that Linux grants; by default it is 3 ms
SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}  # numbers of the system call
# size, policy, flags, niceness, priority, turn in ns, two for deadlines: linux/sched/types.h
ATTRIBUTES = struct.Struct("=IIQiIQQQ")


def stand_back() -> None:
    """Let others have the processor first, from now on, in this thread and those it starts.

    Where niceness belongs to the whole process, which is everywhere but on Linux, nothing changes.
    """
    if sys.platform == "linux":
        os.nice(NICENESS)
        with suppress(PermissionError):  # some sandboxes; niceness remains
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def come_soon(*, wanted: bool = True) -> bool:
    """Let this thread have the processor as soon as it is woken, for short turns at a time.

    Linux, from 6.12 on, lets whoever asks for shorter turns interrupt those with longer ones; that
    takes no right, as the share of the processor stays what it is. Elsewhere nothing changes.

    Args:
        wanted: False takes it back.

    Returns:
        Whether the system took the call; one before 6.12 takes it, and does nothing.
    """
    number = SCHED_SETATTR.get(os.uname().machine) if sys.platform == "linux" else None
    if number is None:
        return False
    niceness = os.getpriority(os.PRIO_PROCESS, 0)
    turn = SHORT if wanted else USUAL
    told = ATTRIBUTES.pack(ATTRIBUTES.size, os.SCHED_OTHER, 0, niceness, 0, turn, 0, 0)
    return bool(_c_library().syscall(number, 0, told, 0) == 0)


@lru_cache(maxsize=1)
def _c_library() -> ctypes.CDLL:
    return ctypes.CDLL(None)


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
