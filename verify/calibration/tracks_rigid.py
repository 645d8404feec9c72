"""Which of many points, seen again and again, are one rigid body."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from verify.records import Array
from verify.triangulation import fit_rigid

REFERENCES = 8  # views that triangles are taken from
TESTS = 16  # views that they are looked for in
MOST_POINTS = 16  # of a view: bounds the work; views with fewer are taken first
TRIANGLES = 6  # best ones that are grown
SHORTEST, LONGEST = 0.012, 0.6  # m, sides of a triangle of LEDs on one flange
SLENDER = 0.15  # height over longest side: flatter ones do not define a frame
PRESENT = 0.5  # share of the views in which a body's part is seen
LEAST_TURN = np.deg2rad(1.0)  # of the body over the session: less, and it stands still
LEAST_MOVE = 5e-3  # m, likewise
ROUNDS = 4


@dataclass(frozen=True, slots=True)
class Cloud:
    """The candidate points of one view."""

    points: Array  # (m, 3), m
    spots: NDArray[np.int64]  # (m, 2), the left and the right spot behind each
    play: float  # m, how far a distance between two of them may be off


@dataclass(frozen=True, slots=True)
class _Grown:
    leds: Array  # (n, 3)
    seen: float  # LEDs a view, on average
    misfit: float  # m, rms


def rigid_body(clouds: Sequence[Cloud], most: int) -> Array | None:
    """The moving points whose mutual distances stay: (n, 3) about their centroid, or None.

    Args:
        clouds: the points of each view.
        most: how many of them to take, those seen most often.
    """
    if len(clouds) < 3:
        return None
    few = sorted(range(len(clouds)), key=lambda i: (len(clouds[i].points), i))
    references = [clouds[i] for i in few[: max(len(few) // 2, 3)]]
    references = _spread([c for c in references if len(c.points) <= MOST_POINTS], REFERENCES)
    tests = _spread(clouds, TESTS)
    triangles = _triangles(references, tests)
    grown = [g for g in (_grow(t, clouds, most) for t in triangles) if g is not None]
    if not grown:
        return None
    best = max(grown, key=lambda g: (round(g.seen, 1), -g.misfit))
    centred: Array = best.leds - best.leds.mean(axis=0)
    return centred


def _spread(clouds: Sequence[Cloud], count: int) -> list[Cloud]:
    if len(clouds) <= count:
        return list(clouds)
    return [clouds[i] for i in np.linspace(0, len(clouds) - 1, count).astype(int)]


def _triangles(references: list[Cloud], tests: list[Cloud]) -> list[Array]:
    """The triangles of points that come back in most views, each (3, 3), best first."""
    scored = []
    for cloud in references:
        for trio in combinations(range(len(cloud.points)), 3):
            if any(len(set(cloud.spots[list(trio), side])) < 3 for side in (0, 1)):
                continue
            corners = cloud.points[list(trio)]
            if _usable(corners):
                scored.append(([_has(test, corners) for test in tests], corners))
    scored.sort(key=lambda s: -sum(s[0]))
    kept: list[Array] = []
    for found, corners in scored:
        if sum(found) < PRESENT * len(tests) or len(kept) == TRIANGLES:
            break
        if not any(np.allclose(_sides(corners), _sides(k), atol=2e-3) for k in kept):
            kept.append(corners)
    return kept


def _sides(corners: Array) -> Array:
    """Sorted lengths of a triangle's sides."""
    sides: Array = np.sort(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1))
    return sides


def _usable(corners: Array) -> bool:
    sides = _sides(corners)
    area = np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
    return bool(sides[0] > SHORTEST and sides[-1] < LONGEST and area > SLENDER * sides[-1] ** 2)


def _has(cloud: Cloud, corners: Array) -> bool:
    return _match(cloud, corners) is not None


