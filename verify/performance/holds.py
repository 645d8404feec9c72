"""Where the arm stood still, and which of these stands are visits of one pose."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.alignment import LONGEST_GAP
from verify.comparison import Comparison
from verify.readings import Readings
from verify.records import Array
from verify.session_file import Stretch

STILL = np.deg2rad(0.1)  # rad/s of any joint: slower is standing
NOISE = 4.0  # standard deviations of a speed that readings at rest may show beside
MOVED = np.deg2rad(0.2)  # rad of any joint: a hold that goes on from elsewhere is another one
SHORTEST = 0.2  # s: shorter is turning back, not standing
SAME = np.deg2rad(0.5)  # rad of any joint: commanded poses of a test lie further apart

Rows = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Visit:
    """One stand of the arm, its pose, and the pose that it came from."""

    pose: int
    rows: Rows  # of the comparison
    came_from: int  # -1 where that is not known


def resting(comparison: Comparison) -> NDArray[np.bool_]:
    """Which pairs were taken while every joint stood, by the readings, (n,)."""
    limit = STILL + NOISE * np.sqrt(comparison.rate_variance)
    standing: NDArray[np.bool_] = np.all(np.abs(comparison.rate) < limit, axis=1)
    return standing


def find_holds(comparison: Comparison, readings: Readings, offset: float) -> list[Rows]:
    """Gather pairs that were taken in one stand.

    Args:
        comparison: the session's pairs.
        readings: what tells whether the arm left in between.
        offset: s, added to the readings' time to get the cameras' clock.

    Returns:
        Rows of each hold, in time's order. One pair is a hold where its neighbours are far off in
        time (single visits); else a hold lasts 0.2 s or more.
    """
    found: list[list[int]] = []
    for row in np.flatnonzero(resting(comparison)).tolist():
        if found and _stayed(comparison, readings, offset, found[-1], row):
            found[-1].append(row)
        else:
            found.append([row])
    holds = [np.array(rows, dtype=np.int64) for rows in found]
    return [rows for rows in holds if _long_enough(comparison.t, rows)]


def _stayed(
    comparison: Comparison, readings: Readings, offset: float, hold: list[int], row: int
) -> bool:
    """Whether the arm has stood where the hold began until this row."""
    q = comparison.q[hold[0]]
    if np.abs(comparison.q[row] - q).max() > MOVED:
        return False
    start, end = np.searchsorted(readings.t, comparison.t[[hold[-1], row]] - offset)
    between = readings.q[start:end]
    return not len(between) or bool(np.abs(between - q).max() <= MOVED)


def _long_enough(t: Array, rows: Rows) -> bool:
    if t[rows[-1]] - t[rows[0]] >= SHORTEST:
        return True
    before = t[rows[0]] - t[rows[0] - 1] if rows[0] > 0 else np.inf
    after = t[rows[-1] + 1] - t[rows[-1]] if rows[-1] + 1 < len(t) else np.inf
    return bool(min(before, after) > LONGEST_GAP)


def visits(comparison: Comparison, holds: Sequence[Rows]) -> list[Visit]:
    """Number the poses that the holds are visits of, by the readings, in order of first visit.

    A hold is of the pose at whose first visit every joint read the same within 0.5°, so that no two
    visits of a pose lie more than 1° apart.
    """
    firsts = np.zeros((len(holds), comparison.q.shape[1]))
    found: list[Visit] = []
    known = 0
    for rows in holds:
        q = comparison.q[rows].mean(axis=0)
        near = np.flatnonzero(np.abs(firsts[:known] - q).max(axis=1) <= SAME)
        pose = int(near[0]) if len(near) else known
        if pose == known:
            firsts[known] = q
            known += 1
        found.append(Visit(pose, rows, found[-1].pose if found else -1))
    return found


def named_visits(
    comparison: Comparison, named: Sequence[Stretch]
) -> tuple[list[Visit], tuple[str, ...], list[Stretch]]:
    """Take the stands that session.toml names.

    Returns:
        The visits in time's order, the names of the poses by their number, and stretches in which
        no pair was measured while the arm stood.
    """
    still = resting(comparison)
    names = tuple(dict.fromkeys(one.name for one in named))
    found, empty = [], []
    came = -1
    for one in sorted(named, key=lambda one: one.start):
        inside = (comparison.t >= one.start) & (comparison.t <= one.end) & still
        if not inside.any():
            empty.append(one)
            continue
        pose = names.index(one.name)
        found.append(Visit(pose, np.flatnonzero(inside), came))
        came = pose
    return found, names, empty
