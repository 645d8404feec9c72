"""Bad corners: weighed down while the adjustment still moves, refused once it stands.

The scale check: do triangulated squares have the size that the board claims?
"""

import numpy as np
from numpy.typing import NDArray

from verify.calibration.stereo import bundle
from verify.calibration.stereo.gauge import AdjustmentModel
from verify.calibration.stereo.parameters import BundleState, CornerStack
from verify.core.fiducials import Board
from verify.core.records import Array
from verify.measurement.triangulation import ray_midpoints, rays

MEDIAN_CHI2 = 1.386  # of chi² with two degrees of freedom
CAUCHY_SCALE = 3.0  # standard deviations at which a corner weighs half
MAX_ROUNDS = 8
TOL_COST = 0.01  # share of the cost: what is left, the adjustment with equal weights mends
MAX_FALSE_REFUSALS = 0.01  # expected in a whole calibration whose noise is normal


def robust_scale(squares: Array) -> float:
    """Variance factor of corners from the median of their squared distances (n,)."""
    return float(np.median(squares)) / MEDIAN_CHI2 if len(squares) else 1.0


def adjust_cauchy(state: BundleState, corners: CornerStack, model: AdjustmentModel) -> BundleState:
    """Adjust with Cauchy's weights, so that no single corner steers the start."""
    before = np.inf
    for _ in range(MAX_ROUNDS):
        squares = bundle.squared_distances(state, corners)
        factor = max(robust_scale(squares), 1e-12)
        weight = 1 / (1 + squares / (CAUCHY_SCALE**2 * factor))
        state = bundle.adjust(state, corners, model, weight, iterations=4)
        now = float(
            np.sum(np.log1p(bundle.squared_distances(state, corners) / (CAUCHY_SCALE**2 * factor)))
        )
        if abs(before - now) < TOL_COST * now:
            break
        before = now
    return state


def good_corners(state: BundleState, corners: CornerStack) -> NDArray[np.bool_]:
    """Tell the corners that the others of their own view do not contradict, (n,).

    A view's own scatter is the yardstick where it is above the others': a blurred picture is not
    refused corner by corner, which would leave its luckiest ones and too small an uncertainty.
    """
    squares = bundle.squared_distances(state, corners)
    limit = 2 * np.log(len(corners) / MAX_FALSE_REFUSALS)  # chi² with two degrees of freedom
    view = 2 * corners.board + corners.camera
    yardstick = np.full(len(corners), max(robust_scale(squares), 1e-12))
    for v in np.unique(view):
        own = view == v
        yardstick[own] = np.maximum(yardstick[own], robust_scale(squares[own]))
    kept: NDArray[np.bool_] = squares < limit * yardstick
    return kept


def adjust_robust(
    state: BundleState, corners: CornerStack, model: AdjustmentModel
) -> tuple[BundleState, NDArray[np.bool_]]:
    """Adjust with equal weights on the corners that are good, and say which those are."""
    used = good_corners(state, corners)
    for _ in range(3):  # a corner that was refused may come back once the state is better
        state = bundle.adjust(state, corners, model, used.astype(float))
        again = good_corners(state, corners)
        if np.array_equal(again, used):
            break
        used = again
    return state, used


def square_edges(
    state: BundleState, corners: CornerStack, used: NDArray[np.bool_], board: Board
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
    state: BundleState, corners: CornerStack, rows: NDArray[np.bool_], pair: int, board: Board
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
        points[both] = ray_midpoints(*lines[0], *lines[1])[0]
    return points
