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
beforehand of pan readings, lenses and bases, by Gauss-Newton steps
with Levenberg-Marquardt damping and analytic derivatives. Each board's own unknowns are eliminated
from its own corners (Schur complement), so the system to solve has the shared parameters only.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from robots.transforms import displace
from verify.calibration.stereo import gauge
from verify.calibration.stereo import parameters as par
from verify.calibration.stereo.gauge import AdjustmentModel
from verify.core.native import entry
from verify.core.records import Array, Index, rigid_transform
from verify.core.rig import Camera

MAX_ITERATIONS = 60
TOL_COST = 1e-4  # chi² that a step still gains: a hundredth of an uncertainty
ROUNDING = 1e-12  # of the cost: what sums in another order differ by
LEAST_DAMPING = 1e-8  # more would slow what the pictures hardly show
FIRST_DAMPING = 1e-4  # where a step without it led astray
N_LOCAL = 6 + par.N_ERRORS  # a board's own unknowns: its pose, its errors
ERRORS = slice(6, N_LOCAL)
COL_POSE, COL_RESIDUAL, N_COLUMNS = 25, 39, 40  # as in kernels.c
N_SEEN = COL_POSE  # shared parameters that move one camera's pixels
LOCAL_COLUMNS = slice(N_SEEN, N_SEEN + N_LOCAL)  # behind them

_see_corners = entry("see_corners")
_fill_columns = entry("fill_columns")


@dataclass(frozen=True, slots=True)
class _CameraCorners:
    """The n corners of one camera, placed and projected; see kernels.c."""

    rows: Index  # (n,), among all corners
    board: Index  # (n,)
    modes: Array  # (n, 3), of the bow
    camera: tuple[Array, Array]
    places: tuple[Array, Array, Array]
    pixels: Array  # (n, 2), NaN behind the camera


def _see(side: int, state: par.BundleState, corners: par.CornerStack) -> _CameraCorners:
    camera, rows = state.cameras[side], np.flatnonzero(corners.camera == side)
    placed = camera_poses(camera, corners.pan[:, side] + state.pan_error[:, side])
    (fx, _, cx), (_, fy, cy), _ = camera.matrix
    moved = np.concatenate(
        [state.errors[:, par.MOTION], state.errors[:, par.BEND] + state.bow], axis=1
    )
    arms, points, seen = np.empty((3, len(rows), 3))
    at = _CameraCorners(
        rows, corners.board[rows], corners.modes[rows],
        (np.array([fx, fy, cx, cy, *camera.distortion]), placed),
        (arms, points, seen), np.empty((len(rows), 2)),
    )  # fmt: skip
    boards = np.ascontiguousarray(state.boards), moved
    known = at.board, corners.point[rows], at.modes, *boards, *at.camera
    _see_corners(len(rows), *known, side, *at.places, at.pixels)
    return at


def predict(state: par.BundleState, corners: par.CornerStack) -> Array:
    """Predict the corners' pixels, (n, 2); NaN behind a camera."""
    pixels = np.empty((len(corners), 2))
    for side in range(2):
        at = _see(side, state, corners)
        pixels[at.rows] = at.pixels
    return pixels


@dataclass(frozen=True, slots=True)
class NormalEquations:
    """The normal equations with the boards' own unknowns eliminated."""

    information: Array  # (b, 47, 47), on the shared parameters, from each board
    gradient: Array  # (b, 47), negative half gradient of the cost
    own: Array  # (b, 14, 14), inverse of each board's own information
    own_gradient: Array  # (b, 14)
    shared: Array  # (b, 14, 47), how a board's own optimum moves with the parameters, negated
    diagonal: Array  # (47,), of the information before the elimination
    prior: Array  # (47, 47), information on lenses and bases beforehand
    prior_gradient: Array  # (47,)

    @property
    def total(self) -> Array:
        """All information on the shared parameters, (47, 47)."""
        whole: Array = self.information.sum(axis=0) + self.prior
        return whole


