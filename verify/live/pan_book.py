"""How the camera bases stand at an instant."""

import threading
import time
from collections import deque

from verify.devices import PanReading
from verify.live.readings_book import ARRIVALS

KEPT = 5.0  # s
OLD = 1.0  # s: a base that has been silent for so long may stand anywhere
PATIENCE = 0.03  # s that a picture waits for word of how the bases stood
SETTLE = 0.1  # s after the last moving reading in which pictures are not believed


class PanBook:
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
            while self._readings[0].t_host < reading.t_host - KEPT:
                self._readings.popleft()
            while self._delays[0][0] < reading.t_host - ARRIVALS:
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
            deadline = time.monotonic() + PATIENCE
            while self._readings[-1].t + delay < t:  # it may have begun to move just now
                rest = deadline - time.monotonic()
                if rest <= 0 or not self._arrived.wait(rest):
                    break
            about = [r for r in self._readings if abs(r.t + delay - t) <= OLD]
        if not about:
            return None
        if any(r.moving and abs(r.t + delay - t) <= SETTLE for r in about):
            return None
        nearest = min(about, key=lambda r: abs(r.t + delay - t))
        return float(nearest.pan[0]), float(nearest.pan[1])
