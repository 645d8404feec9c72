"""The chain in a process of its own: whoever looks on, records or renders costs it nothing.

Threads of one Python process take turns; a pair whose measurement takes a few milliseconds would
wait for as many more. So pictures go to another process through shared memory, one pair at a time,
and measurements come back.
"""

import gc
import multiprocessing
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from itertools import chain
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from verify.helper import HelperLostError, end, received
from verify.live.beside import BesideDetector
from verify.live.rehearsal import Rehearsal
from verify.marker import Marker
from verify.measurement import Carried, Setup, measure, nothing_expected
from verify.priority import come_soon
from verify.records import Array, Image, Measurement, StereoPair
from verify.rig import Rig
from verify.shared_picture import Place, SharedPicture, picture_of
from verify.warm_up import warm_up

START_LIMIT = 120.0  # s: the first start after an installation compiles
PATIENCE = 2.0  # s for a pair, twenty times what a whole frame takes; then it is done here
NO_PICTURE: Image = np.zeros((0, 0), dtype=np.uint8)
GOODBYE = 2.0  # s that it is given to end by itself

Expected = Callable[[float], Sequence[Array]]
Told = tuple[StereoPair, Place, Place]  # without its pictures, and where those are


class MeasuringProcess:
    """Measures pairs elsewhere; the same measurements as `verify.measurement.measure` gives.

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
        self._prepared: tuple[StereoPair, Told] | None = None
        try:
            received(self._connection, START_LIMIT)
        except HelperLostError:
            self.close()
            raise

    def prepare(self, pair: StereoPair) -> None:
        """Put the pictures of the pair that comes next where the process sees them."""
        if not self._lost:
            self._prepared = (pair, self._told(pair))

    def measure(self, pairs: Iterator[StereoPair], expected: Expected) -> Iterator[Measurement]:
        """Measure pairs in order, as `verify.measurement.measure` does.

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
        end(self._process, GOODBYE)
        for picture in self._pictures:
            picture.close()

    def _told(self, pair: StereoPair) -> Told:
        if self._prepared is not None and self._prepared[0] is pair:
            return self._prepared[1]
        left, right = self._pictures
        times = (pair.frame, pair.t_left, pair.t_right, pair.pan_left, pair.pan_right)
        bare = StereoPair(*times, NO_PICTURE, NO_PICTURE)  # a taken pair has JPEGs beside
        return bare, left.put(pair.left), right.put(pair.right)

    def _measured(self, expected: Expected, unanswered: deque[StereoPair]) -> Iterator[Measurement]:
        """What comes of a pair, until the next one is asked for."""
        while True:
            kind, value = received(self._connection, PATIENCE)
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
            detect = BesideDetector(lambda text: connection.send(("warning", text)))
            stack.callback(detect.close)
            detect.spread()
            come_soon()
            warm_up(detect)
            gc.collect()
            gc.freeze()  # what is there is no garbage: looking through it takes a picture's time
            connection.send(("ready", None))
            setup = Setup(rig, marker, _Asked(connection), detect)
            stage = _Stage(setup)
            for measurement in measure(_received(connection, stage), setup, stage.carried):
                connection.send(("measured", measurement))
            connection.send(("next", None))
        except (EOFError, OSError):
            raise
        except Exception as error:
            connection.send(("failed", f"{type(error).__name__}: {error}"))


class _Stage:
    """The last pair, and what was known before it: enough to measure it once more."""

    def __init__(self, setup: Setup) -> None:
        self.carried = Carried()
        self.rehearsal = Rehearsal(self._again)
        self._setup = replace(setup, expected=nothing_expected)
        self._pair: StereoPair | None = None
        self._before = Carried()

    def enter(self, pair: StereoPair) -> None:
        """Take a pair that is about to be measured."""
        self._pair, self._before = pair, replace(self.carried)
        self.rehearsal.note()

    def _again(self) -> None:
        if self._pair is None or self._before.memory is None:  # it would take too long
            return
        come_soon(wanted=False)  # the comparison may still be at work
        try:
            for _ in measure([self._pair], self._setup, replace(self._before)):
                pass
        finally:
            come_soon()


def _received(connection: Connection, stage: _Stage) -> Iterator[StereoPair]:
    """Pairs as they come; whenever one is asked for, the one before is through."""
    first = True
    while True:
        if not first:
            connection.send(("next", None))
        first = False
        patience = stage.rehearsal.patience()
        if patience is not None and not connection.poll(patience):
            stage.rehearsal.run()
        told: Told | None = connection.recv()
        if told is None:
            return
        bare, left, right = told
        pair = replace(bare, left=picture_of(*left), right=picture_of(*right))
        stage.enter(pair)
        yield pair


class _Asked:
    """Asks the main process where the readings put the flange."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def __call__(self, t: float) -> Sequence[Array]:
        self._connection.send(("expected", t))
        poses: Sequence[Array] = self._connection.recv()
        return poses
