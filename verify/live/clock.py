"""The controller's clock against the cameras', estimated from windows of pairs during the run.

Each window gives an offset (verify.analysis.clock); a line through the offsets, whose slope no
crystal exceeds, extrapolates them to now. Until the motion has determined an offset, readings are
taken to be as old as the quickest delivery makes them.
"""

import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import robots
from verify.analysis.clock.estimate import ArrivalClock, ClockEstimate, estimate_clock
from verify.core.readings import Readings
from verify.core.records import Array, Measurement
from verify.core.rig import Rig
from verify.io.session.keys import Clock as GivenClock
from verify.live.buffers import ReadingBuffer
from verify.measurement.track import Track, collect_track

U_ARRIVAL = 0.005  # s: how much later than read the quickest delivery may come, standard
U_DRIFT = 5e-5  # of a crystal, standard uncertainty
RANDOM_WALK = 2e-5  # s a root second: what a crystal's temperature does within minutes
MAX_WINDOWS = 24  # windows: two minutes of them
MIN_JUMP_RATIO = 6.0  # standard uncertainties, and
MIN_JUMP = 0.003  # s: an estimate this far off says that the line no longer holds


@dataclass(frozen=True, slots=True)
class LiveClock:
    """What is added to the readings' time to get the cameras', at one instant."""

    offset: float  # s
    standard_uncertainty: float | None  # s; None: given as exact
    source: str  # given, arrival, estimated
    drift: float = 0.0  # s a second
    segment: int | None = None  # of the controller's clock
    version: int = 0  # rises whenever it was estimated anew

    def words(self) -> str:
        """Say which clock a line rests on."""
        u = self.standard_uncertainty
        known = "" if u is None else f" ± {2e3 * u:.2f} ms (k = 2)"
        return f"{self.source} {1e3 * self.offset:.2f} ms{known}"


class ClockLine:
    """A straight line through the offsets of the last windows, with a bounded slope.

    Source: Bayesian linear regression with a prior of zero for the slope.
    """

    def __init__(self) -> None:
        # a window each: its middle, s, cameras' clock; its offset, s, and that one's variance
        self._points: deque[tuple[float, float, float]] = deque(maxlen=MAX_WINDOWS)
        self.drift = 0.0  # slope of the line, s a second

    def __len__(self) -> int:
        """Count the windows that it rests on."""
        return len(self._points)

    def add(self, t: float, estimate: ClockEstimate, overlap: float) -> None:
        """Take a window's offset.

        Args:
            t: s, cameras' clock, the window's middle.
            estimate: what the motion in it shows.
            overlap: by how many windows each stretch of time is seen.
        """
        if estimate.source != "estimated" or estimate.standard_uncertainty is None:
            return
        variance = estimate.standard_uncertainty**2 * max(overlap, 1.0)
        if self._points:
            expected, known = self.at(t)
            apart = abs(estimate.offset - expected)
            if apart > MIN_JUMP and apart > MIN_JUMP_RATIO * math.sqrt(known**2 + variance):
                self._points.clear()
        self._points.append((t, estimate.offset, variance))
        self.drift = float(self._fit(t)[0][1])

    def at(self, t: float) -> tuple[float, float]:
        """Offset at an instant and its standard uncertainty, s.

        Raises:
            ValueError: no window has shown an offset yet.
        """
        if not self._points:
            raise ValueError("no offset is known yet")
        value, covariance = self._fit(t)
        return float(value[0]), float(np.sqrt(covariance[0, 0]))

    def _fit(self, t: float) -> tuple[Array, Array]:
        """Offset at t and slope, and their covariance."""
        middle, offset, variance = np.array(self._points).T
        age = middle - t
        weight = 1 / (variance + RANDOM_WALK**2 * np.abs(age))
        design = np.stack([np.ones_like(age), age], axis=1)
        information = design.T @ (weight[:, None] * design)
        information[1, 1] += U_DRIFT**-2
        covariance = np.linalg.inv(information)
        base = float(offset[-1])  # the slope's prior is about the line, not about time zero
        solved = covariance @ (design.T @ (weight * (offset - base)))
        solved[0] += base
        return solved, covariance


def clock_from_arrivals(least_delay: float, half_width: float, segment: int | None) -> LiveClock:
    """The clock that deliveries suggest: the quickest one was in hand a little after its reading.

    Args:
        least_delay: s, arrival less the reading's own time, at its least.
        half_width: s, within which a reading is known.
        segment: of the controller's clock.
    """
    doubt = math.hypot(U_ARRIVAL, half_width / math.sqrt(3))
    return LiveClock(least_delay - U_ARRIVAL, doubt, "arrival", segment=segment)


