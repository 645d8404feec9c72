"""Distance of a calibration from a known rig, and its linear covariance."""

from dataclasses import replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from tests.support.scene import move_camera
from verify.calibration.stereo.records import Calibration, covariance_in_si
from verify.core.fiducials import Board
from verify.core.records import Array
from verify.core.rig import Rig

STEP = 1e-6  # SI units and pixels: small against curvature, large against rounding
RANK = 1e-9  # eigenvalues of a correlation below this are a direction that is held


def left_T_right(rig: Rig) -> Array:
    """The right camera's pose in the left one, bases at the readings of the file."""
    left, right = (c.rig_T_camera(c.pan) for c in (rig.left, rig.right))
    relation: Array = np.linalg.inv(left) @ right
    return relation


def departure(rig: Rig, other: Rig) -> Array:
    """Lenses (fx, fy, cx, cy, k1, k2, p1, p2, k3 a side) and relation (m, rad), rig less other."""
    parts = []
    for one, two in ((rig.left, other.left), (rig.right, other.right)):
        parts.append((one.matrix - two.matrix)[[0, 1, 0, 1], [0, 1, 2, 2]])
        parts.append(one.distortion - two.distortion)
    one, two = left_T_right(rig), left_T_right(other)
    parts.append(one[:3, 3] - two[:3, 3])
    parts.append(Rotation.from_matrix(one[:3, :3] @ two[:3, :3].T).as_rotvec())
    return np.concatenate(parts)


def departure_covariance(found: Calibration) -> Array:
    """Covariance (24, 24) of `departure`, from the one in the rig file."""
    covariance = found.rig.covariance
    assert covariance is not None
    columns = [
        departure(moved(found.rig, name, STEP), moved(found.rig, name, -STEP)) / (2 * STEP)
        for name in covariance.parameters
    ]
    jacobian = np.stack(columns, axis=1)
    full: Array = jacobian @ covariance_in_si(covariance) @ jacobian.T
    return full


def moved(rig: Rig, name: str, step: float) -> Rig:
    """Move one parameter of the file."""
    side, _, key = name.partition(".")
    if side == "left":
        return replace(rig, left=move_camera(rig.left, key, step))
    return replace(rig, right=move_camera(rig.right, key, step))


def squared_distance(error: Array, covariance: Array) -> tuple[float, int]:
    """d² of an error (p,) whose covariance (p, p) may be singular, and its degrees of freedom."""
    sigma = np.sqrt(np.diag(covariance))
    stated = sigma > 0
    scaled = covariance[np.ix_(stated, stated)] / np.outer(sigma[stated], sigma[stated])
    size, directions = np.linalg.eigh(scaled)
    kept = size > RANK
    z = (directions.T @ (error[stated] / sigma[stated]))[kept] / np.sqrt(size[kept])
    return float(z @ z), int(kept.sum())


def linear_theory(rig: Rig, rig_T_board: Array, board: Board, sigma: float) -> Array:
    """Standard uncertainties (24,) of `departure` for white noise on every corner seen twice.

    Source: numerical derivatives of cv2.projectPoints; nothing of the adjustment.
    """
    left_T_boards = np.linalg.inv(rig.left.rig_T_camera(rig.left.pan)) @ rig_T_board
    information = np.zeros((24, 24))
    for pose in left_T_boards:
        ends = [[_seen(rig, pose, board, i, s * STEP) for i in range(30)] for s in (1, -1)]
        jacobian = (np.array(ends[0]) - np.array(ends[1])).T / (2 * STEP)
        own, shared = jacobian[:, 24:], jacobian[:, :24]
        left_over = shared - own @ np.linalg.lstsq(own, shared, rcond=None)[0]
        information += left_over.T @ left_over
    scale = 1 / np.sqrt(np.diag(information))
    inverse = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    return sigma * np.sqrt(np.diag(inverse))


def _seen(rig: Rig, left_T_board: Array, board: Board, moved: int, step: float) -> Array:
    """Pixels of one board in both cameras, one of 30 parameters moved, flat."""
    lenses = []
    for side, camera in enumerate((rig.left, rig.right)):
        values = np.concatenate([camera.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], camera.distortion])
        if moved // 9 == side:
            values[moved % 9] += step
        lenses.append(values)
    relation, pose = left_T_right(rig), left_T_board
    if 18 <= moved < 24:
        relation = _moved_pose(relation, moved - 18, step)
    if moved >= 24:
        pose = _moved_pose(pose, moved - 24, step)
    pixels = []
    seen_from = (pose, np.linalg.inv(relation) @ pose)
    for values, camera_T_board in zip(lenses, seen_from, strict=True):
        matrix = np.array([[values[0], 0, values[2]], [0, values[1], values[3]], [0, 0, 1.0]])
        turn = cv2.Rodrigues(camera_T_board[:3, :3])[0]
        seen, _ = cv2.projectPoints(board.points, turn, camera_T_board[:3, 3], matrix, values[4:])
        pixels.append(np.asarray(seen, dtype=float).ravel())
    return np.concatenate(pixels)


def _moved_pose(pose: Array, at: int, step: float) -> Array:
    stepped = pose.copy()
    if at < 3:
        stepped[at, 3] += step
    else:
        stepped[:3, :3] = Rotation.from_rotvec(step * np.eye(3)[at - 3]).as_matrix() @ pose[:3, :3]
    return stepped
