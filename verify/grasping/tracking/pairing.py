"""Pair patches of colour in two pictures to objects in the rig.

Two patches are one object where their rays meet, at a distance and of a size that a target may
have, and where they are equally large in metres.
"""

import math
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.optimize import linear_sum_assignment

from verify.core.records import Array, StereoPair
from verify.core.rig import Rig
from verify.grasping.tracking import stereo
from verify.grasping.tracking.camshift import Blob
from verify.grasping.tracking.kalman import KalmanTrack, begin_track
from verify.grasping.tracking.target import TrackingOptions
from verify.measurement.alignment import spot_instants
from verify.measurement.triangulation import triangulate

MAX_RAY_DISTANCE = 4.0  # standard deviations between two rays that meet
MAX_RAY_DISTANCE_PX = 8.0  # a first, generous bound of the same
# ln of the ratio of the two areas in m²: a side view, a part hidden in one picture
MAX_LOG_AREA_RATIO = math.log(1.8)
FORBIDDEN_COST = 1e6


@dataclass(frozen=True, eq=False)
class StereoObject:
    """A coloured object in both pictures of a pair."""

    left: Blob
    right: Blob
    place: stereo.StereoPoint
    areas: Array  # (2,), m², as the left and the right picture have it
    reach: float  # m², the larger of the two areas with what is connected
    size: Array  # (2,), m, width and height
    size_uncertainty: Array  # (2,), m

    @property
    def area(self) -> float:
        """The smaller of the two areas, m²."""
        return float(self.areas.min())

    @property
    def spread(self) -> Array:
        """Covariance of the position, random and systematic, (3, 3), m²."""
        return self.place.covariance + self.place.systematic


def pair_blobs(
    lefts: list[Blob], rights: list[Blob], pair: StereoPair, rig: Rig, options: TrackingOptions
) -> list[StereoObject]:
    """Find the objects that two pictures' patches belong to, one patch for one object.

    Their velocities are not known here: where they are, use `join_blobs` again. Where two patches
    fit two others either way, opaque objects side by side have the same order in both pictures.
    """
    # of any velocity; its place is not used
    motion = begin_track(pair.t_left, np.zeros(3), np.zeros((3, 3)), options.speed)
    cost = np.full((len(lefts), len(rights)), FORBIDDEN_COST)
    things: dict[tuple[int, int], StereoObject] = {}
    for i, j in _meeting_pairs(lefts, rights, pair, rig):
        thing = join_blobs(lefts[i], rights[j], pair, rig, motion)
        if thing is not None and is_plausible(thing, options):
            things[i, j] = thing
            unlike = math.log(thing.areas[0] / thing.areas[1]) / MAX_LOG_AREA_RATIO
            cost[i, j] = thing.place.mismatch**2 + (3 * unlike) ** 2
    best = np.transpose(linear_sum_assignment(cost)).tolist()
    chosen = {i: j for i, j in best if (i, j) in things}
    _put_in_order(chosen, things, lefts, rights)
    return [things[i, j] for i, j in chosen.items()]


def join_blobs(
    left: Blob,
    right: Blob,
    pair: StereoPair,
    rig: Rig,
    motion: KalmanTrack,
    doubt: tuple[float, float] = (0.0, 0.0),
) -> StereoObject | None:
    """Make an object of two patches; None where the rays do not meet before both cameras.

    `pair` has the pictures' instants and pans; the velocity of `motion` brings both to the left
    one's instant. `doubt`, px, standard, left and right: by which a patch's centre may miss the
    object's.
    """
    cameras = stereo.place_cameras(rig, pair)
    blobs, times = (left, right), (pair.t_left, pair.t_right)
    sights = []
    for camera, blob, extra in zip(cameras, blobs, doubt, strict=True):
        covariance = blob.covariance + np.eye(2) * extra**2
        sights.append(stereo.line_of_sight(camera, blob.centre, covariance, blob.extent))
    start = stereo.ray_midpoint(sights[0], sights[1])
    for i, (t, blob) in enumerate(zip(times, blobs, strict=True)):
        taken = spot_instants(t, blob.centre[None], cameras[i].camera, rig.image_size[1])
        sights[i] = _shift_in_time(sights[i], start, motion, float(taken[0]) - pair.t_left)
    place = stereo.locate(sights[0], sights[1], rig, start)
    if place is None:
        return None
    worth = np.array([pixel_area(s, z) for s, z in zip(sights, place.depth, strict=True)])
    metres, uncertainty = stereo.object_size(sights[0], sights[1], place)
    return StereoObject(
        left,
        right,
        place,
        np.array([left.area, right.area]) * worth,
        float((np.array([left.reach, right.reach]) * worth).max()),
        metres,
        uncertainty,
    )


def pixel_area(where: stereo.LineOfSight, depth: float) -> float:
    """Area that a pixel covers at a depth, m, across its own, maybe oblique, line of sight; m²."""
    slant = float(np.sqrt(1.0 + where.xy @ where.xy))
    return float(depth**2 / (np.linalg.det(where.lens) * slant))


def is_plausible(
    thing: StereoObject, options: TrackingOptions, areas: float = MAX_LOG_AREA_RATIO
) -> bool:
    """Whether two patches can be one object, and one of a target's size and distance."""
    low, high = options.depths
    return bool(
        thing.place.mismatch < MAX_RAY_DISTANCE
        and (thing.place.depth > low).all()
        and (thing.place.depth < high).all()
        and abs(math.log(thing.areas[0] / thing.areas[1])) < areas
        and options.sizes[0] < thing.size.max() < options.sizes[1]
    )


def _meeting_pairs(
    lefts: list[Blob], rights: list[Blob], pair: StereoPair, rig: Rig
) -> list[tuple[int, int]]:
    """Pairs of patches whose rays pass each other closely."""
    if not lefts or not rights:
        return []
    points, gap = triangulate(
        rig.left,
        rig.right,
        pair.pan_left,
        pair.pan_right,
        np.array([blob.centre for blob in lefts])[:, None],
        np.array([blob.centre for blob in rights])[None],
    )
    reach = np.array([[max(a.extent.max(), b.extent.max()) for b in rights] for a in lefts])
    px = MAX_RAY_DISTANCE_PX + 0.2 * reach
    allowed = px * np.linalg.norm(points, axis=-1) / rig.left.matrix[0, 0]
    with np.errstate(invalid="ignore"):  # nan where the rays do not meet at all
        near = gap < allowed
    return [(int(i), int(j)) for i, j in np.argwhere(near)]


def _shift_in_time(
    sight: stereo.LineOfSight, point: Array, motion: KalmanTrack, late: float
) -> stereo.LineOfSight:
    """Bring a patch measured `late` s after the instant back to it."""
    if late == 0 or not np.isfinite(point).all():
        return sight
    slope = sight.placed.slope(sight.placed.inside(point))
    spread = slope @ motion.velocity_covariance @ slope.T * late**2
    xy = sight.xy - slope @ motion.velocity * late
    return replace(sight, xy=xy, covariance=sight.covariance + spread)


def _put_in_order(
    chosen: dict[int, int],
    things: dict[tuple[int, int], StereoObject],
    lefts: list[Blob],
    rights: list[Blob],
) -> None:
    for i, k in combinations(chosen, 2):
        before = lefts[i].centre[0] < lefts[k].centre[0]
        crossed = before != (rights[chosen[i]].centre[0] < rights[chosen[k]].centre[0])
        if crossed and (i, chosen[k]) in things and (k, chosen[i]) in things:
            chosen[i], chosen[k] = chosen[k], chosen[i]
