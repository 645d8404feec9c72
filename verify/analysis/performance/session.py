"""Repeated poses and paths of a session, found and judged."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice, pairwise

import numpy as np

import robots
from robots.transforms import difference
from verify.analysis.comparison import Comparison
from verify.analysis.model import JointErrorModel
from verify.analysis.performance.holds import (
    MAX_HOLD_TRAVEL,
    MAX_POSE_DISTANCE,
    HoldNoise,
    Visit,
    far_off,
    find_holds,
    named_holds,
    number_visits,
    static_noise,
    with_origins,
)
from verify.analysis.performance.indices import repeatability_of
from verify.analysis.performance.paths import PathIndices, PathRun, assess_path, crossings
from verify.analysis.performance.poses import (
    MIN_VISITS,
    DistanceIndices,
    PoseIndices,
    PoseVisits,
    assess_distance,
    assess_pose,
    mean_pose,
)
from verify.core.readings import Readings
from verify.core.records import Array, Flags, Index
from verify.io.session.keys import TimeInterval
from verify.measurement.alignment import MAX_GAP

MAX_DISTANCES = 10  # the longest are judged
MAX_POSE_PAIRS = 200  # pairs of poses, the longest first
PATH_STEP = 0.005  # s, of the readings' path between pairs
MIN_PAIRS = 3  # of a passage: fewer say nothing of the path between its ends
NO_HOLDS, NO_REPEATS, OPEN_POSES = "no_holds", "no_repeats", "poses_not_determined"


@dataclass(frozen=True, slots=True)
class Performance:
    """What repeated poses and paths of a session show."""

    named: bool  # poses or paths were named in session.toml
    poses: tuple[PoseIndices, ...]
    distances: tuple[DistanceIndices, ...]
    paths: tuple[PathIndices, ...]
    noise: HoldNoise
    point: Array  # (3,), m, in the flange frame: what positions are of
    oriented: bool
    seldom: int  # poses visited more than once, but fewer than five times
    empty: tuple[TimeInterval, ...]  # named, but the arm was not measured standing there
    left_out: Index  # numbers of the pairs that lie far off the others of their hold
    duration: float  # s, from the first to the last pair; nan where visits were not timed


@dataclass(frozen=True, slots=True)
class MeasuredPoints:
    """A session's pairs at the measured point, and the readings between them."""

    comparison: Comparison
    arm: robots.Arm
    readings: Readings
    offset: float  # s, added to the readings' time to get the cameras' clock
    attained: Array  # (n, 4, 4)
    read: Array  # (n, 4, 4)
    systematic: Array  # (n, 6, p), d pose at the point / d unit of what does not average out
    off: Array  # (n, 6), attained less read, m and rad
    frame: Index  # (n,), the pairs' numbers
    whole: Flags  # (n,), pairs whose pose (or point) is wholly determined
    oriented: bool  # whether the orientation was measured


def performance(
    model: JointErrorModel,
    arm: robots.Arm,
    readings: Readings,
    offset: float,
    *,
    named_poses: Sequence[TimeInterval] = (),
    named_paths: Sequence[TimeInterval] = (),
    point: Array | None = None,
    timed: bool = True,
    frame: Index | None = None,
) -> Performance | str:
    """Find repeated poses and paths in a session and judge them.

    `offset`, s, is added to the readings' time to get the cameras' clock. Where visits of poses are
    named, others do not count, and so with passages of paths. `point` (3,), m, flange frame: where
    positions alone were measured, of this point; `timed`: the times are those of the visits;
    `frame` (n,): the pairs' numbers. Gives the indices, or why there are none: `no_holds`,
    `no_repeats`, `poses_not_determined`.
    """
    comparison = model.comparison
    frame = comparison.index if frame is None else frame
    measured = _at_point(model, arm, readings, offset, frame, point)
    if not measured.whole.any():
        return OPEN_POSES
    visits, names, empty = _visits(measured, named_poses)
    far = far_off([measured.off[v.rows] for v in visits], oriented=measured.oriented)
    left_out = np.concatenate(
        [np.zeros(0, np.int64), *(v.rows[f] for v, f in zip(visits, far, strict=True))]
    )
    measured.whole[left_out] = False
    visits = [replace(v, rows=v.rows[~f]) for v, f in zip(visits, far, strict=True)]
    if not visits and not named_paths:
        return NO_HOLDS
    stated = measured.comparison.covariance_measured[measured.whole].mean(axis=0)
    noise = static_noise([v.rows for v in visits], measured.off, stated)
    counts = [sum(v.pose == i for v in visits) for i in range(len(names))]
    by_pose = [
        _visits_of_poses(measured, [v for v in visits if v.pose == i], names[i])
        for i, count in enumerate(counts)
        if count >= MIN_VISITS
    ]
    runs = _named_runs(measured, named_paths) or _runs_between(visits, names)
    paths = _paths(measured, runs, repeatability_of(noise.position))
    if not by_pose and not paths:
        return NO_REPEATS
    return Performance(
        named=bool(named_poses or named_paths),
        poses=tuple(assess_pose(one, noise, oriented=measured.oriented) for one in by_pose),
        distances=_distances(by_pose),
        paths=paths,
        noise=noise,
        point=np.zeros(3) if point is None else point,
        oriented=measured.oriented,
        seldom=sum(1 < count < MIN_VISITS for count in counts),
        empty=tuple(empty),
        left_out=measured.frame[left_out],
        duration=float(comparison.t[-1] - comparison.t[0]) if timed else np.nan,
    )


