"""One joint's fixed axis and what its encoder makes of the turn about it, fitted together.

All points of the flange run on circles about one line. That line, the flange's pose at the start
and a curve of the encoder's error over the angle are fitted to the measured poses; no base, no LED
place and no table of the arm enters, as each only says in which frame the line lies.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robots.transforms import difference, rotation_exp, rotation_log
from verify.records import Array
from verify.regression import Fit, autocorrelation, solve

FREE = 10  # a line's four parameters and a start pose's six
ITERATIONS = 12
CONVERGED = 1e-10  # m and rad: far below what poses are known to


@dataclass(frozen=True, slots=True)
class Swept:
    """What is known of a sweep's n pairs; arrays a pair."""

    poses: Array  # (n, 4, 4), measured flange in any one frame
    covariance: Array  # (n, 6, 6), of the poses, m and rad, perturbation on the left
    held: Array  # (n, 6, p), columns of unit variance: what is stated and does not average out
    q: Array  # (n,), rad, reading
    reading_variance: Array  # (n,), rad²


@dataclass(frozen=True, slots=True)
class AxisFit:
    """A sweep fitted; k terms of the encoder's error."""

    direction: Array  # (3,), unit vector along which the joint's angle grows
    point: Array  # (3,), m, on the axis
    value: Array  # (k,), of the terms
    covariance: Array  # (k, k)
    estimable: NDArray[np.bool_]  # (k,)
    turned: Array  # (n,), rad, the fitted angle about the axis, zero as the reading's
    angle_left: Array  # (n,), rad, measured angle less fitted
    angle_variance: Array  # (n,), rad², of that, the reading's own included
    rest: Array  # (n, 6), m and rad, what no turn about the axis explains
    chi2_angle: float  # of what is left of the angles
    chi2_rest: float


def fit_axis(swept: Swept, terms: Array) -> AxisFit:
    """Fit axis, start pose and the encoder's error together.

    Args:
        swept: the pairs.
        terms: (n, k), what a unit of each term adds to the reading.

    Returns:
        The fit; its covariance holds what is stated of the poses, and pairs that repeat each
        other's errors count for fewer.
    """
    state = _start(swept)
    value = np.zeros(terms.shape[1])
    inflation = np.ones(6)
    for last in (False, True):
        state, value, fit, rows = _settled(swept, terms, state, value, inflation)
        if not last:
            inflation = autocorrelation(rows)
    return _worded(swept, terms, state, value, fit)


@dataclass(frozen=True, slots=True)
class _State:
    direction: Array
    point: Array
    start: Array  # (4, 4), the flange where the reading is at its middle


def _start(swept: Swept) -> _State:
    """The mean axis of the turns from pair to pair, and the line that they leave in place."""
    order = np.argsort(swept.q, kind="stable")
    poses, q = swept.poses[order], swept.q[order]
    middle = (q[0] + q[-1]) / 2
    half = len(q) // 2  # turns over half of the sweep: far above noise, below half a turn
    late, early = np.arange(half, len(q)), np.arange(len(q) - half)
    turn = rotation_log(poses[late, :3, :3] @ np.swapaxes(poses[early, :3, :3], 1, 2))
    direction = (q[late] - q[early]) @ turn
    direction = direction / np.linalg.norm(direction)
    first = int(np.argmin(np.abs(q - middle)))
    back = rotation_exp((q - q[first])[:, None] * direction)
    left = (np.eye(3) - back).reshape(-1, 3)
    shift = poses[:, :3, 3] - poses[first, :3, 3]
    arm = np.linalg.lstsq(left, shift.reshape(-1), rcond=1e-6)[0]
    point = poses[first, :3, 3] + arm - direction * (direction @ arm)
    start = poses[first].copy()
    home = rotation_exp(direction * (middle - q[first]))
    start[:3, :3] = home @ start[:3, :3]
    start[:3, 3] = point + home @ (start[:3, 3] - point)
    return _State(direction, point, start)


def _settled(
    swept: Swept, terms: Array, state: _State, value: Array, inflation: Array
) -> tuple[_State, Array, Fit, Array]:
    """Gauss-Newton from a state on; also the whitened residuals, (n, 6)."""
    for _ in range(ITERATIONS):
        fitted, motion = _predicted(swept, terms, state, value)
        white = _whitening(swept, motion, inflation)
        design = np.concatenate(
            [_design(state, fitted, swept, terms, value), -motion[:, :, None] * terms[:, None, :]],
            axis=2,
        )
        residual = difference(swept.poses, fitted)
        rows = (white @ design).reshape(-1, design.shape[2])
        wanted = (white @ residual[:, :, None]).reshape(-1)
        held = (white @ swept.held).reshape(len(rows), -1)
        fit = solve(rows, wanted, held)
        state, value = _moved(state, fit.value[:FREE]), value + fit.value[FREE:]
        if np.abs(fit.value).max() < CONVERGED:
            break
    left = wanted - rows @ fit.value - held @ fit.held
    return state, value, fit, left.reshape(-1, 6)


