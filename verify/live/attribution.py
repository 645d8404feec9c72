"""Which joint changed, by how much, and which others cannot be ruled out."""

from dataclasses import dataclass

import numpy as np

from verify.live.innovations import RETOLD, Innovations

# pairs by which a change may have come later than its sum left zero: noise keeps sums off zero
ONSETS = (0, 1, 2, 3, 5, 8, 13, 21, 34)
TELLS_APART = 15.0  # of chi²: by so much the best joint must beat a rival (docs/results.md)


@dataclass(frozen=True, slots=True)
class Change:
    """What a change looks like."""

    joint: int  # the one that explains most, counted from 0
    size: float  # rad, by how much its reading has moved
    standard_uncertainty: float  # rad
    rivals: tuple[int, ...]  # joints that explain nearly as much, the likeliest first
    pairs: int  # since it was there in full


def attribute(innovations: Innovations, joints: int, pairs: int) -> Change:
    """Suppose each joint in turn to have changed some pairs ago, and compare.

    Args:
        innovations: what the pairs brought.
        joints: how many the arm has.
        pairs: since the change began.

    Returns:
        The change that explains those pairs best.
    """
    pairs = min(max(pairs, 1), RETOLD)
    best, late = 0, 0
    for _ in range(2):  # a second time from where the likeliest joint says that it began
        supposed = [innovations.suppose(j, pairs, late) for j in range(joints)]
        cost = np.array([outcome[0] for outcome in supposed])
        order = np.argsort(cost).tolist()
        best = order[0]
        if late or pairs == 1:
            break
        onsets = [n for n in ONSETS if n < pairs]
        costs = [innovations.suppose(best, pairs, n)[0] for n in onsets]
        late = onsets[int(np.argmin(costs))]
        if late == 0:
            break
    return Change(
        joint=best,
        size=supposed[best][1],
        standard_uncertainty=supposed[best][2],
        rivals=tuple(j for j in order[1:] if cost[j] - cost[best] < TELLS_APART),
        pairs=pairs - late,
    )
