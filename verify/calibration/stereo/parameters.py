"""Parameters of the adjustment: both cameras, the board's bow and poses, the bases' pan errors.

Shared by all pairs: 22 a camera, left then right, named as in rig.toml's [covariance], and the bow:

    columns   name in rig.toml            unit   step
    0, 1      fx_px, fy_px                px     added
    2, 3      cx_px, cy_px                px     added
    4 - 8     k1, k2, p1, p2, k3          1      added
    9 - 11    pan_center_{x,y,z}_mm       m      added, rig axes
    12 - 14   pan_axis_r{x,y,z}_deg       rad    rotation of the axis, on the left, rig axes
    15        pan_zero_deg                rad    added
    16 - 18   mount_r{x,y,z}_deg          rad    rotation of the mount, on the left
    19 - 21   mount_{x,y,z}_mm            m      added, turntable axes
    44 - 46   bow h                       m      added; z = h_0 x² + h_1 x y + h_2 y²

with x, y over half the board's larger side. Each pair adds its board's pose (6: m, rad, rig axes),
both bases' pan errors (2: rad), how the board moved from the left picture to the right (3: m) and
how it bent (3: m, added to the bow).
"""

from dataclasses import dataclass, field, replace

import numpy as np

from robots.transforms import cross_matrix, rotation_exp, rotation_log
from verify.core.records import SIDES, Array, Index
from verify.core.rig import Camera

PARAMETER_KEYS = (
    "fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3",
    "pan_center_x_mm", "pan_center_y_mm", "pan_center_z_mm",
    "pan_axis_rx_deg", "pan_axis_ry_deg", "pan_axis_rz_deg", "pan_zero_deg",
    "mount_rx_deg", "mount_ry_deg", "mount_rz_deg", "mount_x_mm", "mount_y_mm", "mount_z_mm",
)  # fmt: skip
PARAMETER_NAMES = tuple(f"{side}.{key}" for side in SIDES for key in PARAMETER_KEYS)
N_CAMERA_PARAMETERS = len(PARAMETER_KEYS)
PAR_FOCAL, PAR_PRINCIPAL, PAR_LENS = slice(0, 2), slice(2, 4), slice(4, 9)
PAR_CENTER, PAR_AXIS, PAR_ZERO = slice(9, 12), slice(12, 15), 15
PAR_TURN, PAR_OFFSET = slice(16, 19), slice(19, 22)
BOW = slice(2 * N_CAMERA_PARAMETERS, 2 * N_CAMERA_PARAMETERS + 3)  # among the shared parameters
N_SHARED = BOW.stop
PAN_ERRORS, MOTION, BEND = slice(0, 2), slice(2, 5), slice(5, 8)  # of a pair's errors
N_ERRORS = BEND.stop


@dataclass(frozen=True, slots=True)
class BundleState:
    """Values of all unknowns of the adjustment."""

    left: Camera
    right: Camera
    boards: Array  # (b, 4, 4), rig_T_board
    errors: Array  # (b, 8): true pan angles less readings, rad; motion from left to right, m, rig;
    # bend less the bow, m
    bow: Array = field(default_factory=lambda: np.zeros(3))  # (3,), m

    @property
    def cameras(self) -> tuple[Camera, Camera]:
        """Left and right."""
        return self.left, self.right

    @property
    def pan_error(self) -> Array:
        """True pan angles less readings, (b, 2), rad."""
        return self.errors[:, PAN_ERRORS]


@dataclass(frozen=True, slots=True)
class CornerStack:
    """Every corner of every view as one stack, sorted by board."""

    camera: Index  # (n,), 0 left, 1 right
    board: Index  # (n,), which pair
    corner: Index  # (n,), index into board.points
    point: Array  # (n, 3), m, on a flat board, its frame
    modes: Array  # (n, 3), 1: x², x y, y² of the bow
    observed: Array  # (n, 2), px
    root: Array  # (n, 2, 2), turns a residual into one of unit variance
    uncertainty: Array  # (n,), px a coordinate, as stated
    pan: Array  # (b, 2), rad, the readings

    def __len__(self) -> int:
        """Count the corners."""
        return len(self.camera)


