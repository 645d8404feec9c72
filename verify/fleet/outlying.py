"""Single sessions that stand apart from those before and after them: odd, and no change."""

import numpy as np
from numpy.typing import NDArray

from verify.distributions import t_isf
from verify.fleet.series import Series

NEAR = 3  # sessions on either side that one is held against
MEDIAN_VARIANCE = {1: 1.0, 2: 0.5, 3: 0.449}  # of so many, in that of one (normal)


def outlying(series: Series, false_alarm: float) -> NDArray[np.bool_]:
    """Tell which sessions stand apart from both sides, (n,).

    Args:
        series: one joint over time.
        false_alarm: the chance that any is named where all are alike.
    """
    n = len(series)
    apart = np.zeros(n, dtype=bool)
    if n <= NEAR:
        return apart
    limit = t_isf(false_alarm / n / 2, series.degrees_of_freedom)
    for i in range(n):
        sides = [slice(max(i - NEAR, 0), i), slice(i + 1, i + 1 + NEAR)]
        there = [side for side in sides if len(series.t[side])]
        apart[i] = all(_distance(series, i, side) > limit for side in there)
    return apart


def _distance(series: Series, i: int, side: slice) -> float:
    """How far a session lies from the median of its neighbours, in standard uncertainties."""
    share = MEDIAN_VARIANCE[len(series.t[side])]
    variance = series.scatter[i] ** 2 + share * np.max(series.scatter[side]) ** 2
    if np.any(series.group[side] != series.group[i]):
        variance += series.shared[i] ** 2 + np.max(series.shared[side]) ** 2
    return float(abs(series.error[i] - np.median(series.error[side])) / np.sqrt(variance))
