"""Robust adjustment: gross errors get Cauchy weights at first and are refused in the end.

With the squared residual d² of a corner in its stated covariance and the variance factor s² from
the median of all d²:

    start    minimise sum of log(1 + d² / (3² s²)), by reweighting with 1 / (1 + d² / (3² s²))
    end      least squares on the corners with d² < chi²(p) s², s² that of their view if larger

p is such that one corner in a hundred calibrations with normal noise is refused.
"""

import numpy as np
from numpy.typing import NDArray

from verify.calibration.stereo import bundle
from verify.calibration.stereo.estimate import Estimate, estimate_state
from verify.calibration.stereo.gauge import AdjustmentModel
from verify.calibration.stereo.parameters import BundleState, CornerStack
from verify.core.records import Array

MEDIAN_CHI2 = 1.386  # of chi² with two degrees of freedom
CAUCHY_SCALE = 3.0  # standard deviations at which a corner weighs half
MAX_ROUNDS = 8
TOL_COST = 0.01  # share of the cost; the adjustment with equal weights does the rest
MAX_FALSE_REFUSALS = 0.01  # expected in a whole calibration whose noise is normal


def robust_scale(squares: Array) -> float:
    """Variance factor of corners from the median of their squared distances (n,)."""
    return float(np.median(squares)) / MEDIAN_CHI2 if len(squares) else 1.0


def adjust_cauchy(state: BundleState, corners: CornerStack, model: AdjustmentModel) -> BundleState:
    """Adjust with Cauchy weights, so that gross errors do not spoil the start."""
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
    """Select the corners that the others of their own view do not contradict, (n,).

    A view's own scatter counts where it is above the others': of a blurred image not most corners
    are refused, which would leave the few best and too small an uncertainty.
    """
    squares = bundle.squared_distances(state, corners)
    limit = 2 * np.log(len(corners) / MAX_FALSE_REFUSALS)  # chi² with two degrees of freedom
    view = 2 * corners.board + corners.camera
    scale = np.full(len(corners), max(robust_scale(squares), 1e-12))
    for v in np.unique(view):
        own = view == v
        scale[own] = np.maximum(scale[own], robust_scale(squares[own]))
    kept: NDArray[np.bool_] = squares < limit * scale
    return kept


def adjust_robust(state: BundleState, corners: CornerStack, model: AdjustmentModel) -> Estimate:
    """Adjust with equal weights on the good corners, refusing the others."""
    used = good_corners(state, corners)
    for _ in range(3):  # a refused corner may come back once the state is better
        state = bundle.adjust(state, corners, model, used.astype(float))
        again = good_corners(state, corners)
        if np.array_equal(again, used):
            break
        used = again
    return estimate_state(state, corners, model, used)
