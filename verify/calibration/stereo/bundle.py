"""Bundle adjustment of both cameras, their bases, the board's bow and poses to corners' pixels.

Corner X of the board in pair b, in the camera of one side with pan reading p, is observed at

    x = project(K, k; camera_T_rig(p + e_b) rig_T_board_b X) + noise
    rig_T_camera(p) = Trans(pan_center) Rot(pan_axis, p + pan_zero) mount

Unknowns: 47 that all pairs share (table in `parameters`) and, behind them, each pair's own:

    0 - 2   position of the board             m     rig axes
    3 - 5   rotation about its own origin     rad   rig axes, on the left
    6, 7    pan errors e of left and right    rad   prior of variance 1 / precision
    8 - 10  motion from left to right         m     prior of variance 1 / precision, rig axes
    11 - 13 bend, added to the bow            m     prior of variance 1 / precision

Minimised is the sum of squared residuals in the corners' stated covariance, and of what is known
beforehand of pan readings and lenses, by Gauss-Newton steps
with Levenberg-Marquardt damping and analytic derivatives. Each board's own unknowns are eliminated
from its own corners (Schur complement), so the system to solve has the shared parameters only.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from verify.calibration.stereo import gauge, projection
from verify.calibration.stereo.gauge import AdjustmentModel
from verify.calibration.stereo.parameters import (
    BEND,
    BOW,
    MOTION,
    N_CAMERA_PARAMETERS,
    N_ERRORS,
    N_SHARED,
    PAR_AXIS,
    PAR_CENTER,
    PAR_FOCAL,
    PAR_LENS,
    PAR_OFFSET,
    PAR_PRINCIPAL,
    PAR_TURN,
    PAR_ZERO,
    BundleState,
    CornerStack,
    base_rotations,
    camera_columns,
    lens_values,
)
from verify.core.records import Array
from verify.core.rig import Camera, distort_with_jacobian

MAX_ITERATIONS = 60
TOL_COST = 1e-4  # chi² that a step still gains: a hundredth of an uncertainty
Index = NDArray[np.int64]
N_LOCAL = 6 + N_ERRORS  # a board's own unknowns: its pose, its errors
ERRORS = slice(6, N_LOCAL)
N_SEEN = N_CAMERA_PARAMETERS + 3  # shared parameters that move one camera's pixels
LOCAL_COLUMNS = slice(N_SEEN, N_SEEN + N_LOCAL)  # behind them


def predict(state: BundleState, corners: CornerStack) -> Array:
    """Predict the corners' pixels, (n, 2); NaN behind a camera."""
    pixels = np.full((len(corners), 2), np.nan)
    for side, camera in enumerate(state.cameras):
        own = np.flatnonzero(corners.camera == side)
        pixels[own] = _project(camera, _side_corners(camera, side, state, corners, own).point)
    return pixels


def _project(camera: Camera, point: Array) -> Array:
    """Pixels (n, 2) of points (3, n) in the camera's frame; NaN behind the camera."""
    ahead = point[2] > 0
    pixels = np.full((len(ahead), 2), np.nan)
    pixels[ahead] = camera.project(point.T[ahead])
    return pixels


@dataclass(frozen=True, slots=True)
class _CameraCorners:
    """The n corners of one camera, and that camera's pose at each of them."""

    point: Array  # (3, n), in the camera frame
    rig_R_camera: Array  # (3, 3, n)
    turned: Array  # (b, 3, 3), rig axes from turntable axes, of each board
    board: Index  # (n,)
    arm: Array  # (3, n), corner from the board's origin, rig axes
    normal: Array  # (3, n), into the board, rig axes
    modes: Array  # (3, n), of the bow
    from_camera: Array  # (3, n), corner from the optical centre, rig axes
    from_pan_center: Array  # (3, n), corner from the pan centre, rig axes


