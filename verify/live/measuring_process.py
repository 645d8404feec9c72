"""The chain in a process of its own: whoever looks on, records or renders costs it nothing.

Threads of one Python process take turns; a pair whose measurement takes a few milliseconds would
wait for as many more. So pictures go to another process through shared memory, one pair at a time,
and measurements come back.

Both pictures of a pair at once: the right one in a second process, for latency's sake.
"""

import gc
import multiprocessing
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from itertools import chain
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from verify.analysis.warm_up import warm_up
from verify.core.fiducials import Marker
from verify.core.processes import (
    Helper,
    HelperLateError,
    HelperLostError,
    Place,
    SharedPicture,
    end_process,
    location_of,
    picture_at,
    receive,
    request_short_slice,
    split_processors,
)
from verify.core.records import Array, Image, Measurement, Spots, StereoPair
from verify.core.rig import Rig
from verify.live.rehearsal import Rehearsal
from verify.measurement.chain import ChainState, Setup, measure, no_expected_poses
from verify.measurement.detection.detect import detect

DETECTION_TIMEOUT = 1.0  # s for a picture, ten times what a whole frame takes; then it is done here
DetectionRequest = tuple[str, tuple[int, ...], Array | None]  # shared memory, shape, windows


class ParallelDetector:
    """Finds the spots of both pictures at once; the same spots as one after the other.

    Both pictures are searched here while the second process is late, and from then on should it be
    lost.

    Args:
        warn: is told if so; the first time, if it is late.

    Raises:
        HelperLostError: the second process does not start.
    """

    def __init__(self, warn: Callable[[str], None]) -> None:
        self._warn, self._told = warn, False
        self._helper: Helper[DetectionRequest, Spots] | None = Helper(
            _detect_shared_picture, "right picture", prepare=request_short_slice
        )
        self._helper.wait_until_ready()
        self._picture = SharedPicture()
        self._lock = threading.Lock()

    def __call__(
        self, left: Image, right: Image, left_windows: Array | None, right_windows: Array | None
    ) -> tuple[Spots, Spots]:
        """Find the spots of a pair.

        Args:
            left: (h, w) grey or (h, w, 3) BGR.
            right: likewise.
            left_windows: (m, 4) px, where to look; None: everywhere.
            right_windows: likewise.
        """
        helper = self._helper
        if helper is None:
            return detect(left, left_windows), detect(right, right_windows)
        try:
            helper.begin((*(location_of(right) or self._picture.put(right)), right_windows))
            here = detect(left, left_windows)
            return here, helper.finish(DETECTION_TIMEOUT)
        except HelperLateError as error:
            if not self._told:
                self._warn(f"pictures are searched one after the other now and then: {error}")
            self._told = True
        except HelperLostError as error:
            self._warn(f"pictures are searched one after the other from now on: {error}")
            self.close()
        return detect(left, left_windows), detect(right, right_windows)

    def spread(self) -> None:
        """Have both pictures searched on processors of their own; moves the calling thread."""
        if self._helper is not None:
            split_processors(self._helper.pid)

    def close(self) -> None:
        """End the second process."""
        with self._lock:
            if self._helper is not None:
                self._helper.close()
                self._helper = None
            self._picture.close()


def _detect_shared_picture(question: DetectionRequest) -> Spots:
    name, shape, windows = question
    return detect(picture_at(name, shape), windows)


START_TIMEOUT = 120.0  # s: the first start after an installation compiles
MEASUREMENT_TIMEOUT = (
    2.0  # s for a pair, twenty times what a whole frame takes; then it is done here
)
NO_PICTURE: Image = np.zeros((0, 0), dtype=np.uint8)
JOIN_TIMEOUT = 2.0  # s that it is given to end by itself

ExpectedPoses = Callable[[float], Sequence[Array]]
PairMessage = tuple[StereoPair, Place, Place]  # without its pictures, and where those are


