"""The gauge: parameters that pictures of boards leave open, and the convention that fixes them.

Any rigid motion of rig and boards together leaves every picture as it is. The rig frame is fixed by

    (c_left + c_right) / 2 = 0,   (c_right - c_left) || x,   (u_left + u_right) . z = 0

with the pan centres c and the upward directions u: of a base that turned its pan axis, of one that
did not the camera's own y axis. Per kind of base (parameters of `parameters.PARAMETER_KEYS`):

    fixed      axis +y, zero 0, mount's translation 0: the optical centre is the pan centre and the
               mount holds the camera's orientation
    turning    mount's translation along the axis 0, and its rotation about the axis 0 (it is in
               the pan zero)

A constraint is a row (47,) whose product with a parameter step must be 0; the adjustment moves in
the null space of all rows.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import null_space

from robots.transforms import cross_matrix, rotation_exp, rotation_log
from verify.calibration.stereo import parameters as par
from verify.core.records import SIDES, Array, rigid_transform
from verify.core.rig import Camera

BASE_FIXED, BASE_TURNING = "fixed", "turning"
HELD_PARAMETERS = (  # of a base that is fixed
    *par.PARAMETER_KEYS[par.PAR_AXIS],
    par.PARAMETER_KEYS[par.PAR_ZERO],
    *par.PARAMETER_KEYS[par.PAR_OFFSET],
)
Y_AXIS = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, slots=True)
class AdjustmentModel:
    """Which parameters an adjustment holds, and how far it trusts what is known beforehand."""

    bases: tuple[str, str]  # left and right: BASE_FIXED or BASE_TURNING
    precision: Array = field(default_factory=lambda: np.full(par.N_ERRORS, np.inf))  # (8,), 1/rad²,
    # 1/m², of a pair's errors against corners' stated weights; infinite: held at 0
    prior: Array | None = None  # (k, 47); squares of its products with `prior_values` are costs
    bowed: bool = False  # the board's bow is free


def apply_gauge(state: par.BundleState, model: AdjustmentModel, pan: Array) -> par.BundleState:
    """Bring a state into the gauge exactly; no picture of a board changes.

    Bases that never turned stand at the readings pan (2,), rad.
    """
    cameras = [
        _choose_pan_centre(c, base, p)
        for c, base, p in zip(state.cameras, model.bases, pan, strict=True)
    ]
    new_T_old = _rig_frame(cameras, model.bases, pan)
    turned = [_change_frame(c, new_T_old) for c in cameras]
    left, right = (
        _align_axis(c, p) if base == BASE_FIXED else _move_turn_to_zero(c)
        for c, base, p in zip(turned, model.bases, pan, strict=True)
    )
    return replace(state, left=left, right=right, boards=new_T_old @ state.boards)


def _choose_pan_centre(camera: Camera, base: str, pan: float) -> Camera:
    """Move the pan centre along the axis, or to the optical centre, as the kind of base asks."""
    mount = camera.mount.copy()
    if base == BASE_TURNING:
        along = camera.pan_axis * (camera.pan_axis @ mount[:3, 3])
        mount[:3, 3] -= along
        return replace(camera, mount=mount, pan_center=camera.pan_center + along)
    centre = camera.rig_T_camera(pan)[:3, 3]
    mount[:3, 3] = 0.0
    return replace(camera, mount=mount, pan_center=centre)


def upward(camera: Camera, base: str, pan: float) -> Array:
    """A camera's upward direction in the rig, (3,), which the rotation about x goes by."""
    if base == BASE_FIXED:
        return np.asarray(camera.rig_T_camera(pan)[:3, 1], dtype=np.float64)
    # a base whose readings grow the other way has its axis along -y
    return camera.pan_axis * (-1.0 if camera.pan_axis[1] < 0 else 1.0)


def _rig_frame(cameras: list[Camera], bases: tuple[str, str], pan: Array) -> Array:
    left, right = (c.pan_center for c in cameras)
    x = (right - left) / np.linalg.norm(right - left)
    up = sum(upward(c, b, p) for c, b, p in zip(cameras, bases, pan, strict=True))
    y = up - x * (x @ up)
    y = y / np.linalg.norm(y)
    turn = np.array([x, y, np.cross(x, y)])
    return rigid_transform(turn, -turn @ (left + right) / 2)