def _side_corners(
    camera: Camera, side: int, state: BundleState, corners: CornerStack, own: Index
) -> _CameraCorners:
    board = corners.board[own]
    turned = base_rotations(camera, corners.pan[:, side] + state.pan_error[:, side])
    centre = camera.pan_center + turned @ camera.mount[:3, 3]
    rig_R_camera = _per_corner(turned @ camera.mount[:3, :3], board)
    pose = _per_corner(state.boards[:, :3], board)
    modes = corners.modes[own].T
    x, y, z = corners.point[own].T
    z = z + np.einsum("ni,in->n", state.bow + state.errors[board, BEND], modes)
    arm = pose[:, 0] * x + pose[:, 1] * y + pose[:, 2] * z
    points_rig = arm + pose[:, 3] + side * state.errors[board, MOTION].T
    from_camera = points_rig - centre[board].T
    return _CameraCorners(
        point=_rows_times_matrices(from_camera, rig_R_camera),
        rig_R_camera=rig_R_camera,
        turned=turned,
        board=board,
        arm=arm,
        normal=pose[:, 2],
        modes=modes,
        from_camera=from_camera,
        from_pan_center=points_rig - camera.pan_center[:, None],
    )


def _per_corner(matrices: Array, board: Index) -> Array:
    """Matrices (b, i, j) of the boards as those of their corners, (i, j, n)."""
    return np.take(np.ascontiguousarray(matrices.transpose(1, 2, 0)), board, axis=2)


def _rows_times_matrices(rows: Array, matrices: Array) -> Array:
    """Rows (..., 3, n) by matrices (3, 3, n)."""
    one, two, three = (rows[..., i, None, :] * matrices[i] for i in range(3))
    product: Array = one + two + three
    return product


def _cross(vectors: Array, rows: Array) -> Array:
    """Cross products of vectors (3, n) with rows (2, 3, n)."""
    x, y, z = vectors
    u, v, w = rows[:, 0], rows[:, 1], rows[:, 2]
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)


def _seen(side: int) -> Index:
    """Shared parameters that move one camera's pixels."""
    return np.arange(N_SHARED)[np.r_[camera_columns(side), BOW]]


def _columns(camera: Camera, side: int, at: _CameraCorners) -> Array:
    """Derivatives by a camera, bow and the boards' own, (2, 40, n); the last column is empty."""
    depth, xy = at.point[2], at.point[:2] / at.point[2]
    x, y = xy
    distorted, by_xy = distort_with_jacobian(xy.T, camera.distortion)
    focal = camera.matrix[[0, 1], [0, 1]]
    by_inside = np.empty((2, 3, len(depth)))
    by_inside[:, :2] = by_xy.transpose(1, 2, 0) * focal[:, None, None] / depth
    by_inside[:, 2] = -(by_inside[:, 0] * x + by_inside[:, 1] * y)
    by_point = _rows_times_matrices(by_inside, at.rig_R_camera.transpose(1, 0, 2))
    columns = np.zeros((2, N_SEEN + N_LOCAL + 1, len(depth)))
    for axis in range(2):
        columns[axis, PAR_FOCAL.start + axis] = distorted[:, axis]
        columns[axis, PAR_PRINCIPAL.start + axis] = 1.0
    columns[:, PAR_LENS] = focal[:, None, None] * _lens_derivatives(x, y)
    turned = _per_corner(at.turned, at.board)
    # points move against the camera: a rotation u about o moves a point r from o by -(u × r)
    about_center = -_cross(at.from_pan_center, by_point)
    columns[:, PAR_CENTER] = -by_point
    columns[:, PAR_AXIS] = about_center - _rows_times_matrices(about_center, turned)
    columns[:, PAR_ZERO] = camera.pan_axis @ about_center
    columns[:, PAR_TURN] = -_rows_times_matrices(_cross(at.from_camera, by_point), turned)
    columns[:, PAR_OFFSET] = -_rows_times_matrices(by_point, turned)
    by_height = np.einsum("cin,in->cn", by_point, at.normal)
    bend = by_height[:, None] * at.modes
    columns[:, N_CAMERA_PARAMETERS:N_SEEN] = bend
    own = columns[:, LOCAL_COLUMNS]
    own[:, :3], own[:, 3:6] = by_point, _cross(at.arm, by_point)
    own[:, 6 + side] = columns[:, PAR_ZERO]
    if side:
        own[:, ERRORS][:, MOTION] = by_point
    own[:, ERRORS][:, BEND] = bend
    return columns


