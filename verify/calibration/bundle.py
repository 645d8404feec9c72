"""One adjustment over all pairs: rig and board poses that make the seen corners most likely.

Gauss-Newton with Levenberg's damping; analytic derivatives. Each board's pose (and how far the
bases stood off their readings at that pair) is eliminated from its own corners alone, so that the
system to solve has the rig's parameters only (Schur complement).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.transform import Rotation

from verify.calibration import follow, gauge
from verify.calibration.gauge import FIXED, Model
from verify.calibration.parameters import (
    AXIS,
    CENTER,
    FOCAL,
    LENS,
    OFFSET,
    PRINCIPAL,
    TURN,
    WIDTH,
    ZERO,
    Corners,
    State,
)
from verify.records import Array
from verify.rig import Camera, distort, distortion_jacobian

ITERATIONS = 60
CONVERGED = 1e-4  # in chi²: a step promises no more, a hundredth of an uncertainty
Index = NDArray[np.int64]
LOCAL = 8  # a board's own unknowns: its pose (6), the two bases' departures from their readings


def predict(state: State, corners: Corners) -> Array:
    """Where the corners should be seen, (n, 2), px; NaN behind a camera."""
    pixels = np.full((len(corners), 2), np.nan)
    for side, camera in enumerate(state.cameras):
        own = np.flatnonzero(corners.camera == side)
        inside = _inside(camera, side, state, corners, own).point
        ahead = inside[:, 2] > 0
        pixels[own[ahead]] = camera.project(inside[ahead])
    return pixels


@dataclass(frozen=True, slots=True)
class _Inside:
    """The corners of one camera, and that camera at each of them."""

    point: Array  # (n, 3), in the camera frame
    rig_R_camera: Array  # (n, 3, 3)
    turned: Array  # (n, 3, 3), rig axes from turntable axes
    arm: Array  # (n, 3), corner from the board's origin, rig axes
    from_camera: Array  # (n, 3), corner from the optical centre, rig axes
    from_pan_center: Array  # (n, 3), likewise from the pan centre


def _inside(camera: Camera, side: int, state: State, corners: Corners, own: Index) -> _Inside:
    board = corners.board[own]
    angle = corners.pan[:, side] + state.pan_error[:, side] + camera.pan_zero
    turned = Rotation.from_rotvec(angle[:, None] * camera.pan_axis).as_matrix()
    rotation = turned @ camera.mount[:3, :3]
    centre = camera.pan_center + turned @ camera.mount[:3, 3]
    arm = np.einsum("nij,nj->ni", state.boards[board, :3, :3], corners.point[own])
    points_rig = arm + state.boards[board, :3, 3]
    from_camera = points_rig - centre[board]
    return _Inside(
        point=np.einsum("nji,nj->ni", rotation[board], from_camera),
        rig_R_camera=rotation[board],
        turned=turned[board],
        arm=arm,
        from_camera=from_camera,
        from_pan_center=points_rig - camera.pan_center,
    )


def derivatives(state: State, corners: Corners) -> tuple[Array, Array]:
    """How the predicted pixels change with the rig's parameters and with each board's own.

    Returns:
        (n, 2, 44), a SI unit (or pixel) of each of `parameters.NAMES`; (n, 2, 8), a step of the
        board's pose in rig axes (m, rad; a rotation about the board's origin) and of the two
        bases' departures from their readings (rad).
    """
    by_rig = np.zeros((len(corners), 2, 2 * WIDTH))
    by_board = np.zeros((len(corners), 2, LOCAL))
    for side, camera in enumerate(state.cameras):
        own = np.flatnonzero(corners.camera == side)
        at = _inside(camera, side, state, corners, own)
        columns, by_point = _camera_columns(camera, at)
        by_rig[own, :, side * WIDTH : (side + 1) * WIDTH] = columns
        by_board[own, :, :3] = by_point
        by_board[own, :, 3:6] = np.cross(at.arm[:, None], by_point)
        by_board[own, :, 6 + side] = columns[:, :, ZERO]
    return by_rig, by_board


def _camera_columns(camera: Camera, at: _Inside) -> tuple[Array, Array]:
    """Derivatives by the camera's parameters (n, 2, 22) and by the point in the rig (n, 2, 3)."""
    depth = at.point[:, 2:3]
    xy = at.point[:, :2] / depth
    focal = camera.matrix[[0, 1], [0, 1]]
    by_xy = focal[:, None] * distortion_jacobian(xy, camera.distortion)
    by_inside = np.concatenate([by_xy, -by_xy @ xy[:, :, None]], axis=2) / depth[:, :, None]
    by_point = by_inside @ at.rig_R_camera.transpose(0, 2, 1)
    columns = np.zeros((len(xy), 2, WIDTH))
    columns[:, :, FOCAL] = distort(xy, camera.distortion)[:, :, None] * np.eye(2)
    columns[:, :, PRINCIPAL] = np.eye(2)
    for i, one in enumerate(np.eye(5)):  # the model is linear in its coefficients
        columns[:, :, LENS.start + i] = focal * (distort(xy, one) - xy)
    # the world moves against the camera: a turn u about o takes a point r off o by -(u × r)
    about_center = -np.cross(at.from_pan_center[:, None], by_point)
    columns[:, :, CENTER] = -by_point
    columns[:, :, AXIS] = about_center @ (np.eye(3) - at.turned)
    columns[:, :, ZERO] = about_center @ camera.pan_axis
    columns[:, :, TURN] = -np.cross(at.from_camera[:, None], by_point) @ at.turned
    columns[:, :, OFFSET] = -by_point @ at.turned
    return columns, by_point


