"""The gauge: parameters that pictures of boards leave open, and the convention that fixes them.

Any rigid motion of rig and boards together leaves every picture as it is. The rig frame is fixed by

    (c_left + c_right) / 2 = 0,   (c_right - c_left) || x,   (u_left + u_right) . z = 0

with the pan centres c and the upward directions u: of a base that turned its pan axis, of one that
did not the camera's own y axis. Per kind of base (parameters of `parameters.PARAMETER_KEYS`):

    fixed      axis +y, zero 0, mount's translation 0: the optical centre is the pan centre and the
               mount holds the camera's orientation
    centred    mount's translation 0, and its rotation about the axis 0 (it is in the pan zero)
    turning    mount's translation along the axis 0, and its rotation about the axis 0

A constraint is a row (44,) whose product with a parameter step must be 0; the adjustment moves in
the null space of all rows.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import null_space

from verify.calibration.stereo.parameters import (
    N_CAMERA_PARAMETERS,
    PAR_AXIS,
    PAR_CENTER,
    PAR_LENS,
    PAR_OFFSET,
    PAR_TURN,
    PAR_ZERO,
    PARAMETER_KEYS,
    SIDES,
    BundleState,
    camera_columns,
    rotation_from_vector,
    rotation_vector,
)
from verify.core.records import Array
from verify.core.rig import Camera

BASE_FIXED, BASE_TURNING, BASE_CENTRED = "fixed", "turning", "centred"
# centred: turned too little to show where the axis passes; it is put through the optical centre
LENS_KEYS = ("k1", "k2", "p1", "p2", "k3")
FOCAL_TIE = "fy_px"  # held: fy equals fx
HELD_PARAMETERS: dict[str, tuple[str, ...]] = {  # held of each kind of base
    BASE_FIXED: (*PARAMETER_KEYS[PAR_AXIS], PARAMETER_KEYS[PAR_ZERO], *PARAMETER_KEYS[PAR_OFFSET]),
    BASE_CENTRED: (*PARAMETER_KEYS[PAR_OFFSET],),
    BASE_TURNING: (),
}
Y_AXIS = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, slots=True)
class AdjustmentModel:
    """Which parameters an adjustment holds, and how far it trusts pan readings."""

    bases: tuple[str, str]  # left and right: BASE_FIXED, BASE_TURNING or BASE_CENTRED
    held: tuple[str, ...] = ()  # left.k3: at 0; left.fy_px: fy equals fx
    pan_precision: float = np.inf  # 1/rad², of a pan reading against corners' stated weights

    @property
    def pan_errors(self) -> bool:
        """Pan errors are adjusted."""
        return bool(np.isfinite(self.pan_precision)) and any(b != BASE_FIXED for b in self.bases)


def apply_gauge(state: BundleState, model: AdjustmentModel, pan: Array) -> BundleState:
    """Bring a state into the gauge exactly; no picture of a board changes.

    Args:
        state: any state.
        model: which bases turned, and what is held.
        pan: (2,), rad, the readings at which bases that never turned stand.
    """
    cameras = [
        _choose_pan_centre(_apply_held(c, side, model), base, p)
        for c, side, base, p in zip(state.cameras, SIDES, model.bases, pan, strict=True)
    ]
    new_T_old = _rig_frame(cameras, model.bases, pan)
    turned = [_change_frame(c, new_T_old) for c in cameras]
    left, right = (
        _align_axis(c, p) if base == BASE_FIXED else _move_turn_to_zero(c)
        for c, base, p in zip(turned, model.bases, pan, strict=True)
    )
    return BundleState(left, right, new_T_old @ state.boards, state.pan_error)


def _apply_held(camera: Camera, side: str, model: AdjustmentModel) -> Camera:
    matrix, distortion = camera.matrix.copy(), camera.distortion.copy()
    for i, key in enumerate(LENS_KEYS):
        if f"{side}.{key}" in model.held:
            distortion[i] = 0.0
    if f"{side}.{FOCAL_TIE}" in model.held:
        matrix[[0, 1], [0, 1]] = (matrix[0, 0] + matrix[1, 1]) / 2
    return replace(camera, matrix=matrix, distortion=distortion)


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
    new_T_old = np.eye(4)
    new_T_old[:3, :3] = [x, y, np.cross(x, y)]
    new_T_old[:3, 3] = -new_T_old[:3, :3] @ (left + right) / 2
    return new_T_old


def _change_frame(camera: Camera, new_T_old: Array) -> Camera:
    """Express a camera in another rig frame; at angle 0 the turntable's axes are the rig's."""
    turn = np.eye(4)
    turn[:3, :3] = new_T_old[:3, :3]
    return replace(
        camera,
        pan_center=turn[:3, :3] @ camera.pan_center + new_T_old[:3, 3],
        pan_axis=turn[:3, :3] @ camera.pan_axis,
        mount=turn @ camera.mount,
    )


def _align_axis(camera: Camera, pan: float) -> Camera:
    """Give a base that never turned the axis +y; the orientation goes to the mount."""
    mount = np.eye(4)
    turned_back = rotation_from_vector(-Y_AXIS * pan)
    mount[:3, :3] = turned_back @ camera.rig_T_camera(pan)[:3, :3]
    return replace(camera, pan_axis=Y_AXIS, pan_zero=0.0, mount=mount)


def _move_turn_to_zero(camera: Camera) -> Camera:
    """Move the mount's turn about the pan axis to the pan zero."""
    axis, mount, zero = camera.pan_axis, camera.mount.copy(), camera.pan_zero
    for _ in range(20):  # converges as the mount's tilt squared
        spin = float(axis @ rotation_vector(mount[:3, :3]))
        back = rotation_from_vector(-axis * spin)
        mount[:3] = back @ mount[:3]
        zero += spin
        if abs(spin) < 1e-15:
            break
    return replace(camera, mount=mount, pan_zero=zero)


