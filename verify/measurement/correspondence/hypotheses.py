"""Many assignments at once: each one's pose, the spots that it explains, and how well.

Besides the flange's pose each hypothesis has one shift of the whole right image. It stands for the
motion between exposures that are not simultaneous: the marker moves as a whole, so its shape stays
a sharp test even where its place does not.

Where a search starts: spot pairs that may be one LED, and sets of them that fit the marker.

A pair of spots is a point in the rig if their rays nearly meet. Two points may be two LEDs if they
are as far apart as the marker says; three such points, every two of which agree, are a seed.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from verify.core.records import Array
from verify.measurement.correspondence.kernels import fit, seeds
from verify.measurement.correspondence.kernels import points as kernels_points
from verify.measurement.correspondence.kernels import seeds as kernels_seeds
from verify.measurement.correspondence.kernels import spots as kernel_spots
from verify.measurement.correspondence.kernels.fit import HypothesisArrays
from verify.measurement.correspondence.kernels.points import MAX_DEVIATION, Index
from verify.measurement.correspondence.refinement import (
    SearchInputs,
    best_of_each,
    follow_all,
    settle_all,
)
from verify.measurement.correspondence.views import SpotViews

MAX_POINTS = 120  # best rays first; keeps a scene full of lamps on one line within bounds
MAX_EDGES = 3000  # best distances first, likewise
MAX_SEEDS = 512  # an octahedron of six LEDs, the most symmetric marker, has 480 a mirror image


@dataclass(frozen=True, slots=True)
class TriangulatedPoints:
    """Pairs of spots whose rays nearly meet, and where."""

    spot: Index  # (c, 2), left and right spot
    rig: Array  # (c, 3), m
    covariance: Array  # (c, 3, 3), m²; a shift common to all changes distances by less


@dataclass(frozen=True, slots=True)
class SeedGraph:
    """Nodes are "this point is that LED"; edges join those at the marker's distance."""

    point: Index  # (m,)
    led: Index  # (m,)
    deviation: Array  # (m, m), standard deviations of distance; inf where excluded


def find_points(views: SpotViews) -> TriangulatedPoints:
    """Pair left with right spots that lie on each other's epipolar line, within noise and skew."""
    spots = views.pixels.shape[1]
    spot, where = np.empty((MAX_POINTS, 2), dtype=np.int64), np.empty((spots, spots, 3))
    count = kernels_points.pair_spots(
        views.cameras,
        (views.pixels, views.covariance),
        views.allowed,
        views.leds,
        views.mean_focal,
        views.skew,
        where,
        np.empty(MAX_POINTS),
        spot,
    )
    spot, rig, covariance = spot[:count], np.empty((count, 3)), np.empty((count, 3, 3))
    kernels_points.locate_points(views.cameras, views.covariance, where, spot, rig, covariance)
    return TriangulatedPoints(spot, rig, covariance)


def build_graph(views: SpotViews, points: TriangulatedPoints) -> SeedGraph:
    """Join points that may be LEDs at the marker's distances, within noise and skew."""
    left, right = points.spot.T
    possible = np.flatnonzero(views.allowed[0][:, left] & views.allowed[1][:, right])
    led, point = np.divmod(possible, len(points.spot))
    deviation = np.empty((len(point), len(point)))
    places = points.spot, points.rig, points.covariance
    seeds.join_nodes(places, point, led, views.leds, views.led_play, deviation)
    return SeedGraph(point, led, deviation)


def find_edges(graph: SeedGraph) -> Index:
    """List pairs of nodes that agree, (e, 2), best first."""
    agreeing = np.flatnonzero(graph.deviation <= MAX_DEVIATION)
    one, other = np.divmod(agreeing, len(graph.deviation))
    once = one < other
    best = np.argsort(graph.deviation.ravel()[agreeing[once]], kind="stable")[:MAX_EDGES]
    return np.column_stack([one[once][best], other[once][best]])


