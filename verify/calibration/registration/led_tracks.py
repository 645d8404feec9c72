"""Find the LEDs of an arm without a marker file: bright points that move as one rigid body.

Lamps, highlights and reflections are bright too; LEDs move, and their mutual distances stay:

    | x_i(t) - x_j(t) | = d_ij     for all pairs of images t in which points i and j are visible

Triangles of points that recur in most pairs are extended by the points that keep their place beside
them. No two pairs need to be near in time, so single visits serve as well as a motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from verify.core.records import Array, Flags, Index, Progress, Spots, take_rows
from verify.core.rig import Rig
from verify.errors import InputError
from verify.io.session.session import Recording
from verify.measurement.chain import MIN_DEPTH, MIN_MOTION_PX, UNKNOWN_SPEED_PX, detect_in_turn
from verify.measurement.triangulation import fit_rigid, rays, triangulate

MAX_LEDS = 6  # that correspondence can assign
MAX_EPIPOLAR_PX = 1.0  # of two rays that should meet: calibration and merged spots leave so much
MAX_DEPTH = 5.0  # m: beyond it no LED of 5 mm fills two pixels
MAX_STILL_PX = 1.5  # a lamp's image moves less, an LED's on a moving arm more
MIN_STILL_SHARE = 0.5  # of the pairs with a spot at one place: then it is none of the arm's
MIN_PAIRS = 5  # with one pan reading, to find spots that stand still
# Between the exposures an LED moves; how differently two LEDs of one body do changes the distance
# between them: 1 rad/s at 50 mm, in depth four times enlarged.
SPEED_SPREAD = 0.2  # m/s
MIN_POINT_SIGMA = 1.5e-3  # m: depth of a spot that is half a pixel off
N_REFERENCES = 8  # pairs that triangles are taken from
N_TESTS = 16  # pairs in which they are searched for
MAX_POINTS = 16  # of a pair: bounds the work; pairs with fewer are taken first
N_TRIANGLES = 6  # best ones that are extended
MIN_SIDE, MAX_SIDE = 0.012, 0.6  # m, sides of a triangle of LEDs on one flange
MIN_HEIGHT_RATIO = 0.15  # height over longest side: flatter ones do not define a frame
MIN_VIEW_SHARE = 0.5  # of the pairs in which a part of the body is found
MIN_TURN = np.deg2rad(1.0)  # of the body over the session: less, and it stands still
MIN_MOVE = 5e-3  # m, of the body over the session
MAX_ROUNDS = 4


@dataclass(frozen=True, slots=True)
class PairSpots:
    """The bright spots of one stereo pair."""

    frame: int
    t: tuple[float, float]  # s, left and right
    pan: tuple[float, float]  # rad
    spots: tuple[Spots, Spots]
    height: int  # px, of the image


@dataclass(frozen=True)
class PointCloud:
    """The candidate points of one pair."""

    points: Array  # (m, 3), m
    spots: Index  # (m, 2), the left and the right spot behind each
    play: float  # m, how far a distance between two of them may be off

    @cached_property
    def distances(self) -> Array:
        """From each point to each, (m, m), m."""
        return np.asarray(np.linalg.norm(self.points[:, None] - self.points[None], axis=2))


def find_spots(recording: Recording, progress: Progress) -> list[PairSpots]:
    """Find the spots of every pair; InputError: an image cannot be decoded."""
    pairs = []
    for pair in recording.pairs():
        t, pan = (pair.t_left, pair.t_right), (pair.pan_left, pair.pan_right)
        spots, height = detect_in_turn(pair, None, None), pair.left.shape[0]
        pairs.append(PairSpots(pair.frame, t, pan, spots, height))
        progress(len(pairs), len(recording))
    return pairs


def drop_still_spots(pairs: Sequence[PairSpots]) -> list[PairSpots]:
    """Leave out spots that are at one place of an image in most pairs: lamps, highlights."""
    sides = []
    for side in (0, 1):
        found = [pair.spots[side].centre for pair in pairs]
        pan = np.array([pair.pan[side] for pair in pairs])
        moving = [~_still_spots(i, found, pan) for i in range(len(pairs))]
        sides.append([take_rows(p.spots[side], m) for p, m in zip(pairs, moving, strict=True)])
    each = zip(pairs, *sides, strict=True)
    return [replace(pair, spots=(left, right)) for pair, left, right in each]


def _still_spots(i: int, found: list[Array], pan: Array) -> Flags:
    """Which spots of pair i are where others with the same pan reading have one, too."""
    alike = [j for j in np.flatnonzero(pan == pan[i]).tolist() if j != i]
    others = [found[j] for j in alike if len(found[j])]
    if len(alike) + 1 < MIN_PAIRS or not len(found[i]) or not others:
        return np.zeros(len(found[i]), dtype=bool)
    apart = np.linalg.norm(found[i][:, None] - np.concatenate(others)[None], axis=2)
    begin = np.cumsum([0, *map(len, others[:-1])])
    again = np.logical_or.reduceat(apart < MAX_STILL_PX, begin, axis=1).sum(axis=1)
    return np.asarray(again > MIN_STILL_SHARE * len(alike))


def find_leds(pairs: Sequence[PairSpots], rig: Rig, leds: int | None, place: str) -> Array:
    """Find the LEDs, (n, 3), m, as the rigid body that moves; spots that stand still are left out.

    They are in a frame of their own, about their centroid, good to about a millimetre. `leds` says
    how many there are; None: as many as move together. `place` is the recording, for complaints.

    Raises:
        InputError: nothing moves as one rigid body, or another number of LEDs does.
    """
    clouds = [candidate_points(pair, rig) for pair in pairs]
    body = find_rigid_body([c for c in clouds if len(c.points) >= 3], leds or MAX_LEDS)
    if body is None:
        most = max((len(c.points) for c in clouds), default=0)
        raise InputError(
            place,
            f"no three bright points move together as one rigid body (at most {most} in a pair)",
            "three LEDs or more, off one line, in view of both cameras while the arm moves",
            "Light the LEDs, darken the room, and move several joints by 20° or more; or left and "
            "right are exchanged.",
        )
    if leds is not None and len(body) != leds:
        remedy = "Check that every LED is lit and in view of both cameras, or give the number seen."
        raise InputError(place, f"{len(body)} LEDs move together", f"{leds} are asked for", remedy)
    return body


def max_motion_px(pair: PairSpots) -> float:
    """How far LEDs may move in the image between the two exposures, px."""
    return MIN_MOTION_PX + UNKNOWN_SPEED_PX * abs(pair.t[1] - pair.t[0])


def candidate_points(pair: PairSpots, rig: Rig) -> PointCloud:
    """Triangulate every left spot with every right one whose rays meet."""
    left, right = (spots.centre for spots in pair.spots)
    if not len(left) or not len(right):
        return PointCloud(np.zeros((0, 3)), np.zeros((0, 2), dtype=np.int64), 0.0)
    at, gap = triangulate(rig.left, rig.right, *pair.pan, left[:, None], right[None])
    centre, _ = rays(rig.left, pair.pan[0], left[:1])
    distance = np.linalg.norm(at - centre, axis=2)
    gap_px = gap / np.where(distance > 0, distance, np.inf) * rig.left.matrix[0, 0]
    with np.errstate(invalid="ignore"):  # nan where the rays do not meet
        meets = (gap_px < MAX_EPIPOLAR_PX + max_motion_px(pair)) & (distance > MIN_DEPTH)
        meets &= distance < MAX_DEPTH
    index = np.argwhere(meets)
    play = MIN_POINT_SIGMA + SPEED_SPREAD * abs(pair.t[1] - pair.t[0])
    return PointCloud(at[meets], index.astype(np.int64), play)


def find_rigid_body(clouds: Sequence[PointCloud], most: int) -> Array | None:
    """Find the moving points whose mutual distances stay: (n, 3) about their centroid, or None.

    Of the points of the pairs' clouds it takes at most `most`, the most frequent ones.
    """
    if len(clouds) < 3:
        return None
    few = sorted(range(len(clouds)), key=lambda i: (len(clouds[i].points), i))
    references = [clouds[i] for i in few[: max(len(few) // 2, 3)]]
    references = _spread([c for c in references if len(c.points) <= MAX_POINTS], N_REFERENCES)
    triangles = _triangles(references, _spread(clouds, N_TESTS))
    grown = [g for g in (_grow(t, clouds, most) for t in triangles) if g is not None]
    if not grown:
        return None
    leds, _, _ = max(grown, key=lambda g: (round(g[1], 1), -g[2]))
    return np.asarray(leds - leds.mean(axis=0))


GrownBody = tuple[Array, float, float]  # LEDs (n, 3); LEDs a pair, on average; misfit, m, rms


def _spread(clouds: Sequence[PointCloud], count: int) -> list[PointCloud]:
    if len(clouds) <= count:
        return list(clouds)
    return [clouds[i] for i in np.linspace(0, len(clouds) - 1, count).astype(int)]


def _triangles(references: list[PointCloud], tests: list[PointCloud]) -> list[Array]:
    """Find the triangles of points that recur in most pairs, each (3, 3), best first."""
    scored = []
    for cloud in references:
        for trio in combinations(range(len(cloud.points)), 3):
            if any(len(set(cloud.spots[list(trio), side])) < 3 for side in (0, 1)):
                continue
            corners = cloud.points[list(trio)]
            sides, (one, other) = _sides(corners), corners[1:] - corners[0]
            high = np.linalg.norm(np.cross(one, other)) > MIN_HEIGHT_RATIO * sides[-1] ** 2
            if high and sides[0] > MIN_SIDE and sides[-1] < MAX_SIDE:
                scored.append(([_match(test, corners) is not None for test in tests], corners))
    scored.sort(key=lambda s: -sum(s[0]))
    kept: list[Array] = []
    for found, corners in scored:
        if sum(found) < MIN_VIEW_SHARE * len(tests) or len(kept) == N_TRIANGLES:
            break
        if not any(np.allclose(_sides(corners), _sides(k), atol=2e-3) for k in kept):
            kept.append(corners)
    return kept


def _sides(corners: Array) -> Array:
    """Sorted lengths of a triangle's sides."""
    return np.sort(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1))


