"""Where a search starts: spot pairs that may be one LED, and sets of them that fit the marker.

A pair of spots is a point in the rig if their rays nearly meet. Two points may be two LEDs if they
are as far apart as the marker says; three such points, every two of which agree, are a seed.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.identification.views import Views
from verify.records import Array
from verify.triangulation import meet

Index = NDArray[np.int64]

GATE = 4.0  # standard deviations: a true LED is turned away once in 16,000
MOST_POINTS = 120  # best rays first; keeps a scene full of lamps on one line within bounds
MOST_EDGES = 3000  # best distances first, likewise
MOST_SEEDS = 512  # an octahedron of six LEDs, the most symmetric marker, has 480 a mirror image
FARTHEST = 10.0  # m, no camera of this kind resolves a marker there
SMALLEST_PX = 8.0  # px, a marker that looks smaller than this cannot be read
SLENDER = 0.01  # height over longest side: less, and gathering about a line finds the third LED

NEXT, LAST = [1, 2, 0], [2, 0, 1]  # axes


@dataclass(frozen=True, slots=True)
class Points:
    """Pairs of spots whose rays nearly meet, and where."""

    spot: Index  # (2, c), left and right spot
    rig: Array  # (c, 3), m
    covariance: Array  # (c, 3, 3), m²; a shift common to all changes distances by less


@dataclass(frozen=True, slots=True)
class Graph:
    """Nodes are "this point is that LED"; edges join those at the marker's distance."""

    point: Index  # (m,)
    led: Index  # (m,)
    deviation: Array  # (m, m), standard deviations of distance; inf where excluded


def find_points(views: Views) -> Points:
    """Pair left with right spots that lie on each other's epipolar line, within noise and skew."""
    sight = views.pixels / views.focal[:, None]
    sight = np.concatenate([sight, np.ones_like(sight[..., :1])], axis=-1) @ views.camera_R_rig
    rig, gap = meet(views.center[0], sight[0][:, None], views.center[1], sight[1][None])
    depth = (rig - views.center[0]) @ views.camera_R_rig[0, 2]
    noise = (views.covariance[..., 0, 0] + views.covariance[..., 1, 1]) / 2
    noise = np.sqrt(noise[0][:, None] + noise[1][None])
    mismatch = gap * views.mean_focal / depth
    size = np.max(np.linalg.norm(views.leds[:, None] - views.leds[None], axis=-1))
    reach = size * views.mean_focal / SMALLEST_PX if len(views.leds) > 1 else FARTHEST
    with np.errstate(invalid="ignore"):  # NaN, rays that do not meet, fails both
        fits = (mismatch <= views.skew + GATE * noise) & (depth < min(reach, FARTHEST))
    possible = np.any(views.allowed[0][:, :, None] & views.allowed[1][:, None], axis=0)
    spot = np.argwhere(fits & possible)
    spot = spot[np.argsort((mismatch / noise)[spot[:, 0], spot[:, 1]], kind="stable")]
    spot = spot[:MOST_POINTS].T.astype(np.int64)
    found = rig[spot[0], spot[1]]
    slope, weight = _slopes(views, found, spot)
    information = np.swapaxes(slope, 1, 2) @ (weight[..., None] * slope)
    return Points(spot, found, np.asarray(np.linalg.inv(information), dtype=float))


def _slopes(views: Views, points: Array, spot: Index) -> tuple[Array, Array]:
    """Derivative of the four image coordinates by the point, (c, 4, 3), and weights (c, 4)."""
    slopes, weights = [], []
    for side in (0, 1):
        local = (points - views.center[side]) @ views.camera_R_rig[side].T
        slopes.append(project_slope(local, views.focal[side]) @ views.camera_R_rig[side])
        weights.append(1 / np.diagonal(views.covariance[side, spot[side]], axis1=1, axis2=2))
    return np.concatenate(slopes, axis=1), np.concatenate(weights, axis=1)


def project_slope(local: Array, focal: Array) -> Array:
    """Derivative of ideal px by a point in the camera frame, (..., 3) to (..., 2, 3)."""
    slope = np.zeros((*local.shape[:-1], 2, 3))
    scale = focal / local[..., 2:]
    slope[..., 0, 0], slope[..., 1, 1] = scale[..., 0], scale[..., 1]
    slope[..., 2] = -local[..., :2] * scale / local[..., 2:]
    return slope


def cross(a: Array, b: Array) -> Array:
    """Cross products of (..., 3); numpy's own takes three times as long for a few of them."""
    product: Array = a[..., NEXT] * b[..., LAST] - a[..., LAST] * b[..., NEXT]
    return product


def link(views: Views, points: Points) -> Graph:
    """Join points that may be LEDs at the marker's distances, within noise and skew."""
    step = points.rig[:, None] - points.rig[None]
    distance = np.linalg.norm(step, axis=-1)
    toward = step / np.where(distance > 0, distance, 1.0)[..., None]
    spread = np.sum((toward @ points.covariance) * toward, axis=-1)
    sigma = np.sqrt(spread + spread.T + 2 * views.led_play**2)
    shared = (points.spot[:, :, None] == points.spot[:, None]).any(axis=0)

    coloured = views.allowed[0][:, points.spot[0]] & views.allowed[1][:, points.spot[1]]
    led, point = np.nonzero(coloured)
    wanted = np.linalg.norm(views.leds[:, None] - views.leds[None], axis=-1)
    pair = np.ix_(point, point)
    deviation = np.abs(distance[pair] - wanted[np.ix_(led, led)]) / sigma[pair]
    excluded = shared[pair] | (led[:, None] == led[None])
    return Graph(point, led, np.where(excluded, np.inf, deviation))


def find_edges(graph: Graph) -> Index:
    """List pairs of nodes that agree, (e, 2), best first."""
    first, second = np.nonzero(np.triu(graph.deviation <= GATE))
    order = np.argsort(graph.deviation[first, second], kind="stable")[:MOST_EDGES]
    return np.stack([first[order], second[order]], axis=1)


def find_triangles(graph: Graph, leds: Array) -> Index:
    """List triples of nodes every two of which agree, (t, 3), best first; slender ones left out."""
    joined = graph.deviation <= GATE
    first, second = find_edges(graph).T
    edge, third = np.nonzero(joined[first] & joined[second])
    later = third > second[edge]
    edge, third = edge[later], third[later]
    triple = np.stack([first[edge], second[edge], third], axis=1)
    corner = leds[graph.led[triple]]
    side, other = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    longest = np.maximum(np.sum(side**2, axis=1), np.sum(other**2, axis=1))
    broad = np.linalg.norm(cross(side, other), axis=1) > SLENDER * longest
    triple = triple[broad]
    misfit = np.sum(graph.deviation[triple, np.roll(triple, 1, axis=1)] ** 2, axis=1)
    best: Index = triple[np.argsort(misfit, kind="stable")[:MOST_SEEDS]]
    return best
