"""How sure the indices are: 95 % intervals, what noise alone gives, and what a law would give.

The standard has none of it. Scatter is taken as normal with a covariance that the visits show:
cameras see depth worse than the rest, so no isotropy is assumed. Draws are the same every time.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from verify.distributions import chi2_ppf, t_ppf
from verify.performance.measures import SPREADS, repeatability
from verify.records import Array

SIDE = 0.025  # of the probability, beyond either end of an interval
DRAWS = 2000
SEED = 9283
ENDLESS = 1e9  # degrees of freedom, as good as known
ROUNDING = 1e-10  # of the widest variance: a direction without scatter

NODES, WEIGHTS = (part / 2 for part in np.polynomial.legendre.leggauss(64))  # of (-1, 1)
NODES = NODES + 0.5  # of (0, 1)


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
    return float(np.sqrt(total) * (mean + SPREADS * np.sqrt(max(1 - mean**2, 0.0))))


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
    low, high = np.quantile(ratio, [SIDE, 1 - SIDE])
    return Interval(value, value / float(high), value / float(low))


def length_interval(mean: Array, random: Array, freedom: int, systematic: Array) -> Interval:
    """Length (m or rad) of a mean vector (3,) with its interval.

    Lengths are those of the vectors whose distance from the mean, in standard deviations along the
    line between them, is within Student's limit (profile likelihood). A length is never negative
    and noise makes it longer: where noise alone gives such a length in 2.5 % of cases or more, the
    interval reaches down to 0.

    Args:
        mean: (3,).
        random: (3, 3), covariance of the mean, estimated with `freedom` degrees of freedom.
        freedom: degrees of freedom.
        systematic: (3, 3), covariance of what does not average out, stated.
    """
    value = float(np.linalg.norm(mean))
    total = random + systematic
    whole, part = float(np.trace(total)), float(np.trace(random))
    if whole <= 0.0:
        return Interval(value, value, value)
    effective = freedom * (whole / part) ** 2 if part > 0 else ENDLESS
    limit = float(t_ppf(1 - SIDE, min(effective, ENDLESS))) ** 2
    low, high = _lengths_within(mean, total, limit)
    noise = np.linalg.norm(noise_draws(random, freedom, systematic), axis=1)
    return Interval(value, low if np.mean(noise >= value) < SIDE else 0.0, high)


def _lengths_within(mean: Array, covariance: Array, limit: float) -> tuple[float, float]:
    """Shortest and longest vector whose squared Mahalanobis distance from the mean is `limit`.

    By Lagrange, the nearest vector of a given length has the coordinates m / (1 + v c) along the
    principal axes; both its length and its distance are monotone in v on either side of 0.
    """
    from scipy.optimize import brentq  # slow to load, and few sessions have visits

    spread, axes = np.linalg.eigh(covariance)
    spread = np.clip(spread, ROUNDING * spread[-1], None)
    along = axes.T @ mean
    # a mean without a share in the widest direction would leave that direction out
    along[-1] = np.copysign(max(abs(along[-1]), np.sqrt(ROUNDING * spread[-1])), along[-1])

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
    drawn: Array = (normal @ _root(random).T) / scale[:, None] + other @ _root(systematic).T
    return drawn


def mean_interval(values: Array, systematic: float) -> Interval:
    """Mean of n values (n,) with its interval; `systematic` is a standard uncertainty beside it."""
    n = len(values)
    half = float(t_ppf(1 - SIDE, n - 1)) * float(values.std(ddof=1)) / np.sqrt(n)
    half = float(np.hypot(half, float(t_ppf(1 - SIDE, ENDLESS)) * systematic))
    mean = float(values.mean())
    return Interval(mean, mean - half, mean + half)


def spread_interval(values: Array) -> Interval:
    """Three standard deviations of n values (n,) with their interval, by the law of χ²."""
    freedom = len(values) - 1
    spread = SPREADS * float(values.std(ddof=1))
    high, low = np.sqrt(freedom / chi2_ppf([SIDE, 1 - SIDE], freedom))
    return Interval(spread, spread * float(low), spread * float(high))


def _root(covariance: Array) -> Array:
    values, vectors = np.linalg.eigh(covariance)
    root: Array = vectors * np.sqrt(np.clip(values, 0.0, None))
    return root


@cache
def _normal(n: int) -> Array:
    drawn: Array = np.random.default_rng(SEED).standard_normal((DRAWS, n, 3))
    return drawn


@cache
def _student(freedom: int) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(SEED)
    normal, other = rng.standard_normal((2, 2 * DRAWS, 3))
    scale = np.sqrt(rng.chisquare(freedom, 2 * DRAWS) / freedom)
    return normal, other, scale
