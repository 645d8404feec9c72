"""A recording process to be killed: prints the pairs that it has handed on, of what time,
and how many of them before they were on the disk.

python -m tests.support.devices.recording_process FOLDER RATE
"""

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.testing import assert_array_equal

from tests.support.recorded import HEIGHT, MARKER, RIG, WIDTH
from verify.devices.protocols import CapturedPair, EncoderReading
from verify.live.recording.recorder import SessionRecorder
from verify.live.recording.session import SessionFacts

FACTS = SessionFacts(
    "iust_6r", 6, {"rig.toml": RIG.encode(), "marker.toml": MARKER.encode()}, {}, False
)


def pair(number: int, t: float) -> CapturedPair:
    """A pair of noise that anybody can make again from its number."""
    rng = np.random.default_rng(number)
    left, right = rng.integers(0, 255, (2, HEIGHT, WIDTH), dtype=np.uint8)
    return CapturedPair(number, t, t + 0.001, 0.1, -0.1, left, right)


def reading(t: float, segment: int = 0) -> EncoderReading:
    """A reading whose angles tell its time."""
    return EncoderReading(t, t, 0.001, segment, 0.1 * np.arange(6) + t % 100 * 1e-3)


def assert_recorded(session: Any, pairs: list[CapturedPair]) -> None:
    """A session holds these pairs and no others."""
    assert len(session) == len(pairs)
    for before, after in zip(pairs, session.pairs(), strict=True):
        for name in ("frame", "t_left", "t_right", "left", "right", "lossy"):
            assert_array_equal(getattr(after, name), getattr(before, name))


def of_noise(folder: Path, rate: float) -> None:
    recorder = SessionRecorder(folder, "killed", FACTS)

    def pairs() -> Iterator[CapturedPair]:
        begin, number = time.monotonic(), 0
        while True:
            time.sleep(max(begin + number / rate - time.monotonic(), 0.0))
            t = time.monotonic()
            for part in range(4):
                recorder.reading(reading(t + part * 0.001))
            yield pair(number, t)
            number += 1

    for kept in recorder.keep(pairs()):
        print(kept.frame, kept.t_left, recorder.state().late, flush=True)


if __name__ == "__main__":
    of_noise(Path(sys.argv[1]), float(sys.argv[2]))