def normal_equations(
    state: par.BundleState,
    corners: par.CornerStack,
    model: AdjustmentModel,
    weight: Array,
    damping: float = 0.0,
) -> NormalEquations:
    """Set up the normal equations at a state, for what the model says is free.

    The weight (n,) is of each corner beside its stated covariance, 0 leaves it out; `damping` is
    Marquardt's factor on the diagonal of the boards' own information.
    """
    count, width = len(state.boards), par.N_SHARED
    full, gradient = np.zeros((count, width, width)), np.zeros((count, width))
    prior, across = np.zeros(N_LOCAL), np.zeros((count, N_LOCAL, width))
    prior[ERRORS] = np.nan_to_num(model.precision, posinf=0.0)
    block = np.tile(np.diag(prior), (count, 1, 1))
    pull = np.zeros((count, N_LOCAL))
    pull[:, ERRORS] = -prior[ERRORS] * state.errors
    for side in range(2):
        products = _products(side, state, corners, weight)
        # the shared parameters that move this camera's pixels
        mine = np.arange(par.N_SHARED)[np.r_[par.camera_columns(side), par.BOW]]
        full[:, mine[:, None], mine] += products[:, :N_SEEN, :N_SEEN]
        across[:, :, mine] += products[:, LOCAL_COLUMNS, :N_SEEN]
        block += products[:, LOCAL_COLUMNS, LOCAL_COLUMNS]
        gradient[:, mine] += products[:, :N_SEEN, -1]
        pull += products[:, LOCAL_COLUMNS, -1]
    own = _invert_local(block, model, damping)
    shared = own @ across
    toward: Array = shared.transpose(0, 2, 1)
    known = np.zeros((1, width)) if model.prior is None else model.prior
    return NormalEquations(
        information=full - across.transpose(0, 2, 1) @ shared,
        gradient=gradient - (toward @ pull[:, :, None])[:, :, 0],
        own=own,
        own_gradient=pull,
        shared=shared,
        diagonal=np.einsum("bii->i", full) + np.sum(known**2, axis=0),
        prior=known.T @ known,
        prior_gradient=-known.T @ (known @ par.prior_values(state)),
    )


def _products(side: int, state: par.BundleState, corners: par.CornerStack, weight: Array) -> Array:
    """Products of one camera's whitened columns over each board's corners, (b, 40, 40).

    Columns: the camera's parameters (22), the bow (3), the board's own (14), the residual.
    """
    camera, at = state.cameras[side], _see(side, state, corners)
    columns = np.zeros((len(at.rows), 2, N_COLUMNS))
    columns[:, :, COL_RESIDUAL] = corners.observed[at.rows] - at.pixels
    root = corners.root[at.rows] * np.sqrt(weight[at.rows])[:, None, None]
    base = at.camera[1][:, :3, :3] @ camera.mount[:3, :3].T, camera.pan_center, camera.pan_axis
    known = at.board, np.ascontiguousarray(state.boards), at.modes, *base, *at.camera
    _fill_columns(len(at.rows), *known, side, *at.places, root, columns)
    ends = np.searchsorted(at.board, np.arange(len(state.boards) + 1)).tolist()
    products = np.empty((len(state.boards), N_COLUMNS, N_COLUMNS))
    for own, start, end in zip(products, ends[:-1], ends[1:], strict=True):
        whitened = columns[start:end].reshape(-1, N_COLUMNS)
        np.matmul(whitened.T, whitened, out=own)
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


def cost(
    state: par.BundleState, corners: par.CornerStack, model: AdjustmentModel, weight: Array
) -> float:
    """Sum the weighted squares that the adjustment minimises; infinite behind a camera."""
    squares = _squares(state, corners)
    if np.isnan(squares[weight > 0]).any():
        return float("inf")
    total = float(weight @ np.nan_to_num(squares))
    total += float(np.sum(np.nan_to_num(model.precision, posinf=0.0) * state.errors**2))
    if model.prior is not None:
        total += float(np.sum((model.prior @ par.prior_values(state)) ** 2))
    return total


def squared_distances(state: par.BundleState, corners: par.CornerStack) -> Array:
    """Squared residual of each corner in its stated covariance, (n,); 1e12 behind a camera."""
    return np.nan_to_num(_squares(state, corners), nan=1e12)


def _squares(state: par.BundleState, corners: par.CornerStack) -> Array:
    residual = corners.observed - predict(state, corners)
    squares: Array = np.sum(np.einsum("nij,nj->ni", corners.root, residual) ** 2, axis=1)
    return squares


def adjust(
    state: par.BundleState,
    corners: par.CornerStack,
    model: AdjustmentModel,
    weight: Array,
    iterations: int = MAX_ITERATIONS,
) -> par.BundleState:
    """Find the state of least squares by damped Gauss-Newton steps, always in the gauge.

    The weight (n,) is of each corner beside its stated covariance; 0 leaves it out.
    """
    pan = corners.pan[0]
    state = gauge.apply_gauge(state, model, pan)
    before, damping = cost(state, corners, model, weight), LEAST_DAMPING
    for _ in range(iterations):
        trial, promised = _damped_step(state, corners, model, weight, damping)
        now = cost(trial, corners, model, weight)
        if now <= before * (1 + ROUNDING):
            state, damping = trial, damping / 10
            if before - now < TOL_COST and promised < TOL_COST:
                break
            before = now
        else:
            if promised < TOL_COST:
                break
            damping = max(10 * damping, FIRST_DAMPING)
            if damping > 1e8:
                break
    return state