def _visits(
    measured: MeasuredPoints, named: Sequence[TimeInterval]
) -> tuple[list[Visit], tuple[str, ...], list[TimeInterval]]:
    """Find the visits of poses, their names, and what was named without a measured pair."""
    comparison, readings, offset = measured.comparison, measured.readings, measured.offset
    if named:
        holds, called, empty = named_holds(comparison, named)
    else:
        holds, empty = find_holds(comparison, readings, offset), []
        called = [f"P{i + 1}" for i in number_visits(comparison, holds)]
    names = tuple(dict.fromkeys([*(one.name for one in named), *called]))
    poses = [names.index(name) for name in called]
    visits = with_origins(comparison, readings, offset, holds, poses)
    whole = measured.whole
    visits = [replace(v, rows=v.rows[whole[v.rows]]) for v in visits if whole[v.rows].any()]
    return visits, names, empty


def _at_point(
    model: JointErrorModel,
    arm: robots.Arm,
    readings: Readings,
    offset: float,
    frame: Index,
    measured_point: Array | None,
) -> MeasuredPoints:
    comparison = model.comparison
    least = 6 if measured_point is None else 3
    whole = np.array([known.shape[1] >= least for known in comparison.determined], dtype=bool)
    point = np.zeros(3) if measured_point is None else measured_point
    attained, read = comparison.base_T_measured.copy(), comparison.base_T_encoder.copy()
    lever = attained[:, :3, :3] @ point
    for poses in (attained, read):
        poses[:, :3, 3] += poses[:, :3, :3] @ point
    systematic = model.prior_columns.copy()
    systematic[:, :3] += np.cross(systematic[:, 3:], lever[:, :, None], axis=1)
    return MeasuredPoints(
        comparison, arm, readings, offset, attained, read, systematic, difference(attained, read),
        frame, whole, measured_point is None,
    )  # fmt: skip


def _visits_of_poses(measured: MeasuredPoints, visits: Sequence[Visit], name: str) -> PoseVisits:
    rows = np.concatenate([v.rows for v in visits])
    return PoseVisits(
        name=name,
        t=np.array([measured.comparison.t[v.rows].mean() for v in visits]),
        attained=np.array([mean_pose(measured.attained[v.rows]) for v in visits]),
        read=np.array([mean_pose(measured.read[v.rows]) for v in visits]),
        own=np.array([measured.off[v.rows].mean(axis=0) for v in visits]),
        pairs=tuple(measured.frame[v.rows] for v in visits),
        came_from=tuple(v.came_from for v in visits),
        systematic=measured.systematic[rows].mean(axis=0),
    )


def _distances(by_pose: Sequence[PoseVisits]) -> tuple[DistanceIndices, ...]:
    """Judge the longest distances between poses that were visited in turn."""
    places = np.array([one.read[:, :3, 3].mean(axis=0) for one in by_pose]).reshape(-1, 3)
    far = np.triu(np.linalg.norm(places[:, None] - places[None], axis=2))
    longest = np.argsort(-far, axis=None, kind="stable")[:MAX_POSE_PAIRS]
    pairs = [divmod(int(i), len(by_pose)) for i in longest if far.flat[i] > 0]
    judged = (assess_distance(by_pose[a], by_pose[b]) for a, b in pairs)
    return tuple(islice((one for one in judged if one is not None), MAX_DISTANCES))


