"""A pose's visits judged: every index with its interval, its noise and what noise alone gives."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from verify.analysis.performance.holds import HoldNoise
from verify.analysis.performance.indices import (
    P_TAIL,
    SEED,
    Interval,
    barycentre_spread,
    drift,
    length_interval,
    mean_interval,
    noise_length,
    orientation_deviations,
    repeatability_interval,
    repeatability_of,
    spread_interval,
    square_root,
)
from verify.core.records import Array, Index, rigid_transform

MIN_VISITS = 5  # visits: fewer tell no scatter in three directions
MIN_VISITS_PER_DIRECTION = 3  # visits from one direction
MIN_BLOCK_VISITS = 5  # visits, at least, of which drift takes AP and RP
MAX_BLOCKS = 6
N_SHUFFLES = 500


@dataclass(frozen=True, slots=True)
class PoseVisits:
    """n visits of one pose, in time's order."""

    name: str
    t: Array  # (n,), s
    attained: Array  # (n, 4, 4), measured, the mean of each visit's pairs, at the measured point
    read: Array  # (n, 4, 4), where the readings put it
    own: Array  # (n, 6), m and rad, attained less read: what both do alike is no doubt of AP
    pairs: tuple[Index, ...]  # n, numbers of each visit's pairs
    came_from: tuple[int, ...]  # n, number of the pose before; -1 where not known
    systematic: Array  # (6, p), what does not average out, of the mean at the point: m and rad

    @property
    def counts(self) -> Array:
        """Pairs of each visit, (n,)."""
        return np.array([len(pairs) for pairs in self.pairs], dtype=float)


@dataclass(frozen=True, slots=True)
class Repeatability:
    """A repeatability with what the instrument has of it."""

    found: Interval
    floor: float  # what the instrument's noise alone would show
    robot: float  # with the floor taken off in quadrature; nan: not told from the floor
    robot_at_most: float  # the upper end of the interval, likewise


@dataclass(frozen=True, slots=True)
class PoseAccuracy:
    """AP of positions (m)."""

    found: Interval
    mean: Array  # (3,), attained less commanded
    noise: float  # mean length that noise and stated doubts alone give, at a truth of 0
    unbiased: float  # with what noise adds to the square taken off
    expanded_uncertainty: float  # k = 2, along the mean


@dataclass(frozen=True, slots=True)
class AccuracyVariation:
    """VAP: barycentres of one pose, approached from several others."""

    position: Interval  # m, of the two furthest apart
    turn: float  # rad, largest of the three angles
    ways: int
    noise: float  # m, what scatter alone stays under in 95 % of cases


@dataclass(frozen=True, slots=True)
class Drift:
    """Change over the session, from the first block of visits."""

    accuracy: float  # dAP, m
    repeatability: float  # dRP, m
    noise: tuple[float, float]  # m, what the same visits in any order stay under in 95 % of cases
    blocks: int


@dataclass(frozen=True, slots=True)
class PoseIndices:
    """One pose, judged."""

    visits: PoseVisits
    commanded: Array  # (4, 4), the mean of the readings
    deviations: Array  # (n, 3), m, attained less commanded
    accuracy: PoseAccuracy
    repeatability: Repeatability
    angles: Array | None  # (n, 3), rad, about the base's axes; None: no orientation was measured
    angle_accuracy: tuple[Interval, ...]  # 3 or none
    angle_repeatability: tuple[Repeatability, ...]  # 3 or none
    variation: AccuracyVariation | None
    drift: Drift | None


def assess_pose(visits: PoseVisits, noise: HoldNoise, *, oriented: bool) -> PoseIndices:
    """Judge five visits or more of one pose.

    `noise` is that of one pair at rest; `oriented`: the orientation was measured.
    """
    commanded = mean_pose(visits.read)
    deviations = visits.attained[:, :3, 3] - commanded[:3, 3]
    still, still_turn = noise.of_means(visits.counts)
    angles = (
        orientation_deviations(visits.attained[:, :3, :3], commanded[:3, :3]) if oriented else None
    )
    angle_accuracy: tuple[Interval, ...] = ()
    angle_repeatability: tuple[Repeatability, ...] = ()
    if angles is not None:
        doubt = np.linalg.norm(visits.systematic[3:], axis=1)
        floors = 3 * np.sqrt(np.diag(still_turn))
        angle_accuracy = tuple(
            mean_interval(a, u) for a, u in zip(visits.own[:, 3:].T, doubt, strict=True)
        )
        angle_repeatability = tuple(
            subtract_noise(spread_interval(a), f) for a, f in zip(angles.T, floors, strict=True)
        )
    return PoseIndices(
        visits=visits,
        commanded=commanded,
        deviations=deviations,
        accuracy=mean_deviation(visits.own[:, :3], visits.systematic[:3]),
        repeatability=subtract_noise(repeatability_interval(deviations), repeatability_of(still)),
        angles=angles,
        angle_accuracy=angle_accuracy,
        angle_repeatability=angle_repeatability,
        variation=_variation(visits, deviations, angles),
        drift=_drift(deviations),
    )