def _angle(swept: Swept, terms: Array, value: Array) -> Array:
    """Turn about the axis from where the reading is at its middle, (n,), rad."""
    middle = (swept.q.min() + swept.q.max()) / 2
    angle: Array = swept.q - middle - terms @ value
    return angle


def _predicted(swept: Swept, terms: Array, state: _State, value: Array) -> tuple[Array, Array]:
    """Poses (n, 4, 4), and how each moves with a turn about the axis, (n, 6)."""
    turn = rotation_exp(_angle(swept, terms, value)[:, None] * state.direction)
    fitted = np.tile(np.eye(4), (len(turn), 1, 1))
    fitted[:, :3, :3] = turn @ state.start[:3, :3]
    fitted[:, :3, 3] = state.point + turn @ (state.start[:3, 3] - state.point)
    arm = fitted[:, :3, 3] - state.point
    direction = np.tile(state.direction, (len(turn), 1))
    return fitted, np.concatenate([np.cross(state.direction, arm), direction], axis=1)


def _whitening(swept: Swept, motion: Array, inflation: Array) -> Array:
    """Whitening of the poses and of the reading that says where they should be, (n, 6, 6)."""
    moved = motion * np.sqrt(swept.reading_variance)[:, None]
    lower = np.linalg.cholesky(swept.covariance + moved[:, :, None] * moved[:, None, :])
    return np.linalg.inv(lower * np.sqrt(inflation))


def _across(direction: Array) -> Array:
    """Two unit vectors at right angles to a direction and to each other, (2, 3)."""
    return np.asarray(np.linalg.svd(direction[None])[2][1:], dtype=np.float64)


def _design(state: _State, fitted: Array, swept: Swept, terms: Array, value: Array) -> Array:
    """Derivative of the poses by line and start pose, (n, 6, 10)."""
    turn = rotation_exp(_angle(swept, terms, value)[:, None] * state.direction)
    arm = fitted[:, :3, 3] - state.point
    design = np.zeros((len(turn), 6, FREE))
    for i, v in enumerate(_across(state.direction)):
        tilt = np.cross(state.direction, v)  # turns the direction towards v
        moved = tilt - turn @ tilt
        design[:, :3, i] = np.cross(moved, arm)
        design[:, 3:, i] = moved
        design[:, :3, 2 + i] = v - turn @ v
    design[:, :3, 4:7] = turn
    design[:, 3:, 7:10] = turn
    return design


def _moved(state: _State, step: Array) -> _State:
    across = _across(state.direction)
    direction = state.direction + step[:2] @ across
    start = state.start.copy()
    start[:3, 3] += step[4:7]
    start[:3, :3] = rotation_exp(step[7:10]) @ start[:3, :3]
    return _State(direction / np.linalg.norm(direction), state.point + step[2:4] @ across, start)


def _worded(swept: Swept, terms: Array, state: _State, value: Array, fit: Fit) -> AxisFit:
    """Split what is left into turns about the axis and the rest."""
    fitted, motion = _predicted(swept, terms, state, value)
    left = difference(swept.poses, fitted) - swept.held @ fit.held
    weighted = np.linalg.solve(swept.covariance, motion[:, :, None])[:, :, 0]
    information = np.sum(motion * weighted, axis=1)
    angle = np.sum(weighted * left, axis=1) / information
    variance = 1 / information + swept.reading_variance
    rest = left - motion * angle[:, None]
    chi2_rest = np.sum(rest * np.linalg.solve(swept.covariance, rest[:, :, None])[:, :, 0])
    middle = (swept.q.min() + swept.q.max()) / 2
    return AxisFit(
        direction=state.direction,
        point=state.point,
        value=value,
        covariance=fit.covariance[FREE:, FREE:],
        estimable=fit.estimable[FREE:],
        turned=_angle(swept, terms, value) + middle,
        angle_left=angle,
        angle_variance=variance,
        rest=rest,
        chi2_angle=float(np.sum(angle**2 / variance)),
        chi2_rest=float(chi2_rest),
    )
