"""Noise of measured poses: what was stated, or what the richest model leaves, whichever is larger.

    s² = Σ |w_i ξ_i|² / (m - Σ h)

over the m independent numbers of places, or of turns, with h the share of each in the fit
(leverage): what a fit with many parameters takes away is given back. A stated uncertainty is never
reduced, and enlarged only where residuals exceed it by more than their own scatter.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from verify.calibration.kinematics.poses import IdentificationPoses
from verify.core.records import Array, Flags
from verify.core.statistics import chi2_ppf

MIN_EXCESS_SIGMA = 3.0  # standard deviations by which residuals must exceed what was stated
START_NOISE = (1e-4, 1e-4)  # m, rad: so small that no prior hides a fault from the first fit
TOL_SCALE = 1e-3  # relative
Estimate = Callable[[slice, float], tuple[float, float]]  # part, factor: factor, degrees of freedom


@dataclass(frozen=True, slots=True)
class NoiseScale:
    """Factors of the residuals over the stated standard uncertainties, or these, m and rad."""

    position: float
    orientation: float
    degrees_of_freedom: float = np.inf  # of their estimate; infinite where stated figures hold

    def of(self, poses: IdentificationPoses) -> Array:
        """Scale the whitener: (n, 6, 6)."""
        factors = np.array([self.position] * 3 + [self.orientation] * 3)
        return np.asarray(poses.whitener / factors)

    def whiten(self, poses: IdentificationPoses, twists: Array) -> Array:
        """Twists (n, 6) in units of their standard uncertainty, (n, 6)."""
        return (self.of(poses) @ twists[:, :, None])[:, :, 0]

    def near(self, other: "NoiseScale") -> bool:
        """Tell whether two differ by less than matters."""
        mine, others = (self.position, self.orientation), (other.position, other.orientation)
        return bool(np.allclose(mine, others, rtol=TOL_SCALE, atol=0.0))

    def at_least(self, other: "NoiseScale") -> "NoiseScale":
        """The larger of both, part by part, as sure as that of fewer degrees of freedom."""
        return NoiseScale(
            max(self.position, other.position),
            max(self.orientation, other.orientation),
            min(self.degrees_of_freedom, other.degrees_of_freedom),
        )


def initial_scale(poses: IdentificationPoses) -> NoiseScale:
    """The noise that a first fit takes for granted."""
    return NoiseScale(1.0, 1.0) if poses.stated else NoiseScale(*START_NOISE)


def residual_scale(
    left: Array, columns: Array, covariance: Array, poses: IdentificationPoses, at: NoiseScale
) -> NoiseScale:
    """Estimate the noise from the residuals (n, 6), m and rad, that a fit leaves.

    `columns` (n, 6, c) are the pose's change with each of c fitted numbers, `covariance` (c, c) is
    theirs by the noise `at`, which the fit took for granted.
    """

    def estimate(part: slice, factor: float) -> tuple[float, float]:
        white = _marginal_whitener(poses, part)
        taken = np.einsum("nac,cd,nad->", design := white @ columns[:, part], covariance, design)
        numbers = np.sum(poses.votes[:, part] * np.any(white != 0, axis=2))
        freedom = max(float(numbers - taken / factor**2), 1.0)
        variance = float(np.sum((white @ left[:, part, None]) ** 2)) / freedom
        if poses.stated and variance < 1 + MIN_EXCESS_SIGMA * np.sqrt(2 / freedom):
            return 1.0, np.inf
        return float(np.sqrt(variance)), freedom

    return _by_parts(poses, estimate, at)


def median_scale(left: Array, poses: IdentificationPoses, used: Flags) -> NoiseScale:
    """Estimate the noise by the median of the residuals (n, 6), which outlying rows do not move."""

    def estimate(part: slice, _factor: float) -> tuple[float, float]:
        white = _marginal_whitener(poses, part)[used]
        distance = np.sum((white @ left[used][:, part, None])[:, :, 0] ** 2, axis=1)
        middle = chi2_ppf(0.5, np.maximum(np.any(white != 0, axis=2).sum(axis=1), 1))
        variance = float(np.median(distance / middle))
        return (max(1.0, variance**0.5) if poses.stated else variance**0.5), np.inf

    return _by_parts(poses, estimate, NoiseScale(1.0, 1.0))


def _by_parts(poses: IdentificationPoses, estimate: Estimate, at: NoiseScale) -> NoiseScale:
    """Estimate places and turns apart; together where what is left open mixes them."""
    if poses.position_only:
        position, freedom = estimate(slice(0, 3), at.position)
        return NoiseScale(position, 1.0, freedom)
    if (poses.dimensions < 6).any():
        both, freedom = estimate(slice(0, 6), at.position)
        return NoiseScale(both, both, freedom)
    place, one = estimate(slice(0, 3), at.position)
    turn, other = estimate(slice(3, 6), at.orientation)
    return NoiseScale(place, turn, min(one, other))


def _marginal_whitener(poses: IdentificationPoses, part: slice) -> Array:
    """Whitener of places or turns by themselves, (n, 3, 3); of both, (n, 6, 6)."""
    white = poses.whitener
    if part.stop - part.start == 6:
        return white
    size = 3 if poses.position_only else 6
    information = (np.swapaxes(white, 1, 2) @ white)[:, :size, :size]
    own = np.linalg.inv(information)[:, part, part]
    return np.linalg.inv(np.linalg.cholesky(own))
