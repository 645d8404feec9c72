"""Whether the board is flat: a bow that all its pictures share bends focal lengths with it.

It shifts the same corners of every picture alike, so the pictures' scatter does not show it. Its
height as a quadratic over the board, beside everything else, does.
"""

from dataclasses import dataclass, replace

import numpy as np

from verify.board import Board
from verify.calibration import bundle
from verify.calibration.estimate import Estimate, estimate, inverted
from verify.calibration.parameters import Corners
from verify.distributions import chi2_isf
from verify.records import Array

CHANCE = 1e-3  # that a flat board seems bowed
ROUNDS = 4
SETTLED = 0.05  # of a mode's standard uncertainty


@dataclass(frozen=True, slots=True)
class Bow:
    """Height of the board's middle over its rim; x², xy and y² over half its larger side."""

    height: Array  # (3,), m, of each mode, into the board
    covariance: Array  # (3, 3)
    response: Array  # (44, 3), how the rig's parameters move with a metre of each

    @property
    def sentence(self) -> str:
        """Say it to the reader."""
        size = 1e3 * float(np.abs(self.height).max())
        return (
            f"the board is not flat: it bows by {size:.2f} mm between its middle and its rim, "
            "which was fitted along; a flat, stiff board is better."
        )


def straightened(
    found: Estimate, corners: Corners, board: Board
) -> tuple[Estimate, Corners, Bow | None]:
    """Fit the board's bow along, where the pictures show one that chance seldom makes."""
    modes = _modes(corners, board)
    fitted = _fit(found, corners, modes)
    z2 = float(fitted.height @ np.linalg.solve(fitted.covariance, fitted.height))
    if z2 <= chi2_isf(CHANCE, 3):
        return found, corners, None
    so_far = np.linalg.lstsq(modes, corners.point[:, 2], rcond=None)[0]
    height = np.asarray(so_far, dtype=np.float64)
    for _ in range(ROUNDS):
        height = height + fitted.height
        bent = corners.point.copy()
        bent[:, 2] = modes @ height
        corners = replace(corners, point=bent)
        state = bundle.adjust(found.state, corners, found.model, found.used.astype(float))
        found = estimate(state, corners, found.model, found.used)
        fitted = _fit(found, corners, modes)
        if np.all(np.abs(fitted.height) < SETTLED * np.sqrt(np.diag(fitted.covariance))):
            break
    return found, corners, replace(fitted, height=height)


def restated(bow: Bow, found: Estimate, corners: Corners, board: Board) -> Bow:
    """The same bow with covariance and response in the model that was settled on."""
    return replace(_fit(found, corners, _modes(corners, board)), height=bow.height)


def _modes(corners: Corners, board: Board) -> Array:
    xy = corners.point[:, :2] - board.points[:, :2].mean(axis=0)
    x, y = (xy / (np.ptp(board.points[:, :2], axis=0).max() / 2)).T
    return np.stack([x * x, x * y, y * y], axis=1)


def _fit(found: Estimate, corners: Corners, modes: Array) -> Bow:
    """One step of the modes with rig and boards eliminated."""
    by_rig, by_board = bundle.derivatives(found.state, corners)
    root = corners.root * found.used[:, None, None]
    normal_to = found.state.boards[corners.board][:, :3, 2]
    by_height = np.einsum("nij,nj->ni", by_board[:, :, :3], normal_to)
    shape = np.einsum("nij,njk->nik", root, by_height[:, :, None] * modes[:, None, :])
    rig, own = root @ by_rig @ found.basis, root @ by_board
    seen = corners.seen - bundle.predict(found.state, corners)
    residual = np.einsum("nij,nj->ni", root, np.nan_to_num(seen))
    count = found.basis.shape[1]
    full, pull = np.zeros((count + 3, count + 3)), np.zeros(count + 3)
    for b in range(len(found.state.boards)):
        mine = corners.board == b
        g = np.concatenate([rig[mine], shape[mine]], axis=2).reshape(-1, count + 3)
        a, r = own[mine].reshape(-1, own.shape[2]), residual[mine].ravel()
        across = a.T @ g
        inverse = found.system.own[b]
        full += g.T @ g - across.T @ inverse @ across
        pull += g.T @ r - across.T @ inverse @ found.system.own_gradient[b]
    both = inverted(full)
    step = both @ pull
    covariance = found.noise**2 * both[count:, count:]
    moved = -found.basis @ inverted(full[:count, :count]) @ full[:count, count:]
    return Bow(step[count:], covariance, moved)
