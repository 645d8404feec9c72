"""Rigid motions as (..., 4, 4) matrices; `a_T_b` carries coordinates in b to coordinates in a."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ROUNDS = 5  # by which motions of base and body are told apart


def invert(a_T_b: Array) -> Array:
    """Turn a_T_b around: b_T_a, (..., 4, 4), by the transpose of its rotation."""
    b_R_a = np.swapaxes(a_T_b[..., :3, :3], -1, -2)
    b_T_a = np.zeros_like(a_T_b)
    b_T_a[..., :3, :3] = b_R_a
    b_T_a[..., :3, 3] = -np.squeeze(b_R_a @ a_T_b[..., :3, 3, None], -1)
    b_T_a[..., 3, 3] = 1
    return b_T_a


def carry(a_T_b: Array, points_b: Array) -> Array:
    """Express points (..., 3) given in b in frame a, by a_T_b (..., 4, 4).

    Leading shapes broadcast: one motion and (k, 3) points give (k, 3), (n, 1, 4, 4) motions and
    (k, 3) points give (n, k, 3).
    """
    return np.squeeze(a_T_b[..., :3, :3] @ points_b[..., None], -1) + a_T_b[..., :3, 3]


def turn_z(angle: Array | float) -> Array:
    """RotZ (..., 4, 4) of angles (...), rad."""
    turn = np.zeros((*np.shape(angle), 4, 4))
    turn[..., 0, 0] = turn[..., 1, 1] = np.cos(angle)
    turn[..., 1, 0] = np.sin(angle)
    turn[..., 0, 1] = -turn[..., 1, 0]
    turn[..., 2, 2] = turn[..., 3, 3] = 1
    return turn


def cross_matrix(vectors: Array) -> Array:
    """Matrices (..., 3, 3) of v x . for vectors (..., 3)."""
    matrix = np.zeros((*vectors.shape, 3))
    matrix[..., (2, 0, 1), (1, 2, 0)] = vectors
    return matrix - matrix.swapaxes(-1, -2)


def rigid_columns(points: Array) -> Array:
    """Derivative (..., 3, 6) of points (..., 3) by a rigid motion: shift, turn about the origin."""
    columns = np.empty((*points.shape, 6))
    columns[..., :3], columns[..., 3:] = np.eye(3), -cross_matrix(points)
    return columns


def middle_pose(poses: Array) -> Array:
    """The rigid motion (4, 4) amid poses (n, 4, 4): median of places, mean of rotations."""
    from scipy.spatial.transform import Rotation  # as in `rotation_log`

    middle = np.median(poses, axis=0)
    middle[:3, :3] = Rotation.from_matrix(poses[:, :3, :3]).mean().as_matrix()
    return np.asarray(middle)


def misplacement(
    measured: Array, read: Array, of_base: bool = True, of_body: bool = True
) -> tuple[Array, Array]:
    """Motions B and X (4, 4) of base and body by which poses (n, 4, 4) as measured are B read X.

    Either is none unless it is asked for; of both, each round takes some of the other's.
    """
    base, body, back = np.eye(4), np.eye(4), invert(read)
    for _ in range(ROUNDS if of_base and of_body else 1):
        base = middle_pose(measured @ invert(body) @ back) if of_base else base
        body = middle_pose(back @ invert(base) @ measured) if of_body else body
    return base, body


def rotation_log(rotation: Array) -> Array:
    """Rotation vectors (..., 3), rad, of rotation matrices (..., 3, 3); lengths in [0, pi]."""
    from scipy.spatial.transform import Rotation  # slow to load, and not all processes turn

    vectors = Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_rotvec()
    return np.asarray(vectors, dtype=float).reshape(*rotation.shape[:-2], 3)


def rotation_exp(vector: Array) -> Array:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3), rad."""
    from scipy.spatial.transform import Rotation

    matrices = Rotation.from_rotvec(vector.reshape(-1, 3)).as_matrix()
    return np.asarray(matrices, dtype=float).reshape(*vector.shape, 3)


def difference(a_T_b: Array, a_T_c: Array) -> Array:
    """Motion that carries c onto b, in axes of a, (..., 6): m, then rotation vector, rad."""
    turn = a_T_b[..., :3, :3] @ np.swapaxes(a_T_c[..., :3, :3], -1, -2)
    return np.concatenate([a_T_b[..., :3, 3] - a_T_c[..., :3, 3], rotation_log(turn)], axis=-1)


def displace(a_T_c: Array, motion: Array) -> Array:
    """The a_T_b (..., 4, 4) whose `difference` from a_T_c (..., 4, 4) is `motion` (..., 6)."""
    a_T_b = a_T_c.copy()
    a_T_b[..., :3, :3] = rotation_exp(motion[..., 3:]) @ a_T_c[..., :3, :3]
    a_T_b[..., :3, 3] += motion[..., :3]
    return a_T_b