def find_triangles(graph: SeedGraph, leds: Array) -> Index:
    """List triples of nodes every two of which agree, (t, 3), best first; slender ones left out."""
    triples, costs = np.empty((MAX_SEEDS, 3), dtype=np.int64), np.empty(MAX_SEEDS)
    edges = find_edges(graph)
    return triples[: seeds.list_triangles(graph.deviation, edges, graph.led, leds, costs, triples)]


MIN_SKEW = 1e-3  # px: simultaneous for every purpose, and nothing is divided by zero
MIN_DEPTH = 0.02  # m, depth below which a point cannot be imaged
FREE_SIGMA = np.repeat(
    [10.0, 3.0], 3
)  # m, rad: standard deviations that leave a pose to the images
MAX_GATE = 10.0  # px, an LED predicted worse than this could be any spot
SPOT_REWARD = (
    20.0  # 2 ln of how much denser spots are at an LED (half a px) than clutter (20 an image)
)
MERGED_COST = 9.0  # of the same kind: a clean spot is taken unless it lies 3 sigma farther off
P_REJECT = 1e-4  # chi² beyond this probability is not this marker
UNPAIRED_COST = (
    7.0  # likewise: an LED in view of one camera is hidden from the other once in 30 times
)
COARSE_SIGMA = (
    4e-3  # m, how well a coarse pose places an LED: depth, with the images a few ms apart
)
DOF_BY_LEDS = np.array([0, 3, 5, 6])  # degrees of freedom, by LEDs seen: three determine all
POSE_SLICE, SHIFT_SLICE = np.arange(6), np.arange(6, 8)  # of a covariance
SIDES = np.array([[0], [1]])


@dataclass(frozen=True, slots=True)
class Hypotheses:
    """Assignments of spots to LEDs, with the pose that each one means."""

    rotation: Array  # (h, 3, 3), rig_R_flange
    position: Array  # (h, 3), m, flange in the rig
    shift: Array  # (h, 2), px, of the right image
    spot: Index  # (h, 2, n), left and right spot of each LED, -1 for none
    hold: Array  # (h, 6), 1/m² and 1/rad²: how firmly each step keeps the pose where it is
    covariance: Array  # (h, 8, 8), m, rad, px
    chi2: Array  # (h,), the shift's own share included; inf before the first fit

    def __len__(self) -> int:
        """Count the hypotheses."""
        return len(self.position)

    @property
    def arrays(self) -> HypothesisArrays:
        """Their arrays, as compiled functions take them."""
        return (
            self.rotation, self.position, self.shift, self.spot, self.hold, self.covariance,
            self.chi2,
        )  # fmt: skip

    def copied(self) -> "Hypotheses":
        """The same in arrays of their own."""
        return self.take(np.arange(len(self)))

    def first(self, count: int) -> "Hypotheses":
        """Keep the first so many."""
        return self.take(slice(count))

    def take(self, chosen: NDArray[np.bool_] | Index | slice) -> "Hypotheses":
        """Keep some, by index, mask or slice."""
        return Hypotheses(
            self.rotation[chosen],
            self.position[chosen],
            self.shift[chosen],
            self.spot[chosen],
            self.hold[chosen],
            self.covariance[chosen],
            self.chi2[chosen],
        )

    def join(self, other: "Hypotheses") -> "Hypotheses":
        """Append others."""
        return Hypotheses(
            np.concatenate([self.rotation, other.rotation]),
            np.concatenate([self.position, other.position]),
            np.concatenate([self.shift, other.shift]),
            np.concatenate([self.spot, other.spot]),
            np.concatenate([self.hold, other.hold]),
            np.concatenate([self.covariance, other.covariance]),
            np.concatenate([self.chi2, other.chi2]),
        )


