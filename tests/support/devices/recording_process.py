"""A recording process to be killed: prints the pairs that it has handed on, of what time,
and how many of them before they were on the disk.

python -m tests.support.devices.recording_process FOLDER RATE    pairs of noise
python -m tests.support.devices.recording_process FOLDER sim     the simulated station
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

    hand_on(recorder, pairs())


def of_the_simulated_station(folder: Path) -> None:
    """The template's station; cameras are read one after the other, which 15 Hz allows."""
    # here: a process that records noise begins sooner without
    from verify.live.station import file
    from verify.live.station.station import open_station
    from verify.simulation.devices.station import SimulatedStation

    folder.mkdir(parents=True)
    text = file.template().replace("rate_hz = 30.0", "rate_hz = 15.0")
    (folder / "station.toml").write_text(text)
    station = open_station(folder / "station.toml", SimulatedStation)
    recorder, rig = station.open_recorder(), station.rig
    left, right = station.open_cameras()
    encoders = station.open_encoders()

    def pairs() -> Iterator[CapturedPair]:
        number = 0
        while True:
            pictures = left.read(), right.read()
            for came in encoders.read():
                recorder.reading(came)
            if pictures[0] is None or pictures[1] is None:
                continue
            one, other = pictures
            assert one.sequence == other.sequence
            pans = (rig.left.pan, rig.right.pan)
            yield CapturedPair(number, one.t, other.t, *pans, one.image, other.image)
            number += 1

    hand_on(recorder, pairs())


def hand_on(recorder: SessionRecorder, pairs: Iterator[CapturedPair]) -> None:
    for kept in recorder.keep(pairs):
        print(kept.frame, kept.t_left, recorder.state().late, flush=True)


if __name__ == "__main__":
    if sys.argv[2] == "sim":
        of_the_simulated_station(Path(sys.argv[1]))
    of_noise(Path(sys.argv[1]), float(sys.argv[2]))
