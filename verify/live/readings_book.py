"""The latest encoder readings: kept, looked up, waited for."""

import threading
import time
from collections import deque

import numpy as np

from verify.devices import EncoderReading
from verify.live.readings_store import ReadingsStore
from verify.readings import LONGEST_GAP, Readings

KEPT = 90.0  # s of readings: the clock's window and its margins
ABOUT = 0.7  # s before an instant that its reading is interpolated from, with room for its speed
FEWEST_ABOUT = 6  # readings, however slow: what a curve misses shows by those beside it
ARRIVALS = 30.0  # s over which the quickest delivery is looked for


class ReadingsBook:
    """Readings of the controller's present clock segment; a new segment starts a new book."""

    def __init__(self) -> None:
        self.arrived = threading.Condition()
        self._readings: deque[EncoderReading] = deque()
        self._store = ReadingsStore()  # the same, as arrays
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
            while self._readings[0].t < reading.t - KEPT:
                self._readings.popleft()
            self._store.forget_before(reading.t - KEPT)
            self.added += 1
            self.arrived.notify_all()

    def _note_delay(self, reading: EncoderReading) -> None:
        """Keep the least of the delays of the last while (a queue that rises)."""
        delay = reading.t_host - reading.t
        while self._delays and self._delays[-1][1] >= delay:
            self._delays.pop()
        self._delays.append((reading.t_host, delay))
        while self._delays[0][0] < reading.t_host - ARRIVALS:
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
            before = int(np.searchsorted(times, t - ABOUT))
            begin = max(min(before, len(times) - FEWEST_ABOUT), 0)
            silences = np.flatnonzero(np.diff(times[begin:]) > LONGEST_GAP)
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