WINDOW = 10.0  # s of pairs in an estimate
ESTIMATE_PERIOD = 3.0  # s from one estimate to the next
MIN_PAIRS = 40  # pairs, and
MIN_SPAN = 3.0  # s, below which a motion shows little
READING_MARGIN = 6.0  # s of readings on either side: half a window of offsets is searched
MAX_ARRIVAL_RATIO = 10.0  # standard uncertainties of an arrival clock: no offset is farther away
ESTIMATE_TIMEOUT = 20.0  # s for an estimate; a machine that is so busy gets none

ClockRequest = tuple[Track, robots.Arm, Readings, ArrivalClock]
Estimator = Callable[[ClockRequest], ClockEstimate]


def estimate_offset(question: ClockRequest) -> ClockEstimate:
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
        book: ReadingBuffer,
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
        self._contradiction = 0.0  # s: arrival's offset less the motion's, where that is too far
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

    def at(self, t: float, doubt: float = 0.0) -> LiveClock | None:
        """The clock at an instant.

        Args:
            t: s, cameras' clock.
            doubt: s, half-width within which the picture was taken.

        Returns:
            None before the first reading.
        """
        segment = self._book.segment
        if self._given is not None:
            offset, u = self._given.encoder_offset, self._given.standard_uncertainty
            return LiveClock(offset, u, "given", segment=segment)
        with self._lock:
            self._follow_segment()
            if len(self._line):
                offset, spread = self._line.at(t)
                drift = self._line.drift
                return LiveClock(offset, spread, "estimated", drift, segment, self._version)
        delay = self._book.least_delay()
        if delay is None:
            return None
        # what deliveries suggest is less well known where the motion contradicts it
        width = math.hypot(max(self._book.half_width_about(math.inf), doubt), self._contradiction)
        return clock_from_arrivals(delay, width, self._segment)

    def estimate_now(self) -> bool:
        """Estimate the offset from the window; False where there is too little to do so."""
        with self._lock:
            self._follow_segment()
            window, segment = list(self._window), self._segment
        if len(window) < MIN_PAIRS or window[-1].t - window[0].t < MIN_SPAN:
            return False
        clock = self.at(window[-1].t)
        if clock is None:
            return False
        readings = self._book.since(window[0].t - clock.offset - READING_MARGIN)
        if readings is None or len(readings.t) < MIN_PAIRS // 4:
            return False
        track = collect_track(window, self._rig, [np.zeros((6, 1))] * len(window))
        middle = (window[0].t + window[-1].t) / 2
        known = ArrivalClock(clock.offset, clock.standard_uncertainty or 0.0)
        found = self._estimator((track, self._arm, readings, known))
        with self._lock:
            if segment == self._segment and self._believable(found):
                self._line.add(middle, found, WINDOW / ESTIMATE_PERIOD)
                self._version += 1
        return True

    def run(self, stop: threading.Event) -> None:
        """Estimate every few seconds until told to stop."""
        while not stop.wait(ESTIMATE_PERIOD):
            try:
                self.estimate_now()
            except Exception as error:  # an alarm must not end with the clock's estimate
                self.trouble = f"the clock could not be estimated: {error}"

    def _believable(self, found: ClockEstimate) -> bool:
        """Refuse an offset that is not the only one, or that arrival times exclude.

        That is the motion of another cycle, or a line or cameras that are always late.
        """
        delay, self.trouble = self._book.least_delay(), ""
        if delay is None or found.source != "estimated":
            return False
        late = found.offset - delay
        near = abs(late) <= MAX_ARRIVAL_RATIO * ArrivalClock(delay, U_ARRIVAL).reach
        self._contradiction = 0.0 if near else abs(late)
        if not near:
            self.trouble = (
                f"the motion shows an offset {late:+.2f} s from what the arrival of readings "
                "shows, and is not used: are readings or pictures always late?"
            )
        return near

    def _follow_segment(self) -> None:
        """Begin anew when the controller's clock did."""
        if self._book.segment != self._segment:
            self._segment = self._book.segment
            self._window.clear()
            self._line = ClockLine()
            self._contradiction, self.trouble = 0.0, ""
            self._version += 1
