"""A calibrated pair of webcams: boards placed by a recipe, corners from OpenCV's projection."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from tests.support.boards.board_images import picture
from tests.support.boards.made_views import BOARD, SIZE, fixed_rig, make_pairs
from verify.calibration.stereo.calibrate import calibrate
from verify.calibration.stereo.records import Calibration
from verify.core.records import Array, Image

NOISE = 0.05  # px, each coordinate


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
        middle = [0.0, 0.0, z] + reach * [2 * s[4] - 1, 2 * s[5] - 1, 0.0]
        pose[:3, :3] = turn.as_matrix()
        pose[:3, 3] = middle - turn.apply(BOARD.points.mean(axis=0))
    return placed


@cache
def calibration(seed: int = 3, count: int = 20, tilt_deg: float = 35.0) -> Calibration:
    """Pairs of boards with NOISE at each corner; corners outside the image are not seen."""
    rng, boards = np.random.default_rng(seed), place_boards(count, tilt_deg)
    rig = fixed_rig()
    at_rest = np.tile([rig.left.pan, rig.right.pan], (count, 1))  # and every reading is zero
    pairs = make_pairs(rig, boards, rng, 0 * at_rest, at_rest, sigma=NOISE, stated=NOISE)
    return calibrate(pairs, BOARD, SIZE)


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
