"""Orientations of a measured body, as quaternions: of Euler angles, rotation vectors, three points.

Euler angles are named by their axes as scipy does: capitals turn about the moving axes, one after
the other (ZYX: KUKA's A, B, C; ABB's EulerZYX); small letters about the fixed ones (xyz: Fanuc's
W, P, R; roll, pitch, yaw).

The frame of three points p1, p2, p3 has its origin in p1, x towards p2, and p3 on the side of
positive y. A pose is the best fit of the first row's triangle to that row's points.

Source: KUKA KSS, system variable $POS_ACT; Fanuc, operator's manual, Cartesian coordinates; ABB,
RAPID reference, EulerZYX; Kabsch, Acta Cryst. A32, 1976 (best fit).
"""

import numpy as np
from scipy.spatial.transform import Rotation

from verify.core.records import Array
from verify.errors import InputError

MAX_FLEX = 0.5  # mm: sides of a rigid triangle, from row to row
MIN_HEIGHT = 5.0  # mm: of p3 above the line of p1 and p2
AXES = set("xyzXYZ")
TOL_NORM = 2e-3  # of a quaternion's length


def rotations(values: Array, kind: str, first: int = 0) -> Array:
    """Turn angles (m, 3), rad, or quaternions (m, 4), scalar first, into unit quaternions (m, 4).

    `first` is the number of the first row, from 0.

    Raises:
        InputError: a kind that is not known, or a quaternion whose length is not 1.
    """
    if kind == "quaternion":
        length = np.linalg.norm(values, axis=1, keepdims=True)
        wrong = np.flatnonzero(np.abs(length - 1) > TOL_NORM)
        if len(wrong):
            row = first + int(wrong[0]) + 1
            found = f"a quaternion of row {row} has the length {length[wrong[0], 0]:.4g}"
            raise InputError("--rotation quaternion", found, "a turn's has the length 1")
        return np.asarray(values / length)
    if kind == "rotvec":
        turns = Rotation.from_rotvec(values)
    else:
        require_rotation(kind)
        turns = Rotation.from_euler(kind, values)
    return turns.as_quat(scalar_first=True)


def require_rotation(kind: str) -> None:
    """Refuse, by an InputError, what names no rotation."""
    one_case = kind.islower() or kind.isupper()
    three = len(kind) == 3 and set(kind) <= AXES and kind[0] != kind[1] != kind[2] and one_case
    if kind not in ("rotvec", "quaternion") and not three:
        expected = "rotvec, quaternion, or three axes: xyz (fixed), ZYX (moving)"
        raise InputError("--rotation", f'is "{kind}"', expected)


class Triangle:
    """Three points on a rigid body."""

    def __init__(self, points: Array) -> None:
        """Take the first row's points, (3, 3), mm, one a row.

        Raises:
            InputError: they lie on a line.
        """
        sides = points[1] - points[0], points[2] - points[0]
        normal = np.cross(*sides)
        height = np.linalg.norm(normal) / max(float(np.linalg.norm(sides[0])), 1e-9)
        if height < MIN_HEIGHT:
            found = f"p3 lies {height:.2f} mm off the line through p1 and p2"
            expected = f"{MIN_HEIGHT:g} mm or more show how the body turns"
            remedy = "Choose other points or check --lengths."
            raise InputError("three points", found, expected, remedy)
        x, z = sides[0] / np.linalg.norm(sides[0]), normal / np.linalg.norm(normal)
        self._first_R_body = np.column_stack([x, np.cross(z, x), z])
        self._first = points

    def poses(self, points: Array, first: int = 0) -> tuple[Array, Array]:
        """Positions (m, 3), mm, and unit quaternions (m, 4), scalar first, of rows (m, 3, 3), mm.

        `first` is the number of the first row, from 0.

        Raises:
            InputError: the sides of a row's triangle are not those of the first.
        """
        flex = np.abs(_sides(points) - _sides(self._first[None]))
        worst = np.unravel_index(int(flex.argmax()), flex.shape)
        if flex[worst] > MAX_FLEX:
            row = first + int(worst[0]) + 1
            found = f"a side of the triangle in row {row} differs by {flex[worst]:.3f} mm"
            expected = f"at most {MAX_FLEX:g} mm on a rigid body"
            remedy = "Leave that row out, or check the points."
            raise InputError("three points", found, expected, remedy)
        centres = points.mean(axis=1, keepdims=True)
        given = self._first - self._first.mean(axis=0)
        # each row's turn of the first triangle: U diag(1, 1, det) V' of the points' covariance
        u, _, vt = np.linalg.svd(np.swapaxes(points - centres, 1, 2) @ given)
        u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]
        turns = u @ vt
        corner = turns @ given[0]
        poses = Rotation.from_matrix(turns @ self._first_R_body)
        return centres[:, 0] + corner, poses.as_quat(scalar_first=True)


def _sides(points: Array) -> Array:
    """Lengths of the sides, (m, 3), of triangles (m, 3, 3)."""
    return np.asarray(np.linalg.norm(points - np.roll(points, 1, axis=1), axis=2))
