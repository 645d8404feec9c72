"""Build hypotheses: assignments of spots to LEDs, each with its pose, many at once.

A pair of spots is a point in the rig if their rays nearly meet. Two points may be two LEDs if they
are as far apart as in the marker; three such points, every two of which agree, are a seed.

Besides the flange's pose a hypothesis has a shift of the whole right image, px: the motion between
exposures that are not simultaneous. The marker moves as a whole, so its shape stays a sharp test.
"""

from dataclasses import dataclass

import numpy as np

from verify.core.records import Array, Flags, Index, rigid_transform, take_rows
from verify.measurement.correspondence.kernels import entries as kernels
from verify.measurement.correspondence.kernels.entries import MAX_DEVIATION
from verify.measurement.correspondence.views import SpotViews

MAX_POINTS = 120  # best rays first; keeps a scene full of lamps on one line within bounds
MAX_EDGES = 3000  # best distances first; bounds the work in such a scene


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
    deviation: Array  # (m, m), standard deviations of distance; inf where excluded, and below


def find_points(views: SpotViews) -> TriangulatedPoints:
    """Pair left with right spots that lie on each other's epipolar line, within noise and skew."""
    return TriangulatedPoints(
        *kernels.find_points(views.scene, views.mean_focal, views.skew, MAX_POINTS)
    )


def build_graph(views: SpotViews, found: TriangulatedPoints) -> SeedGraph:
    """Join points that may be LEDs at the marker's distances, within noise and skew."""
    places = found.spot, found.rig, found.covariance
    return SeedGraph(*kernels.join_nodes(views.scene, places, views.led_play))


def find_edges(graph: SeedGraph) -> Index:
    """List pairs of nodes that agree, (e, 2), best first."""
    one, other = (graph.deviation <= MAX_DEVIATION).nonzero()
    best = graph.deviation[one, other].argsort(kind="stable")[:MAX_EDGES]
    return np.ascontiguousarray(np.array([one[best], other[best]]).T)


FREE_SIGMAS = 10.0, 3.0  # m, rad: so large that the images alone decide the pose


@dataclass(frozen=True, slots=True)
class Hypotheses:
    """Assignments of spots to LEDs, with the pose that each one means."""

    state: Array  # (h, 85), pose, shift of the right image and their fit: `kernels/fit.h`
    spot: Index  # (h, 2, n), left and right spot of each LED, -1 for none

    def __len__(self) -> int:
        """Count the hypotheses."""
        return len(self.state)

    @property
    def chi2(self) -> Array:
        """Chi² of each, (h,), the shift's own share included; inf before the first fit."""
        return self.state[:, kernels.CHI2]

    def rig_T_flange(self, which: int) -> Array:
        """Give the pose (4, 4) that one of them means."""
        state = self.state[which]
        turn = state[: kernels.POSITION].reshape(3, 3)
        return rigid_transform(turn, state[kernels.POSITION : kernels.SHIFT])

    def take(self, chosen: Flags | Index | slice) -> "Hypotheses":
        """Keep some, by index, mask or slice."""
        return take_rows(self, chosen)

    def join(self, other: "Hypotheses") -> "Hypotheses":
        """Append others."""
        state = np.concatenate([self.state, other.state])
        return Hypotheses(state, np.concatenate([self.spot, other.spot]))


def seed_hypotheses(
    views: SpotViews, found: TriangulatedPoints, graph: SeedGraph, nodes: Index, rig_R_flange: Array
) -> Hypotheses:
    """Begin hypotheses from one, two or three nodes each, (h, 1), (h, 2) or (h, 3).

    What the nodes leave open (all turns, or that about their line) stays as in `rig_R_flange`.
    """
    rotation = np.array(rig_R_flange, order="C")[None]
    if nodes.shape[1] == 2:
        rig, led = found.rig[graph.point[nodes]], views.leds[graph.led[nodes]]
        line = (led[:, 1] - led[:, 0]) @ rig_R_flange.T
        rotation = np.ascontiguousarray(_minimal_rotations(line, rig[:, 1] - rig[:, 0]) @ rotation)
    places, node = (found.spot, found.rig), (graph.point, graph.led)
    sigmas = (*FREE_SIGMAS, views.skew)
    return Hypotheses(*kernels.begin_poses(places, node, nodes, views.leds, rotation, sigmas))


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
