"""Find where the arm stood still, which of these holds visit one pose, and the noise in them."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from verify.analysis.clock.search import are_visits
from verify.analysis.comparison import Comparison
from verify.core.readings import Readings
from verify.core.records import Array, Flags, Index
from verify.io.session.keys import TimeInterval
from verify.measurement.alignment import MAX_GAP

MAX_REST_SPEED = np.deg2rad(0.1)  # rad/s of any joint: slower is standing
MAX_SPEED_SIGMA = 4.0  # standard deviations of a speed that readings at rest may show beside
MAX_HOLD_TRAVEL = np.deg2rad(0.2)  # rad of any joint: what goes on from elsewhere is another hold
MIN_HOLD_TIME = 0.2  # s: shorter is turning back, not standing
MAX_POSE_DISTANCE = np.deg2rad(0.5)  # rad of any joint: commanded poses of a test lie further apart
MAX_APART = 10.0  # of the usual distance from the middle: 6.5 standard deviations
MIN_APART = 1e-7  # m or rad: less is rounding
MIN_DOF = 20  # of the scatter within holds: fewer know it worse than what is stated


@dataclass(frozen=True, slots=True)
class Visit:
    """One visit of the arm, its pose, and the pose that it came from."""

    pose: int
    rows: Index  # of the comparison
    came_from: int  # -1 where that is not known


def at_rest(comparison: Comparison) -> Flags:
    """Which pairs were taken while every joint stood, by the readings, (n,)."""
    limit = MAX_REST_SPEED + MAX_SPEED_SIGMA * np.sqrt(comparison.rate_variance)
    return np.asarray(np.all(np.abs(comparison.rate) < limit, axis=1))


def find_holds(comparison: Comparison, readings: Readings, offset: float) -> list[Index]:
    """Gather pairs that were taken in one visit: rows of each hold, in time's order.

    The readings tell whether the arm left in between; `offset`, s, is added to their time to get
    the cameras' clock. One pair is a hold where its neighbours are far off in time (single visits);
    else a hold lasts 0.2 s or more.
    """
    found: list[list[int]] = []
    for row in np.flatnonzero(at_rest(comparison)).tolist():
        if found and _stays_at_rest(comparison, readings, offset, found[-1], row):
            found[-1].append(row)
        else:
            found.append([row])
    holds = [np.array(rows, dtype=np.int64) for rows in found]
    return [rows for rows in holds if _long_enough(comparison.t, rows)]


def _stays_at_rest(
    comparison: Comparison, readings: Readings, offset: float, hold: list[int], row: int
) -> bool:
    """Whether the arm has stood where the hold began until this row."""
    q = comparison.q[hold[0]]
    if np.abs(comparison.q[row] - q).max() > MAX_HOLD_TRAVEL:
        return False
    start, end = np.searchsorted(readings.t, comparison.t[[hold[-1], row]] - offset)
    between = readings.q[start:end]
    return not len(between) or bool(np.abs(between - q).max() <= MAX_HOLD_TRAVEL)


def _long_enough(t: Array, rows: Index) -> bool:
    if t[rows[-1]] - t[rows[0]] >= MIN_HOLD_TIME:
        return True
    before = t[rows[0]] - t[rows[0] - 1] if rows[0] > 0 else np.inf
    after = t[rows[-1] + 1] - t[rows[-1]] if rows[-1] + 1 < len(t) else np.inf
    return bool(min(before, after) > MAX_GAP)


def number_visits(comparison: Comparison, holds: Sequence[Index]) -> list[int]:
    """Number the poses that the holds are visits of, by the readings, in order of first visit.

    A hold is of the pose at whose first visit every joint read the same within 0.5°, so that no two
    visits of a pose lie more than 1° apart.
    """
    firsts = np.zeros((len(holds), comparison.q.shape[1]))
    found: list[int] = []
    for rows in holds:
        q, known = comparison.q[rows].mean(axis=0), max(found, default=-1) + 1
        near = np.flatnonzero(np.abs(firsts[:known] - q).max(axis=1) <= MAX_POSE_DISTANCE)
        found.append(int(near[0]) if len(near) else known)
        if found[-1] == known:
            firsts[known] = q
    return found


def named_holds(
    comparison: Comparison, named: Sequence[TimeInterval]
) -> tuple[list[Index], list[str], list[TimeInterval]]:
    """Rows of each visit that session.toml names, in time's order, and the names.

    Also gives the stretches in which no pair was measured while the arm stood.
    """
    still = at_rest(comparison)
    ordered = sorted(named, key=lambda one: one.start)
    rows = [
        np.flatnonzero((comparison.t >= one.start) & (comparison.t <= one.end) & still)
        for one in ordered
    ]
    found = [(r, one.name) for r, one in zip(rows, ordered, strict=True) if len(r)]
    empty = [one for r, one in zip(rows, ordered, strict=True) if not len(r)]
    return [r for r, _ in found], [name for _, name in found], empty


def with_origins(
    comparison: Comparison,
    readings: Readings,
    offset: float,
    holds: Sequence[Index],
    poses: Sequence[int],
) -> list[Visit]:
    """The visits of poses, each with the pose before it.

    That is not known where the arm stood elsewhere in between, by its readings (`offset`, s, is
    added to their time), or where a single visit in between has no reading.
    """
    limit = MAX_REST_SPEED + MAX_SPEED_SIGMA * np.sqrt(comparison.rate_variance)
    came = [-1]
    for (before, after), pose in zip(pairwise(holds), poses, strict=False):
        ends = np.array([before[-1], after[0]])
        t = readings.t[slice(*np.searchsorted(readings.t, comparison.t[ends] - offset))]
        q, rate = readings.motion(t)  # of single visits the speed is 0: none is passed by
        away = np.abs(q[:, None] - comparison.q[ends]).max(axis=2).min(axis=1) > MAX_POSE_DISTANCE
        lost = are_visits(comparison.t) and np.ptp(comparison.index[ends]) > 1
        stood = np.any(away & np.all(np.abs(rate) < limit, axis=1))
        came.append(-1 if lost or stood else pose)
    return [Visit(*one) for one in zip(poses, holds, came[: len(holds)], strict=True)]


def far_off(groups: Sequence[Array], *, oriented: bool) -> list[Flags]:
    """Members (k, 6), m and rad, of each group that lie far off its middle, (k,) each.

    Far is MAX_APART of the usual distance in all groups of three or more, of positions or, if
    `oriented`, of turns. Where half of a group lies far off it has no middle, and nobody does.
    """
    parts = (slice(0, 3), slice(3, 6)) if oriented else (slice(0, 3),)
    off = [one - np.median(one, axis=0) for one in groups]
    apart = [np.stack([np.linalg.norm(o[:, p], axis=1) for p in parts], axis=1) for o in off]
    several = [one for one in apart if len(one) > 2]
    usual = np.median(np.concatenate(several), axis=0) if several else np.zeros(len(parts))
    far = [np.any(one > MAX_APART * np.maximum(usual, MIN_APART), axis=1) for one in apart]
    return [one & (2 * np.count_nonzero(one) < len(one)) for one in far]


@dataclass(frozen=True, slots=True)
class HoldNoise:
    """Scatter of one pair's position and turn at rest."""

    position: Array  # (3, 3), m²
    turn: Array  # (3, 3), rad²
    together: float  # >= 1, by which neighbouring pairs' likeness raises the variance of a mean
    source: str  # "holds": seen while the arm stood; "stated": the poses' own covariance
    freedom: int  # degrees of freedom, 0 where stated

    def of_means(self, counts: Array) -> tuple[Array, Array]:
        """Covariance (3, 3) that it gives visits of `counts` pairs each, mean over the visits."""
        factor = float(np.mean(np.minimum(self.together / counts, 1.0)))
        return self.position * factor, self.turn * factor


