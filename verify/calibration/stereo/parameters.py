"""The rig's parameters as the adjustment steps in them, named as rig.toml's [covariance] does."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from verify.core.kernels.linear_algebra import rotation_vectors
from verify.core.records import Array
from verify.core.rig import Camera

SIDES = ("left", "right")
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


@dataclass(frozen=True, slots=True)
class BundleState:
    """Where the adjustment stands."""

    left: Camera
    right: Camera
    boards: Array  # (b, 4, 4), rig_T_board
    pan_error: Array  # (b, 2), rad, by which the bases stood off their readings

    @property
    def cameras(self) -> tuple[Camera, Camera]:
        """Left and right."""
        return self.left, self.right


@dataclass(frozen=True, slots=True)
class CornerStack:
    """Every corner of every view as one stack, sorted by board."""

    camera: NDArray[np.int64]  # (n,), 0 left, 1 right
    board: NDArray[np.int64]  # (n,), which pair
    corner: NDArray[np.int64]  # (n,), index into board.points
    point: Array  # (n, 3), m, board frame
    seen: Array  # (n, 2), px
    root: Array  # (n, 2, 2), turns a residual into one of unit variance
    uncertainty: Array  # (n,), px a coordinate, as stated
    pan: Array  # (b, 2), rad, the readings

    def __len__(self) -> int:
        """Count the corners."""
        return len(self.camera)


def rotation_from_vector(vector: Array) -> Array:
    """Rotation matrix (3, 3) of a rotation vector (3,), rad."""
    return np.asarray(cv2.Rodrigues(vector)[0], dtype=np.float64)


def rotation_vector(matrix: Array) -> Array:
    """Rotation vector (3,), rad, of a rotation matrix (3, 3)."""
    vector = np.empty(3)
    rotation_vectors(np.array([matrix]), vector[None])
    return vector


def base_rotations(camera: Camera, pan: Array) -> Array:
    """A base's rotation at readings (b,), rad: rig axes from turntable axes, (b, 3, 3).

    Source: Rodrigues' formula.
    """
    angle = (pan + camera.pan_zero)[:, None, None]
    x, y, z = camera.pan_axis
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned: Array = np.eye(3) + np.sin(angle) * across + (1 - np.cos(angle)) * (across @ across)
    return turned


def step_camera(camera: Camera, step: Array) -> Camera:
    """Step a camera's parameters (22,), SI units and pixels; small rotations on the left."""
    matrix = camera.matrix.copy()
    matrix[0, 0] += step[0]
    matrix[1, 1] += step[1]
    matrix[:2, 2] += step[PAR_PRINCIPAL]
    mount = camera.mount.copy()
    mount[:3, :3] = rotation_from_vector(step[PAR_TURN]) @ mount[:3, :3]
    mount[:3, 3] += step[PAR_OFFSET]
    axis = rotation_from_vector(step[PAR_AXIS]) @ camera.pan_axis
    return replace(
        camera,
        matrix=matrix,
        distortion=camera.distortion + step[PAR_LENS],
        pan_center=camera.pan_center + step[PAR_CENTER],
        pan_axis=axis / np.linalg.norm(axis),
        pan_zero=camera.pan_zero + float(step[PAR_ZERO]),
        mount=mount,
    )


def step_poses(boards: Array, step: Array) -> Array:
    """Step poses (b, 4, 4) by (b, 6): a translation and a rotation vector, in rig axes."""
    stepped = boards.copy()
    stepped[:, :3, :3] = Rotation.from_rotvec(step[:, 3:]).as_matrix() @ boards[:, :3, :3]
    stepped[:, :3, 3] += step[:, :3]
    return stepped


def length_parameters(state: BundleState) -> Array:
    """The parameters (44,) that scale with the board's squares, m; the others are 0."""
    found = np.zeros(2 * N_CAMERA_PARAMETERS)
    for side, camera in enumerate(state.cameras):
        own = found[side * N_CAMERA_PARAMETERS : (side + 1) * N_CAMERA_PARAMETERS]
        own[PAR_CENTER] = camera.pan_center
        own[PAR_OFFSET] = camera.mount[:3, 3]
    return found
