"""Order of a grid of corners, and the smooth map from a board to one image of it.

The map carries board coordinates s (2), in squares from the first corner, to pixels:

    x = scale * w (1 + k_1 |w|² + k_2 |w|⁴) + middle,    w = homography(h; s)

    0 - 7   h, homography without its last entry
    8, 9    k_1, k_2, prior 0 ± PRIOR_RADIAL

It serves the surroundings of corners, not the calibration.
"""

import itertools
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import least_squares

from verify.core.records import Array, Flags, Image

PRIOR_RADIAL = 0.3  # at half the image's width: a strongly distorting lens
PRIOR_RESIDUAL = 0.5  # px: how well few corners would have to fit before they speak on the lens
STEP = 0.05  # squares, of numerical derivatives
# squares from a corner, diagonally, where its four squares' brightness is read
SAMPLE_OFFSET = 0.25
AROUND = SAMPLE_OFFSET * np.array([[-1, -1], [1, 1], [-1, 1], [1, -1]])
# white, white, white, black, as at a board's rim, makes 1.0; a crossing far more
MIN_CROSSING_CONTRAST = 1.4
MIN_LINE_SHARE = 0.6  # of a row's or column's corners: some may be covered or in glare
Block = tuple[int, int, int, int]  # of corners: x and y of the first, columns, rows


@dataclass(frozen=True, slots=True)
class CornerMap:
    """The map from squares to pixels."""

    parameters: Array  # (10,), homography without its last entry, r² and r⁴ terms
    middle: Array  # (2,), px, of the image, which stands in for the lens's axis
    scale: float  # px

    def __call__(self, squares: Array) -> Array:
        """Carry points of the board (n, 2), in squares from the first corner, to pixels (n, 2)."""
        return _apply_map(self.parameters, squares) * self.scale + self.middle

    def jacobian(self, squares: Array) -> Array:
        """Derivative d px / d squares, (n, 2, 2), columns along the board's x and y."""
        sides = [(self(squares + e) - self(squares - e)) / (2 * STEP) for e in np.eye(2) * STEP]
        return np.stack(sides, axis=-1)

    def bend(self, squares: Array) -> Array:
        """Second derivatives along the board's x and along its y, px, (n, 2, 2) in columns."""
        here = self(squares)
        sides = [
            (self(squares + e) - 2 * here + self(squares - e)) / STEP**2 for e in np.eye(2) * STEP
        ]
        return np.stack(sides, axis=-1)


def fit_map(squares: Array, pixels: Array, shape: tuple[int, ...]) -> CornerMap | None:
    """Fit the map of squares (n, 2) to pixels (n, 2); None where they determine no homography.

    At least four corners, not three on a line; the shape is the image's.
    """
    middle = np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2])
    scale = max(shape[:2]) / 2
    normalised = (pixels - middle) / scale
    homography, _ = cv2.findHomography(squares, normalised)
    if homography is None or abs(homography[2, 2]) < 1e-9:
        return None
    start = np.append(homography.ravel()[:8] / homography[2, 2], [0.0, 0.0])
    weight = PRIOR_RESIDUAL / scale / PRIOR_RADIAL

    def misses(parameters: Array) -> Array:
        off = _apply_map(parameters, squares) - normalised
        return np.concatenate([off.ravel(), weight * parameters[8:]])

    def slopes(parameters: Array) -> Array:
        return np.vstack([_map_slopes(parameters, squares), weight * np.eye(2, 10, 8)])

    found = least_squares(misses, start, jac=slopes, method="lm", x_scale="jac")
    return CornerMap(np.asarray(found.x), middle, scale)


def _apply_map(parameters: Array, squares: Array) -> Array:
    flat = squares @ parameters[[[0, 3], [1, 4]]] + parameters[[2, 5]]
    xy = flat / (squares @ parameters[6:8] + 1)[:, None]
    r2 = (xy[:, 0] ** 2 + xy[:, 1] ** 2)[:, None]
    return np.asarray(xy * (1 + r2 * (parameters[8] + r2 * parameters[9])))


def _map_slopes(parameters: Array, squares: Array) -> Array:
    """Derivative of `_apply_map` by its parameters, (2 n, 10)."""
    k1, k2 = parameters[8:]
    across = np.column_stack([squares, np.ones(len(squares))])
    across /= (squares @ parameters[6:8] + 1)[:, None]
    xy = across @ parameters[[[0, 3], [1, 4], [2, 5]]]
    r2 = (xy[:, 0] ** 2 + xy[:, 1] ** 2)[:, None]
    radial, by_r2 = 1 + r2 * (k1 + r2 * k2), 2 * (k1 + 2 * k2 * r2)
    slopes = np.empty((len(squares), 2, 10))
    for axis in range(2):
        by_xy = by_r2 * xy[:, axis, None] * xy
        by_xy[:, axis] += radial[:, 0]
        slopes[:, axis, :3] = by_xy[:, :1] * across
        slopes[:, axis, 3:6] = by_xy[:, 1:] * across
    slopes[:, :, 6:8] = -((radial + by_r2 * r2) * xy)[:, :, None] * across[:, None, :2]
    slopes[:, :, 8:] = xy[:, :, None] * np.stack([r2, r2 * r2], axis=2)
    return slopes.reshape(-1, 10)


