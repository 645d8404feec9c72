"""Compile everything that numba compiles, so that no first run waits for it.

python -m verify.compile_ahead     after an installation
"""

import sys
import time

import numpy as np

from verify.analysis.warm_up import warm_up, warm_up_comparison
from verify.calibration.corners.find import refine_corners
from verify.calibration.stereo.bundle import normal_equations
from verify.calibration.stereo.calibrate import stack_corners
from verify.calibration.stereo.gauge import BASE_FIXED, AdjustmentModel
from verify.calibration.stereo.parameters import N_ERRORS, BundleState
from verify.core.fiducials import Board, BoardPair, BoardView
from verify.core.rig import Camera

SQUARE_PX = 20.0  # px


def compile_ahead() -> None:
    """Compile what watching a robot takes, and what a first report and calibration would."""
    warm_up()
    warm_up_comparison()
    _compile_calibration()


def _still_camera() -> Camera:
    return Camera(np.eye(3), np.zeros(5), np.zeros(3), np.array([0.0, 1.0, 0.0]), 0.0, np.eye(4))


def _compile_calibration() -> None:
    """A picture without a corner, and a pair of a board that stands before one camera twice."""
    board, corner = Board(3, 3, 1.0), np.arange(9)
    places = SQUARE_PX * (1 + board.points[:, :2])
    refine_corners(np.zeros((80, 80), dtype=np.uint8), board, corner, places)
    view = BoardView(corner, places, np.tile(np.eye(2), (9, 1, 1)))
    corners = stack_corners([BoardPair(0, 0.0, 0.0, view, view)], board)
    ahead = np.eye(4)[None].copy()
    ahead[0, 2, 3] = 1.0
    state = BundleState(_still_camera(), _still_camera(), ahead, np.zeros((1, N_ERRORS)))
    normal_equations(state, corners, AdjustmentModel((BASE_FIXED, BASE_FIXED)), np.ones(18))


if __name__ == "__main__":
    begin = time.monotonic()
    sys.stdout.write("Compiling inner loops.\n")
    sys.stdout.flush()
    compile_ahead()
    sys.stdout.write(f"Compiled in {time.monotonic() - begin:.0f} s.\n")