def _match(cloud: Cloud, corners: Array) -> NDArray[np.int64] | None:
    """The three points of a view that form the triangle best, (3,), or None."""
    wanted = [np.linalg.norm(corners[i] - corners[j]) for i, j in ((0, 1), (0, 2), (1, 2))]
    apart = np.linalg.norm(cloud.points[:, None] - cloud.points[None], axis=2)
    first, second, third = (np.abs(apart - w) for w in wanted)
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


def _grow(corners: Array, clouds: Sequence[Cloud], most: int) -> _Grown | None:
    """Add to a triangle what keeps its place beside it."""
    poses, in_body, spread = _placed(corners, clouds)
    if len(poses) < PRESENT * len(clouds) or not _moves(poses):
        return None
    leds = list(corners)
    everything = np.concatenate(in_body)
    reach = 2 * spread
    limit = PRESENT * len(in_body)
    while len(leds) < most:
        near = np.linalg.norm(everything[:, None] - np.array(leds)[None], axis=2).min(axis=1)
        free = everything[near > max(SHORTEST, 2 * reach)]
        if not len(free):
            break
        count = (np.linalg.norm(free[:, None] - free[None], axis=2) < reach).sum(axis=1)
        top = int(np.argmax(count))
        if count[top] < limit:
            break
        cluster = free[np.linalg.norm(free - free[top], axis=1) < reach]
        leds.append(np.median(cluster, axis=0))
    return _settled(np.array(leds), clouds)


def _placed(corners: Array, clouds: Sequence[Cloud]) -> tuple[Array, list[Array], float]:
    """Where the triangle stands in each view that has it, and the view's points from there."""
    poses, in_body, plays = [], [], []
    for cloud in clouds:
        trio = _match(cloud, corners)
        if trio is None:
            continue
        pose = fit_rigid(cloud.points[trio], corners)
        poses.append(pose)
        in_body.append((cloud.points - pose[:3, 3]) @ pose[:3, :3])
        plays.append(cloud.play)
    return np.array(poses).reshape(-1, 4, 4), in_body, float(np.median(plays or [0.0]))


def _moves(poses: Array) -> bool:
    moved = np.linalg.norm(np.ptp(poses[:, :3, 3], axis=0))
    turned = np.linalg.norm(poses[:, :3, :3] - poses[0, :3, :3], axis=(1, 2)).max() / np.sqrt(2)
    return bool(moved > LEAST_MOVE or turned > LEAST_TURN)


def _settled(leds: Array, clouds: Sequence[Cloud]) -> _Grown | None:
    """Move the LEDs to their mean places over the views, and see how well they hold."""
    for _ in range(ROUNDS):
        found = [f for f in (_all_of(leds, cloud) for cloud in clouds) if f is not None]
        if len(found) < PRESENT * len(clouds):
            return None
        stack = np.array(found)  # (views, n, 3), in the body; nan where not seen
        mean = np.nanmean(stack, axis=0)
        off = float(np.sqrt(np.nanmean((stack - mean) ** 2)))
        leds = mean
    seen = float(np.mean(np.isfinite(stack[:, :, 0]).sum(axis=1)) * len(found) / len(clouds))
    return _Grown(leds, seen, off)


def _all_of(leds: Array, cloud: Cloud) -> Array | None:
    """The LEDs as one view has them, brought to the body's frame, (n, 3); nan where unseen."""
    trio = _match(cloud, leds[:3])
    if trio is None:
        return None
    pose = fit_rigid(cloud.points[trio], leds[:3])
    local = (cloud.points - pose[:3, 3]) @ pose[:3, :3]
    apart = np.linalg.norm(local[:, None] - leds[None], axis=2)
    nearest = apart.argmin(axis=0)
    there = apart.min(axis=0) < 3 * cloud.play
    if there.sum() < 3:
        return None
    pose = fit_rigid(cloud.points[nearest[there]], leds[there])
    seen = (cloud.points[nearest] - pose[:3, 3]) @ pose[:3, :3]
    seen[~there] = np.nan
    found: Array = seen
    return found