def _lens_derivatives(x: Array, y: Array) -> Array:
    """Derivative of `distort` by its five coefficients, (2, 5, n); the model is linear in them."""
    xx, yy, twice_xy = x * x, y * y, 2 * x * y
    r2 = xx + yy
    r4 = r2 * r2
    r6 = r4 * r2
    return np.array(
        [
            [x * r2, x * r4, twice_xy, r2 + 2 * xx, x * r6],
            [y * r2, y * r4, r2 + 2 * yy, twice_xy, y * r6],
        ]
    )


@dataclass(frozen=True, slots=True)
class NormalEquations:
    """The normal equations with the boards' own unknowns eliminated."""

    information: Array  # (b, 47, 47), on the shared parameters, from each board
    gradient: Array  # (b, 47), negative half gradient of the cost
    own: Array  # (b, 14, 14), inverse of each board's own information
    own_gradient: Array  # (b, 14)
    shared: Array  # (b, 14, 47), how a board's own optimum moves with the parameters, negated
    diagonal: Array  # (47,), of the information before the elimination
    lens: Array  # (47, 47), information on the lenses beforehand
    lens_gradient: Array  # (47,)

    @property
    def total(self) -> Array:
        """All information on the shared parameters, (47, 47)."""
        whole: Array = self.information.sum(axis=0) + self.lens
        return whole


def normal_equations(
    state: BundleState,
    corners: CornerStack,
    model: AdjustmentModel,
    weight: Array,
    damping: float = 0.0,
) -> NormalEquations:
    """Set up the normal equations at a state, for what the model says is free.

    The weight (n,) is of each corner beside its stated covariance, 0 leaves it out; `damping` is
    Marquardt's factor on the diagonal of the boards' own information.
    """
    count, width = len(state.boards), N_SHARED
    full, gradient = np.zeros((count, width, width)), np.zeros((count, width))
    prior, across = np.zeros(N_LOCAL), np.zeros((count, N_LOCAL, width))
    prior[ERRORS] = _finite(model.precision)
    block = np.tile(np.diag(prior), (count, 1, 1))
    pull = np.zeros((count, N_LOCAL))
    pull[:, ERRORS] = -prior[ERRORS] * state.errors
    for side in range(2):
        products = _products(side, state, corners, weight)
        mine = _seen(side)
        full[:, mine[:, None], mine] += products[:, :N_SEEN, :N_SEEN]
        across[:, :, mine] += products[:, LOCAL_COLUMNS, :N_SEEN]
        block += products[:, LOCAL_COLUMNS, LOCAL_COLUMNS]
        gradient[:, mine] += products[:, :N_SEEN, -1]
        pull += products[:, LOCAL_COLUMNS, -1]
    own = _invert_local(block, model, damping)
    shared = own @ across
    toward: Array = shared.transpose(0, 2, 1)
    lens = np.zeros((1, width)) if model.lens is None else model.lens
    return NormalEquations(
        information=full - across.transpose(0, 2, 1) @ shared,
        gradient=gradient - (toward @ pull[:, :, None])[:, :, 0],
        own=own,
        own_gradient=pull,
        shared=shared,
        diagonal=np.einsum("bii->i", full) + np.sum(lens**2, axis=0),
        lens=lens.T @ lens,
        lens_gradient=-lens.T @ (lens @ lens_values(state)),
    )


def _products(side: int, state: BundleState, corners: CornerStack, weight: Array) -> Array:
    """Products of one camera's whitened columns over each board's corners, (b, 40, 40).

    Columns: the camera's parameters (22), the bow (3), the board's own (14), the residual.
    """
    camera = state.cameras[side]
    rows = np.flatnonzero(corners.camera == side)
    at = _side_corners(camera, side, state, corners, rows)
    columns = _columns(camera, side, at)
    columns[:, -1] = (corners.observed[rows] - _project(camera, at.point)).T
    root = (corners.root[rows] * np.sqrt(weight[rows])[:, None, None]).transpose(1, 2, 0)
    first, second = (r[0] * columns[0] + r[1] * columns[1] for r in root)
    ends = np.searchsorted(corners.board[rows], np.arange(len(state.boards) + 1))
    products = np.empty((len(state.boards), len(first), len(first)))
    for b in range(len(state.boards)):
        x, y = (whitened[:, ends[b] : ends[b + 1]] for whitened in (first, second))
        products[b] = x @ x.T + y @ y.T
    return products


