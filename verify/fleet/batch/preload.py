"""All that measuring takes, loaded by being imported: see nursery.py."""

import ctypes
import signal
from contextlib import suppress

# a command that ends at once, for its input is bad, is not to leave this one behind for seconds
PR_SET_PDEATHSIG = 1  # of linux/prctl.h
ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)

import cv2  # noqa: E402

from verify.analysis.warm_up import (
    warm_up,
    warm_up_comparison,
)
from verify.fleet.batch import tasks  # noqa: E402

__all__ = ["tasks"]

cv2.setNumThreads(1)  # threads are not copied: each worker has its own
with suppress(Exception):  # whatever is wrong, the first session says it better
    warm_up()
    warm_up_comparison()