def block_points(block: Block) -> Array:
    """Board coordinates of a block of corners, (columns * rows, 2), squares, along x first."""
    x0, y0, columns, rows = block
    y, x = np.mgrid[:rows, :columns]
    return np.stack([x.ravel() + x0, y.ravel() + y0], axis=1).astype(float)


def fit_grid_map(grey: Image, grid: Array) -> CornerMap | None:
    """Fit the map to a grid (rows, columns, 2), px, that starts at the first corner."""
    rows, columns = grid.shape[:2]
    return fit_map(block_points((0, 0, columns, rows)), grid.reshape(-1, 2), grey.shape)


def crossings(grey: Image, places: Array) -> tuple[Array, Flags]:
    """Contrast of crossings, and whether each is one, by places in their four squares (..., 4, 2).

    The squares, px in the image (h, w), in order: lower x and y, higher ones, lower x and higher y,
    higher x and lower y. Contrast (...), half the difference of both diagonals, DN, is positive
    where the first square is among the brighter ones, nan outside the image. It must be a crossing
    where opposite squares agree well enough.
    """
    height, width = grey.shape
    inside = ((places >= 0) & (places <= [width - 1, height - 1])).all(axis=(-1, -2))
    soft = cv2.blur(grey, (3, 3))
    x, y = (places[..., k].reshape(-1, 4).astype(np.float32) for k in (0, 1))
    read = cv2.remap(soft, x, y, cv2.INTER_LINEAR).astype(float).reshape(places.shape[:-1])
    contrast = (read[..., 0] + read[..., 1] - read[..., 2] - read[..., 3]) / 4
    noise = 2.0  # DN
    unlike = np.abs(read[..., 0] - read[..., 1]) + np.abs(read[..., 2] - read[..., 3]) + noise
    contrast[~inside] = np.nan
    return contrast, inside & (4 * np.abs(contrast) > MIN_CROSSING_CONTRAST * unlike)


def block_crossings(grey: Image, grid_map: CornerMap, block: Block) -> tuple[Array, Flags]:
    """Contrast of a block's crossings, and whether each is one, (rows, columns)."""
    around = (block_points(block)[:, None] + AROUND).reshape(-1, 2)
    return crossings(grey, grid_map(around).reshape(block[3], block[2], 4, 2))


def is_whole(grey: Image, grid_map: CornerMap, columns: int, rows: int) -> bool:
    """Whether corners from the map's first one on are a chessboard and no part of a larger one."""
    contrast, there = block_crossings(grey, grid_map, (-1, -1, columns + 2, rows + 2))
    inner, edges = slice(1, -1), (slice(0, 1), slice(-1, None))
    around = [*((inner, edge) for edge in edges), *((edge, inner) for edge in edges)]
    return alternate(contrast[inner, inner], there[inner, inner]) and not any(
        alternate(contrast[line], there[line]) for line in around
    )


def has_crossings(grey: Image, grid_map: CornerMap, block: Block) -> bool:
    """Whether crossings are in every row and column of a block."""
    return alternate(*block_crossings(grey, grid_map, block))


def alternate(contrast: Array, there: Flags) -> bool:
    """Whether every row and column (rows, columns) has crossings whose colours alternate."""
    signed = _checkered(contrast)
    good = there & (signed * np.sign(signed.sum()) > 0)
    if min(good.shape) == 1:
        return bool(good.mean() >= MIN_LINE_SHARE)
    return bool(min(good.mean(axis=0).min(), good.mean(axis=1).min()) >= MIN_LINE_SHARE)


def _checkered(contrast: Array) -> Array:
    """Contrast (rows, columns) with every other sign changed; 0 where it is not known."""
    signed: Array = np.nan_to_num(contrast)
    signed[1::2, ::2] *= -1
    signed[::2, 1::2] *= -1
    return signed


def orient_grid(grey: Image, grid: Array, columns: int, rows: int) -> Array | None:
    """Put a found grid (r, c, 2), px, in any order, into the board's: (rows * columns, 2), x first.

    Columns are inner corners along the board's x. Of the orders that are not mirrored, those whose
    first square is black come before the others; where the pattern looks alike in several, the one
    that stands most nearly upright is taken. None where the grid has other counts.
    """
    along, down = (np.gradient(grid, axis=axis)[:, :, None] for axis in (1, 0))
    around = grid[:, :, None] + along * AROUND[:, :1] + down * AROUND[:, 1:]
    contrast, _ = crossings(grey, around)
    orders = []
    for mirrored, turns in itertools.product((False, True), range(4)):
        order, shown = (np.rot90(a[:, ::-1] if mirrored else a, turns) for a in (grid, contrast))
        # right-handed with the line of sight, or the view is mirrored
        steps = axes(order)
        if order.shape[:2] == (rows, columns) and np.linalg.det(steps) > 0:
            sign = -1 if (mirrored + turns) % 2 else 1  # each exchanges the diagonals
            first_is_black = bool(sign * _checkered(shown).sum() < 0)
            upright = np.trace(steps / np.linalg.norm(steps, axis=1, keepdims=True))
            orders.append((first_is_black, float(upright), order))
    best = max(orders, key=lambda one: one[:2], default=None)
    return None if best is None else np.ascontiguousarray(best[2].reshape(-1, 2))


def axes(grid: Array) -> Array:
    """Mean steps along the grid's x and y, (2, 2), px, in rows."""
    return np.stack([np.diff(grid, axis=k).mean(axis=(0, 1)) for k in (1, 0)])
