"""The measuring process: pairs of pictures in shared memory in, measurements out.

Threads of one Python process take turns: display and recording would delay a measurement of a few
milliseconds by as much again. The measuring process searches the left picture of a pair, and
starts a process for the right one.
"""

import gc
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from verify.core import processes
from verify.core.fiducials import Marker
from verify.core.native import library_folder
from verify.core.records import Array, Image, Measurement, Spots, StereoPair
from verify.core.rig import Rig
from verify.measurement.chain import Setup, detect_in_turn, measure, warm_up
from verify.measurement.detection.detect import detect

if TYPE_CHECKING:  # not loaded where pairs are measured: it brings the comparison along
    from verify.live.protocols import ExpectedPoses

DETECTION_TIMEOUT = 1.0  # s a picture, ten times what a whole frame takes
MEASUREMENT_TIMEOUT = 2.0  # s a pair, twenty times what a whole frame takes
JOIN_TIMEOUT = 2.0  # s
NO_PICTURE: Image = np.zeros((0, 0), dtype=np.uint8)

# shared memory, shape, windows, lossy
DetectionRequest = tuple[str, tuple[int, ...], Array | None, bool]
# a pair without its pictures, and where those are
PairMessage = tuple[StereoPair, processes.Place, processes.Place]


class ParallelDetector:
    """Finds the spots of both pictures at once; the same spots as one after the other.

    Both pictures are searched here while the second process is late, and for good once it is lost.

    Args:
        warn: called with a sentence then; the first time, if it is late.

    Raises:
        ChildLostError: the second process does not start.
    """

    def __init__(self, warn: Callable[[str], None]) -> None:
        self._warn, self._warned = warn, False
        self._process: processes.ChildProcess[DetectionRequest, Spots] | None = (
            processes.ChildProcess(
                processes.answer_requests, _detect_shared_picture, name="right picture"
            )
        )
        self._process.wait_until_ready()
        self._picture = processes.SharedPicture()

    def __call__(
        self, pair: StereoPair, left_windows: Array | None, right_windows: Array | None
    ) -> tuple[Spots, Spots]:
        """Find the spots of a pair; windows (m, 4) px, where to search; None: everywhere."""
        process = self._process
        if process is None:
            return detect_in_turn(pair, left_windows, right_windows)
        right = processes.location_of(pair.right) or self._picture.put(pair.right)
        try:
            process.begin((*right, right_windows, pair.lossy[1]))
            spots = detect(pair.left, left_windows, lossy=pair.lossy[0])
            return spots, process.finish(DETECTION_TIMEOUT)
        except processes.ChildLateError as error:
            if not self._warned:
                self._warn(f"pictures are searched one at a time, now and then: {error}")
            self._warned = True
        except processes.ChildLostError as error:
            self._warn(f"pictures are searched one at a time from now on: {error}")
            self.close()
        return detect_in_turn(pair, left_windows, right_windows)

    def close(self) -> None:
        """End the second process."""
        if self._process is not None:
            self._process.stop()
            self._process = None
        self._picture.close()


def _detect_shared_picture(request: DetectionRequest) -> Spots:
    name, shape, windows, lossy = request
    return detect(processes.picture_at(name, shape), windows, lossy=lossy)


class MeasuringProcess:
    """Measures pairs in another process; the same measurements as `chain.measure` gives live.

    Once that process is lost, pairs are measured here.

    Args:
        rig: the calibrated cameras.
        marker: the LEDs.
        warn: called with a sentence then.

    Raises:
        ChildLostError: the process does not start.
    """

    def __init__(self, rig: Rig, marker: Marker, warn: Callable[[str], None]) -> None:
        library_folder()  # or the processes would compile the inner loops
        self._rig, self._marker, self._warn = rig, marker, warn
        self._process: processes.ChildProcess[Any, Any] = processes.ChildProcess(
            _measure_pairs, rig, marker, name="measurement", nested=True
        )
        self._pictures = (processes.SharedPicture(), processes.SharedPicture())
        self._lost = False
        self._prepared: tuple[StereoPair, PairMessage] | None = None
        try:
            self._process.wait_until_ready()
        except BaseException:  # Ctrl-C too: it is not waited for while it loads
            self._process.stop(0.0)
            raise

    def prepare(self, pair: StereoPair) -> None:
        """Put the pictures of the next pair into shared memory."""
        if not self._lost:
            self._prepared = (pair, self._message(pair))

    def measure(
        self, pairs: Iterator[StereoPair], expected: "ExpectedPoses"
    ) -> Iterator[Measurement]:
        """Measure pairs in order, as `chain.measure` does: each causally, then settled.

        Args:
            pairs: in time order.
            expected: candidates for rig_T_flange at a time (s), from the encoders.
        """
        unanswered: deque[StereoPair] = deque()
        try:
            for pair in pairs:
                unanswered.append(pair)
                self._process.send(self._message(pair))
                yield from self._measured(expected, unanswered)
            self._process.send(None)
            yield from self._measured(expected, unanswered)
        except processes.ChildLostError as error:
            self._lost = True
            self._process.stop(0.0)
            self._warn(f"pairs are measured by the main process from now on: {error}")
            setup = Setup(self._rig, self._marker, expected)
            yield from measure(chain(list(unanswered), pairs), setup, causal=True)

    def close(self) -> None:
        """End the process."""
        self._process.stop(JOIN_TIMEOUT)
        for picture in self._pictures:
            picture.close()

    def _message(self, pair: StereoPair) -> PairMessage:
        if self._prepared is not None and self._prepared[0] is pair:
            return self._prepared[1]
        left, right = self._pictures
        times = (pair.frame, pair.t_left, pair.t_right, pair.pan_left, pair.pan_right)
        # a recorded pair holds JPEGs as well
        bare = StereoPair(*times, NO_PICTURE, NO_PICTURE, pair.lossy)
        return bare, left.put(pair.left), right.put(pair.right)

    def _measured(
        self, expected: "ExpectedPoses", unanswered: deque[StereoPair]
    ) -> Iterator[Measurement]:
        """Measurements until the next pair is requested."""
        while True:
            kind, value = self._process.receive(MEASUREMENT_TIMEOUT)
            if kind == "next":
                return
            if kind == "expected":
                self._process.send(expected(value))
            elif kind == "warning":
                self._warn(value)
            else:
                while unanswered and unanswered[0].frame <= value.frame:
                    unanswered.popleft()
                yield value


def _measure_pairs(line: processes.ParentLine, rig: Rig, marker: Marker) -> None:
    """Measure until the parent process sends no more pairs; runs in the measuring process."""
    with ExitStack() as stack:
        detector = ParallelDetector(lambda text: line.send("warning", text))
        stack.callback(detector.close)
        warm_up(detector)
        gc.collect()
        gc.freeze()  # the collector need not search what is there: that takes a picture's time
        line.send(processes.READY)

        def expected(t: float) -> Sequence[Array]:
            line.send("expected", t)
            poses: Sequence[Array] = line.receive()
            return poses

        setup = Setup(rig, marker, expected, detector)
        for measurement in measure(_receive_pairs(line), setup, causal=True):
            line.send("measured", measurement)
        line.send("next")


def _receive_pairs(line: processes.ParentLine) -> Iterator[StereoPair]:
    """Receive pairs; when the next one is requested, the one before has been measured."""
    for bare, left, right in iter(line.receive, None):
        yield replace(bare, left=processes.picture_at(*left), right=processes.picture_at(*right))
        line.send("next")
