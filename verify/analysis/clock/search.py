"""Offsets at which the motion that was read could be the one that was measured.

Compared is what no base can disturb: angle and distance between two poses some tenths of a second
apart, as measured (a) and as read (b), by an offset o,

    cost(o) = mean over motions of min((a - b(o))² / variance, MAX_SQUARED_MISFIT)

where the variance holds the poses' noise, what a wrong table leaves, and what the arm moves within
half a step of the search. Visits have no motion to compare: there each offset that brings a reading
to a visit is tried, and poses are compared instead.
"""

import numpy as np

import robots
from verify.analysis.comparison import compare
from verify.analysis.least_squares import solve, whiten
from verify.core.kernels.entries import motion_misfits, motion_sizes
from verify.core.readings import HOLD_TIME, MAX_GAP, Readings
from verify.core.records import Array, Index
from verify.measurement.track import Track, subset

MAX_MOTIONS = 400  # enough to find the offset; more only cost time
COARSE_STEP = 0.02  # s; brisk joints turn half a degree in it
MAX_OFFSETS = 30_000  # that are tried, whatever the time stamps say: ten minutes' worth
MAX_INSTANTS = 100_000  # that are looked up at a time: a few megabytes
MAX_SQUARED_MISFIT = 100.0  # beyond which a motion has one vote
MAX_PAIRS_BY_POSE = 40  # where each offset costs a comparison
MAX_OFFSETS_BY_POSE = 400
MIN_OVERLAP = 0.5  # of the pairs must have a reading at an offset that is tried
MOTION_LAG = 0.3  # s between the poses of a motion: noise falls, motion grows with it
# Angle and distance errors that a wrong rig or table leaves in a relative motion, so that the
# search is not ruled by pairs that happen to be exact: rad, m.
MODEL_ERROR = (1e-3, 5e-4)
# A dip's cost, above the lowest one, at which it is still refined: the search's own roughness.
MAX_DIP_EXCESS = 8.0


def coarse_costs(
    track: Track,
    arm: robots.Arm,
    readings: Readings,
    guess: float | None = None,
    overlap: float = MIN_OVERLAP,
) -> Array:
    """Cost of the offsets that give a share `overlap` of pairs a reading, (m, 2): offset s, cost.

    About `guess`, s, where there are more than MAX_OFFSETS to try.
    """
    offsets = _offsets_to_try(track, readings, guess, overlap)
    if not are_visits(track.t) and not are_visits(readings.t):
        curve = _costs_by_motion(track, arm, readings, offsets, overlap)
        if len(curve):
            return curve
    return _costs_by_pose(track, arm, readings, offsets, overlap)


def dips(curve: Array) -> Array:
    """Local minima of a curve that could be the lowest one once refined, (d,), s."""
    offset, cost = curve.T
    padded = np.concatenate([[np.inf], cost, [np.inf]])
    lowest = (cost <= padded[:-2]) & (cost <= padded[2:])
    return np.asarray(offset[lowest & (cost <= cost.min() + MAX_DIP_EXCESS)])


def are_visits(t: Array) -> bool:
    """Whether most instants stand alone: between them nothing is known."""
    return len(t) < 2 or float(np.median(np.diff(t))) > MAX_GAP


def _offsets_to_try(track: Track, readings: Readings, guess: float | None, overlap: float) -> Array:
    """Offsets COARSE_STEP apart, or those that bring a reading to a visit, (m,), s."""
    uncovered = (1.0 - overlap) * float(track.t[-1] - track.t[0])
    lowest = float(track.t[-1] - readings.t[-1]) - uncovered
    highest = float(track.t[0] - readings.t[0]) + uncovered
    if lowest > highest:
        return np.zeros(0)
    if are_visits(readings.t):
        return _visit_offsets(track.t, readings.t, (lowest, highest))
    middle = 0.5 * (lowest + highest) if guess is None else guess
    reach = 0.5 * MAX_OFFSETS * COARSE_STEP
    lowest = max(lowest, min(middle, highest) - reach)
    highest = min(highest, max(middle, lowest) + reach)
    return np.linspace(lowest, highest, int(np.ceil((highest - lowest) / COARSE_STEP)) + 1)


