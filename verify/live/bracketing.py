"""From measured pair to joint error: wait for the reading that brackets it, and compare."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from verify.core.records import Array, Measurement
from verify.live.buffers import ReadingBuffer
from verify.live.clock import ClockKeeper, LiveClock
from verify.live.joint_row import Comparer, JointRow
from verify.live.protocols import MonitoredRobot

MIN_READING_TIMEOUT = 0.1  # s for the bracketing reading; and of slow encoders
TIMEOUT_PERIODS = 3.0  # of their periods
MAX_PAIRS_TOGETHER = 4  # pairs that are compared at once, where one reading brackets several
MAX_QUEUED = 4  # pairs that wait already: then no one waits for readings any more


@dataclass(frozen=True, slots=True)
class MeasuredPair:
    """A measured pair on its way to be compared."""

    measurement: Measurement
    arrived: float  # s, host's monotonic clock, when its later picture was in hand
    doubt: float  # s, half-width within which it was taken


@dataclass(frozen=True, slots=True)
class BracketedPair:
    """A measured pair whose reading is there, or has not come in time."""

    taken: MeasuredPair
    clock: LiveClock | None  # None: no reading has ever come
    since: float  # s, host's monotonic clock: the later of picture and bracketing reading


class Bracketing:
    """Compares measured pairs in order.

    Args:
        subject: the robot.
        book: its readings.
        keeper: its clock.
        turning: the bases turn.
    """

    def __init__(
        self, subject: MonitoredRobot, book: ReadingBuffer, keeper: ClockKeeper, *, turning: bool
    ) -> None:
        self._subject, self._book, self._keeper = subject, book, keeper
        self._comparer = Comparer(
            subject.arm, subject.rig, subject.marker, subject.resolution, turning=turning
        )

    def wait(
        self, taken: MeasuredPair, queued: int, meanwhile: Callable[[int], None]
    ) -> BracketedPair:
        """Wait for the reading that brackets a pair.

        Args:
            taken: the pair.
            queued: how many wait behind it.
            meanwhile: called before a wait, with the pair's number: nothing is urgent.
        """
        now = self.at_once(taken)
        if now is not None:
            return now
        meanwhile(taken.measurement.frame)
        longest = max(MIN_READING_TIMEOUT, TIMEOUT_PERIODS * (self._book.period() or 0.0))
        return self._bracketed(taken, 0.0 if queued >= MAX_QUEUED else longest)[0]

    def at_once(self, taken: MeasuredPair) -> BracketedPair | None:
        """Give a pair that needs no wait; None for another."""
        pair, ready = self._bracketed(taken, 0.0)
        return pair if ready else None

    def _bracketed(self, taken: MeasuredPair, patience: float) -> tuple[BracketedPair, bool]:
        """Give a pair after so many s at most, and whether nothing is missing for it."""
        measurement = taken.measurement
        clock = self._keeper.at(measurement.t, taken.doubt)
        if clock is None or measurement.status != "measured":
            return BracketedPair(taken, clock, taken.arrived), True
        there = measurement.t - clock.offset  # on the readings' clock
        came = self._book.wait_past(there, time.monotonic() + patience)
        since = taken.arrived if came is None else max(taken.arrived, came)
        return BracketedPair(taken, clock, since), came is not None

    def compare(self, pairs: Sequence[BracketedPair]) -> list[tuple[JointRow, float]]:
        """Compare pairs, each by itself, in their order; each row with the pair's `since`."""
        timed = [(p.taken.measurement, p.clock) for p in pairs if p.clock is not None]
        there = [m.t - c.offset for m, c in timed]
        readings = self._book.about(min(there)) if timed else None
        rows = iter(self._comparer.rows(timed, readings, self._time_doubts(there)))
        without = self._comparer.without
        return [
            (without(p.taken.measurement) if p.clock is None else next(rows), p.since)
            for p in pairs
        ]

    def _time_doubts(self, there: list[float]) -> Array:
        """Standard uncertainty of the readings' times (n,), s: stated, else the driver's."""
        stated = self._subject.time_uncertainty
        if stated is not None:
            return np.full(len(there), stated)
        return np.round([self._book.half_width_about(t) / 3**0.5 for t in there], 6)
