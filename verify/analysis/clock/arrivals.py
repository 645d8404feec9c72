"""The clock's offset from the times at which readings arrived, where a log holds them.

A reading of controller's time t that arrives at t_host on the cameras' clock was late by some delay
d ≥ 0, so that t_host - t = offset + d. The quickest delivery of a log is late by little:

    offset = min(t_host - t) - MEAN_DELIVERY
"""

from dataclasses import dataclass

import numpy as np

from verify.core.records import Array

MEAN_DELIVERY = 0.005  # s: how late the quickest delivery is taken to be, and its uncertainty
# s, standard: of the stamps of pictures, which some cameras put on when a picture is delivered
CAMERA_STAMP = 0.03
MIN_SPREAD_SHARE = 0.1  # of the delays' spread: the quickest of a jittery line is less well known


@dataclass(frozen=True, slots=True)
class ArrivalClock:
    """What deliveries say of the offset."""

    offset: float  # s
    standard_uncertainty: float  # s, of the readings' side alone

    @property
    def reach(self) -> float:
        """Standard uncertainty with the pictures' own stamps, s: what the motion is weighed by."""
        return float(np.hypot(self.standard_uncertainty, CAMERA_STAMP))


def clock_from_arrival_times(t: Array, t_host: Array) -> ArrivalClock:
    """The offset that arrival times suggest: readings' own times t and arrivals t_host, (m,), s."""
    delay = t_host - t
    quickest = float(delay.min())
    spread = MIN_SPREAD_SHARE * (float(np.median(delay)) - quickest)
    return ArrivalClock(quickest - MEAN_DELIVERY, float(np.hypot(MEAN_DELIVERY, spread)))
