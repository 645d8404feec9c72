"""The scale check: do triangulated squares have the size that the board claims?"""

import numpy as np
from numpy.typing import NDArray

from verify.board import Board
from verify.calibration.parameters import Corners, State
from verify.records import Array
from verify.triangulation import meet, rays


def edges(
    state: State, corners: Corners, used: NDArray[np.bool_], board: Board
) -> tuple[float, float, float]:
    """Triangulate the corners that both cameras saw and measure the squares' edges.

    Returns:
        Mean edge, its standard uncertainty from how the pairs' means scatter, and the standard
        deviation of single edges, m; NaN where no pair shows two neighbouring corners twice.
    """
    found = []
    for pair in range(len(state.boards)):
        points = _triangulated(state, corners, used & (corners.board == pair), pair, board)
        grid = points.reshape(board.rows, board.columns, 3)
        along = np.linalg.norm(np.diff(grid, axis=1), axis=-1).ravel()
        down = np.linalg.norm(np.diff(grid, axis=0), axis=-1).ravel()
        lengths = np.concatenate([along, down])
        found.append(lengths[np.isfinite(lengths)])
    found = [lengths for lengths in found if len(lengths)]
    if not found:
        return float("nan"), float("nan"), float("nan")
    every = np.concatenate(found)
    means = np.array([lengths.mean() for lengths in found])
    scatter = float(means.std(ddof=1) / np.sqrt(len(means))) if len(means) > 1 else float("nan")
    return float(every.mean()), scatter, float(every.std(ddof=1))


def _triangulated(
    state: State, corners: Corners, rows: NDArray[np.bool_], pair: int, board: Board
) -> Array:
    """Corners of one pair in the rig, (corners of the board, 3), NaN where not seen twice."""
    seen = np.full((2, len(board), 2), np.nan)
    seen[corners.camera[rows], corners.corner[rows]] = corners.seen[rows]
    both = np.flatnonzero(np.isfinite(seen).all(axis=(0, 2)))
    points = np.full((len(board), 3), np.nan)
    if len(both):
        lines = [
            rays(camera, corners.pan[pair, side] + state.pan_error[pair, side], seen[side, both])
            for side, camera in enumerate(state.cameras)
        ]
        points[both] = meet(*lines[0], *lines[1])[0]
    return points
