"""Indices of ISO 9283 as functions of arrays (m, rad), and their 95 % intervals.

Attained poses are n visits of one commanded pose; m stations of a path have n visits each. The
standard states no uncertainty: here scatter is taken as normal with the covariance that the visits
show, as depth is known worse than the rest. Draws are the same every time.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from verify.core.records import Array, Index
from verify.core.statistics import chi2_ppf, t_ppf

REPEATABILITY_SIGMAS = 3.0  # standard deviations that repeatability counts
P_TAIL = 0.025  # of the probability, beyond either end of an interval
N_DRAWS = 2000
SEED = 9283
INFINITE_DOF = 1e9  # degrees of freedom, as good as known
TOL_VARIANCE = 1e-10  # of the widest variance: a direction without scatter
NODES, WEIGHTS = (part / 2 for part in np.polynomial.legendre.leggauss(64))  # of (-1, 1)
NODES = NODES + 0.5  # of (0, 1)


def barycentre_distances(attained: Array) -> Array:
    """Distance l_j (m) of each attained position from the barycentre: (..., n, 3) to (..., n)."""
    lengths: Array = np.linalg.norm(attained - attained.mean(axis=-2, keepdims=True), axis=-1)
    return lengths


def repeatability(attained: Array) -> Array:
    """RP (m): mean distance from the barycentre and three standard deviations of the distances.

    One radius (...) a set of n of two or more, `attained` (..., n, 3).
    """
    length = barycentre_distances(attained)
    radius: Array = length.mean(axis=-1) + REPEATABILITY_SIGMAS * length.std(axis=-1, ddof=1)
    return radius


def orientation_deviations(attained: Array, commanded: Array) -> Array:
    """Small turns (n, 3), rad, about the axes of the frame, from the commanded orientation (3, 3).

    For turns as small as an arm's errors, three angles of any convention are these components of
    the rotation vector, to the second order; unlike theirs it has no singular orientation.
    """
    return Rotation.from_matrix(attained @ commanded.T).as_rotvec()


def barycentre_spread(barycentres: Array) -> tuple[float, tuple[int, int]]:
    """Largest distance between barycentres (h, .), in their unit (vAP), and of which two."""
    apart = np.linalg.norm(barycentres[:, None] - barycentres[None], axis=2)
    one, other = np.unravel_index(int(np.argmax(apart)), apart.shape)
    return float(apart[one, other]), (int(one), int(other))


def path_accuracy(attained: Array, commanded: Array) -> tuple[float, int]:
    """AT (m): largest distance of a station's barycentre from the commanded path, and where.

    `attained` (m, n, 3): where each of n passages crosses the plane normal to the commanded path
    (m, 3) at each of m stations.
    """
    off = np.linalg.norm(attained.mean(axis=1) - commanded, axis=1)
    worst = int(np.argmax(off))
    return float(off[worst]), worst


def path_repeatability(attained: Array) -> tuple[float, int]:
    """RT (m): the largest repeatability of any station, and where; (m, n, 3)."""
    radius = repeatability(attained)
    worst = int(np.argmax(radius))
    return float(radius[worst]), worst


def drift(attained: Array, commanded: Array, starts: Index) -> Array:
    """Largest change of AP and of RP from the first block of visits to any other: (..., 2), m.

    dAP and dRP, of `attained` (..., n, 3), in time's order, `commanded` (3,); `starts` (b,): the
    first visit of each block of two or more visits.
    """
    blocks = np.split(attained, starts[1:], axis=-2)
    found = np.array(
        [(np.linalg.norm(b.mean(axis=-2) - commanded, axis=-1), repeatability(b)) for b in blocks]
    )
    return np.moveaxis(np.abs(found - found[0]).max(axis=0), 0, -1)


@dataclass(frozen=True, slots=True)
class Interval:
    """A figure and its 95 % interval."""

    value: float
    low: float
    high: float


def repeatability_of(covariance: Array) -> float:
    """RP (m) that endless visits would give, of normal scatter with this covariance (3, 3).

    The mean of a normal vector's length is π^-½ ∫ (1 − ∏ (1 + 2 λ u²)^-½) u^-2 du over u > 0, from
    the moment generating function of its square.
    """
    spread = np.clip(np.linalg.eigvalsh(covariance), 0.0, None)
    total = float(spread.sum())
    if total == 0.0:
        return 0.0
    share = spread / total
    u = NODES / (1 - NODES)  # all of u > 0, where dx / x² stands for du / u²
    product = np.prod((1 + 2 * share[:, None] * u * u) ** -0.5, axis=0)
    mean = float(np.sum(WEIGHTS * (1 - product) / NODES**2)) / np.sqrt(np.pi)
    return float(np.sqrt(total) * (mean + REPEATABILITY_SIGMAS * np.sqrt(max(1 - mean**2, 0.0))))


def repeatability_interval(attained: Array) -> Interval:
    """RP (m) with its interval, from n visits (n, 3).

    The ratio of a figure from n visits to that of endless ones depends on n and on the scatter's
    shape alone; its law is drawn for the shape that the visits show.
    """
    value = float(repeatability(attained))
    spread = np.linalg.eigvalsh(np.cov(attained.T))
    if spread[-1] <= 0.0:
        return Interval(value, value, value)
    spread = np.clip(spread / spread[-1], 0.0, None)
    drawn = repeatability(_normal(len(attained)) * np.sqrt(spread))
    ratio = drawn / repeatability_of(np.diag(spread))
    low, high = np.quantile(ratio, [P_TAIL, 1 - P_TAIL])
    return Interval(value, value / float(high), value / float(low))


def length_interval(mean: Array, random: Array, freedom: int, systematic: Array) -> Interval:
    """Length (m or rad) of a mean vector (3,) with its interval.

    `random` (3, 3): covariance of the mean, estimated with `freedom` degrees of freedom;
    `systematic` (3, 3): of what does not average out, stated. Lengths are those of the vectors
    whose distance from the mean, in standard deviations along the line between them, is within
    Student's limit (profile likelihood). A length is never negative and noise makes it longer:
    where noise alone gives such a length in 2.5 % of cases or more, the interval reaches down to 0.
    """
    value = float(np.linalg.norm(mean))
    total = random + systematic
    whole, part = float(np.trace(total)), float(np.trace(random))
    if whole <= 0.0:
        return Interval(value, value, value)
    effective = freedom * (whole / part) ** 2 if part > 0 else INFINITE_DOF
    limit = float(t_ppf(1 - P_TAIL, min(effective, INFINITE_DOF))) ** 2
    low, high = _length_range(mean, total, limit)
    noise = np.linalg.norm(noise_draws(random, freedom, systematic), axis=1)
    return Interval(value, low if np.mean(noise >= value) < P_TAIL else 0.0, high)


def _length_range(mean: Array, covariance: Array, limit: float) -> tuple[float, float]:
    """Shortest and longest vector whose squared Mahalanobis distance from the mean is `limit`.

    By Lagrange, the nearest vector of a given length has the coordinates m / (1 + v c) along the
    principal axes; both its length and its distance are monotone in v on either side of 0.
    """
    from scipy.optimize import brentq  # slow to load, and few sessions have visits

    spread, axes = np.linalg.eigh(covariance)
    spread = np.clip(spread, TOL_VARIANCE * spread[-1], None)
    along = axes.T @ mean
    # a mean without a share in the widest direction would leave that direction out
    along[-1] = np.copysign(max(abs(along[-1]), np.sqrt(TOL_VARIANCE * spread[-1])), along[-1])

    def vector(v: float) -> Array:
        return np.asarray(along / (1 + v * spread), dtype=float)

    def beyond(v: float) -> float:
        return float(np.sum((along - vector(v)) ** 2 / spread)) - limit

    low = 0.0
    if np.sum(along**2 / spread) > limit:
        v = 1 / spread[-1]
        while beyond(v) < 0:
            v *= 4
        low = float(np.linalg.norm(vector(brentq(beyond, 0.0, v))))
    pole = -1 / spread[-1]
    return low, float(np.linalg.norm(vector(brentq(beyond, pole * (1 - 1e-12), 0.0))))


def noise_length(random: Array, freedom: int, systematic: Array) -> float:
    """Mean length (m or rad) that noise alone gives to a vector whose truth is 0."""
    return float(np.linalg.norm(noise_draws(random, freedom, systematic), axis=1).mean())


def noise_draws(random: Array, freedom: int, systematic: Array) -> Array:
    """Errors (d, 3) of a mean: Student's t of the random part, normal of the systematic one."""
    normal, other, scale = _student(freedom)
    return (normal @ square_root(random).T) / scale[:, None] + other @ square_root(systematic).T