@dataclass(frozen=True, slots=True)
class Normal:
    """The normal equations with the boards' own unknowns eliminated."""

    information: Array  # (b, 44, 44), what each board says of the rig's parameters
    gradient: Array  # (b, 44), towards a better fit
    own: Array  # (b, 8, 8), inverse of each board's own information
    own_gradient: Array  # (b, 8)
    shared: Array  # (b, 8, 44), how a board's own optimum moves with the parameters, negated
    diagonal: Array  # (44,), of the information before the elimination


def normal(
    state: State, corners: Corners, model: Model, weight: Array, damping: float = 0.0
) -> Normal:
    """Set up the normal equations at a state.

    Args:
        state: where to linearise.
        corners: what was seen.
        model: what is free; the boards' own unknowns are taken from it.
        weight: (n,), of each corner beside its stated covariance; 0 leaves it out.
        damping: Marquardt's factor on the diagonal of the boards' own information.
    """
    count = len(state.boards)
    by_rig, by_board = derivatives(state, corners)
    root = corners.root * np.sqrt(weight)[:, None, None]
    residual = np.einsum("nij,nj->ni", root, corners.seen - predict(state, corners)).ravel()
    rows = (root @ by_rig).reshape(-1, 2 * WIDTH)
    own_rows = (root @ by_board).reshape(-1, LOCAL)
    free = _own_free(model)
    prior = _own_prior(model)
    ends = 2 * np.searchsorted(corners.board, np.arange(count + 1))
    width = 2 * WIDTH
    information, gradient = np.zeros((count, width, width)), np.zeros((count, width))
    own, own_gradient = np.zeros((count, LOCAL, LOCAL)), np.zeros((count, LOCAL))
    shared, diagonal = np.zeros((count, LOCAL, width)), np.zeros(width)
    for b in range(count):
        part = slice(ends[b], ends[b + 1])
        g, a, r = rows[part], own_rows[part], residual[part]
        block = a.T @ a + np.diag(prior)
        pull = a.T @ r - prior * np.concatenate([np.zeros(6), state.pan_error[b]])
        inner = block[np.ix_(free, free)]
        inner = inner + damping * np.diag(np.diag(inner))
        inverse = np.zeros((LOCAL, LOCAL))
        inverse[np.ix_(free, free)] = np.linalg.inv(inner)
        across = a.T @ g
        own[b], own_gradient[b] = inverse, pull
        shared[b] = inverse @ across
        full = g.T @ g
        diagonal += np.diag(full)
        information[b] = full - across.T @ shared[b]
        gradient[b] = g.T @ r - shared[b].T @ pull
    return Normal(information, gradient, own, own_gradient, shared, diagonal)


def _own_free(model: Model) -> Index:
    turns = [model.pan_errors and base != FIXED for base in model.bases]
    return np.flatnonzero(np.concatenate([np.ones(6, dtype=bool), turns]))


def _own_prior(model: Model) -> Array:
    prior = np.zeros(LOCAL)
    if model.pan_errors:
        prior[6:] = model.pan_precision
    return prior


def cost(state: State, corners: Corners, model: Model, weight: Array) -> float:
    """Sum of squares that the adjustment makes small; infinite behind a camera."""
    whitened = np.einsum("nij,nj->ni", corners.root, corners.seen - predict(state, corners))
    squares = np.sum(whitened**2, axis=1)
    if np.isnan(squares[weight > 0]).any():
        return float("inf")
    total = float(weight @ np.nan_to_num(squares))
    if model.pan_errors:
        total += model.pan_precision * float(np.sum(state.pan_error**2))
    return total


def distances(state: State, corners: Corners) -> Array:
    """Squared distance of each corner from where it should be, in its stated covariance, (n,)."""
    whitened = np.einsum("nij,nj->ni", corners.root, corners.seen - predict(state, corners))
    squares: Array = np.nan_to_num(np.sum(whitened**2, axis=1), nan=1e12)
    return squares


def adjust(
    state: State,
    corners: Corners,
    model: Model,
    weight: Array,
    iterations: int = ITERATIONS,
) -> State:
    """Find the state of least squares by damped Gauss-Newton steps, in the gauge throughout."""
    pan = corners.pan[0]
    state = gauge.settle(state, model, pan)
    here, damping = cost(state, corners, model, weight), 1e-4
    for _ in range(iterations):
        trial, promised = _stepped(state, corners, model, weight, damping)
        there = cost(trial, corners, model, weight)
        if there <= here:
            state, damping = trial, damping / 10
            if here - there < CONVERGED and promised < CONVERGED:
                break
            here = there
        else:
            if promised < CONVERGED:
                break
            damping *= 10
            if damping > 1e8:
                break
    return state


def _stepped(
    state: State, corners: Corners, model: Model, weight: Array, damping: float
) -> tuple[State, float]:
    """One damped step, and by how much it should lower the cost."""
    pan = corners.pan[0]
    system = normal(state, corners, model, weight, damping)
    basis = gauge.free_directions(gauge.constraints(state, model, pan)[0])
    matrix = basis.T @ (system.information.sum(axis=0) + damping * np.diag(system.diagonal)) @ basis
    pull = basis.T @ system.gradient.sum(axis=0)
    scale = 1 / np.sqrt(np.diag(matrix))
    factor = cho_factor(matrix * np.outer(scale, scale) + 1e-14 * np.eye(len(matrix)))
    step = basis @ (scale * cho_solve(factor, scale * pull))
    own_step = np.einsum("bij,bj->bi", system.own, system.own_gradient) - system.shared @ step
    promised = float(system.gradient.sum(axis=0) @ step) + float(
        np.einsum("bi,bij,bj->", system.own_gradient, system.own, system.own_gradient)
    )
    return gauge.settle(follow.step(state, corners, step, own_step), model, pan), promised
