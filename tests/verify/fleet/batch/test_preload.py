"""Workers are copies of one process that has everything loaded."""

import os
import signal
import sys
from collections import deque
from dataclasses import dataclass
from pathlib import Path

import pytest

from verify.fleet.batch import workers
from verify.fleet.batch.records import Task
from verify.fleet.batch.workers import ProcessPool

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere nothing is copied")


@dataclass(frozen=True)
class Origin:
    """Tells whose copy the worker is, and what it had before it was asked for anything."""

    number: int

    def perform(self) -> tuple[int, bool]:
        return os.getppid(), {"verify.fleet.batch.preload", "numba.core.compiler"} <= set(
            sys.modules
        )


def test_workers_are_copies_of_one_process_that_has_everything_loaded() -> None:
    before = signal.getsignal(signal.SIGINT)
    workers.prepare()
    assert signal.getsignal(signal.SIGINT) == before
    tasks: deque[Task] = deque(Origin(n) for n in range(6))
    crew = ProcessPool(2)
    try:
        ((source, loaded),) = {outcome for _, outcome in crew.run(tasks)}
    finally:
        crew.close()
    assert loaded
    assert source != os.getpid()
    ignored = Path(f"/proc/{source}/status").read_text().split("SigIgn:")[1].split()[0]
    assert int(ignored, 16) & 1 << (signal.SIGINT - 1)  # Ctrl-C is for who waits for the workers
