"""Steps a device as a control loop does: often, and never held up."""

import time
from collections.abc import Callable
from typing import Protocol, TypeVar

import numpy as np

PERIOD = 1 / 200  # s, quicker than a control loop: tests cannot wait
LONGEST_STEP = 0.5  # s: a step waits for nothing; the rest is a machine that does other things
USUAL_STEP = 0.01  # s
Status = TypeVar("Status", covariant=True)
S = TypeVar("S")


class Stepping(Protocol[Status]):
    def step(self) -> Status: ...


def stepped(device: Stepping[S], until: Callable[[S], bool], limit: float = 10.0) -> list[S]:
    """Step until satisfied; every step is quick."""
    end, seen, took = time.monotonic() + limit, [], []
    while True:
        begin = time.monotonic()
        seen.append(device.step())
        took.append(time.monotonic() - begin)
        assert took[-1] < LONGEST_STEP
        if until(seen[-1]):
            assert len(took) < 20 or np.median(took) < USUAL_STEP
            return seen
        assert time.monotonic() < end, seen[-1]
        time.sleep(PERIOD)