def _visit_offsets(t: Array, reading_t: Array, limits: tuple[float, float]) -> Array:
    """Offsets that bring some reading to the first, the middle or the last pair, (m,), s."""
    some = t[[0, len(t) // 2, -1]]
    offsets = np.unique((some[:, None] - reading_t[None]).ravel())
    inside = offsets[(offsets >= limits[0]) & (offsets <= limits[1])]
    if limits[0] <= 0.0 and limits[1] >= 0.0:
        inside = np.append(inside, 0.0)
    # closer than what a visit lasts they are one
    return np.unique(np.round(inside / HOLD_TIME) * HOLD_TIME)


def _costs_by_motion(
    track: Track, arm: robots.Arm, readings: Readings, offsets: Array, overlap: float
) -> Array:
    """The curve by relative motions; empty where too few poses are whole."""
    early, late = _motion_ends(track)
    if not len(early) or not len(offsets):
        return np.zeros((0, 2))
    sizes = np.empty((len(early), 2))
    motion_sizes(track.base_T_flange[early], track.base_T_flange[late], sizes)
    by_noise = [
        np.trace(track.covariance_pixels[:, block, block], axis1=1, axis2=2) / 3
        for block in (slice(3, 6), slice(0, 3))
    ]
    variance = np.square(MODEL_ERROR) + np.stack([v[early] + v[late] for v in by_noise], axis=1)
    # by the search's step: the grid is never met exactly
    speed = sizes / np.maximum(track.t[late] - track.t[early], COARSE_STEP)[:, None]
    variance = variance + 2 * np.mean(speed**2, axis=0) * COARSE_STEP**2 / 12
    # poses along the whole log once; every offset then only looks them up
    grid_t = readings.instants(COARSE_STEP)
    poses = robots.forward(arm, readings.at(grid_t))
    pairs, ends = np.unique([early, late], return_inverse=True)
    parts = []
    for some in np.array_split(offsets, -(-len(offsets) * len(pairs) // MAX_INSTANTS)):
        instants = track.t[pairs] - some[:, None]
        read = readings.available(instants.reshape(-1)).reshape(instants.shape)
        known = read[:, ends[0]] & read[:, ends[1]]
        enough = known.mean(axis=1) >= overlap
        cost = np.empty(int(enough.sum()))
        nearest = np.searchsorted(grid_t, instants[enough] - COARSE_STEP / 2)
        nearest = np.ascontiguousarray(np.minimum(nearest, len(grid_t) - 1)[:, ends])
        motion_misfits(nearest, known[enough], poses, (sizes, variance), MAX_SQUARED_MISFIT, cost)
        parts.append(np.stack([some[enough], cost], axis=1))
    return np.concatenate(parts)


def _costs_by_pose(
    track: Track, arm: robots.Arm, readings: Readings, offsets: Array, overlap: float
) -> Array:
    """The curve by poses, beside constant joint errors: for visits, and what few LEDs determine."""
    few = np.linspace(0, len(track) - 1, min(len(track), MAX_PAIRS_BY_POSE)).astype(int)
    sample = subset(track, np.unique(few))
    share = np.array([readings.available(sample.t - offset).mean() for offset in offsets])
    offsets, share = offsets[share >= overlap], share[share >= overlap]
    if len(offsets) > MAX_OFFSETS_BY_POSE:
        best = np.argsort(-share, kind="stable")
        even = np.linspace(0, len(offsets) - 1, MAX_OFFSETS_BY_POSE).astype(int)
        offsets = np.sort(offsets[best[:MAX_OFFSETS_BY_POSE] if are_visits(readings.t) else even])
    curve = []
    for offset in offsets if len(sample) >= 3 else ():
        comparison = compare(sample, arm, readings, offset)
        white = whiten(comparison)
        misfit = solve(white.rows(comparison.jacobian), white.rows(comparison.xi[:, :, None])[:, 0])
        curve.append((offset, misfit.chi2 / max(misfit.degrees_of_freedom, 1)))
    return np.array(curve).reshape(-1, 2)


def _motion_ends(track: Track) -> tuple[Index, Index]:
    """First and last pair of each motion that is compared."""
    full = np.flatnonzero(track.known_dof == 6)
    if len(full) < 3:
        return np.zeros(0, dtype=int), np.zeros(0, dtype=int)
    lag = max(round(MOTION_LAG / float(np.median(np.diff(track.t[full])))), 1)
    early, late = full[:-lag], full[lag:]
    if len(early) > MAX_MOTIONS:
        chosen = np.linspace(0, len(early) - 1, MAX_MOTIONS).astype(int)
        early, late = early[chosen], late[chosen]
    return early, late
