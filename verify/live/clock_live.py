"""The controller's clock against the cameras', estimated while the robot moves.

Offsets come from the motion, a window at a time (verify.clock); a line through them, whose slope
no crystal exceeds, carries them to now. Until the motion has shown an offset, readings are taken
to be as old as the quickest delivery makes them.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from verify.clock import ClockEstimate
from verify.records import Array

ARRIVAL_DOUBT = 0.005  # s: how much later than read the quickest delivery may come, standard
DRIFT = 5e-5  # of a crystal, standard uncertainty
WANDER = 2e-5  # s a root second: what a crystal's temperature does within minutes
REMEMBERED = 24  # windows: two minutes of them
JUMPED = 6.0  # standard uncertainties, and
JUMPED_BY = 0.003  # s: an estimate this far off says that the line no longer holds


@dataclass(frozen=True, slots=True)
class Clock:
    """What is added to the readings' time to get the cameras', at one instant."""

    offset: float  # s
    standard_uncertainty: float | None  # s; None: given as exact
    source: str  # given, arrival, estimated
    drift: float = 0.0  # s a second
    segment: int | None = None  # of the controller's clock
    version: int = 0  # rises whenever it was estimated anew

    def words(self) -> str:
        """Say which clock a line rests on."""
        known = "" if self.standard_uncertainty is None else f" ± {self.standard_uncertainty:.1e} s"
        return f"{self.source} {self.offset:.6f} s{known}"


@dataclass(frozen=True, slots=True)
class _Point:
    t: float  # s, cameras' clock, middle of the window
    offset: float
    variance: float


class ClockLine:
    """A straight line through the offsets of the last windows, with a bounded slope.

    Source: Bayesian linear regression with a prior of zero for the slope.
    """

    def __init__(self) -> None:
        self._points: deque[_Point] = deque(maxlen=REMEMBERED)
        self._drift = 0.0
        # what was told last, and when for: a pair's instant is asked for several times
        self._asked: tuple[float, tuple[float, float]] | None = None

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
            if apart > JUMPED_BY and apart > JUMPED * math.sqrt(known**2 + variance):
                self._points.clear()
        self._points.append(_Point(t, estimate.offset, variance))
        self._drift = float(self._fit(t)[0][1])
        self._asked = None

    def at(self, t: float) -> tuple[float, float]:
        """Offset at an instant and its standard uncertainty, s.

        Raises:
            ValueError: no window has shown an offset yet.
        """
        if not self._points:
            raise ValueError("no offset is known yet")
        if self._asked is None or self._asked[0] != t:
            self._asked = (t, self._solved(t))
        return self._asked[1]

    @property
    def drift(self) -> float:
        """Slope of the line, s a second."""
        return self._drift

    def _fit(self, t: float) -> tuple[Array, Array]:
        """Offset at t and slope, and their covariance."""
        age = np.array([point.t - t for point in self._points])
        offset = np.array([point.offset for point in self._points])
        wander = WANDER**2 * np.abs(age)
        weight = 1 / (np.array([point.variance for point in self._points]) + wander)
        design = np.stack([np.ones_like(age), age], axis=1)
        information = design.T @ (weight[:, None] * design)
        information[1, 1] += DRIFT**-2
        covariance = np.linalg.inv(information)
        base = float(offset[-1])  # the slope's prior is about the line, not about time zero
        solved = covariance @ (design.T @ (weight * (offset - base)))
        solved[0] += base
        return solved, covariance

    def _solved(self, t: float) -> tuple[float, float]:
        value, covariance = self._fit(t)
        return float(value[0]), float(np.sqrt(covariance[0, 0]))


def by_arrival(least_delay: float, half_width: float, segment: int | None) -> Clock:
    """The clock that deliveries suggest: the quickest one was in hand a little after its reading.

    Args:
        least_delay: s, arrival less the reading's own time, at its least.
        half_width: s, within which a reading is known.
        segment: of the controller's clock.
    """
    doubt = math.hypot(ARRIVAL_DOUBT, half_width / math.sqrt(3))
    return Clock(least_delay - ARRIVAL_DOUBT, doubt, "arrival", segment=segment)
