"""Buffers of the latest encoder readings and base angles: look up an instant, or wait for it."""

import math
import threading
import time
from collections import deque

import numpy as np

from verify.core.readings import MAX_GAP, Readings
from verify.core.records import Array
from verify.devices.protocols import EncoderReading, PanReading
from verify.io.left_out import MAX_SPEED
from verify.live.pairing import FramePair

INITIAL_CAPACITY = 256  # readings
TIME, ARRIVAL, HALF_WIDTH, ANGLES = 0, 1, 2, slice(3, None)  # columns of a series


class ReadingSeries:
    """Readings with rising times as rows of one array; not locked."""

    def __init__(self) -> None:
        self._kept: Array = np.empty((0, 3))
        self._first, self._end = 0, 0

    @property
    def rows(self) -> Array:
        """Readings, (m, 3 + joints), s and rad; a view that the next reading may move."""
        return self._kept[self._first : self._end]

    @property
    def t(self) -> Array:
        """Times, (m,), s; likewise a view."""
        return self._kept[self._first : self._end, TIME]

    def add(self, reading: EncoderReading) -> None:
        """Append a reading; a joint that passes ±180° or ±360° and is counted anew goes on."""
        q = reading.q
        before = self._kept[self._end - 1] if self._end > self._first else None
        if before is not None and (since := reading.t - before[TIME]) < MAX_GAP:
            leap = q - before[ANGLES]
            turns = 2 * np.pi * np.rint(leap / (2 * np.pi))
            q = q - turns * (np.abs(leap - turns) < MAX_SPEED * since)
        if self._end == len(self._kept):  # move what is there into twice the room
            rows = self.rows.reshape(-1, 3 + len(reading.q))
            self._kept = np.empty((max(2 * len(rows), INITIAL_CAPACITY), rows.shape[1]))
            self._kept[: len(rows)] = rows
            self._first, self._end = 0, len(rows)
        self._kept[self._end, :3] = reading.t, reading.t_host, reading.half_width
        self._kept[self._end, ANGLES] = q
        self._end += 1

    def drop_before(self, t: float) -> None:
        """Drop the readings before an instant."""
        while self._first < self._end and self._kept[self._first, TIME] < t:
            self._first += 1

    def copied(self, begin: int) -> Readings | None:
        """Readings from one of them on, counted from the oldest; None where there is none."""
        rows = self.rows[begin:]
        return Readings(rows[:, TIME].copy(), rows[:, ANGLES].copy()) if len(rows) else None


READING_SPAN = 90.0  # s of readings: the clock's window and its margins
INTERPOLATION_SPAN = 0.7  # s before an instant that interpolation and speed need
MIN_INTERPOLATION_READINGS = 6  # readings, however slow: neighbours show what a curve misses
ARRIVAL_SPAN = 30.0  # s over which the least delay is sought


class LeastDelay:
    """The least delay of the last while: a reading's arrival less its own time; not locked."""

    def __init__(self) -> None:
        self._delays: deque[tuple[float, float]] = deque()  # t_host and delay, both rising

    def add(self, reading: EncoderReading | PanReading) -> None:
        """Take a reading."""
        delay = reading.t_host - reading.t
        while self._delays and self._delays[-1][1] >= delay:
            self._delays.pop()
        self._delays.append((reading.t_host, delay))
        while self._delays[0][0] < reading.t_host - ARRIVAL_SPAN:
            self._delays.popleft()

    @property
    def value(self) -> float | None:
        """The least delay, s; None without readings."""
        return self._delays[0][1] if self._delays else None


