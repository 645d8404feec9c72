"""The noise of measured poses: what was stated, or what a fit leaves, whichever is larger."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from verify.arm_identification.poses import Poses
from verify.records import Array

CLEARLY = 3.0  # standard deviations by which what is left must exceed what was stated


@dataclass(frozen=True, slots=True)
class Scale:
    """By how much what is left exceeds the stated standard uncertainties."""

    position: float
    orientation: float

    def of(self, poses: Poses) -> Array:
        """Scale the whitener: (n, 6, 6)."""
        factors = np.array([self.position] * 3 + [self.orientation] * 3)
        scaled: Array = poses.whitener / factors
        return scaled

    def near(self, other: "Scale") -> bool:
        """Tell whether two differ by less than matters."""
        return bool(
            np.isclose(self.position, other.position, rtol=0.01)
            and np.isclose(self.orientation, other.orientation, rtol=0.01)
        )


def scale_of(left: Array, poses: Poses, used: NDArray[np.bool_], free: int) -> Scale:
    """Find the noise by the median of what is left, which outlying rows do not move.

    A stated uncertainty is never talked down, and up only where what is left exceeds it by more
    than its own scatter.

    Args:
        left: (n, 6), m and rad, what a fit leaves.
        poses: n rows.
        used: (n,), rows that belong.
        free: parameters of the fit.
    """
    count = int(poses.dimensions[used].sum())
    lost = count / max(count - free, 1)

    def spread(part: slice) -> float:
        return _spread(left[used], poses, used, part, lost)

    if poses.position_only:
        return Scale(spread(slice(0, 3)), 1.0)
    if (poses.dimensions[used] < 6).any():  # what is left open mixes places and turns
        both = spread(slice(0, 6))
        return Scale(both, both)
    return Scale(spread(slice(0, 3)), spread(slice(3, 6)))


def _spread(left: Array, poses: Poses, used: NDArray[np.bool_], part: slice, lost: float) -> float:
    """Standard deviation in units of the stated one, of places or turns by themselves."""
    white = poses.whitener[used]
    if part.stop - part.start < 6:
        size = 3 if poses.position_only else 6
        information = (np.swapaxes(white, 1, 2) @ white)[:, :size, :size]
        own = np.linalg.inv(information)[:, part, part]
        white = np.linalg.inv(np.linalg.cholesky(own))
    distance = np.sum((white @ left[:, part, None])[:, :, 0] ** 2, axis=1)
    freedom = np.maximum(np.any(white != 0, axis=2).sum(axis=1), 1)
    middle = chi2.median(freedom)
    variance = float(np.median(distance / middle)) * lost
    # of a median: half over the density there and the root of the number
    scatter = float(np.mean(0.5 / (chi2.pdf(middle, freedom) * middle)) / np.sqrt(len(freedom)))
    if poses.stated and variance < 1 + CLEARLY * scatter:
        return 1.0
    return float(np.sqrt(variance))