def static_noise(holds: Sequence[Index], off: Array, stated: Array) -> HoldNoise:
    """Pool the scatter within the holds of poses measured less read (n, 6), m and rad.

    `stated`, (6, 6): by the poses, where too few holds have several pairs.
    """
    freedom = sum(len(rows) - 1 for rows in holds)
    if freedom < MIN_DOF:
        return HoldNoise(stated[:3, :3], stated[3:, 3:], 1.0, "stated", 0)
    inside = [off[rows] - off[rows].mean(axis=0) for rows in holds if len(rows) > 1]
    square = sum(one.T @ one for one in inside) / freedom
    return HoldNoise(square[:3, :3], square[3:, 3:], _correlation_factor(inside), "holds", freedom)


def _correlation_factor(inside: Sequence[Array]) -> float:
    """Factor (1 + r) / (1 - r) of a first-order process, r the neighbours' correlation.

    Taking a hold's own mean off lowers r by about one over its pairs; that is put back.
    """
    scale = np.sqrt(sum(np.sum(one**2, axis=0) for one in inside))
    scale = np.where(scale > 0, scale, 1.0)
    ahead = float(sum(np.sum(one[1:] * one[:-1] / scale**2) for one in inside)) / 6
    lengths = np.array([len(one) for one in inside])
    r = ahead + float(np.sum(lengths - 1) / np.sum(lengths)) / float(lengths.mean())
    r = min(max(r, 0.0), 0.95)
    return (1 + r) / (1 - r)
