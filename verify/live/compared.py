"""From measured pair to joint error: wait for the reading that brackets it, and compare."""

import time
from dataclasses import dataclass

from verify.live.clock_keeper import ClockKeeper
from verify.live.joint_row import Comparer, JointRow, Scales
from verify.live.ports import Subject
from verify.live.readings_book import ReadingsBook
from verify.records import Measurement

LEAST_PATIENCE = 0.1  # s for the bracketing reading; and of slow encoders
PERIODS = 3.0  # of their periods
ENOUGH_QUEUED = 4  # pairs that wait already: then no one waits for readings any more


@dataclass(frozen=True, slots=True)
class Taken:
    """A measured pair on its way to be compared."""

    measurement: Measurement
    arrived: float  # s, host's monotonic clock, when its later picture was in hand
    doubt: float  # s, half-width within which it was taken
    measured: float  # s, host's monotonic clock


@dataclass(frozen=True, slots=True)
class Outcome:
    """A row, and when what it rests on was there."""

    row: JointRow
    since: float  # s, host's monotonic clock: the later of picture and bracketing reading
    taken: Taken


class Bracketing:
    """Compares measured pairs in order.

    Args:
        subject: the robot.
        book: its readings.
        keeper: its clock.
        turning: the bases turn.
    """

    def __init__(
        self, subject: Subject, book: ReadingsBook, keeper: ClockKeeper, *, turning: bool
    ) -> None:
        self._subject, self._book, self._keeper = subject, book, keeper
        self._turning = turning
        self._comparers: dict[float | None, Comparer] = {}

    def compare(self, taken: Taken, queued: int) -> Outcome:
        """Compare one pair.

        Args:
            taken: the pair.
            queued: how many wait behind it.

        Returns:
            Its row, and since when it could have been there.
        """
        measurement = taken.measurement
        clock = self._keeper.at(measurement.t, taken.doubt)
        comparer = self._comparer()
        if clock is None:
            return Outcome(comparer.without(measurement), taken.arrived, taken)
        there = measurement.t - clock.offset
        since = taken.arrived
        if measurement.status == "measured":
            patience = 0.0 if queued >= ENOUGH_QUEUED else self._patience()
            reading = self._book.wait_past(there, time.monotonic() + patience)
            since = max(since, reading.t_host) if reading is not None else since
        row = comparer.row(measurement, self._book.about(there), clock)
        return Outcome(row, since, taken)

    def _patience(self) -> float:
        period = self._book.period()
        return LEAST_PATIENCE if period is None else max(LEAST_PATIENCE, PERIODS * period)

    def _comparer(self) -> Comparer:
        """One for how well the readings' times are known: stated, else as the driver says."""
        stated = self._subject.time_uncertainty
        if stated is None:
            stated = round(self._book.half_width() / 3**0.5, 6) or None
        if stated not in self._comparers:
            subject = self._subject
            scales = Scales(subject.resolution, stated)
            self._comparers = {
                stated: Comparer(
                    subject.arm, subject.rig, subject.marker, scales, turning=self._turning
                )
            }
        return self._comparers[stated]
