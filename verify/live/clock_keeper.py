"""Keeps the controller's clock while the robot moves: a window of pairs every few seconds."""

import threading
from collections import deque
from collections.abc import Callable

import numpy as np

import robots
from verify.clock import ClockEstimate, estimate_clock
from verify.live.clock_live import Clock, ClockLine, by_arrival
from verify.live.readings_book import ReadingsBook
from verify.readings import Readings
from verify.records import Measurement
from verify.rig import Rig
from verify.session_file import Clock as GivenClock
from verify.track import Track, collect

WINDOW = 10.0  # s of pairs in an estimate
EVERY = 3.0  # s from one estimate to the next
FEWEST = 40  # pairs, and
LEAST_SPAN = 3.0  # s, below which a motion shows little
MARGIN = 6.0  # s of readings on either side: half a window of offsets is searched
CAMERA_DELAY = 0.5  # s: pictures may be stamped so much late; a reading is never older than that
DELIVERY = 5.0  # s: no line, and no program that writes in lumps, is always later than that
NEAR = 0.05  # s: of several offsets that fit a periodic motion, one this near the known one
PATIENCE = 20.0  # s for an estimate; a machine that is so busy gets none

Question = tuple[Track, robots.Arm, Readings]
Estimator = Callable[[Question], ClockEstimate]


def estimate(question: Question) -> ClockEstimate:
    """Find the offset; a function for a process of its own."""
    return estimate_clock(*question)


class ClockKeeper:
    """Says which clock holds at an instant, and estimates it anew.

    Args:
        arm: the robot.
        rig: the cameras.
        book: the readings.
        given: the offset where the station states it.
        estimator: answers a window; in another process, as it takes longer than a picture.
    """

    def __init__(
        self,
        arm: robots.Arm,
        rig: Rig,
        book: ReadingsBook,
        given: GivenClock | None,
        estimator: Estimator,
    ) -> None:
        self._arm, self._rig, self._book, self._given = arm, rig, book, given
        self._estimator = estimator
        self._lock = threading.Lock()
        self._window: deque[Measurement] = deque()
        self._line = ClockLine()
        self._segment: int | None = None
        self._version = 0
        self.trouble = ""

    def add(self, measurement: Measurement) -> None:
        """Take a measured pair into the window."""
        if self._given is not None or measurement.status != "measured":
            return
        with self._lock:
            self._follow_segment()
            self._window.append(measurement)
            while self._window[0].t < measurement.t - WINDOW:
                self._window.popleft()

    def at(self, t: float, doubt: float = 0.0) -> Clock | None:
        """The clock at an instant.

        Args:
            t: s, cameras' clock.
            doubt: s, half-width within which the picture was taken.

        Returns:
            None before the first reading.
        """
        segment = self._book.segment
        if self._given is not None:
            given = self._given
            return Clock(given.encoder_offset, given.standard_uncertainty, "given", segment=segment)
        with self._lock:
            self._follow_segment()
            if len(self._line):
                offset, spread = self._line.at(t)
                drift = self._line.drift
                return Clock(offset, spread, "estimated", drift, segment, self._version)
        delay = self._book.least_delay()
        if delay is None:
            return None
        return by_arrival(delay, max(self._book.half_width(), doubt), segment)

    def estimate_now(self) -> bool:
        """Estimate the offset from the window; False where there is too little to do so."""
        with self._lock:
            self._follow_segment()
            window, segment = list(self._window), self._segment
        if len(window) < FEWEST or window[-1].t - window[0].t < LEAST_SPAN:
            return False
        clock = self.at(window[-1].t)
        if clock is None:
            return False
        readings = self._book.since(window[0].t - clock.offset - MARGIN)
        if readings is None or len(readings.t) < FEWEST // 4:
            return False
        track = collect(window, self._rig, [np.zeros((6, 1))] * len(window))
        found = self._estimator((track, self._arm, readings))
        middle = (window[0].t + window[-1].t) / 2
        with self._lock:
            if segment == self._segment and self._believable(found, middle):
                self._line.add(middle, found, WINDOW / EVERY)
                self._version += 1
        return True

    def run(self, stop: threading.Event) -> None:
        """Estimate every few seconds until told to stop."""
        while not stop.wait(EVERY):
            try:
                self.estimate_now()
                self.trouble = ""
            except Exception as error:  # an alarm must not end with the clock's estimate
                self.trouble = f"the clock could not be estimated: {error}"

    def _believable(self, found: ClockEstimate, t: float) -> bool:
        """Refuse an offset by which readings came before they were taken, or a rival's."""
        delay = self._book.least_delay()
        if delay is None or not delay - DELIVERY < found.offset < delay + CAMERA_DELAY:
            return False
        if not found.rivals:
            return True
        known = self._line.at(t)[0] if len(self._line) else delay
        return abs(found.offset - known) < (NEAR if len(self._line) else CAMERA_DELAY)

    def _follow_segment(self) -> None:
        """Begin anew when the controller's clock did."""
        if self._book.segment != self._segment:
            self._segment = self._book.segment
            self._window.clear()
            self._line = ClockLine()
            self._version += 1
