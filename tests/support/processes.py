"""Other processes, as tests wait for them."""

import signal
import time
from collections.abc import Callable
from pathlib import Path

TIMEOUT = 300.0  # s: a busy machine is slow to import


def wait_until(happened: Callable[[], bool], timeout: float = TIMEOUT) -> None:
    limit = time.monotonic() + timeout
    while not happened():
        assert time.monotonic() < limit
        signal.sigtimedwait([signal.SIGUSR2], 0.02)


def running(pid: int) -> bool:
    try:
        return "State:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False