def _match(cloud: PointCloud, corners: Array) -> Index | None:
    """Find the three points of a pair that form the triangle best, (3,), or None."""
    wanted = [np.linalg.norm(corners[i] - corners[j]) for i, j in ((0, 1), (0, 2), (1, 2))]
    first, second, third = (np.abs(cloud.distances - w) for w in wanted)
    ij = np.argwhere(first < cloud.play)
    if not len(ij):
        return None
    i, j = ij.T
    off = np.maximum(np.maximum(second[i], third[j]), first[i, j][:, None])  # (edges, m)
    best = np.unravel_index(np.argmin(off), off.shape)
    if off[best] >= cloud.play:
        return None
    trio = np.array([i[best[0]], j[best[0]], best[1]], dtype=np.int64)
    distinct = all(len(set(cloud.spots[trio, side].tolist())) == 3 for side in (0, 1))
    return trio if distinct else None


def _grow(corners: Array, clouds: Sequence[PointCloud], most: int) -> GrownBody | None:
    """Add to a triangle the points that keep their place beside it."""
    placed = [
        (cloud.play, *_in_body(cloud, trio, corners))
        for cloud in clouds
        if (trio := _match(cloud, corners)) is not None
    ]
    if len(placed) < MIN_VIEW_SHARE * len(clouds):
        return None
    plays, poses, in_body = zip(*placed, strict=True)
    if not _is_moving(np.array(poses)):
        return None
    leds = list(corners)
    everything = np.concatenate(in_body)
    reach = 2 * float(np.median(plays))
    limit = MIN_VIEW_SHARE * len(placed)
    while len(leds) < most:
        near = np.linalg.norm(everything[:, None] - np.array(leds)[None], axis=2).min(axis=1)
        free = everything[near > max(MIN_SIDE, 2 * reach)]
        if not len(free):
            break
        count = (np.linalg.norm(free[:, None] - free[None], axis=2) < reach).sum(axis=1)
        top = int(np.argmax(count))
        if count[top] < limit:
            break
        cluster = free[np.linalg.norm(free - free[top], axis=1) < reach]
        leds.append(np.median(cluster, axis=0))
    return _refine_body(np.array(leds), clouds)


