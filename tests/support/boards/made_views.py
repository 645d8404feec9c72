"""Pairs of board views from a known rig; pixels by OpenCV, not our code."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from tests.support.scene import project
from verify.calibration.corners.find import find_board
from verify.core.fiducials import Board, BoardPair, BoardView
from verify.core.records import Array, Image
from verify.core.rig import Camera, Rig

BOARD = Board(columns=9, rows=7, square=0.04)
SIZE = (1280, 720)
SIGMA = 0.04  # px, of a corner's coordinate


def fixed_rig(toe_in_deg: float = 7.5, baseline: float = 0.17) -> Rig:
    """Bases that never turn; the mean of the cameras' y axes has no z component."""
    sides = []
    for sign, fy, bend in ((-1, 1011.1, 0.01), (1, 1012.9, -0.01)):
        matrix = np.array([[1012.4 - 2 * sign, 0, 640 + 6 * sign], [0, fy, 355.2], [0, 0, 1.0]])
        mount = np.eye(4)
        mount[:3, :3] = Rotation.from_rotvec([bend, -0.01, 0.015 * sign]).as_matrix()
        sides.append(
            Camera(
                matrix=matrix,
                distortion=np.array([-0.085, 0.06, 0.0006, -0.0004, 0.0]),
                pan_center=np.array([sign * baseline / 2, 0.0, 0.0]),
                pan_axis=np.array([0.0, 1.0, 0.0]),
                pan_zero=0.0,
                mount=mount,
                pan=-sign * np.deg2rad(toe_in_deg),
            )
        )
    return levelled(Rig(SIZE, sides[0], sides[1], np.full((4, 4), np.nan), ""), turning=False)


def levelled(rig: Rig, turning: bool) -> Rig:
    """Carry a rig whose pan centres lie on x into the frame that a calibration chooses.

    Turning about x makes the mean of the pan axes level (of the cameras' y axes, bases fixed);
    a turning mount keeps no turn about the axis and no offset along it, a fixed one no axis.
    """
    sides = [rig.left, rig.right]
    ups = [c.pan_axis if turning else c.rig_T_camera(c.pan)[:3, 1] for c in sides]
    up = ups[0] + ups[1]
    level = Rotation.from_rotvec([-np.arctan2(up[2], up[1]), 0.0, 0.0])
    for i, camera in enumerate(sides):
        mount = np.eye(4)
        if not turning:
            back = Rotation.from_rotvec([0.0, -camera.pan, 0.0])
            placed = Rotation.from_matrix(camera.rig_T_camera(camera.pan)[:3, :3])
            mount[:3, :3] = (back * level * placed).as_matrix()
            sides[i] = replace(camera, mount=mount)
            continue
        axis = level.apply(camera.pan_axis)
        turn = level * Rotation.from_matrix(camera.mount[:3, :3])
        spin = brentq(lambda s, a, t: a @ _spun(a, -s, t).as_rotvec(), -1, 1, (axis, turn), 1e-15)
        offset = level.apply(camera.mount[:3, 3])
        offset = Rotation.from_rotvec(-spin * axis).apply(offset - axis * (axis @ offset))
        mount[:3, :3], mount[:3, 3] = _spun(axis, -spin, turn).as_matrix(), offset
        sides[i] = replace(camera, pan_axis=axis, pan_zero=camera.pan_zero + spin, mount=mount)
    return replace(rig, left=sides[0], right=sides[1])


def _spun(axis: Array, angle: float, turn: Rotation) -> Rotation:
    return Rotation.from_rotvec(angle * axis) * turn


def turning_rig() -> Rig:
    """Bases with tilted axes, and cameras that are not on them."""
    sides = []
    plain = fixed_rig()
    for sign, camera in ((-1, plain.left), (1, plain.right)):
        axis = np.array([0.02 * sign, 1.0, 0.012 + 0.01 * sign])
        mount = np.eye(4)
        mount[:3, :3] = Rotation.from_rotvec([0.015, 0.01, -0.02 * sign]).as_matrix()
        mount[:3, 3] = [0.006 * sign, 0.003, 0.018]
        axis /= np.linalg.norm(axis)
        sides.append(replace(camera, pan_axis=axis, pan_zero=0.01 * sign, mount=mount))
    return levelled(Rig(SIZE, sides[0], sides[1], np.full((4, 4), np.nan), ""), turning=True)


def poses(
    rng: np.random.Generator, count: int, distance: tuple[float, float] = (0.75, 1.3)
) -> Array:
    """Boards that face the cameras with tilts all round, about the middle of the view."""
    found = np.tile(np.eye(4), (count, 1, 1))
    centre = np.array([(BOARD.columns - 1) / 2, (BOARD.rows - 1) / 2, 0.0]) * BOARD.square
    for pose in found:
        turn = rng.uniform(-1, 1, 3) * np.deg2rad([35, 35, 20])
        pose[:3, :3] = Rotation.from_euler("yxz", turn[[1, 0, 2]]).as_matrix()
        z = rng.uniform(*distance)
        middle = np.array([*(rng.uniform(-0.25, 0.25, 2) * [1.0, 0.6]), 1.0]) * z
        pose[:3, 3] = middle - pose[:3, :3] @ centre
    return found


def view(
    camera: Camera,
    pan: float,
    pose: Array,
    rng: np.random.Generator | None,
    sigma: float = SIGMA,
    board: Board = BOARD,
    stated: float = SIGMA,
) -> BoardView | None:
    """See a board by the corners that fall into the picture."""
    points_rig = board.points @ pose[:3, :3].T + pose[:3, 3]
    centre = project(camera, pan, points_rig)
    if rng is not None:
        centre = centre + rng.normal(0, sigma, centre.shape)
    inside = np.all((centre > 2) & (centre < np.array(SIZE) - 3), axis=1)
    if inside.sum() < 12:
        return None
    corner = np.flatnonzero(inside)
    covariance = np.tile(np.eye(2) * stated**2, (len(corner), 1, 1))
    return BoardView(corner, centre[corner], covariance)


def make_pairs(
    rig: Rig,
    boards: Array,
    rng: np.random.Generator | None,
    pan: Array | None = None,
    pan_error: Array | None = None,
    sigma: float = SIGMA,
    board: Board = BOARD,
    stated: float = SIGMA,
) -> list[BoardPair]:
    """Look at boards (b, 4, 4) with readings (b, 2), rad; the bases stand off them by an error."""
    readings = np.tile([rig.left.pan, rig.right.pan], (len(boards), 1)) if pan is None else pan
    true = readings if pan_error is None else readings + pan_error
    return [
        BoardPair(
            frame=i,
            pan_left=float(readings[i, 0]),
            pan_right=float(readings[i, 1]),
            left=view(rig.left, true[i, 0], pose, rng, sigma, board, stated),
            right=view(rig.right, true[i, 1], pose, rng, sigma, board, stated),
        )
        for i, pose in enumerate(boards)
    ]


def half_turned(seen: BoardView) -> BoardView:
    """Number the corners from the board's far end."""
    return replace(seen, corner=len(BOARD) - 1 - seen.corner)


def _grey(path: Path) -> Image:
    return np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), dtype=np.uint8)


def found_pairs(
    left: Sequence[Path], right: Sequence[Path], board: Board, pan: tuple[float, float] = (0.0, 0.0)
) -> list[BoardPair]:
    """Find the boards in pairs of pictures, or in one camera's; bases at one reading (rad)."""
    views = [[find_board(_grey(path), board) for path in side] for side in (left, right)]
    return [BoardPair(i, *pan, one, other) for i, (one, other) in enumerate(zip_longest(*views))]