def start_hypotheses(views: SpotViews, rotation: Array, position: Array, spot: Index) -> Hypotheses:
    """Begin hypotheses (h of them) at coarse poses, nothing held."""
    count = len(position)
    hold, covariance = np.empty((count, 6)), np.zeros((count, fit.N_FREE, fit.N_FREE))
    hold[:] = FREE_SIGMA**-2
    covariance[:, POSE_SLICE, POSE_SLICE] = FREE_SIGMA**2
    covariance[:, SHIFT_SLICE, SHIFT_SLICE] = views.skew**2
    chi2 = np.full(count, np.inf)
    return Hypotheses(rotation, position, np.zeros((count, 2)), spot, hold, covariance, chi2)


def seed_hypotheses(
    views: SpotViews,
    points: TriangulatedPoints,
    graph: SeedGraph,
    nodes: Index,
    rig_R_flange: Array,
) -> Hypotheses:
    """Begin hypotheses from one, two or three nodes each, (h, 1), (h, 2) or (h, 3).

    What the nodes leave open (all turns, or that about their line) stays as in `rig_R_flange`.
    """
    count, corners = nodes.shape
    rotation, position = np.empty((count, 3, 3)), np.empty((count, 3))
    rotation[:] = rig_R_flange
    if corners == 2:
        rig, led = points.rig[graph.point[nodes]], views.leds[graph.led[nodes]]
        line = (led[:, 1] - led[:, 0]) @ rig_R_flange.T
        rotation = np.ascontiguousarray(_minimal_rotations(line, rig[:, 1] - rig[:, 0]) @ rotation)
    spot = np.empty((count, 2, len(views.leds)), dtype=np.int64)
    kernels_seeds.begin_poses(
        (points.spot, points.rig),
        (graph.point, graph.led),
        nodes,
        views.leds,
        rotation,
        position,
        spot,
    )
    return start_hypotheses(views, rotation, position, spot)


def _minimal_rotations(source: Array, target: Array) -> Array:
    """Rotations (h, 3, 3) of least angle that carry directions (h, 3) onto others."""
    source = source / np.linalg.norm(source, axis=1, keepdims=True)
    target = target / np.linalg.norm(target, axis=1, keepdims=True)
    half = source + target
    opposite = np.linalg.norm(half, axis=1) < 1e-9  # half a turn about anything across will do
    across = np.cross(source, np.eye(3)[np.argmin(np.abs(source), axis=1)])
    half = np.where(opposite[:, None], across, half)
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    # Two half turns, about the source and about the half-way direction, make the least turn.
    first = 2 * source[:, :, None] * source[:, None] - np.eye(3)
    second = 2 * half[:, :, None] * half[:, None] - np.eye(3)
    return np.where(opposite[:, None, None], second, second @ first)


def refine(views: SpotViews, hypotheses: Hypotheses) -> Hypotheses:
    """Fit, gather what each pose explains, fit again; drop what fails and what is there twice."""
    if len(hypotheses) == 0:
        return hypotheses
    steps = 2  # from a few mm off they leave 0.01 px
    own = hypotheses.copied()
    count = settle_all(_kernel_inputs(views), own.arrays, steps, settle_bounds(len(views.leds)))
    return own.first(count)


def follow_pose(
    views: SpotViews, found: Hypotheses, rig_T_flange: Array, place: Array, *, settled: bool
) -> Hypotheses:
    """Take the spots nearest to a predicted pose, alone and from what the search found.

    Args:
        views: the two images.
        found: what the search found there; LEDs that one camera alone sees are looked for anew.
        rig_T_flange: (4, 4), the prediction.
        place: (6,), m and rad, its standard uncertainties.
        settled: nothing is left to find, if the prediction's spots are those of the first found.
    """
    count = len(found) + 1
    none = np.full((count, 2, len(views.leds)), -1, dtype=np.int64)
    own = start_hypotheses(views, np.empty((count, 3, 3)), np.empty((count, 3)), none)
    own.rotation[0], own.position[0] = rig_T_flange[:3, :3], rig_T_flange[:3, 3]
    own.covariance[0, POSE_SLICE, POSE_SLICE] = place**2
    for mine, theirs in zip(own.arrays, found.arrays, strict=True):
        mine[1:] = theirs
    own.hold[:] = place**-2
    count = follow_all(_kernel_inputs(views), own.arrays, settle_bounds(len(views.leds)), settled)
    return own.first(count)


