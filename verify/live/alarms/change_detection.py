"""Detect a change of one joint in white noise by two-sided CUSUM sums, and attribute it to a joint.

Source: Page, Biometrika 41, 1954; average run length of Siegmund, Sequential Analysis, 1985,
ch. 10, here without its allowance for overshoot: pairs that repeat each other have none.
"""

from dataclasses import dataclass

import numpy as np

from verify.live.alarms.innovations import MAX_REPEATED, Innovation, InnovationFilter

DIRECTIONS = np.array([[1.0], [-1.0]])
REFERENCE = 0.5  # standard deviations of a pair: a change of twice that is found soonest


def alarm_threshold(false_alarms_per_hour: float, rate: float, joints: int) -> float:
    """Where the sums must stand for an alarm, in standard deviations of a pair.

    False alarms are of the robot as a whole, all joints, both directions; the rate is pairs a
    second.
    """
    from scipy.optimize import brentq  # slow to load, and not every command watches

    pairs = 3600.0 * rate * 2 * joints / false_alarms_per_hour
    return float(brentq(lambda h: run_length(h) - pairs, 0.0, 200.0))


def run_length(h: float) -> float:
    """Pairs from one false alarm of one sum to the next, on average."""
    return float((np.expm1(2 * REFERENCE * h) - 2 * REFERENCE * h) / (2 * REFERENCE**2))


class Cusum:
    """The sums of all joints."""

    def __init__(self, joints: int, limit: float) -> None:
        self.limit, self._joints = limit, joints
        self.restart()

    def restart(self) -> None:
        """Begin anew: the change has been told, or something else has changed."""
        self.sums = np.zeros((2, self._joints))  # upward, downward
        self._since = np.zeros((2, self._joints), dtype=int)
        self.count = 0  # pairs since it began anew

    def take(self, innovation: Innovation) -> None:
        """Add a pair."""
        score = DIRECTIONS * innovation.along_joints
        self.sums = np.maximum(self.sums + score - REFERENCE, 0.0)
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


# pairs by which a change may have come later than its sum left zero: noise keeps sums off zero
ONSET_DELAYS = (0, 1, 2, 3, 5, 8, 13, 21, 34)
MAX_MISFIT = 4.0  # chi² a direction: beyond it an offset of one joint does not explain the pairs
MIN_OWN_SHARE = 0.75  # of that chi²: below it an error of this joint that varies does not either
MIN_CHI2_DIFFERENCE = 15.0  # of chi²: by so much the best joint must beat a rival (docs/results.md)


@dataclass(frozen=True, slots=True)
class ChangeAttribution:
    """What a change looks like."""

    joint: int  # the one that explains most, counted from 0
    size: float  # rad, by how much its reading has moved
    standard_uncertainty: float  # rad
    rivals: tuple[int, ...]  # joints that explain nearly as much, the likeliest first
    pairs: int  # since it was there in full
    constant: bool  # an offset of this joint explains the pairs
    alone: bool  # an error of this joint explains most of what they are off by


def attribute_change(innovations: InnovationFilter, joints: int, pairs: int) -> ChangeAttribution:
    """Suppose each joint in turn to have changed some pairs ago; the change that explains best."""
    pairs = min(max(pairs, 1), MAX_REPEATED)
    best, late = 0, 0
    for _ in range(2):  # a second time from where the likeliest joint says that it began
        supposed = [innovations.suppose(j, pairs, late) for j in range(joints)]
        cost = np.array([outcome.cost for outcome in supposed])
        order = np.argsort(cost).tolist()
        best = order[0]
        if late or pairs == 1:
            break
        onsets = [n for n in ONSET_DELAYS if n < pairs]
        costs = [innovations.suppose(best, pairs, n).cost for n in onsets]
        late = onsets[int(np.argmin(costs))]
        if late == 0:
            break
    found = supposed[best]
    return ChangeAttribution(
        joint=best,
        size=found.size,
        standard_uncertainty=found.standard_uncertainty,
        rivals=tuple(j for j in order[1:] if cost[j] - cost[best] < MIN_CHI2_DIFFERENCE),
        pairs=pairs - late,
        constant=found.misfit < MAX_MISFIT,
        alone=found.misfit < MAX_MISFIT or found.own_share > MIN_OWN_SHARE,
    )