def _damped_step(
    state: par.BundleState,
    corners: par.CornerStack,
    model: AdjustmentModel,
    weight: Array,
    damping: float,
) -> tuple[par.BundleState, float]:
    """Take one damped step; with it, by how much it should lower the cost to first order."""
    pan = corners.pan[0]
    system = normal_equations(state, corners, model, weight, damping)
    basis = gauge.free_directions(gauge.constraints(state, model, pan))
    matrix = basis.T @ (system.total + damping * np.diag(system.diagonal)) @ basis
    gradient = system.gradient.sum(axis=0) + system.prior_gradient
    pull = basis.T @ gradient
    scale = 1 / np.sqrt(np.diag(matrix))
    factor = cho_factor(matrix * np.outer(scale, scale) + 1e-14 * np.eye(len(matrix)))
    step = basis @ (scale * cho_solve(factor, scale * pull))
    own_step = np.einsum("bij,bj->bi", system.own, system.own_gradient) - system.shared @ step
    promised = float(gradient @ step) + float(
        np.einsum("bi,bij,bj->", system.own_gradient, system.own, system.own_gradient)
    )
    return gauge.apply_gauge(step_state(state, corners, step, own_step), model, pan), promised


def step_state(
    state: par.BundleState, corners: par.CornerStack, change: Array, own: Array
) -> par.BundleState:
    """Step the shared parameters by (47,) and each board's own by (b, 14), all at once.

    Images of boards determine least of all a rotation of the rig against its own baseline; in the
    rig frame it carries every board along an arc that a straight step leaves at once. So a board
    moves with its camera, exactly; J D is what this does already to first order:

        rig_T_board' = exp(d - J D) (rig_T_camera' camera_T_rig) rig_T_board

    with the board's own step d and the step D of the camera's parameters.
    """
    changes = (change[par.camera_columns(0)], change[par.camera_columns(1)])
    errors = state.errors + own[:, 6:]
    cameras = _cameras(state, changes, corners.pan.mean(axis=0))
    boards, beyond = state.boards.copy(), own[:, :6].copy()
    host = np.ones(len(boards), dtype=np.int64)  # the camera that each board moves with
    host[corners.board[corners.camera == 0]] = 0  # the left one, where it saw the board
    for side, (old, new, d) in enumerate(zip(state.cameras, cameras, changes, strict=True)):
        mine = host == side
        before = corners.pan[mine, side] + state.pan_error[mine, side]
        after = corners.pan[mine, side] + errors[mine, par.PAN_ERRORS][:, side]
        carried = camera_poses(new, after) @ np.linalg.inv(camera_poses(old, before))
        beyond[mine] -= _motion(old, before, after - before, d, boards[mine, :3, 3])
        boards[mine] = carried @ boards[mine]
    return par.BundleState(*cameras, displace(boards, beyond), errors, state.bow + change[par.BOW])


def _cameras(
    state: par.BundleState, changes: tuple[Array, Array], pan: Array
) -> tuple[Camera, Camera]:
    """Step both cameras; the right one moves with the left one, at the mean readings (2,)."""
    left, right = (par.step_camera(c, d) for c, d in zip(state.cameras, changes, strict=True))
    at_left, at_right = pan[:1], pan[1:]
    before = camera_poses(state.right, at_right)
    carried = camera_poses(left, at_left) @ np.linalg.inv(camera_poses(state.left, at_left))
    still = np.zeros(1)
    straight = _motion(state.right, at_right, still, changes[1], before[:, :3, 3])
    with_left = _motion(state.left, at_left, still, changes[0], before[:, :3, 3])
    wanted = displace(carried @ before, straight - with_left)
    turntable = camera_poses(right, at_right) @ np.linalg.inv(right.mount)
    return left, replace(right, mount=(np.linalg.inv(turntable) @ wanted)[0])


def camera_poses(camera: Camera, pan: Array) -> Array:
    """Place a camera for readings (b,), rad: rig_T_camera (b, 4, 4)."""
    return rigid_transform(par.base_rotations(camera, pan), camera.pan_center) @ camera.mount


def _motion(camera: Camera, pan: Array, turned_on: Array, change: Array, points: Array) -> Array:
    """How a step of a camera carries points (b, 3) that go with it, to first order, (b, 6)."""
    placed_there = camera_poses(camera, pan)
    turned = placed_there[:, :3, :3] @ camera.mount[:3, :3].T
    about_center = change[par.PAR_AXIS] - turned @ change[par.PAR_AXIS]
    about_center = about_center + (change[par.PAR_ZERO] + turned_on)[:, None] * camera.pan_axis
    about_camera = turned @ change[par.PAR_TURN]
    shift = (
        change[par.PAR_CENTER]
        + turned @ change[par.PAR_OFFSET]
        + np.cross(about_center, points - camera.pan_center)
        + np.cross(about_camera, points - placed_there[:, :3, 3])
    )
    return np.concatenate([shift, about_center + about_camera], axis=1)
