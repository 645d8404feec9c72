"""Where workers come from: copies of one process that has everything loaded, on Linux.

Several workers load nothing twice, share what they do not change, and one that dies is replaced at
once. The process is a fresh interpreter: threads and open videos of this one stay out of it.
Elsewhere libraries of the system do not bear being copied: each worker is a fresh interpreter.
"""

import signal
import sys
from multiprocessing import get_context
from multiprocessing.context import BaseContext

LOADED = "verify.batch.loaded"


def context() -> BaseContext:
    """Give what starts workers."""
    if sys.platform != "linux":
        return get_context("spawn")
    chosen = get_context("forkserver")
    chosen.set_forkserver_preload(["__main__", LOADED])
    return chosen


def prepare() -> None:
    """Have everything loaded for workers to come, while this process does other things.

    Of the main thread alone.
    """
    if sys.platform != "linux":
        return
    context()
    from multiprocessing import forkserver  # not everywhere

    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the one who started it
    try:
        forkserver.ensure_running()
    finally:
        signal.signal(signal.SIGINT, before)
