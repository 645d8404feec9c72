"""Measured poses with readings as arrays, and their noise.

The noise is what was stated, or what the richest model leaves, whichever is larger.

    s² = Σ |w_i ξ_i|² / (m - Σ h)

over the m independent numbers of places, or of turns, with h the share of each in the fit
(leverage): what a fit with many parameters takes away is given back. A stated uncertainty is never
reduced, and enlarged only where residuals exceed it by more than their own scatter.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from verify.core.records import Array, Flags, Index, rigid_transform
from verify.core.statistics import chi2_ppf

SAME_POSTURE = np.deg2rad(0.5)  # joints that differ by less are in one posture


@dataclass(frozen=True, slots=True)
class IdentificationPoses:
    """n rows; j joints. Twists are (translation, rotation vector) at the target, world axes."""

    q: Array  # (n, j), rad, as read
    world_T_target: Array  # (n, 4, 4), m; where only positions were measured, no turn
    whitener: Array  # (n, 6, 6): times a twist, unit variance; zero rows where nothing is known
    stated: bool  # the covariances were stated; else only their proportions count
    base: Index  # (n,), from 0: which placing of the robot in the world
    tool: Index  # (n,), from 0: which mounting of the target
    recording: Index  # (n,), which of several the row is from
    block: Index  # (n,): rows of one block are held out together, as they repeat each other
    nuisance: Array  # (n, 6, p), of unit variance: what does not average out
    position_only: bool
    votes: Array  # (n, 6), how many independent numbers each whitened one counts for, at most 1

    def __len__(self) -> int:
        """Count the rows."""
        return len(self.q)

    @property
    def dimensions(self) -> Index:
        """How many numbers each row determines, (n,)."""
        return np.asarray(np.any(self.whitener != 0, axis=2).sum(axis=1))

    @property
    def posture(self) -> Index:
        """Which rows share posture, base and tool, (n,) from 0: they show noise, no more."""
        key = np.column_stack([np.round(self.q / SAME_POSTURE), self.base, self.tool])
        return np.asarray(np.unique(key, axis=0, return_inverse=True)[1])

    @property
    def first_visits(self) -> Index:
        """The first row of each posture."""
        return np.asarray(np.unique(self.posture, return_index=True)[1])

    @property
    def numbers(self) -> float:
        """How many independent numbers were measured."""
        return float(np.sum(self.votes * np.any(self.whitener != 0, axis=2)))


def build_poses(
    q: Array,
    measured: Array,
    covariance: Array | None = None,
    *,
    nuisance: Array | None = None,
    determined: tuple[Array, ...] | None = None,
) -> IdentificationPoses:
    """Gather poses or positions of one point with the readings q (n, j), rad, at their instants.

    `measured` is (n, 4, 4) or (n, 3), m, in any fixed frame, its covariance (n, 6, 6) or (n, 3, 3),
    m and rad; None: not known, and estimated from what is left, one variance for positions and one
    for turns. `nuisance` (n, 6, p) holds effects of unit variance that all rows share, `determined`
    n functionals (6, d) of a pose that were measured, all where not given. Placing of the robot,
    mounting of the target and recording are one, and each row is a block by itself.

    Raises:
        ValueError: shapes that do not fit together.
    """
    n = len(q)
    position_only = measured.ndim == 2
    size = 3 if position_only else 6
    if len(measured) != n or (covariance is not None and covariance.shape != (n, size, size)):
        raise ValueError(f"{n} readings, measured {measured.shape}, covariance of another shape")
    targets = rigid_transform(np.eye(3), measured) if position_only else measured
    none = np.zeros(n, dtype=np.int64)
    return IdentificationPoses(
        q=np.asarray(q, dtype=float),
        world_T_target=np.asarray(targets, dtype=float),
        whitener=_whitener(n, size, covariance, determined),
        stated=covariance is not None,
        base=none,
        tool=none,
        recording=none,
        block=np.arange(n),
        nuisance=np.zeros((n, 6, 0)) if nuisance is None else nuisance,
        position_only=position_only,
        votes=np.ones((n, 6)),
    )


def _whitener(
    n: int, size: int, covariance: Array | None, determined: tuple[Array, ...] | None
) -> Array:
    whitener = np.zeros((n, 6, 6))
    if covariance is None:
        whitener[:, range(size), range(size)] = 1.0
    elif determined is None:
        whitener[:, :size, :size] = np.linalg.inv(np.linalg.cholesky(covariance))
    else:
        for i, known in enumerate(determined):
            own = np.linalg.cholesky(known.T @ covariance[i] @ known)
            whitener[i, : known.shape[1]] = np.linalg.solve(own, known.T)
    return whitener


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