class ReadingBuffer:
    """Readings of the controller's present clock segment; a new segment clears the buffer."""

    def __init__(self) -> None:
        self._arrived = threading.Condition()
        self._series = ReadingSeries()
        self._newest = -math.inf  # s, controller's clock
        self._delay = LeastDelay()
        self.segment: int | None = None

    def add(self, reading: EncoderReading) -> None:
        """Take a reading, and wake those who wait for one."""
        with self._arrived:
            if reading.segment != self.segment:
                self._series, self._delay = ReadingSeries(), LeastDelay()
                self.segment, self._newest = reading.segment, -math.inf
            if reading.t <= self._newest:
                return  # a driver promises rising times; a spline needs them
            self._newest = reading.t
            self._series.add(reading)
            self._delay.add(reading)
            self._series.drop_before(reading.t - READING_SPAN)
            self._arrived.notify_all()

    def least_delay(self) -> float | None:
        """Host's time of arrival less the reading's own, at its least, s; None without readings."""
        with self._arrived:
            return self._delay.value

    def period(self) -> float | None:
        """Time between readings, s, the median of the latest; None with fewer than three."""
        with self._arrived:
            latest = self._series.t[-20:].copy()
        return float(np.median(np.diff(latest))) if len(latest) > 2 else None

    def wait_past(self, t: float, deadline: float) -> float | None:
        """Wait for the first reading at or after t, s, controller's clock; None: it came too late.

        Returns when that was in hand; this and the deadline in s of the host's monotonic clock.
        """
        with self._arrived:
            if not self._arrived.wait_for(lambda: self._newest >= t, deadline - time.monotonic()):
                return None
            return float(self._series.rows[np.searchsorted(self._series.t, t), ARRIVAL])

    def about(self, t: float) -> Readings | None:
        """Readings about an instant t (s, controller's clock), for its angle and speed.

        None from before a silence of the line: what happened in it is not known.
        """
        with self._arrived:
            times = self._series.t
            before = int(np.searchsorted(times, t - INTERPOLATION_SPAN))
            begin = max(min(before, len(times) - MIN_INTERPOLATION_READINGS), 0)
            silences = np.flatnonzero(np.diff(times[begin:]) > MAX_GAP)
            if len(silences):  # the arm went on while the line was silent
                begin += int(silences[-1]) + 1
            return self._series.copied(begin)

    def since(self, t: float) -> Readings | None:
        """All readings from an instant (s, controller's clock) on."""
        with self._arrived:
            return self._series.copied(int(np.searchsorted(self._series.t, t)))

    def half_width_about(self, t: float) -> float:
        """Half-width within which the readings beside an instant, or the newest, were taken, s.

        The larger one: a controller's answers take different times.
        """
        with self._arrived:
            after = int(np.searchsorted(self._series.t, t))
            beside = self._series.rows[max(after - 1, 0) : after + 1]
            return float(beside[:, HALF_WIDTH].max()) if len(beside) else 0.0


PAN_SPAN = 5.0  # s
MAX_PAN_AGE = 1.0  # s: a base that has been silent for so long may stand anywhere
PAN_TIMEOUT = 0.03  # s that a picture waits for the angles of the bases
SETTLING_TIME = 0.1  # s after the last moving reading in which pictures are not believed


class PanBuffer:
    """Turns readings of the bases into angles at an instant.

    A base stands while pictures are measured, so the reading before it holds; pictures taken while
    a base moves are not measured.
    """

    def __init__(self) -> None:
        self._arrived = threading.Condition()
        self._readings: deque[PanReading] = deque()
        self._delay = LeastDelay()
        self._segment: int | None = None

    def add(self, reading: PanReading) -> None:
        """Take a reading."""
        with self._arrived:
            if reading.segment != self._segment:
                self._readings.clear()
                self._delay = LeastDelay()
                self._segment = reading.segment
            self._readings.append(reading)
            self._delay.add(reading)
            while self._readings[0].t_host < reading.t_host - PAN_SPAN:
                self._readings.popleft()
            self._arrived.notify_all()

    def at(self, t: float) -> tuple[float, float] | None:
        """Angles of left and right base, rad, at an instant (s, cameras' clock).

        None while a base moves, and where there is no reading.
        """
        with self._arrived:
            delay = self._delay.value
            if delay is None:
                return None
            # it may have begun to move just now
            self._arrived.wait_for(lambda: self._readings[-1].t + delay >= t, PAN_TIMEOUT)
            about = [r for r in self._readings if abs(r.t + delay - t) <= MAX_PAN_AGE]
        if not about or any(r.moving and abs(r.t + delay - t) <= SETTLING_TIME for r in about):
            return None
        nearest = min(about, key=lambda r: abs(r.t + delay - t))
        return float(nearest.pan[0]), float(nearest.pan[1])

    def of_pair(self, pair: FramePair) -> tuple[float, float] | None:
        """Angles of left and right base, rad, each at its own picture's instant; else None."""
        left, right = self.at(pair.left.t), self.at(pair.right.t)
        return None if left is None or right is None else (left[0], right[1])
