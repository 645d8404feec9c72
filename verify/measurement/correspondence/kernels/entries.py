"""Entries of the compiled search for the LED of each spot; hypotheses are rows, as in fit.h."""

from typing import Any

import numpy as np

from verify.core.native import entry
from verify.core.records import Array, Flags, Index

# camera_R_rig (2, 3, 3), optical centres (2, 3) m, focal lengths (2, 2) px; spots (2, s, 2) px, NaN
# where there is none, covariance (2, s, 2, 2) px², which are merged (2, s), which LEDs each may be
# (2, n, s); LEDs (n, 3) m, flange frame
Scene = tuple[Array, Array, Array, Array, Array, Flags, Flags, Array]
# nearest depth, m; an LED's play times the focal length, m px; inverse variance of the shift, 1/px²
Limits = tuple[float, float, float]
# centres (m, 2) px, covariance (m, 2, 2) px², merged (m,), saturated (m,) and colour (m, 3)
ImageSpots = tuple[Array, Array, Flags, Flags, Array]
# the same, peaks (m,) DN and diameters (m,) px; least peak of an LED, DN, nan where not known; s,
# the instant of a row, that row, px, and s a row
PictureSpots = tuple[ImageSpots, Array, Array, float, tuple[float, float, float]]

# Where the figures of a hypothesis stand in its row, and how many there are: as in fit.h
POSITION, SHIFT, CHI2, N_STATE = 9, 12, 20, 85
# As in views.c: LEDs that shine in a channel, without a hue, and of any
BLUE, GREEN, RED, WHITE, ANY = range(5)
# As in points.c and spots.c
MAX_DEVIATION = 4.0
SPOT_REWARD, MERGED_COST, ALIKE_CHI2, UNPAIRED_COST = 20.0, 9.0, 9.0, 7.0

_find_points = entry("find_points")
_join_nodes = entry("join_nodes")
_list_triangles = entry("list_triangles")
_begin_poses = entry("begin_poses")
_refine = entry("refine")
_follow = entry("follow")
_track_leds = entry("track_leds")
_count_all = entry("count_all")
_departures_of_all = entry("departures_of_all")
_prepare_images = entry("prepare_images")


def _numbers(scene: Scene) -> tuple[Any, ...]:
    """Give a scene as entries take it."""
    camera_R_rig, center, focal, pixels, covariance, merged, allowed, leds = scene
    spots = pixels.shape[1], pixels, covariance, merged, allowed
    return camera_R_rig, center, focal, *spots, len(leds), leds


def prepare_images(
    spots: tuple[ImageSpots, ImageSpots],
    optics: tuple[Array, Array],
    model: tuple[float, float, float],
    light: Index,
    most: int,
) -> tuple[Array, Array, Flags, Flags]:
    """Prepare both images' spots, the first s of them, or fewer where there are no more.

    `optics`: camera matrices (2, 3, 3), px, and lenses (2, 5); `model`: px², variance beside the
    noise, that of a merged spot and of the right image's in addition; `light` (n,), of each LED:
    BLUE to ANY; `most`: s. Gives, for the left and the right one, pixels (2, s, 2), ideal px, NaN
    where there is no spot; covariance (2, s, 2, 2), px²; merged (2, s); and allowed (2, n, s): this
    spot may be that LED.
    """
    pixels, covariance = np.empty((2, most, 2)), np.empty((2, most, 2, 2))
    merged, allowed = np.empty((2, most), np.bool_), np.empty((2, len(light), most), np.bool_)
    images = pixels, covariance, merged, allowed
    left, right = spots
    _prepare_images(
        len(left[0]), *left, len(right[0]), *right, *optics, *model, len(light), light, most,
        *images,
    )  # fmt: skip
    return images


def find_points(
    scene: Scene, mean_focal: float, skew: float, limit: int
) -> tuple[Index, Array, Array]:
    """List pairs of spots on each other's epipolar line (c, 2), left and right, best first.

    `mean_focal`, px; `skew`, px, by how much the marker may have moved between the images. At most
    `limit` pairs are listed, by mismatch over its noise. Gives their points, (c, 3), m, and the
    points' covariance, (c, 3, 3), m².
    """
    spot, rig = np.empty((limit, 2), np.int64), np.empty((limit, 3))
    spread = np.empty((limit, 3, 3))
    count = _find_points(*_numbers(scene), mean_focal, skew, limit, spot, rig, spread)
    return spot[:count], rig[:count], spread[:count]


def join_nodes(
    scene: Scene, points: tuple[Index, Array, Array], play: float
) -> tuple[Index, Index, Array]:
    """List the nodes, and how far every two are from the marker's distance, in deviations.

    `points`: spots (c, 2), places (c, 3) m, covariance (c, 3, 3) m²; `play`, m: how far an LED's
    light may be from where the marker has it. Gives point and LED of each node, (m,) both, and the
    upper half of (m, m); infinitely far are nodes that share a spot or an LED.
    """
    most = len(points[0]) * len(scene[-1])
    point, led = np.empty(most, np.int64), np.empty(most, np.int64)
    deviation = np.empty(most * most)  # what is not filled takes no memory
    count = _join_nodes(*_numbers(scene), len(points[0]), *points, play, point, led, deviation)
    return point[:count], led[:count], deviation[: count * count].reshape(count, count)


def list_triangles(deviation: Array, edges: Index, led: Index, leds: Array, most: int) -> Index:
    """List triples of nodes (t, 3) every two of which agree, best first; no slender triangles.

    `deviation` (m, m), of `join_nodes`; `edges` (e, 2), best first; `led` (m,), of each node;
    `leds` (n, 3), m, flange frame. At most `most` are listed, by the sum of squares of the three
    deviations.
    """
    triples = np.empty((most, 3), np.int64)
    count = _list_triangles(len(deviation), deviation, len(edges), edges, led, leds, most, triples)
    return triples[:count]


