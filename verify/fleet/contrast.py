"""Two sets of sessions held against each other: before and after a repair, one cell and another."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.distributions import t_isf
from verify.fleet.least_squares import fit
from verify.fleet.series import Series


@dataclass(frozen=True, slots=True)
class Contrast:
    """One joint's level in two sets of sessions, degrees; uncertainties are standard ones."""

    sessions: tuple[int, int]
    level: tuple[float, float]
    difference: float  # second less first
    standard_uncertainty: float  # of the difference: what both share drops out
    limit: float  # of |difference|, beyond which it is shown

    @property
    def shown(self) -> bool:
        """The difference is beyond chance."""
        return abs(self.difference) > self.limit


def contrast(series: Series, second: NDArray[np.bool_], false_alarm: float) -> Contrast | None:
    """Hold the sessions that are `second` against the others; None where either set is empty.

    Args:
        series: one joint of one arm.
        second: (n,), which belong to the second set.
        false_alarm: the chance that a difference is shown where there is none.
    """
    counts = int((~second).sum()), int(second.sum())
    if not all(counts):
        return None
    design = np.column_stack([np.ones(len(series)), second.astype(float)])
    found = fit(series, design)
    first, difference = found.coefficients.tolist()
    u = float(np.sqrt(found.covariance[1, 1]))
    limit = float(t_isf(false_alarm / 2, series.degrees_of_freedom)) * u
    return Contrast(counts, (first, first + difference), difference, u, limit)
