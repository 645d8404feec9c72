"""A change of one joint in white noise: two-sided CUSUM sums, one pair a joint.

Source: Page, Biometrika 41, 1954; average run length of Siegmund, Sequential Analysis, 1985,
ch. 10, here without its allowance for overshoot: pairs that repeat each other have none.
"""

import numpy as np
from scipy.optimize import brentq

from verify.live.innovations import Innovation
from verify.records import Array

BOTH_WAYS = np.array([[1.0], [-1.0]])
REFERENCE = 0.5  # standard deviations of a pair: a change of twice that is found soonest


def threshold(false_alarms_per_hour: float, rate: float, joints: int) -> float:
    """Where the sums must stand for an alarm.

    Args:
        false_alarms_per_hour: of the robot as a whole: all joints, both directions.
        rate: pairs a second.
        joints: how many are watched.

    Returns:
        h, in standard deviations of a pair.
    """
    pairs = 3600.0 * rate * 2 * joints / false_alarms_per_hour
    return float(brentq(lambda h: run_length(h) - pairs, 0.0, 200.0))


def run_length(h: float) -> float:
    """Pairs from one false alarm of one sum to the next, on average."""
    return float((np.expm1(2 * REFERENCE * h) - 2 * REFERENCE * h) / (2 * REFERENCE**2))


class Cusum:
    """The sums of all joints.

    Args:
        joints: how many.
        limit: `threshold`.
    """

    def __init__(self, joints: int, limit: float) -> None:
        self.limit = limit
        self.sums = np.zeros((2, joints))  # upward, downward
        self._since = np.zeros((2, joints), dtype=int)
        self.count = 0  # pairs since it began anew

    def take(self, innovation: Innovation) -> None:
        """Add a pair."""
        length = np.sqrt(np.sum(innovation.joints**2, axis=0))
        score: Array = np.divide(
            innovation.residual @ innovation.joints,
            length,
            out=np.zeros_like(length),
            where=length > 0,
        )
        self.sums = np.maximum(self.sums + BOTH_WAYS * score - REFERENCE, 0.0)
        self._since = np.where(self.sums > 0, self._since + 1, 0)
        self.count += 1

    @property
    def exceeded(self) -> bool:
        """Some sum stands beyond the limit."""
        return bool(self.sums.max() > self.limit)

    @property
    def begun(self) -> int:
        """Pairs since the largest sum left zero: when the change began, as far as it tells."""
        return int(self._since.flat[int(np.argmax(self.sums))])

    def restart(self) -> None:
        """Begin anew: the change has been told, or something else has changed."""
        self.sums[:] = 0.0
        self._since[:] = 0
        self.count = 0
