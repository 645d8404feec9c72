"""Start values of a registration in closed form: the clock offset, then base and LED body.

    angle(R_body(t_i), R_body(t_j)) = angle(R_flange(t_i - c), R_flange(t_j - c))    c: clock, s
    rig_T_body_i X = Y base_T_flange_i         X: body_T_flange, Y: rig_T_base (each 3 m + 3 rad)

The angle between two poses of one body is the same in every frame, so c is found before anything is
registered, on a grid, by the least mean squared angle. Base and body follow by `handeye`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

import robots
from robots.transforms import difference, invert
from verify.calibration.handeye import MIN_POSES, HandEye, nearest_rotation, solve_robustly
from verify.core.readings import Readings
from verify.core.records import Array, Flags, Index

TIME_STEP = 0.02  # s; brisk joints turn half a degree in it
MAX_PAIR_DISTANCE = 8  # pairs that angles are taken over: 1, 2, 4, …
MAX_ANGLES = 800  # enough to find the clock coarsely; more only cost time
MODEL_ERROR = np.deg2rad(0.1)  # of an angle between two poses, by joints and lenses not perfect
MAX_SQUARED_MISFIT = 100.0  # a wild pair has one vote
MIN_OVERLAP = 0.5  # of the pairs must have a reading at an offset that is tried
MIN_SEPARATION = 10 * TIME_STEP  # nearer minima are one, roughened by noise
MAX_OFFSETS = 8  # offsets that are compared by the whole registration
MAX_MISFIT_RATIO = 1.3  # of the best misfit: within it offsets fit equally well
MAX_RESIDUAL_RATIO = 6.0  # times the median residual: a pose of spots confused

Rotations = Callable[[Array], Array]  # instants (m,) to rotations (m, 3, 3)


@dataclass(frozen=True, slots=True)
class RegistrationStart:
    """Where the adjustment begins."""

    clock: float  # s
    rivals: tuple[float, ...]  # s, other offsets that fit as well
    solved: HandEye  # x: body_T_flange, y: rig_T_base; residuals of all n poses, nan: no reading
    good: Flags  # (n,), poses that it rests on


def start_registration(
    t: Array,
    rig_T_body: Array,
    arm: robots.Arm,
    readings: Readings,
    given: float | None,
    *,
    x: Array | None = None,
    y: Array | None = None,
) -> RegistrationStart:
    """Find clock, base and body by rig_T_body (n, 4, 4), m, at t (n,), s, on the cameras' clock.

    Readings are on the controller's clock; `given`, s, is the clock offset where session.toml tells
    it, x body_T_flange and y rig_T_base where they are known, (4, 4).

    Raises:
        ValueError: fewer than three poses have a reading.
    """

    def turns(instants: Array) -> Array:
        return robots.forward(arm, readings.at(instants))[:, :3, :3]

    measured = rig_T_body[:, :3, :3]
    tried = clock_candidates(t, measured, readings, turns) if given is None else [given]
    starts = []
    for offset in tried or [0.0]:
        known = readings.available(t - offset)
        poses = robots.forward(arm, readings.at((t - offset)[known]))
        if x is None and y is None:
            solved, rests = solve_robustly(rig_T_body[known], poses, MAX_RESIDUAL_RATIO)
        else:
            solved = _solve_loop(rig_T_body[known], poses, x, y)
            rests = np.ones(len(poses), dtype=bool)
        good = np.zeros(len(t), dtype=bool)
        good[np.flatnonzero(known)[rests]] = True
        residual = np.full((len(t), 6), np.nan)
        residual[known] = solved.residual
        whole = replace(solved, residual=residual)
        starts.append((_misfit(solved), RegistrationStart(offset, (), whole, good)))
    least = min(misfit for misfit, _ in starts)
    close = [s for misfit, s in starts if misfit <= MAX_MISFIT_RATIO * least]
    best = max(close, key=lambda s: (round(float(s.good.mean()), 2), -abs(s.clock)))
    rivals = tuple(s.clock for s in close if s is not best)
    return RegistrationStart(best.clock, rivals, best.solved, best.good)


def _solve_loop(a: Array, b: Array, x: Array | None, y: Array | None) -> HandEye:
    """Solve A X = Y B for the one that is not known, by the mean over the poses."""
    if len(a) < MIN_POSES:
        raise ValueError(f"needs {MIN_POSES} poses or more; got {len(a)}")
    if x is not None:
        y = mean_motion(a @ x @ invert(b))
    elif y is not None:
        x = mean_motion(invert(a) @ y @ b)
    else:
        raise ValueError("one of the two has to be known")
    return HandEye(x, y, difference(a @ x, y @ b), mirrored=False)


def mean_motion(motions: Array) -> Array:
    """The mean of rigid motions (n, 4, 4): of the places, and the rotation nearest to the mean."""
    mean: Array = motions.mean(axis=0)
    mean[:3, :3] = nearest_rotation(mean[:3, :3])
    return mean


def _misfit(solved: HandEye) -> float:
    """Median residual, a tenth of a radian counting like 10 mm."""
    place, turn = (np.linalg.norm(p, axis=1) for p in np.split(solved.residual, 2, axis=1))
    return float(np.median(place) + 0.1 * np.median(turn))


def clock_candidates(
    t: Array, measured: Array, readings: Readings, turns: Rotations
) -> list[float]:
    """Find clock offsets at which the readings turn by the angles that the images show.

    `measured` holds rotations (n, 3, 3) in any one frame at t (n,), s, on the cameras' clock;
    `turns` the same by the readings (controller's clock), in any other frame. Returns offsets, best
    first, at most eight, to within 20 ms; none where no offset gives half of the pairs a reading.
    """
    early, late = _angle_pairs(len(t))
    angle = _angles(measured[early], measured[late])
    grid = readings.instants(TIME_STEP)
    read = turns(grid)
    half = 0.5 * float(t[-1] - t[0])
    lowest, highest = float(t[-1] - readings.t[-1]) - half, float(t[0] - readings.t[0]) + half
    offsets = np.arange(lowest, highest + TIME_STEP, TIME_STEP)
    cost = np.full(len(offsets), np.inf)
    for i, offset in enumerate(offsets):
        known = readings.available(t - offset)
        both = known[early] & known[late]
        if known.mean() < MIN_OVERLAP or not both.any():
            continue
        at = np.clip(np.searchsorted(grid, t - offset - TIME_STEP / 2), 0, len(grid) - 1)
        misfit = (_angles(read[at[early[both]]], read[at[late[both]]]) - angle[both]) ** 2
        cost[i] = np.mean(np.minimum(misfit / MODEL_ERROR**2, MAX_SQUARED_MISFIT))
    return _minima(offsets, cost)


def _minima(offsets: Array, cost: Array) -> list[float]:
    kept: list[float] = []
    for i in np.argsort(cost, kind="stable").tolist():
        if not np.isfinite(cost[i]) or len(kept) == MAX_OFFSETS:
            break
        if all(abs(offsets[i] - k) > MIN_SEPARATION for k in kept):
            kept.append(float(offsets[i]))
    return kept


def _angle_pairs(n: int) -> tuple[Index, Index]:
    """Which pairs to take the angle between."""
    lags = [lag for lag in (1, 2, 4, MAX_PAIR_DISTANCE) if lag < n]
    early = np.concatenate([np.arange(n - lag) for lag in lags])
    late = np.concatenate([np.arange(lag, n) for lag in lags])
    if len(early) > MAX_ANGLES:
        some = np.linspace(0, len(early) - 1, MAX_ANGLES).astype(int)
        early, late = early[some], late[some]
    return early, late


def _angles(one: Array, other: Array) -> Array:
    """Angles between rotations, (n,), rad: the Frobenius norm is sqrt(8) sin(angle / 2)."""
    apart = np.sqrt(np.sum((one - other) ** 2, axis=(1, 2)) / 8)
    return np.asarray(2 * np.arcsin(np.minimum(apart, 1.0)))
