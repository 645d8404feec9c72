"""The offset between the controller's clock and the cameras', from the motion itself.

First coarsely, by what no registration can disturb: the angle and the distance that the flange
moves from pair to pair, seen and read. Then finely, by the poses, together with a constant error
of every joint, so that an encoder's offset does not pass for a clock's.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import robots
from verify.analysis.comparison import Comparison, compare
from verify.analysis.kernels import motion_misfits, motion_sizes
from verify.analysis.least_squares import autocorrelation, solve, whiten
from verify.core.readings import MAX_GAP, Readings
from verify.core.records import Array
from verify.measurement.track import Track, subset

MAX_PAIRS = 400  # enough to find the offset coarsely; more only cost time
COARSE_STEP = 0.02  # s; brisk joints turn half a degree in it
MAX_INSTANTS = 100_000  # that are looked up at a time: a few megabytes
MAX_SQUARED_MISFIT = 100.0  # a squared misfit, beyond which a pair has one vote
MAX_PAIRS_BY_POSE = 40  # where each offset costs a comparison
COARSE_STEP_BY_POSE = 0.05  # s, likewise: the fine search converges from further off
MAX_OFFSETS = 400
MIN_OVERLAP = 0.5  # of the pairs must have a reading at an offset that is tried
# Angle and distance errors that a wrong rig or table leaves in a relative motion, so that the
# search is not ruled by pairs that happen to be exact: rad, m.
MODEL_ERROR = (1e-3, 5e-4)
MAX_ITERATIONS = 30
TOL_OFFSET = 1e-7  # s
# An offset that the motion shows no better than this is no offset: the arm moves 0.3° at 30°/s.
MAX_UNCERTAINTY = 0.01  # s
# of the clock's effect must be left after joint offsets are fitted; less is rounding and noise
MIN_VISIBLE_SHARE = 0.02
# the same from the readings' noise alone, at rest, is 1 with a spread of a few percent
MIN_SIGNAL_TO_NOISE = 4.0


@dataclass(frozen=True, slots=True)
class ClockEstimate:
    """What to add to the readings' time, and how well it is known."""

    offset: float  # s; 0 where the motion does not show it
    standard_uncertainty: float | None  # s; None: taken as exact, or not known
    source: str  # given, estimated, not_observable
    curve: Array  # (m, 2): offset s, cost a pair
    rivals: tuple[float, ...] = ()  # s, other offsets at which a periodic motion fits as well


def estimate_clock(track: Track, arm: robots.Arm, readings: Readings) -> ClockEstimate:
    """Find the offset from the motion.

    Returns:
        The offset with its standard uncertainty, or source `not_observable` where the motion
        (at rest, or at constant speed) cannot show it.
    """
    offsets, cost = _coarse_costs(track, arm, readings)
    if not len(offsets):
        offsets, cost = _coarse_costs_by_pose(track, arm, readings)
    if not len(offsets):
        return ClockEstimate(0.0, None, "not_observable", np.zeros((0, 2)))
    curve = np.stack([offsets, cost], axis=1)
    offset, rivals = _choose(track, readings, offsets, cost)
    fine = _fine_offset(track, arm, readings, offset)
    if fine is None:
        at_rest = 0.0 if _has_overlap(track, readings, 0.0) else offset
        return ClockEstimate(at_rest, None, "not_observable", curve)
    return ClockEstimate(fine[0], fine[1], "estimated", curve, rivals)


def _choose(
    track: Track, readings: Readings, offsets: Array, cost: Array
) -> tuple[float, tuple[float, ...]]:
    """The best offset; of several as good (a periodic motion) the one with most readings."""
    lowest = float(cost.min())
    noise = 3 * np.sqrt(2 / len(track)) * max(lowest, 1.0)  # of a mean of squares, three sigma
    padded = np.concatenate([[np.inf], cost, [np.inf]])
    minima = (padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:])
    good = offsets[minima & (cost <= lowest + noise)]
    apart = [float(good[0])]
    for offset in good[1:]:
        if offset - apart[-1] > 10 * COARSE_STEP:  # nearer minima are one, roughened by noise
            apart.append(float(offset))
    if len(apart) == 1:
        return float(offsets[np.argmin(cost)]), ()
    best = max(
        apart, key=lambda o: (round(float(readings.available(track.t - o).mean()), 2), -abs(o))
    )
    near = np.abs(offsets - best) <= 10 * COARSE_STEP
    best = float(offsets[near][np.argmin(cost[near])])
    return best, tuple(o for o in apart if abs(o - best) > 10 * COARSE_STEP)


def _has_overlap(track: Track, readings: Readings, offset: float) -> bool:
    return bool(readings.available(track.t - offset).mean() >= MIN_OVERLAP)