class MeasuringProcess:
    """Measures pairs elsewhere; the same measurements as `verify.measurement.chain.measure` gives.

    Should the process be lost, pairs are measured here from then on.

    Args:
        rig: the calibrated cameras.
        marker: the LEDs.
        warn: is told if so.

    Raises:
        HelperLostError: the process does not start.
    """

    def __init__(self, rig: Rig, marker: Marker, warn: Callable[[str], None]) -> None:
        self._rig, self._marker, self._warn = rig, marker, warn
        # not forked: a copy of a process with threads and cameras is no sound one
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        # it starts a process itself, which a daemon may not; it ends when its pipe is closed
        self._process = context.Process(
            target=_serve, args=(theirs, rig, marker), name="measurement", daemon=False
        )
        self._process.start()
        theirs.close()
        self._pictures = (SharedPicture(), SharedPicture())
        self._lost = False
        self._prepared: tuple[StereoPair, PairMessage] | None = None
        try:
            receive(self._connection, START_TIMEOUT)
        except HelperLostError:
            self.close()
            raise

    def prepare(self, pair: StereoPair) -> None:
        """Put the pictures of the pair that comes next where the process sees them."""
        if not self._lost:
            self._prepared = (pair, self._told(pair))

    def measure(
        self, pairs: Iterator[StereoPair], expected: ExpectedPoses
    ) -> Iterator[Measurement]:
        """Measure pairs in order, as `verify.measurement.chain.measure` does.

        Args:
            pairs: in time order.
            expected: candidates for rig_T_flange at a time (s), from the encoders.
        """
        unanswered: deque[StereoPair] = deque()
        try:
            for pair in pairs:
                unanswered.append(pair)
                self._send(self._told(pair))
                yield from self._measured(expected, unanswered)
            self._send(None)
            yield from self._measured(expected, unanswered)
        except HelperLostError as error:
            self._lost = True
            self._warn(f"pairs are measured by the main process from now on: {error}")
            setup = Setup(self._rig, self._marker, expected)
            yield from measure(chain(list(unanswered), pairs), setup)

    def close(self) -> None:
        """End the process."""
        self._connection.close()
        end_process(self._process, JOIN_TIMEOUT)
        for picture in self._pictures:
            picture.close()

    def _told(self, pair: StereoPair) -> PairMessage:
        if self._prepared is not None and self._prepared[0] is pair:
            return self._prepared[1]
        left, right = self._pictures
        times = (pair.frame, pair.t_left, pair.t_right, pair.pan_left, pair.pan_right)
        bare = StereoPair(*times, NO_PICTURE, NO_PICTURE)  # a taken pair has JPEGs beside
        return bare, left.put(pair.left), right.put(pair.right)

    def _measured(
        self, expected: ExpectedPoses, unanswered: deque[StereoPair]
    ) -> Iterator[Measurement]:
        """What comes of a pair, until the next one is asked for."""
        while True:
            kind, value = receive(self._connection, MEASUREMENT_TIMEOUT)
            if kind == "next":
                return
            if kind == "expected":
                self._send(expected(value))
            elif kind == "warning":
                self._warn(value)
            else:
                while unanswered and unanswered[0].frame <= value.frame:
                    unanswered.popleft()
                yield value

    def _send(self, what: Any) -> None:
        if self._lost:
            raise HelperLostError("the process is gone")
        try:
            self._connection.send(what)
        except (OSError, ValueError) as error:
            raise HelperLostError(str(error)) from error


def _serve(connection: Connection, rig: Rig, marker: Marker) -> None:
    """Measure until nobody asks any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the one who asks
    with suppress(EOFError, OSError), ExitStack() as stack:
        try:
            detect = ParallelDetector(lambda text: connection.send(("warning", text)))
            stack.callback(detect.close)
            detect.spread()
            request_short_slice()
            warm_up(detect)
            gc.collect()
            gc.freeze()  # what is there is no garbage: looking through it takes a picture's time
            connection.send(("ready", None))
            setup = Setup(rig, marker, _ReadingQuery(connection), detect)
            stage = _LastPair(setup)
            for measurement in measure(_receive_pairs(connection, stage), setup, stage.carried):
                connection.send(("measured", measurement))
            connection.send(("next", None))
        except (EOFError, OSError):
            raise
        except Exception as error:
            connection.send(("failed", f"{type(error).__name__}: {error}"))


class _LastPair:
    """The last pair, and what was known before it: enough to measure it once more."""

    def __init__(self, setup: Setup) -> None:
        self.carried = ChainState()
        self.rehearsal = Rehearsal(self._again)
        self._setup = replace(setup, expected=no_expected_poses)
        self._pair: StereoPair | None = None
        self._before = ChainState()

    def enter(self, pair: StereoPair) -> None:
        """Take a pair that is about to be measured."""
        self._pair, self._before = pair, replace(self.carried)
        self.rehearsal.note()

    def _again(self) -> None:
        if self._pair is None or self._before.memory is None:  # it would take too long
            return
        request_short_slice(wanted=False)  # the comparison may still be at work
        try:
            for _ in measure([self._pair], self._setup, replace(self._before)):
                pass
        finally:
            request_short_slice()


def _receive_pairs(connection: Connection, stage: _LastPair) -> Iterator[StereoPair]:
    """Pairs as they come; whenever one is asked for, the one before is through."""
    first = True
    while True:
        if not first:
            connection.send(("next", None))
        first = False
        patience = stage.rehearsal.patience()
        if patience is not None and not connection.poll(patience):
            stage.rehearsal.run()
        told: PairMessage | None = connection.recv()
        if told is None:
            return
        bare, left, right = told
        pair = replace(bare, left=picture_at(*left), right=picture_at(*right))
        stage.enter(pair)
        yield pair


class _ReadingQuery:
    """Asks the main process where the readings put the flange."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def __call__(self, t: float) -> Sequence[Array]:
        self._connection.send(("expected", t))
        poses: Sequence[Array] = self._connection.recv()
        return poses
