"""What a calibration from boards found, and all that its report says."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.board import Board
from verify.records import Array
from verify.rig import Rig


@dataclass(frozen=True, slots=True)
class Residuals:
    """Every corner that entered the adjustment, one row each."""

    camera: NDArray[np.int64]  # (r,), 0 left, 1 right
    frame: NDArray[np.int64]  # (r,)
    corner: NDArray[np.int64]  # (r,), index into board.points
    seen: Array  # (r, 2), px
    residual: Array  # (r, 2), px, seen less predicted
    uncertainty: Array  # (r,), px a coordinate: as the corner finder stated it, times `noise`
    used: NDArray[np.bool_]  # (r,), false: refused as an outlier


@dataclass(frozen=True, slots=True)
class Calibration:
    """Two cameras and the boards they were calibrated with."""

    rig: Rig  # cameras and [covariance]; not registered: no robot base
    board: Board
    frames: NDArray[np.int64]  # (b,), pairs that were used
    rig_T_board: Array  # (b, 4, 4)
    board_covariance: Array  # (b, 6, 6), m and rad, perturbation on the left, rig axes
    residuals: Residuals
    noise: float  # what the corners' stated uncertainty had to be multiplied with
    degrees_of_freedom: int
    fixed: tuple[str, ...]  # parameters that the data do not determine, held: gauge, or k3 = 0
    decisions: tuple[str, ...]  # sentences: the model order chosen and why, pairs left out and why
    square_found: tuple[float, float, float]  # m: mean triangulated edge, its standard
    # uncertainty, standard deviation of single edges
    turning: bool  # the bases were turned between pairs: axes, centres and mounts are found
