"""Buffers of the latest encoder readings and base angles: look up an instant, or wait for it."""

import threading
import time
from collections import deque

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

    def __len__(self) -> int:
        """Count the readings."""
        return self._end - self._first

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

    def forget_before(self, t: float) -> None:
        """Let readings before an instant go."""
        while self._first < self._end and self._t[self._first] < t:
            self._first += 1

    def clear(self) -> None:
        """Let all go."""
        self._first = self._end = 0

    def copied(self, begin: int) -> Readings | None:
        """Readings from one of them on, counted from the oldest; None where there is none."""
        chosen = slice(self._first + begin, self._end)
        if chosen.start >= chosen.stop:
            return None
        return Readings(self._t[chosen].copy(), self._q[chosen].copy())

    def _make_room(self, joints: int) -> None:
        """Move what is kept to the begin of arrays twice as long as it needs."""
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
ARRIVAL_SPAN = 30.0  # s over which the quickest delivery is looked for


class ReadingBuffer:
    """Readings of the controller's present clock segment; a new segment starts a new book."""

    def __init__(self) -> None:
        self.arrived = threading.Condition()
        self._readings: deque[EncoderReading] = deque()
        self._store = ReadingSeries()  # the same, as arrays
        self._delays: deque[tuple[float, float]] = deque()  # t_host, t_host - t: rising delays
        self.segment: int | None = None
        self.added = 0

    def add(self, reading: EncoderReading) -> None:
        """Take a reading; those who wait for one look again."""
        with self.arrived:
            if reading.segment != self.segment:
                self._readings.clear()
                self._store.clear()
                self._delays.clear()
                self.segment = reading.segment
            if self._readings and reading.t <= self._readings[-1].t:
                return  # a driver promises rising times; a spline could not bear less
            self._readings.append(reading)
            self._store.add(reading.t, reading.q)
            self._note_delay(reading)
            while self._readings[0].t < reading.t - READING_SPAN:
                self._readings.popleft()
            self._store.forget_before(reading.t - READING_SPAN)
            self.added += 1
            self.arrived.notify_all()

    def _note_delay(self, reading: EncoderReading) -> None:
        """Keep the least of the delays of the last while (a queue that rises)."""
        delay = reading.t_host - reading.t
        while self._delays and self._delays[-1][1] >= delay:
            self._delays.pop()
        self._delays.append((reading.t_host, delay))
        while self._delays[0][0] < reading.t_host - ARRIVAL_SPAN:
            self._delays.popleft()

    def least_delay(self) -> float | None:
        """Host's time of arrival less the reading's own, at its least, s; None without readings."""
        with self.arrived:
            return self._delays[0][1] if self._delays else None

    def period(self) -> float | None:
        """Time between readings, s, the median of the latest; None with fewer than three."""
        with self.arrived:
            latest = [self._readings[-i].t for i in range(1, min(len(self._readings), 20) + 1)]
        return float(np.median(-np.diff(latest))) if len(latest) > 2 else None

    def latest(self) -> EncoderReading | None:
        """The newest reading."""
        with self.arrived:
            return self._readings[-1] if self._readings else None

    def wait_past(self, t: float, deadline: float) -> EncoderReading | None:
        """Wait for the first reading at or after an instant.

        Args:
            t: s, controller's clock.
            deadline: s, host's monotonic clock.

        Returns:
            That reading; None if it did not come in time.
        """
        with self.arrived:
            while not self._readings or self._readings[-1].t < t:
                rest = deadline - time.monotonic()
                if rest <= 0 or not self.arrived.wait(rest):
                    if self._readings and self._readings[-1].t >= t:
                        break
                    return None
            found = self._readings[-1]
            for reading in reversed(self._readings):
                if reading.t < t:
                    break
                found = reading
            return found

    def about(self, t: float) -> Readings | None:
        """Readings about an instant t (s, controller's clock), for its angle and speed.

        None from before a silence of the line: what happened in it is not known.
        """
        with self.arrived:
            times = self._store.t
            before = int(np.searchsorted(times, t - INTERPOLATION_SPAN))
            begin = max(min(before, len(times) - MIN_INTERPOLATION_READINGS), 0)
            silences = np.flatnonzero(np.diff(times[begin:]) > MAX_GAP)
            if len(silences):  # the arm went on while the line was silent
                begin += int(silences[-1]) + 1
            return self._store.copied(begin)

    def since(self, t: float) -> Readings | None:
        """All readings from an instant (s, controller's clock) on."""
        with self.arrived:
            return self._store.copied(int(np.searchsorted(self._store.t, t)))

    def half_width_about(self, t: float) -> float:
        """Within what the readings on either side of an instant are known, s: the worse of both.

        Answers of a controller come now quickly, now late, and the newest says nothing of the
        others.
        """
        after = 0.0
        with self.arrived:
            for reading in reversed(self._readings):
                if reading.t < t:
                    return max(after, reading.half_width)
                after = reading.half_width
        return after

    def half_width(self) -> float:
        """Within what each reading is known, s, of the newest."""
        latest = self.latest()
        return latest.half_width if latest is not None else 0.0


PAN_SPAN = 5.0  # s
MAX_PAN_AGE = 1.0  # s: a base that has been silent for so long may stand anywhere
PAN_TIMEOUT = 0.03  # s that a picture waits for word of how the bases stood
SETTLING_TIME = 0.1  # s after the last moving reading in which pictures are not believed


class PanBuffer:
    """Turns readings of the bases into angles at an instant.

    A base stands while pictures are measured, so the reading before it holds; pictures taken while
    a base moves are not measured.
    """

    def __init__(self) -> None:
        self._arrived = threading.Condition()
        self._readings: deque[PanReading] = deque()
        self._delays: deque[tuple[float, float]] = deque()
        self._segment: int | None = None

    def add(self, reading: PanReading) -> None:
        """Take a reading."""
        with self._arrived:
            if reading.segment != self._segment:
                self._readings.clear()
                self._delays.clear()
                self._segment = reading.segment
            self._readings.append(reading)
            self._delays.append((reading.t_host, reading.t_host - reading.t))
            while self._readings[0].t_host < reading.t_host - PAN_SPAN:
                self._readings.popleft()
            while self._delays[0][0] < reading.t_host - ARRIVAL_SPAN:
                self._delays.popleft()
            self._arrived.notify_all()

    def at(self, t: float) -> tuple[float, float] | None:
        """Angles of left and right base, rad, at an instant (s, cameras' clock).

        None while a base moves, and where no reading tells.
        """
        with self._arrived:
            if not self._readings:
                return None
            delay = min(delay for _, delay in self._delays)
            deadline = time.monotonic() + PAN_TIMEOUT
            while self._readings[-1].t + delay < t:  # it may have begun to move just now
                rest = deadline - time.monotonic()
                if rest <= 0 or not self._arrived.wait(rest):
                    break
            about = [r for r in self._readings if abs(r.t + delay - t) <= MAX_PAN_AGE]
        if not about:
            return None
        if any(r.moving and abs(r.t + delay - t) <= SETTLING_TIME for r in about):
            return None
        nearest = min(about, key=lambda r: abs(r.t + delay - t))
        return float(nearest.pan[0]), float(nearest.pan[1])