def constraints(
    state: BundleState, model: AdjustmentModel, pan: Array
) -> tuple[Array, dict[str, int]]:
    """List the constraints on a parameter step: gauge, kinds of base, held coefficients.

    Returns:
        Rows (c, 44), and the row of each held coefficient.
    """
    rows: list[Array] = []
    unit = np.eye(2 * N_CAMERA_PARAMETERS)
    ends = [unit[camera_columns(side)] for side in (0, 1)]
    for axis in (1, 2):
        rows += [own[PAR_CENTER][axis] for own in ends]
    rows.append(ends[0][PAR_CENTER][0] + ends[1][PAR_CENTER][0])
    level = np.zeros(2 * N_CAMERA_PARAMETERS)
    for own, camera, base, p in zip(ends, state.cameras, model.bases, pan, strict=True):
        level += _tilt_row(own, camera, base, p)
        rows += _base_rows(own, camera, base)
    rows.append(level)
    place: dict[str, int] = {}
    for name in model.held:
        side, _, key = name.partition(".")
        own = ends[SIDES.index(side)]
        place[name] = len(rows)
        rows.append(own[1] - own[0] if key == FOCAL_TIE else own[PAR_LENS][LENS_KEYS.index(key)])
    return np.array(rows), place


def free_directions(rows: Array) -> Array:
    """An orthonormal basis (44, p) of the steps that the constraints leave."""
    return np.asarray(null_space(rows), dtype=np.float64)


def _tilt_row(own: Array, camera: Camera, base: str, pan: float) -> Array:
    """Change of the upward direction's z component; (u × w)_z = u_x w_y - u_y w_x for a turn u."""
    up = upward(camera, base, pan)
    if base == BASE_FIXED:
        turned = rotation_from_vector(camera.pan_axis * (pan + camera.pan_zero))
        by_turn = np.array([up[1], -up[0], 0.0]) @ turned
        return np.asarray(by_turn @ own[PAR_TURN])
    return np.asarray(np.array([up[1], -up[0], 0.0]) @ own[PAR_AXIS])


def _base_rows(own: Array, camera: Camera, base: str) -> list[Array]:
    if base == BASE_FIXED:
        return [*own[PAR_AXIS], own[PAR_ZERO], *own[PAR_OFFSET]]
    axis = camera.pan_axis
    turn = rotation_vector(camera.mount[:3, :3])
    # (d × axis) · w = d · (axis × w): how a step d of the axis changes its product with w
    rows = [
        axis @ own[PAR_AXIS],
        np.cross(axis, turn) @ own[PAR_AXIS] + axis @ _log_derivative(turn) @ own[PAR_TURN],
    ]
    if base == BASE_CENTRED:
        return [*rows, *own[PAR_OFFSET]]
    offset = camera.mount[:3, 3]
    return [*rows, np.cross(axis, offset) @ own[PAR_AXIS] + axis @ own[PAR_OFFSET]]


def _log_derivative(w: Array) -> Array:
    """Inverse left Jacobian of SO(3): log(exp(d) exp(w)) = w + J d, to first order.

    Source: Solà et al., A micro Lie theory for state estimation in robotics, 2018, eq. 146.
    """
    angle = float(np.linalg.norm(w))
    cross = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    if angle < 1e-4:
        factor = 1 / 12
    else:
        factor = 1 / angle**2 - (1 + np.cos(angle)) / (2 * angle * np.sin(angle))
    jacobian: Array = np.eye(3) - cross / 2 + factor * cross @ cross
    return jacobian


def fixed_names(model: AdjustmentModel) -> tuple[str, ...]:
    """Name the parameters that the pictures do not determine and those that the model holds."""
    bases = zip(SIDES, model.bases, strict=True)
    gauge = [f"{side}.{key}" for side, base in bases for key in HELD_PARAMETERS[base]]
    return (*gauge, *model.held)
