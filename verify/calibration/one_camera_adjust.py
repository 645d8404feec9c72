"""One camera's lens and its boards' poses adjusted to the corners: the stereo rig's own algebra.

The camera stands in the left one's place; of its parameters the lens alone is free, and no view
of the right one is there (see `one_camera`).
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from verify.calibration import bundle, follow, gauge, order, robust
from verify.calibration.estimate import Estimate, taken_stock
from verify.calibration.gauge import FIXED, FOCAL_TIE, LENS_KEYS, Model
from verify.calibration.parameters import LENS, WIDTH, Corners, State, moved
from verify.records import Array

SIDE = "left"  # whose place the camera takes
ALL_LENS = LENS.stop  # fx, fy, cx, cy and the coefficients
NOT_THERE = tuple(name for name in order.shortest() if not name.startswith(SIDE))
MAY_GO = tuple(name for name in order.shortest() if name.startswith(SIDE))


def held_names(dropped: tuple[order.Dropped, ...]) -> tuple[str, ...]:
    """Name the coefficients that are held, as a model names them."""
    return tuple(d.name for d in dropped)


def settle_roughly(state: State, corners: Corners, held: tuple[str, ...]) -> State:
    """Adjust with Cauchy's weights, so that no single corner steers the start.

    Args:
        state: where to begin.
        corners: of all views.
        held: coefficients that stay 0, or focal lengths equal, as `order` names them.
    """
    before = np.inf
    for _ in range(robust.ROUNDS):
        squares = bundle.distances(state, corners)
        width = robust.CAUCHY**2 * max(robust.scale(squares), 1e-12)
        state = adjust(state, corners, held, 1 / (1 + squares / width), iterations=4)
        now = float(np.sum(np.log1p(bundle.distances(state, corners) / width)))
        if abs(before - now) < robust.SETTLED * now:
            break
        before = now
    return state


def adjust_good(
    state: State, corners: Corners, held: tuple[str, ...]
) -> tuple[State, NDArray[np.bool_]]:
    """Adjust on the corners that are good, as `robust.adjust` does for a rig.

    Returns:
        The state, and which corners those are, (n,).
    """
    used = robust.good(state, corners)
    for _ in range(3):
        state = adjust(state, corners, held, used.astype(float))
        again = robust.good(state, corners)
        if np.array_equal(again, used):
            break
        used = again
    return state, used


def estimate(
    state: State, corners: Corners, held: tuple[str, ...], used: NDArray[np.bool_]
) -> Estimate:
    """Take stock of an adjusted state, as `estimate.estimate` does for a rig.

    Args:
        state: adjusted.
        corners: of all views.
        held: what was held.
        used: (n,), corners that were not refused.
    """
    return taken_stock(state, corners, _model(held), used, _rows(held))


def reduce(found: Estimate, corners: Corners) -> tuple[Estimate, tuple[order.Dropped, ...]]:
    """Take away what the pictures do not support, one at a time, by the rule of `order`.

    Returns:
        The estimate without them, and what went.
    """
    gone: tuple[order.Dropped, ...] = ()
    while (weak := next(order.unsupported(found), None)) is not None:
        gone = (*gone, weak)
        weight = found.used.astype(float)
        state = adjust(found.state, corners, held_names(gone), weight, order.REFIT)
        found = estimate(state, corners, held_names(gone), found.used)
    return found, gone


def adjust(
    state: State,
    corners: Corners,
    held: tuple[str, ...],
    weight: Array,
    iterations: int = bundle.ITERATIONS,
) -> State:
    """Find the lens and the poses of least squares, as `bundle.adjust` does for a rig.

    Args:
        state: where to begin.
        corners: of all views.
        held: coefficients that stay 0, or focal lengths equal, as `order` names them.
        weight: (n,), of each corner, 0 to 1.
        iterations: at most.
    """
    rows, _ = _rows(held)
    basis, model = gauge.free_directions(rows), _model(held)
    state = _with_held(state, rows)
    here, damping = bundle.cost(state, corners, model, weight), 1e-4
    for _ in range(iterations):
        trial, promised = _stepped(state, corners, model, basis, weight, damping)
        there = bundle.cost(trial, corners, model, weight)
        gained = here - there
        if gained >= 0:
            state, here, damping = trial, there, damping / 10
        else:
            damping *= 10
        if promised < bundle.CONVERGED and gained < bundle.CONVERGED:
            break
    return state


def _stepped(
    state: State, corners: Corners, model: Model, basis: Array, weight: Array, damping: float
) -> tuple[State, float]:
    """One damped step, and by how much it should lower the cost."""
    system = bundle.normal(state, corners, model, weight, damping)
    full = system.information.sum(axis=0) + damping * np.diag(system.diagonal)
    matrix, gradient = basis.T @ full @ basis, system.gradient.sum(axis=0)
    scale = 1 / np.sqrt(np.diag(matrix))
    factor = cho_factor(matrix * np.outer(scale, scale) + 1e-14 * np.eye(len(matrix)))
    change = basis @ (scale * cho_solve(factor, scale * (basis.T @ gradient)))
    straight = np.einsum("bij,bj->bi", system.own, system.own_gradient)
    promised = float(gradient @ change + np.sum(system.own_gradient * straight))
    return follow.step(state, corners, change, straight - system.shared @ change), promised


def _with_held(state: State, rows: Array) -> State:
    """Bring the lens to where held coefficients are 0 and tied focal lengths equal."""
    camera, lens = state.left, np.zeros(2 * WIDTH)
    lens[:ALL_LENS] = *camera.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], *camera.distortion
    change = -np.linalg.pinv(rows) @ (rows @ lens)
    return replace(state, left=moved(camera, change[:WIDTH]))


def _rows(held: tuple[str, ...]) -> tuple[Array, dict[str, int]]:
    """What must stay 0 of a step: all but this camera's lens, and what is held of that."""
    unit = np.eye(2 * WIDTH)
    rows = [*unit[ALL_LENS:]]
    place: dict[str, int] = {}
    for name in held:
        key = name.partition(".")[2]
        place[name] = len(rows)
        rows.append(unit[1] - unit[0] if key == FOCAL_TIE else unit[LENS][LENS_KEYS.index(key)])
    return np.array(rows), place


def _model(held: tuple[str, ...]) -> Model:
    return Model((FIXED, FIXED), (*NOT_THERE, *held))