def _kernel_inputs(views: SpotViews) -> SearchInputs:
    """Lay out the images and the marker for the refinement."""
    play = views.led_play * views.mean_focal
    return (
        views.cameras,
        (views.pixels, views.covariance, views.merged),
        views.allowed,
        (
            (MIN_DEPTH, play, 1 / max(views.skew, MIN_SKEW) ** 2),
            (MIN_DEPTH, play, MAX_DEVIATION, MAX_GATE, MERGED_COST),
        ),
        views.leds,
    )


def unique(hypotheses: Hypotheses) -> Hypotheses:
    """Keep the best fit of each assignment: two poses of a flat marker may share one."""
    if len(hypotheses) < 2:
        return hypotheses
    return hypotheses.take(best_of_each(hypotheses.chi2, hypotheses.spot))


@lru_cache(maxsize=8)
def settle_bounds(leds: int) -> tuple[Array, Index]:
    """Bounds of `select_likely` for so many LEDs: chi² by degrees of freedom, and those."""
    freedom = np.maximum(np.arange(4 * leds + 1), 1)
    return np.asarray(chdtri(freedom, P_REJECT), dtype=float), DOF_BY_LEDS


def score(views: SpotViews, hypotheses: Hypotheses) -> Array:
    """Twice the negative log evidence of each, against clutter alone: the less the better."""
    used, seen, both = _counts(hypotheses)
    merged = (hypotheses.spot >= 0) & views.merged[SIDES, hypotheses.spot]
    explained = SPOT_REWARD * used - MERGED_COST * merged.sum(axis=(1, 2))
    total: Array = hypotheses.chi2 + UNPAIRED_COST * (seen - both) - explained
    return total


def is_single_led(hypotheses: Hypotheses) -> NDArray[np.bool_]:
    """Say where one LED of several is all that both cameras see: any lamp would do as well."""
    several = hypotheses.spot.shape[2] > 1
    alone: NDArray[np.bool_] = several & (_counts(hypotheses)[2] == 1)
    return alone


def _counts(hypotheses: Hypotheses) -> Index:
    """Count spots in use, LEDs seen, and LEDs seen by both cameras, (3, h)."""
    counts = np.empty((3, len(hypotheses)), dtype=np.int64)
    kernel_spots.count_all(hypotheses.spot, counts)
    return counts


def conflicts(hypotheses: Hypotheses, best: int) -> NDArray[np.bool_]:
    """Say which hypotheses contradict one: another spot for an LED, or another LED for a spot."""
    theirs, mine = hypotheses.spot[:, :, :, None], hypotheses.spot[best][:, None]
    same_led = np.eye(mine.shape[-1], dtype=np.bool_)
    contrary = (theirs >= 0) & (mine >= 0) & ((theirs == mine) != same_led)
    return np.asarray(contrary.any(axis=(1, 2, 3)))


def departure(
    views: SpotViews, hypotheses: Hypotheses, rig_T_flange: Array, position: float, rotation: float
) -> Array:
    """Measure how far the LEDs of each hypothesis (h,) are from where a reference pose has them.

    Their mean is compared on the scale of `position` (m), their arrangement about it on that of
    `rotation` (rad): a symmetric marker's turn stands out however far the whole has moved. What
    the LEDs seen do not determine plays no part.
    """
    off = np.empty(len(hypotheses))
    kernel_spots.departures_of_all(
        views.leds,
        hypotheses.spot,
        (hypotheses.rotation, hypotheses.position),
        np.array(rig_T_flange, order="C"),
        (position, rotation, COARSE_SIGMA),
        off,
    )
    return off