def _in_body(cloud: PointCloud, index: Index, leds: Array) -> tuple[Array, Array]:
    """Fit the body by some points of a pair: its pose (4, 4), all points in its frame (m, 3)."""
    pose = fit_rigid(cloud.points[index], leds)
    return pose, (cloud.points - pose[:3, 3]) @ pose[:3, :3]


def _is_moving(poses: Array) -> bool:
    moved = np.linalg.norm(np.ptp(poses[:, :3, 3], axis=0))
    turned = np.linalg.norm(poses[:, :3, :3] - poses[0, :3, :3], axis=(1, 2)).max() / np.sqrt(2)
    return bool(moved > MIN_MOVE or turned > MIN_TURN)


def _refine_body(leds: Array, clouds: Sequence[PointCloud]) -> GrownBody | None:
    """Move the LEDs to their mean places over the pairs; with it, how well they fit."""
    for _ in range(MAX_ROUNDS):
        found = [f for f in (_match_leds(leds, cloud) for cloud in clouds) if f is not None]
        if len(found) < MIN_VIEW_SHARE * len(clouds):
            return None
        stack = np.array(found)  # (views, n, 3), in the body; nan where not visible
        mean = np.nanmean(stack, axis=0)
        off = float(np.sqrt(np.nanmean((stack - mean) ** 2)))
        leds = mean
    visible = float(np.mean(np.isfinite(stack[:, :, 0]).sum(axis=1)) * len(found) / len(clouds))
    return leds, visible, off


def _match_leds(leds: Array, cloud: PointCloud) -> Array | None:
    """Find the LEDs in one pair, in the body's frame, (n, 3); nan where not visible."""
    trio = _match(cloud, leds[:3])
    if trio is None:
        return None
    _, local = _in_body(cloud, trio, leds[:3])
    apart = np.linalg.norm(local[:, None] - leds[None], axis=2)
    nearest = apart.argmin(axis=0)
    there = apart.min(axis=0) < 3 * cloud.play
    if there.sum() < 3:
        return None
    _, local = _in_body(cloud, nearest[there], leds[there])
    found: Array = local[nearest]
    found[~there] = np.nan
    return found