def _coarse_costs(track: Track, arm: robots.Arm, readings: Readings) -> tuple[Array, Array]:
    """Cost of every offset that gives enough pairs a reading; (m,) and (m,)."""
    early, late = _pair_partners(track)
    if not len(early):
        return np.zeros(0), np.zeros(0)
    seen = np.empty((len(early), 2))
    motion_sizes(track.base_T_flange[early], track.base_T_flange[late], seen)
    variance = np.square(MODEL_ERROR) + _invariant_variance(track, early, late)
    lowest, highest = _span(track, readings)
    count = max(int(np.ceil((highest - lowest) / COARSE_STEP)), 1) + 1
    # poses along the whole log once; every offset then only looks them up
    grid_t = _grid(readings)
    grid = grid_t, robots.forward(arm, readings.at(grid_t))
    ends = np.stack([track.t[early], track.t[late]])
    offsets, cost = [], []
    every = np.linspace(lowest, highest, count)
    for some in np.array_split(every, -(-count * len(early) // MAX_INSTANTS)):
        instants = ends - some[:, None, None]
        told = readings.available(instants.reshape(-1)).reshape(instants.shape)
        known = told[:, 0] & told[:, 1]
        enough = known.mean(axis=1) >= MIN_OVERLAP
        found = np.empty(int(enough.sum()))
        motion_misfits(
            instants[enough],
            known[enough],
            grid,
            COARSE_STEP,
            (seen, variance),
            MAX_SQUARED_MISFIT,
            found,
        )
        offsets.append(some[enough])
        cost.append(found)
    return np.concatenate(offsets), np.concatenate(cost)


def _coarse_costs_by_pose(track: Track, arm: robots.Arm, readings: Readings) -> tuple[Array, Array]:
    """The same from what few LEDs determine: misfit of the poses beside constant joint errors."""
    few = np.linspace(0, len(track) - 1, min(len(track), MAX_PAIRS_BY_POSE)).astype(int)
    sample = subset(track, np.unique(few))
    lowest, highest = _span(track, readings)
    count = min(max(int(np.ceil((highest - lowest) / COARSE_STEP_BY_POSE)), 1), MAX_OFFSETS) + 1
    offsets, cost = [], []
    for offset in np.linspace(lowest, highest, count):
        if len(sample) < 3 or readings.available(sample.t - offset).mean() < MIN_OVERLAP:
            continue
        comparison = compare(sample, arm, readings, offset)
        white = whiten(comparison)
        misfit = solve(white.rows(comparison.jacobian), white.rows(comparison.xi[:, :, None])[:, 0])
        offsets.append(offset)
        cost.append(misfit.chi2 / max(misfit.degrees_of_freedom, 1))
    return np.array(offsets), np.array(cost)


def _span(track: Track, readings: Readings) -> tuple[float, float]:
    """Offsets at which half the pairs' span can have readings."""
    half = 0.5 * float(track.t[-1] - track.t[0])
    lowest = float(track.t[-1] - readings.t[-1]) - half
    highest = float(track.t[0] - readings.t[0]) + half
    return lowest, highest


def _grid(readings: Readings) -> Array:
    """Instants COARSE_STEP apart wherever there are readings, (g,) s."""
    ends = np.flatnonzero(np.diff(readings.t) > MAX_GAP)
    starts = np.concatenate([[0], ends + 1])
    stops = np.concatenate([ends, [len(readings.t) - 1]])
    bursts = [
        np.arange(readings.t[a], readings.t[b] + COARSE_STEP, COARSE_STEP)
        for a, b in zip(starts, stops, strict=True)
    ]
    return np.concatenate(bursts)


def _pair_partners(track: Track) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which pairs to take the relative motion between: some tenths of a second apart."""
    full = np.flatnonzero(track.known_dof == 6)
    if len(full) < 3:
        return np.zeros(0, dtype=int), np.zeros(0, dtype=int)
    typical = float(np.median(np.diff(track.t[full])))
    lag = max(round(0.3 / typical), 1)  # noise falls, motion grows with the lag
    early, late = full[:-lag], full[lag:]
    if len(early) > MAX_PAIRS:
        chosen = np.linspace(0, len(early) - 1, MAX_PAIRS).astype(int)
        early, late = early[chosen], late[chosen]
    return early, late


def _invariant_variance(track: Track, early: NDArray[np.int64], late: NDArray[np.int64]) -> Array:
    trace = [
        np.trace(track.covariance_pixels[:, block, block], axis1=1, axis2=2) / 3
        for block in (slice(3, 6), slice(0, 3))
    ]
    return np.stack([v[early] + v[late] for v in trace], axis=1)


def _fine_offset(
    track: Track, arm: robots.Arm, readings: Readings, offset: float
) -> tuple[float, float] | None:
    """Newton on the offset with a constant error of every joint fitted beside it."""
    for _ in range(MAX_ITERATIONS):
        comparison = compare(track, arm, readings, offset)
        if len(comparison) < 3:
            return None
        solved = _step(comparison)
        if solved is None:
            return None
        step, uncertainty = solved
        offset += float(np.clip(step, -0.1, 0.1))  # readings are not linear over longer times
        if abs(step) < TOL_OFFSET:
            break
    return (offset, uncertainty) if uncertainty < MAX_UNCERTAINTY else None


def _step(comparison: Comparison) -> tuple[float, float] | None:
    """Correction of the offset and its standard uncertainty, or None where nothing shows it."""
    # a later clock reads the joints where they were earlier: d xi / d offset = - J rate
    effect = -np.einsum("nij,nj->ni", comparison.jacobian, comparison.rate)[:, :, None]
    white = whiten(comparison)
    rows, joints = white.rows(effect)[:, 0], white.rows(comparison.jacobian)
    xi = white.rows(comparison.xi[:, :, None])[:, 0]
    basis = np.linalg.svd(joints, full_matrices=False)
    basis_u = basis[0][:, basis[1] > 1e-9 * basis[1][0]]
    left = rows - basis_u @ (basis_u.T @ rows)
    size = float(np.linalg.norm(left))
    by_noise = float(np.sum(joints**2, axis=0) @ comparison.rate_variance)
    if size**2 <= MIN_SIGNAL_TO_NOISE * by_noise or size < MIN_VISIBLE_SHARE * np.linalg.norm(rows):
        return None
    step = -float(left @ xi) / size**2
    residual = xi - basis_u @ (basis_u.T @ xi) + left * step
    degrees = max(len(xi) - basis_u.shape[1] - 1, 1)
    misfit = max(float(residual @ residual) / degrees, 1.0)  # what offsets alone do not explain
    factor = float(autocorrelation(white.by_pair(residual)).max())
    return step, float(np.sqrt(misfit * factor)) / size
