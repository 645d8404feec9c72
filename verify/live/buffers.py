"""Buffers of the latest encoder readings and base angles: look up an instant, or wait for it."""

import threading
import time
from collections import deque
from itertools import takewhile

import numpy as np

from verify.core.readings import MAX_GAP, Readings
from verify.core.records import Array
from verify.devices.protocols import EncoderReading, PanReading

INITIAL_CAPACITY = 256  # readings


class ReadingSeries:
    """Rising times and their joint angles; not locked."""

    def __init__(self) -> None:
        self._t: Array = np.empty(0)
        self._q: Array = np.empty((0, 0))
        self._first, self._end = 0, 0

    @property
    def t(self) -> Array:
        """Times, (m,), s; a view that the next reading may move."""
        return self._t[self._first : self._end]

    def add(self, t: float, q: Array) -> None:
        """Append a reading: s, and (joints,), rad."""
        if self._end == len(self._t):
            self._make_room(len(q))
        self._t[self._end], self._q[self._end] = t, q
        self._end += 1

    def drop_before(self, t: float) -> None:
        """Drop the readings before an instant."""
        while self._first < self._end and self._t[self._first] < t:
            self._first += 1

    def copied(self, begin: int) -> Readings | None:
        """Readings from one of them on, counted from the oldest; None where there is none."""
        chosen = slice(self._first + begin, self._end)
        if chosen.start >= chosen.stop:
            return None
        return Readings(self._t[chosen].copy(), self._q[chosen].copy())

    def _make_room(self, joints: int) -> None:
        """Move the readings to the beginning of arrays of twice their length."""
        kept = slice(self._first, self._end)
        t, q = self._t[kept], self._q[kept]
        room = max(2 * len(t), INITIAL_CAPACITY)
        self._t, self._q = np.empty(room), np.empty((room, joints))
        self._t[: len(t)] = t
        if len(t):
            self._q[: len(t)] = q
        self._first, self._end = 0, len(t)


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
        self._readings: deque[EncoderReading] = deque()
        self._series = ReadingSeries()  # the same, as arrays
        self._delay = LeastDelay()
        self.segment: int | None = None

    def add(self, reading: EncoderReading) -> None:
        """Take a reading, and wake those who wait for one."""
        with self._arrived:
            if reading.segment != self.segment:
                self._readings.clear()
                self._series, self._delay = ReadingSeries(), LeastDelay()
                self.segment = reading.segment
            if self._readings and reading.t <= self._readings[-1].t:
                return  # a driver promises rising times; a spline needs them
            self._readings.append(reading)
            self._series.add(reading.t, reading.q)
            self._delay.add(reading)
            while self._readings[0].t < reading.t - READING_SPAN:
                self._readings.popleft()
            self._series.drop_before(reading.t - READING_SPAN)
            self._arrived.notify_all()

    def least_delay(self) -> float | None:
        """Host's time of arrival less the reading's own, at its least, s; None without readings."""
        with self._arrived:
            return self._delay.value

    def period(self) -> float | None:
        """Time between readings, s, the median of the latest; None with fewer than three."""
        with self._arrived:
            latest = [self._readings[-i].t for i in range(1, min(len(self._readings), 20) + 1)]
        return float(np.median(-np.diff(latest))) if len(latest) > 2 else None

    def wait_past(self, t: float, deadline: float) -> EncoderReading | None:
        """Wait for the first reading at or after t, s, controller's clock; None: it came too late.

        The deadline is in s of the host's monotonic clock.
        """
        with self._arrived:
            self._arrived.wait_for(
                lambda: self._readings and self._readings[-1].t >= t, deadline - time.monotonic()
            )
            later = list(takewhile(lambda reading: reading.t >= t, reversed(self._readings)))
            return later[-1] if later else None

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
        """Half-width within which the readings beside an instant were taken, s: the larger one.

        A controller's answers take different times, so the newest does not stand for the others.
        """
        after = 0.0
        with self._arrived:
            for reading in reversed(self._readings):
                if reading.t < t:
                    return max(after, reading.half_width)
                after = reading.half_width
        return after

    def half_width(self) -> float:
        """Half-width within which the newest reading was taken, s."""
        with self._arrived:
            return self._readings[-1].half_width if self._readings else 0.0


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
        if not about:
            return None
        if any(r.moving and abs(r.t + delay - t) <= SETTLING_TIME for r in about):
            return None
        nearest = min(about, key=lambda r: abs(r.t + delay - t))
        return float(nearest.pan[0]), float(nearest.pan[1])