def begin_poses(
    points: tuple[Index, Array],
    graph: tuple[Index, Index],
    nodes: Index,
    leds: Array,
    rotation: Array,
    sigmas: tuple[float, float, float],
) -> tuple[Array, Index]:
    """Begin a hypothesis at each set of nodes: `state` (h, 85) and spots (h, 2, n), -1 for none.

    `points`: spots (c, 2) and places (c, 3) m; `graph`: point and LED of each node, (m,) both;
    `nodes` (h, 1), (h, 2) or (h, 3); `leds` (n, 3), m, flange frame; `rotation` (h, 3, 3) or (1, 3,
    3), of no use where there are three nodes; `sigmas`: standard deviations by which steps keep the
    pose, m and rad, and of the shift, px.
    """
    count = len(nodes)
    state, spot = np.empty((count, N_STATE)), np.empty((count, 2, len(leds)), np.int64)
    _begin_poses(
        *points, *graph, *nodes.shape, nodes, len(leds), leds, len(rotation), rotation, *sigmas,
        state, spot,
    )  # fmt: skip
    return state, spot


def refine(scene: Scene, limits: Limits, state: Array, spot: Index, bounds: Array) -> int:
    """Fit hypotheses in place and give each LED the spot that it explains, until that is settled.

    `bounds` (4 n + 1,): the greatest chi², by degrees of freedom. Gives how many are good; they
    stand in front, each assignment once, best first.
    """
    return _refine(*_numbers(scene), *limits, len(state), state, spot, bounds)


def follow(
    scene: Scene,
    limits: Limits,
    found: tuple[Array, Index],
    rig_T_flange: Array,
    sigmas: tuple[float, float, float],
    bounds: Array,
) -> tuple[Array, Index]:
    """Take the spots nearest to a predicted pose (4, 4), alone and from what was found.

    LEDs that one camera alone sees are looked for anew. `sigmas` as in `begin_poses`. Gives what
    `refine` would keep: `state` and spots, as `found`.
    """
    count = 1 + len(found[0])
    state, spot = np.empty((count, N_STATE)), np.empty((count, *found[1].shape[1:]), np.int64)
    count = _follow(
        *_numbers(scene), *limits, len(found[0]), *found, rig_T_flange, *sigmas, bounds, state, spot
    )
    return state[:count], spot[:count]


def track_leds(
    pictures: tuple[PictureSpots, PictureSpots],
    optics: tuple[Array, Array, Array, Array, Array],
    model: tuple[float, float, float],
    marker: tuple[Array, Index],
    limits: Limits,
    prediction: tuple[Array, float, float, float],
    bounds: tuple[Array, float],
) -> tuple[Array, Index, Array, Array, Array] | None:
    """Follow a prediction to two pictures' spots, if each LED has one and each likely spot is one.

    `optics`: camera matrices (2, 3, 3), px, lenses (2, 5), camera_R_rig (2, 3, 3), centres (2, 3),
    m, and focal lengths (2, 2), px; `model`: px², variance of a coordinate beyond which no spot is
    likely, of a spot beside its noise, and of the right image's in addition; `marker`: LEDs (n, 3),
    m, flange frame, and their light as in `prepare_images`; `prediction`: rig_T_flange (4, 4) and
    sigmas as in `begin_poses`; `bounds`: as in `refine`, and a chi² that tracked LEDs do not reach.

    Returns:
        rig_T_flange (4, 4); spots (2, n), among the likely ones; of the LEDs, those of the left
        picture first, centres (2 n, 2), px, covariance (2 n, 2, 2), px², and in rows (4, 2 n) peak,
        DN, instant, s, depth along the optical axis, m, and width, px. None: not tracked.
    """
    n, (matrix, lens, *placed) = len(marker[0]), optics
    pose, spot = np.empty((4, 4)), np.empty((2, n), np.int64)
    centre, covariance, rows = np.empty((2 * n, 2)), np.empty((2 * n, 2, 2)), np.empty((4, 2 * n))
    (one, *left, left_rows), (other, *right, right_rows) = pictures
    vague, *variance = model
    found = _track_leds(
        len(one[0]), *one, *left, *left_rows, len(other[0]), *other, *right, *right_rows,
        vague, matrix, lens, *placed, *variance, n, *marker, *limits, *prediction, *bounds,
        pose, spot, centre, covariance, rows,
    )  # fmt: skip
    return (pose, spot, centre, covariance, rows) if found else None


def count_all(spot: Index) -> Index:
    """Count, for assignments (h, 2, n), -1 for no spot, what they use; (3, h).

    Spots in use, LEDs with a spot in an image, and LEDs with one in both.
    """
    counts = np.empty((3, len(spot)), np.int64)
    _count_all(len(spot), spot.shape[2], spot, counts)
    return counts


def departures_of_all(
    leds: Array, spot: Index, state: Array, rig_T_flange: Array, scales: tuple[float, float, float]
) -> Array:
    """Measure how far the LEDs of each hypothesis (h,) are from where a reference pose has them.

    `leds` (n, 3), m, flange frame; `spot` (h, 2, n), -1 for none; `state` (h, 85); `rig_T_flange`
    (4, 4), the reference; `scales`: position (m), rotation (rad), and how well a coarse pose places
    an LED (m).
    """
    off = np.empty(len(state))
    _departures_of_all(len(leds), leds, len(off), spot, state, rig_T_flange, *scales, off)
    return off
