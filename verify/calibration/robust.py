"""Bad corners: weighed down while the adjustment still moves, refused once it stands."""

import numpy as np
from numpy.typing import NDArray

from verify.calibration import bundle
from verify.calibration.gauge import Model
from verify.calibration.parameters import Corners, State
from verify.records import Array

MEDIAN = 1.386  # of chi² with two degrees of freedom
CAUCHY = 3.0  # standard deviations at which a corner weighs half
ROUNDS = 8
SETTLED = 0.01  # share of the cost: what is left, the adjustment with equal weights mends
FALSE_REFUSALS = 0.01  # expected in a whole calibration whose noise is normal


def scale(squares: Array) -> float:
    """Variance factor of corners from the median of their squared distances (n,)."""
    return float(np.median(squares)) / MEDIAN if len(squares) else 1.0


def settle_roughly(state: State, corners: Corners, model: Model) -> State:
    """Adjust with Cauchy's weights, so that no single corner steers the start."""
    before = np.inf
    for _ in range(ROUNDS):
        squares = bundle.distances(state, corners)
        factor = max(scale(squares), 1e-12)
        weight = 1 / (1 + squares / (CAUCHY**2 * factor))
        state = bundle.adjust(state, corners, model, weight, iterations=4)
        now = float(np.sum(np.log1p(bundle.distances(state, corners) / (CAUCHY**2 * factor))))
        if abs(before - now) < SETTLED * now:
            break
        before = now
    return state


def good(state: State, corners: Corners) -> NDArray[np.bool_]:
    """Tell the corners that the others of their own view do not contradict, (n,).

    A view's own scatter is the yardstick where it is above the others': a blurred picture is not
    refused corner by corner, which would leave its luckiest ones and too small an uncertainty.
    """
    squares = bundle.distances(state, corners)
    limit = 2 * np.log(len(corners) / FALSE_REFUSALS)  # chi² with two degrees of freedom
    view = 2 * corners.board + corners.camera
    yardstick = np.full(len(corners), max(scale(squares), 1e-12))
    for v in np.unique(view):
        own = view == v
        yardstick[own] = np.maximum(yardstick[own], scale(squares[own]))
    kept: NDArray[np.bool_] = squares < limit * yardstick
    return kept


def adjust(state: State, corners: Corners, model: Model) -> tuple[State, NDArray[np.bool_]]:
    """Adjust with equal weights on the corners that are good, and say which those are."""
    used = good(state, corners)
    for _ in range(3):  # a corner that was refused may come back once the state is better
        state = bundle.adjust(state, corners, model, used.astype(float))
        again = good(state, corners)
        if np.array_equal(again, used):
            break
        used = again
    return state, used
