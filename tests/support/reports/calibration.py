"""A rig calibrated on paper: boards placed by a recipe, corners from OpenCV's projection.

Nothing is adjusted: the rig is the true one, the residuals are the noise, and the covariance is
linear theory's for these boards, from differences of OpenCV's projection.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from robots.transforms import carry
from tests.support.boards.board_images import picture
from tests.support.leds.scene import moved
from tests.support.scene import move_camera, project
from verify.calibration.stereo.records import Calibration, Residuals, state_covariance
from verify.core.fiducials import Board
from verify.core.records import Array, Image
from verify.core.rig import Camera, Rig

SIZE = (1280, 720)
BOARD = Board(columns=9, rows=7, square=0.04)
NOISE = 0.05  # px, each coordinate
STEP = 1e-6  # SI units and pixels
KEYS = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2")
MOUNT = ("mount_x_mm", "mount_y_mm", "mount_z_mm", "mount_rx_deg", "mount_ry_deg", "mount_rz_deg")
GAUGE = tuple(
    f"{side}.{key}"
    for side in ("left", "right")
    for key in (
        *(f"pan_center_{axis}_mm" for axis in "xyz"),
        *(f"pan_axis_r{axis}_deg" for axis in "xz"),
        "pan_zero_deg",
    )
)


def make_rig() -> Rig:
    """Two webcams 170 mm apart, toed in by 7.5° each; the left camera's frame is the rig's."""
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([0.4, -15.0, -0.3], degrees=True).as_matrix()
    turn[:3, 3] = [0.1685, 0.0012, 0.0224]
    left = _camera((1012.4, 1011.1, 646.3, 355.2), (-0.085, 0.06, 0.0006, -0.0004), np.eye(4))
    right = _camera((1008.7, 1007.9, 634.8, 363.6), (-0.079, 0.052, -0.0005, 0.0007), turn)
    return Rig(SIZE, left, right, np.full((4, 4), np.nan), base_source="")


def _camera(
    k: tuple[float, float, float, float], lens: tuple[float, float, float, float], mount: Array
) -> Camera:
    matrix = np.array([[k[0], 0.0, k[2]], [0.0, k[1], k[3]], [0.0, 0.0, 1.0]])
    return Camera(matrix, np.array([*lens, 0.0]), np.zeros(3), np.array([0.0, 1, 0]), 0.0, mount)


def place_boards(
    count: int = 20, tilt_deg: float = 35.0, depth: tuple[float, float] = (0.7, 1.3)
) -> Array:
    """Boards spread over the field, (b, 4, 4), rig_T_board, at random, always the same."""
    share = np.random.default_rng(11).random((count, 6))
    placed = np.tile(np.eye(4), (count, 1, 1))
    for pose, s in zip(placed, share, strict=True):
        z = depth[0] + (depth[1] - depth[0]) * s[0]
        angles = (s[1:4] * 2 - 1) * [tilt_deg, tilt_deg, 20.0]
        turn = Rotation.from_euler("xyz", angles, degrees=True)
        reach = np.array([0.70 * z - 0.08, 0.37 * z - 0.06, 0.0])
        middle = [0.085, 0.0, z] + reach * [2 * s[4] - 1, 2 * s[5] - 1, 0.0]
        pose[:3, :3] = turn.as_matrix()
        pose[:3, 3] = middle - turn.apply(BOARD.points.mean(axis=0))
    return placed


@cache
def calibration(seed: int = 3, count: int = 20, tilt_deg: float = 35.0) -> Calibration:
    """Pairs of boards with NOISE at each corner; corners outside the image are not seen."""
    rig, boards = make_rig(), place_boards(count, tilt_deg)
    random = np.random.default_rng(seed)
    parts: list[Array] = []
    for camera, own in enumerate((rig.left, rig.right)):
        for frame, board in enumerate(boards):
            exact = _corners(own, board)
            seen = np.all((exact > 2) & (exact < np.array(SIZE) - 3), axis=1)
            corner = np.flatnonzero(seen)
            noise = random.normal(0, NOISE, (len(corner), 2))
            names = np.column_stack([np.full_like(corner, camera), np.full_like(corner, frame)])
            parts.append(np.column_stack([names, corner, exact[corner] + noise, noise]))
    rows = np.concatenate(parts)
    residuals = Residuals(
        camera=rows[:, 0].astype(np.int64),
        frame=rows[:, 1].astype(np.int64),
        corner=rows[:, 2].astype(np.int64),
        observed=rows[:, 3:5],
        residual=rows[:, 5:7],
        uncertainty=np.full(len(rows), NOISE),
        used=np.ones(len(rows), dtype=bool),
    )
    names, full, board_covariance = _linear_theory(rig, boards, residuals)
    degrees = 2 * len(rows) - len(names) - 6 * count
    return Calibration(
        rig=replace(rig, covariance=state_covariance(names, full, degrees)),
        board=BOARD,
        frames=np.arange(count),
        rig_T_board=boards,
        board_covariance=board_covariance,
        residuals=residuals,
        noise=1.3,
        degrees_of_freedom=degrees,
        fixed=(*GAUGE, *(f"left.{key}" for key in MOUNT), "left.k3", "right.k3"),
        decisions=("k3 is held at zero: with it the fit gets better by less than it costs.",),
        square_found=(0.040004, 0.000003, 0.00004),
        turning=False,
    )


def _corners(camera: Camera, rig_T_board: Array) -> Array:
    """Corners by OpenCV, (n, 2), px."""
    return project(camera, 0.0, carry(rig_T_board, BOARD.points))


def _linear_theory(
    rig: Rig, boards: Array, residuals: Residuals
) -> tuple[tuple[str, ...], Array, Array]:
    """Names and covariance of the cameras' parameters, SI, and (b, 6, 6) of the boards'."""
    own_keys = (("left", rig.left, KEYS), ("right", rig.right, (*KEYS, *MOUNT)))
    names = tuple(f"{side}.{key}" for side, _, keys in own_keys for key in keys)
    p = len(names)
    normal = np.zeros((p + 6 * len(boards),) * 2)
    for i, (_, camera, keys) in enumerate(own_keys):
        cameras = [[move_camera(camera, key, s) for s in (STEP, -STEP)] for key in keys]
        place = i * len(KEYS)
        for frame, board in enumerate(boards):
            moves = STEP * np.eye(6)
            moved_boards = [[moved(board, s * m[:3], s * m[3:]) for s in (1, -1)] for m in moves]
            corner = residuals.corner[(residuals.camera == i) & (residuals.frame == frame)]
            by_camera = [[_corners(c, board)[corner] for c in each] for each in cameras]
            by_board = [[_corners(camera, b)[corner] for b in each] for each in moved_boards]
            rows = np.zeros((2 * len(corner), len(normal)))
            rows[:, place : place + len(keys)] = _slopes(by_camera)
            rows[:, p + 6 * frame : p + 6 * frame + 6] = _slopes(by_board)
            normal += rows.T @ rows / NOISE**2
    full = np.linalg.inv(normal)
    starts = range(p, len(full), 6)
    return names, full[:p, :p], np.array([full[s : s + 6, s : s + 6] for s in starts])


def _slopes(ends: list[list[Array]]) -> Array:
    """Derivatives (2n, k) from corners (k, 2, n, 2) a step on and a step back."""
    forth, back = np.moveaxis(np.array(ends), 1, 0).reshape(2, len(ends), -1)
    return (forth - back).T / (2 * STEP)


def with_poor_view(found: Calibration, frame: int = 4, camera: int = 1) -> Calibration:
    """Make one view's residuals five times as large, and have two of its corners refused."""
    bad = (found.residuals.camera == camera) & (found.residuals.frame == frame)
    used = found.residuals.used.copy()
    used[np.flatnonzero(bad)[:2]] = False
    residual = np.where(bad[:, None], 5.0, 1.0) * found.residuals.residual
    return replace(found, residuals=replace(found.residuals, residual=residual, used=used))


def pictures(found: Calibration, frame: int = 0) -> tuple[Image, Image]:
    """A chessboard as both cameras would see it, without noise."""
    left, right = (
        picture(found.board, camera, np.linalg.inv(camera.mount) @ found.rig_T_board[frame], None)
        for camera in (found.rig.left, found.rig.right)
    )
    return left, right


INPUTS: Mapping[str, str] = {
    "board.toml": "sha256:" + "3f" * 32,
    "left/000000.png": "sha256:" + "a1" * 32,
    "right/000000.png": "sha256:" + "b2" * 32,
}