def _named_runs(measured: MeasuredPoints, named: Sequence[TimeInterval]) -> dict[str, list[Index]]:
    """Rows of each passage that is named, by the path's name."""
    t = measured.comparison.t
    runs: dict[str, list[Index]] = {}
    for one in named:
        runs.setdefault(one.name, []).append(np.flatnonzero((t >= one.start) & (t <= one.end)))
    return runs


def _runs_between(visits: Sequence[Visit], names: Sequence[str]) -> dict[str, list[Index]]:
    """Rows of each passage from one pose to another, by a name that both poses give."""
    runs: dict[str, list[Index]] = {}
    for before, after in pairwise(visits):
        if before.pose != after.pose:
            name = f"{names[before.pose]} → {names[after.pose]}"
            rows = np.arange(before.rows[-1], after.rows[0] + 1)
            runs.setdefault(name, []).append(rows)
    return runs


def _paths(
    measured: MeasuredPoints, paths: dict[str, list[Index]], floor: float
) -> tuple[PathIndices, ...]:
    """Judge every path with five passages or more; `floor`: m, what noise alone repeats to."""
    t = measured.comparison.t
    found = []
    for name, runs in paths.items():
        runs = [rows[measured.whole[rows]] for rows in runs]
        # those whose pairs follow the motion closely enough to know the path between them
        whole = [rows for rows in runs if len(rows) >= MIN_PAIRS]
        close = [rows for rows in whole if np.diff(t[rows]).max() <= MAX_GAP]
        runs = _same_way(measured.comparison, close)
        if len(runs) < MIN_VISITS:
            continue
        met = crossings([_passage(measured, rows) for rows in runs])
        if met is not None:
            doubt = _systematic_along(measured, runs, met.t)
            found.append(assess_path(name, met, floor, doubt, oriented=measured.oriented))
    return tuple(found)


def _same_way(comparison: Comparison, runs: Sequence[Index]) -> list[Index]:
    """Keep passages that go the same way, within what poses may differ, as most of them."""
    if len(runs) < MIN_VISITS:
        return []
    share = np.linspace(0, 1, 9)
    ways = []
    for rows in runs:
        q = comparison.q[rows]
        way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(q, axis=0)).max(axis=1))])
        even = np.linspace(0, 1, len(rows)) if way[-1] == 0 else way / way[-1]
        ways.append(np.stack([np.interp(share, even, column) for column in q.T], axis=1))
    # pairs fall on the path where they fall: the coarse course tells one path from another
    off = np.abs(np.array(ways) - np.median(ways, axis=0)).max(axis=(1, 2))
    span = float(np.ptp(np.median(ways, axis=0), axis=0).max())
    return [
        r for r, one in zip(runs, off, strict=True) if one <= max(2 * MAX_POSE_DISTANCE, 0.1 * span)
    ]


def _passage(measured: MeasuredPoints, rows: Index) -> PathRun:
    """Follow the readings' path closely, with what the pairs are off it taken in between."""
    t = measured.comparison.t[rows]
    fine = np.arange(t[0], t[-1] + PATH_STEP / 2, PATH_STEP)
    q = measured.readings.at(fine - measured.offset)
    read = robots.forward(measured.arm, q)
    point = measured.read[rows[0]]
    local = np.linalg.inv(measured.comparison.base_T_encoder[rows[0]]) @ point
    places = read @ local
    off = np.stack([np.interp(fine, t, c) for c in measured.off[rows].T], axis=1)
    moving = _motion_range(q)
    return PathRun(
        fine[moving],
        (places[:, :3, 3] + off[:, :3])[moving],
        places[moving, :3, 3],
        off[moving, 3:],
        places[moving, :3, :3],
    )


def _motion_range(q: Array) -> slice:
    """From where the arm leaves its first pose to where it reaches its last."""
    left = np.flatnonzero(np.abs(q - q[0]).max(axis=1) > MAX_HOLD_TRAVEL)
    short = np.flatnonzero(np.abs(q - q[-1]).max(axis=1) > MAX_HOLD_TRAVEL)
    if not len(left) or not len(short):
        return slice(0, len(q))
    return slice(max(int(left[0]) - 1, 0), int(short[-1]) + 2)


def _systematic_along(measured: MeasuredPoints, runs: Sequence[Index], t: Array) -> Array:
    """What does not average out at each station (m, 3, p), of the pairs nearest in time."""
    nearest = [
        rows[np.argmin(np.abs(measured.comparison.t[rows] - one[:, None]), axis=1)]
        for rows, one in zip(runs, t.T, strict=True)
    ]
    return np.asarray(np.mean([measured.systematic[rows, :3] for rows in nearest], axis=0))