def camera_columns(side: int) -> slice:
    """Columns of a camera (0 left, 1 right) among the shared parameters."""
    return slice(side * N_CAMERA_PARAMETERS, (side + 1) * N_CAMERA_PARAMETERS)


def base_rotations(camera: Camera, pan: Array) -> Array:
    """Rotations (b, 3, 3), rig axes from turntable axes, at pan angles (b,), rad (Rodrigues)."""
    angle = (pan + camera.pan_zero)[:, None, None]
    across = cross_matrix(camera.pan_axis)
    return np.eye(3) + np.sin(angle) * across + (1 - np.cos(angle)) * (across @ across)


def step_camera(camera: Camera, step: Array) -> Camera:
    """Step a camera's parameters (22,), SI units and pixels; small rotations on the left."""
    matrix = camera.matrix.copy()
    matrix[0, 0] += step[0]
    matrix[1, 1] += step[1]
    matrix[:2, 2] += step[PAR_PRINCIPAL]
    mount = camera.mount.copy()
    mount[:3, :3] = rotation_exp(step[PAR_TURN]) @ mount[:3, :3]
    mount[:3, 3] += step[PAR_OFFSET]
    axis = rotation_exp(step[PAR_AXIS]) @ camera.pan_axis
    return replace(
        camera,
        matrix=matrix,
        distortion=camera.distortion + step[PAR_LENS],
        pan_center=camera.pan_center + step[PAR_CENTER],
        pan_axis=axis / np.linalg.norm(axis),
        pan_zero=camera.pan_zero + float(step[PAR_ZERO]),
        mount=mount,
    )


def length_parameters(state: BundleState) -> Array:
    """The parameters (47,) that scale with the board's squares, m; the others are 0."""
    lengths = np.zeros(N_SHARED)
    lengths[BOW] = state.bow
    for side, camera in enumerate(state.cameras):
        own = lengths[camera_columns(side)]
        own[PAR_CENTER] = camera.pan_center
        own[PAR_OFFSET] = camera.mount[:3, 3]
    return lengths


def lens_values(state: BundleState) -> Array:
    """Focal lengths, principal points and distortion among the shared parameters, (47,); else 0."""
    values = np.zeros(N_SHARED)
    for side, camera in enumerate(state.cameras):
        own = values[camera_columns(side)]
        own[PAR_FOCAL], own[PAR_PRINCIPAL] = camera.matrix[[0, 1], [0, 1]], camera.matrix[:2, 2]
        own[PAR_LENS] = camera.distortion
    return values


def prior_values(state: BundleState) -> Array:
    """What priors speak of, (47,): lenses, and of bases the axis and mount less upright ones.

    An axis that points down is upright as well: its readings grow the other way.
    """
    values = lens_values(state)
    for side, camera in enumerate(state.cameras):
        own, axis = values[camera_columns(side)], camera.pan_axis
        own[PAR_AXIS] = np.cross([0.0, np.copysign(1.0, axis[1]), 0.0], axis)
        own[PAR_TURN], own[PAR_OFFSET] = rotation_log(camera.mount[:3, :3]), camera.mount[:3, 3]
    return values


def parameter_difference(one: BundleState, other: BundleState) -> Array:
    """The step (47,) of the shared parameters from the other state to the one."""
    step = lens_values(one) - lens_values(other)
    step += length_parameters(one) - length_parameters(other)
    for side, (new, old) in enumerate(zip(one.cameras, other.cameras, strict=True)):
        own = step[camera_columns(side)]
        own[PAR_AXIS] = np.cross(old.pan_axis, new.pan_axis)
        own[PAR_ZERO] = new.pan_zero - old.pan_zero
        own[PAR_TURN] = rotation_log(new.mount[:3, :3] @ old.mount[:3, :3].T)
    return step
