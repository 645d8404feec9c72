"""A board in a fixture before two cameras."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tests.support.boards.made_views import view
from tests.support.scene import make_marker, make_rig
from verify.core.fiducials import Board, BoardPair
from verify.core.records import Array
from verify.core.rig import Covariance, Rig

BOARD = Board(columns=7, rows=5, square=0.03)
SIGMA = 0.03  # px, of a corner


def placed(x: float = -0.09, y: float = -0.06, z: float = 0.65) -> Array:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0.25, -0.3, 0.1]).as_matrix()
    pose[:3, 3] = [x, y, z]
    return pose


def pair(
    rig: Rig,
    rig_T_board: Array,
    rng: np.random.Generator | None = None,
    *,
    frame: int = 0,
    turn: float = 0.0,
    error: tuple[float, float] = (0.0, 0.0),
) -> BoardPair:
    """The board seen with both bases turned by `turn` from home, readings off by `error`, rad."""
    left, right = rig.left.pan + turn, rig.right.pan + turn
    views = (
        view(camera, pan + off, rig_T_board, rng, SIGMA, BOARD, SIGMA)
        for camera, pan, off in zip((rig.left, rig.right), (left, right), error, strict=True)
    )
    return BoardPair(frame, left, right, *views)


STATED = make_marker(led_standard_uncertainty=2e-5, centre_shift_standard_uncertainty=1e-5)


def doubtful_rig() -> Rig:
    names = tuple(f"right.mount_r{axis}_deg" for axis in "xyz")
    return replace(make_rig(), covariance=Covariance(names, np.full(3, 0.005), np.eye(3)))


def board_pairs(true: Rig, count: int = 1) -> list[BoardPair]:
    rng = np.random.default_rng(0)
    return [pair(true, placed(z=0.6 + 0.02 * i), rng, frame=i) for i in range(count)]