def _change_frame(camera: Camera, new_T_old: Array) -> Camera:
    """Express a camera in another rig frame; at angle 0 the turntable's axes are the rig's."""
    turn = rigid_transform(new_T_old[:3, :3], np.zeros(3))
    return replace(
        camera,
        pan_center=turn[:3, :3] @ camera.pan_center + new_T_old[:3, 3],
        pan_axis=turn[:3, :3] @ camera.pan_axis,
        mount=turn @ camera.mount,
    )


def _align_axis(camera: Camera, pan: float) -> Camera:
    """Give a base that never turned the axis +y; the orientation goes to the mount."""
    turn = rotation_exp(-Y_AXIS * pan) @ camera.rig_T_camera(pan)[:3, :3]
    mount = rigid_transform(turn, np.zeros(3))
    return replace(camera, pan_axis=Y_AXIS, pan_zero=0.0, mount=mount)


def _move_turn_to_zero(camera: Camera) -> Camera:
    """Move the mount's turn about the pan axis to the pan zero."""
    axis, mount, zero = camera.pan_axis, camera.mount.copy(), camera.pan_zero
    for _ in range(20):  # converges as the mount's tilt squared
        spin = float(axis @ rotation_log(mount[:3, :3]))
        mount[:3] = rotation_exp(-axis * spin) @ mount[:3]
        zero += spin
        if abs(spin) < 1e-15:
            break
    return replace(camera, mount=mount, pan_zero=zero)


def constraints(state: par.BundleState, model: AdjustmentModel, pan: Array) -> Array:
    """List the constraints on a parameter step, (c, 47): gauge, kinds of base, a flat board."""
    unit = np.eye(par.N_SHARED)
    rows: list[Array] = [] if model.bowed else [*unit[par.BOW]]
    ends = [unit[par.camera_columns(side)] for side in (0, 1)]
    for axis in (1, 2):
        rows += [own[par.PAR_CENTER][axis] for own in ends]
    rows.append(ends[0][par.PAR_CENTER][0] + ends[1][par.PAR_CENTER][0])
    level = np.zeros(par.N_SHARED)
    for own, camera, base, p in zip(ends, state.cameras, model.bases, pan, strict=True):
        level += _tilt_row(own, camera, base, p)
        rows += _base_rows(own, camera, base)
    return np.array([*rows, level])


def free_directions(rows: Array) -> Array:
    """An orthonormal basis (47, p) of the steps that the constraints leave."""
    return np.asarray(null_space(rows), dtype=np.float64)


def _tilt_row(own: Array, camera: Camera, base: str, pan: float) -> Array:
    """Change of the upward direction's z component; (u × w)_z = u_x w_y - u_y w_x for a turn u."""
    up = upward(camera, base, pan)
    if base == BASE_FIXED:
        turned = rotation_exp(camera.pan_axis * (pan + camera.pan_zero))
        by_turn = np.array([up[1], -up[0], 0.0]) @ turned
        return np.asarray(by_turn @ own[par.PAR_TURN])
    return np.asarray(np.array([up[1], -up[0], 0.0]) @ own[par.PAR_AXIS])


def _base_rows(own: Array, camera: Camera, base: str) -> list[Array]:
    if base == BASE_FIXED:
        return [*own[par.PAR_AXIS], own[par.PAR_ZERO], *own[par.PAR_OFFSET]]
    axis = camera.pan_axis
    turn = rotation_log(camera.mount[:3, :3])
    # (d × axis) · w = d · (axis × w): how a step d of the axis changes its product with w
    return [
        axis @ own[par.PAR_AXIS],
        np.cross(axis, turn) @ own[par.PAR_AXIS] + axis @ _log_derivative(turn) @ own[par.PAR_TURN],
        np.cross(axis, camera.mount[:3, 3]) @ own[par.PAR_AXIS] + axis @ own[par.PAR_OFFSET],
    ]


def _log_derivative(w: Array) -> Array:
    """Inverse left Jacobian of SO(3): log(exp(d) exp(w)) = w + J d, to first order.

    Source: Solà et al., A micro Lie theory for state estimation in robotics, 2018, eq. 146.
    """
    angle = float(np.linalg.norm(w))
    cross, factor = cross_matrix(w), 1 / 12
    if angle >= 1e-4:
        factor = 1 / angle**2 - (1 + np.cos(angle)) / (2 * angle * np.sin(angle))
    return np.eye(3) - cross / 2 + factor * cross @ cross


def fixed_names(model: AdjustmentModel) -> tuple[str, ...]:
    """Name the parameters that the pictures do not determine."""
    fixed = [side for side, base in zip(SIDES, model.bases, strict=True) if base == BASE_FIXED]
    return tuple(f"{side}.{key}" for side in fixed for key in HELD_PARAMETERS)