def _invert_local(block: Array, model: AdjustmentModel, damping: float) -> Array:
    """Invert the free part of each board's own information (b, 14, 14), damped; 0 elsewhere."""
    free = np.flatnonzero(np.concatenate([np.ones(6), np.isfinite(model.precision)]))
    inner = block[:, free[:, None], free]
    diagonal = np.arange(len(free))
    inner[:, diagonal, diagonal] *= 1 + damping
    inverse = np.zeros_like(block)
    inverse[:, free[:, None], free] = np.linalg.inv(inner)
    return inverse


def cost(state: BundleState, corners: CornerStack, model: AdjustmentModel, weight: Array) -> float:
    """Sum the weighted squares that the adjustment minimises; infinite behind a camera."""
    squares = _squares(state, corners)
    if np.isnan(squares[weight > 0]).any():
        return float("inf")
    total = float(weight @ np.nan_to_num(squares))
    total += float(np.sum(_finite(model.precision) * state.errors**2))
    if model.lens is not None:
        total += float(np.sum((model.lens @ lens_values(state)) ** 2))
    return total


def _finite(precision: Array) -> Array:
    return np.where(np.isfinite(precision), precision, 0.0)


def squared_distances(state: BundleState, corners: CornerStack) -> Array:
    """Squared residual of each corner in its stated covariance, (n,); 1e12 behind a camera."""
    return np.nan_to_num(_squares(state, corners), nan=1e12)


def _squares(state: BundleState, corners: CornerStack) -> Array:
    residual = corners.observed - predict(state, corners)
    squares: Array = np.sum(np.einsum("nij,nj->ni", corners.root, residual) ** 2, axis=1)
    return squares


def adjust(
    state: BundleState,
    corners: CornerStack,
    model: AdjustmentModel,
    weight: Array,
    iterations: int = MAX_ITERATIONS,
) -> BundleState:
    """Find the state of least squares by damped Gauss-Newton steps, always in the gauge.

    The weight (n,) is of each corner beside its stated covariance; 0 leaves it out.
    """
    pan = corners.pan[0]
    state = gauge.apply_gauge(state, model, pan)
    before, damping = cost(state, corners, model, weight), 1e-4
    for _ in range(iterations):
        trial, promised = _damped_step(state, corners, model, weight, damping)
        now = cost(trial, corners, model, weight)
        if now <= before:
            state, damping = trial, damping / 10
            if before - now < TOL_COST and promised < TOL_COST:
                break
            before = now
        else:
            if promised < TOL_COST:
                break
            damping *= 10
            if damping > 1e8:
                break
    return state


def _damped_step(
    state: BundleState, corners: CornerStack, model: AdjustmentModel, weight: Array, damping: float
) -> tuple[BundleState, float]:
    """Take one damped step; with it, by how much it should lower the cost to first order."""
    pan = corners.pan[0]
    system = normal_equations(state, corners, model, weight, damping)
    basis = gauge.free_directions(gauge.constraints(state, model, pan))
    matrix = basis.T @ (system.total + damping * np.diag(system.diagonal)) @ basis
    gradient = system.gradient.sum(axis=0) + system.lens_gradient
    pull = basis.T @ gradient
    scale = 1 / np.sqrt(np.diag(matrix))
    factor = cho_factor(matrix * np.outer(scale, scale) + 1e-14 * np.eye(len(matrix)))
    step = basis @ (scale * cho_solve(factor, scale * pull))
    own_step = np.einsum("bij,bj->bi", system.own, system.own_gradient) - system.shared @ step
    promised = float(gradient @ step) + float(
        np.einsum("bi,bij,bj->", system.own_gradient, system.own, system.own_gradient)
    )
    return gauge.apply_gauge(
        projection.step_state(state, corners, step, own_step), model, pan
    ), promised