def mean_deviation(deviations: Array, systematic: Array) -> PoseAccuracy:
    """How far the mean of deviations (n, 3), m, attained less read, visit by visit, lies off.

    `systematic` (3, p), m: what does not average out.
    """
    n = len(deviations)
    mean = deviations.mean(axis=0)
    random, shared = np.cov(deviations.T) / n, systematic @ systematic.T
    found = length_interval(mean, random, n - 1, shared)
    total = random + shared
    towards = mean / found.value if found.value > 0 else np.zeros(3)
    return PoseAccuracy(
        found=found,
        mean=mean,
        noise=noise_length(random, n - 1, shared),
        unbiased=float(np.sqrt(max(found.value**2 - float(np.trace(total)), 0.0))),
        expanded_uncertainty=2 * float(np.sqrt(towards @ total @ towards)),
    )


def subtract_noise(found: Interval, floor: float) -> Repeatability:
    """Take the instrument's own scatter off in quadrature, where the interval lies above it.

    Of the bound no more goes off than the visits surely show: a floor beyond is stated too high.
    """
    robot = float(np.sqrt(found.value**2 - floor**2)) if found.low > floor else np.nan
    at_most = float(np.sqrt(found.high**2 - min(floor, found.low) ** 2))
    return Repeatability(found, floor, robot, at_most)


def _variation(
    visits: PoseVisits, deviations: Array, angles: Array | None
) -> AccuracyVariation | None:
    came = np.array(visits.came_from)
    ways = [np.flatnonzero(came == way) for way in sorted(set(came.tolist()) - {-1})]
    ways = [rows for rows in ways if len(rows) >= MIN_VISITS_PER_DIRECTION]
    if len(ways) < 2:
        return None
    _, (one, other) = barycentre_spread(np.array([deviations[rows].mean(axis=0) for rows in ways]))
    inside = np.concatenate([deviations[rows] - deviations[rows].mean(axis=0) for rows in ways])
    freedom = len(inside) - len(ways)
    pooled = inside.T @ inside / freedom
    apart = deviations[ways[one]].mean(axis=0) - deviations[ways[other]].mean(axis=0)
    random = pooled * (1 / len(ways[one]) + 1 / len(ways[other]))
    centres = np.array([angles[rows].mean(axis=0) for rows in ways]) if angles is not None else None
    turn = float(np.ptp(centres, axis=0).max()) if centres is not None else np.nan
    rng = np.random.default_rng(SEED)
    spread = np.array([1 / np.sqrt(len(rows)) for rows in ways])[:, None]
    drawn = rng.standard_normal((N_SHUFFLES, len(ways), 3)) @ square_root(pooled).T * spread
    alone = np.linalg.norm(drawn[:, :, None] - drawn[:, None], axis=3).max(axis=(1, 2))
    interval = length_interval(apart, random, freedom, np.zeros((3, 3)))
    noise = float(np.quantile(alone, 1 - 2 * P_TAIL))
    return AccuracyVariation(interval, turn, len(ways), noise)


def _drift(deviations: Array) -> Drift | None:
    blocks = min(len(deviations) // MIN_BLOCK_VISITS, MAX_BLOCKS)
    if blocks < 2:
        return None
    starts = np.linspace(0, len(deviations), blocks + 1).astype(np.int64)[:-1]
    none = np.zeros(3)
    accuracy, repeatability = drift(deviations, none, starts).tolist()
    rng = np.random.default_rng(SEED)
    orders = np.tile(np.arange(len(deviations)), (N_SHUFFLES, 1))
    shuffled = rng.permuted(orders, axis=1)  # every row in an order of its own
    noise = np.quantile(drift(deviations[shuffled], none, starts), 1 - 2 * P_TAIL, axis=0)
    return Drift(accuracy, repeatability, (float(noise[0]), float(noise[1])), blocks)


@dataclass(frozen=True, slots=True)
class DistanceIndices:
    """Two poses' distance, as often as both were visited in turn."""

    names: tuple[str, str]
    commanded: float  # m
    visits: int
    accuracy: Interval  # AD, m, signed
    repeatability: Interval  # RD, m


def assess_distance(one: PoseVisits, other: PoseVisits) -> DistanceIndices | None:
    """Judge the distance of two poses, a visit of one with the next of the other.

    None where fewer than five visits of one are followed by one of the other.
    """
    after = np.searchsorted(other.t, one.t)
    inside = after < len(other.t)
    # each visit of the other has one partner: the last visit of the first before it
    last = {int(a): i for i, a in enumerate(after.tolist()) if inside[i]}
    if len(last) < MIN_VISITS:
        return None
    rows, partners = list(last.values()), list(last)
    places = one.attained[rows, :3, 3], other.attained[partners, :3, 3]
    read = one.read[rows, :3, 3] - other.read[partners, :3, 3]
    between = read.mean(axis=0)
    commanded = float(np.linalg.norm(between))
    found = np.linalg.norm(places[0] - places[1], axis=1)
    own = found - np.linalg.norm(read, axis=1)  # as of AP: what both do alike is no doubt
    along = between / commanded if commanded > 0 else np.zeros(3)
    doubt = float(np.linalg.norm(along @ (one.systematic[:3] - other.systematic[:3])))
    return DistanceIndices(
        (one.name, other.name),
        commanded,
        len(rows),
        mean_interval(own, doubt),
        spread_interval(found),
    )


def mean_pose(poses: Sequence[Array] | Array) -> Array:
    """The mean (4, 4) of poses (k, 4, 4) that lie near each other."""
    stack = np.asarray(poses)
    turn = Rotation.from_matrix(stack[:, :3, :3]).mean().as_matrix()
    return rigid_transform(turn, stack[:, :3, 3].mean(axis=0))