def mean_interval(values: Array, systematic: float) -> Interval:
    """Mean of n values (n,) with its interval; `systematic` is a standard uncertainty beside it."""
    n = len(values)
    half = float(t_ppf(1 - P_TAIL, n - 1)) * float(values.std(ddof=1)) / np.sqrt(n)
    half = float(np.hypot(half, float(t_ppf(1 - P_TAIL, INFINITE_DOF)) * systematic))
    mean = float(values.mean())
    return Interval(mean, mean - half, mean + half)


def spread_interval(values: Array) -> Interval:
    """Three standard deviations of n values (n,) with their interval, by the law of χ²."""
    freedom = len(values) - 1
    spread = REPEATABILITY_SIGMAS * float(values.std(ddof=1))
    high, low = np.sqrt(freedom / chi2_ppf([P_TAIL, 1 - P_TAIL], freedom))
    return Interval(spread, spread * float(low), spread * float(high))


def square_root(covariance: Array) -> Array:
    """A matrix (3, 3) whose square is the covariance, which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.clip(values, 0.0, None)))


@cache
def _normal(n: int) -> Array:
    return np.random.default_rng(SEED).standard_normal((N_DRAWS, n, 3))


@cache
def _student(freedom: int) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(SEED)
    normal, other = rng.standard_normal((2, 2 * N_DRAWS, 3))
    scale = np.sqrt(rng.chisquare(freedom, 2 * N_DRAWS) / freedom)
    return normal, other, scale
