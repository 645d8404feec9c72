"""Order of a grid of corners, and the smooth map from a board to one image of it.

The map carries board coordinates s (2), in squares from the first corner, to pixels:

    x = scale * w (1 + k_1 |w|² + k_2 |w|⁴) + middle,    w = homography(h; s)

    0 - 7   h, homography without its last entry
    8, 9    k_1, k_2, prior 0 ± PRIOR_RADIAL

It serves the surroundings of corners, not the calibration.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from verify.core.records import Array, Image

PRIOR_RADIAL = 0.3  # at half the image's width: a strongly distorting lens
PRIOR_RESIDUAL = 0.5  # px: how well few corners would have to fit before they speak on the lens
STEP = 0.05  # squares, of numerical derivatives
# squares from a corner, diagonally, where its four squares' brightness is read
SAMPLE_OFFSET = 0.25
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
    r2 = np.sum(xy**2, axis=1, keepdims=True)
    bent: Array = xy * (1 + r2 * (parameters[8] + r2 * parameters[9]))
    return bent


def _map_slopes(parameters: Array, squares: Array) -> Array:
    """Derivative of `_apply_map` by its parameters, (2 n, 10)."""
    k1, k2 = parameters[8:]
    across = np.column_stack([squares, np.ones(len(squares))])
    across /= (squares @ parameters[6:8] + 1)[:, None]
    xy = across @ parameters[[[0, 3], [1, 4], [2, 5]]]
    slopes = np.zeros((len(squares), 2, 10))
    slopes[:, 0, :3] = slopes[:, 1, 3:6] = across
    slopes[:, :, 6:8] = -xy[:, :, None] * across[:, None, :2]
    r2 = np.sum(xy**2, axis=1)[:, None, None]
    squared = xy[:, :, None] * xy[:, None]
    by_xy = squared * (2 * k1 + 4 * k2 * r2) + np.eye(2) * (1 + r2 * (k1 + r2 * k2))
    found: Array = by_xy @ slopes
    found[:, :, 8:] = xy[:, :, None] * np.concatenate([r2, r2**2], axis=2)
    return found.reshape(-1, 10)


def block_points(block: Block) -> Array:
    """Board coordinates of a block of corners, (columns * rows, 2), squares, along x first."""
    x0, y0, columns, rows = block
    y, x = np.mgrid[:rows, :columns]
    return np.stack([x.ravel() + x0, y.ravel() + y0], axis=1).astype(float)


def fit_grid_map(grey: Image, grid: Array) -> CornerMap | None:
    """Fit the map to a grid (rows, columns, 2), px, that starts at the first corner."""
    rows, columns = grid.shape[:2]
    return fit_map(block_points((0, 0, columns, rows)), grid.reshape(-1, 2), grey.shape)


def crossings(grey: Image, grid_map: CornerMap, squares: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Contrast of the crossings at places (n, 2) of a board, in squares, and whether each is one.

    Contrast is half the difference of both diagonals (n,), DN, positive where the square with lower
    x and y is the brighter, nan outside the image (h, w). It must be a crossing where opposite
    squares agree well enough.
    """
    around = np.array([[-1, -1], [1, 1], [-1, 1], [1, -1]]) * SAMPLE_OFFSET
    places = grid_map((squares[:, None] + around).reshape(-1, 2)).reshape(-1, 4, 2)
    height, width = grey.shape
    inside = ((places >= 0) & (places <= [width - 1, height - 1])).all(axis=(1, 2))
    soft = cv2.blur(grey, (3, 3))
    x, y = (places[..., k].astype(np.float32) for k in (0, 1))
    read = cv2.remap(soft, x, y, cv2.INTER_LINEAR).astype(float)
    contrast = (read[:, 0] + read[:, 1] - read[:, 2] - read[:, 3]) / 4
    unlike = np.abs(read[:, 0] - read[:, 1]) + np.abs(read[:, 2] - read[:, 3]) + 2.0  # DN, noise
    contrast[~inside] = np.nan
    return contrast, inside & (4 * np.abs(contrast) > MIN_CROSSING_CONTRAST * unlike)


def alternating_crossings(grey: Image, grid_map: CornerMap, squares: Array) -> NDArray[np.bool_]:
    """Where crossings are whose colours alternate as most do, (n,)."""
    contrast, there = crossings(grey, grid_map, squares)
    parity = np.where(squares.sum(axis=1) % 2 == 0, 1, -1)
    sign = np.sign(np.nansum(parity * contrast))
    good: NDArray[np.bool_] = there & (np.nan_to_num(contrast) * parity * sign > 0)
    return good


def is_whole(grey: Image, grid: Array) -> bool:
    """Whether a grid (rows, columns, 2) is a chessboard and no part of a larger one."""
    rows, columns = grid.shape[:2]
    grid_map = fit_grid_map(grey, grid)
    if grid_map is None:
        return False
    return has_crossings(grey, grid_map, (0, 0, columns, rows)) and not any(
        has_crossings(grey, grid_map, line) for line in neighbour_lines(columns, rows)
    )


def neighbour_lines(columns: int, rows: int) -> list[Block]:
    """The columns left and right of a grid, and the rows above and below it."""
    return [(-1, 0, 1, rows), (columns, 0, 1, rows), (0, -1, columns, 1), (0, rows, columns, 1)]


def has_crossings(grey: Image, grid_map: CornerMap, block: Block) -> bool:
    """Whether crossings are in every row and column of a block."""
    columns, rows = block[2:]
    good = alternating_crossings(grey, grid_map, block_points(block)).reshape(rows, columns)
    if columns == 1 or rows == 1:
        return bool(good.mean() >= MIN_LINE_SHARE)
    return bool(min(good.mean(axis=0).min(), good.mean(axis=1).min()) >= MIN_LINE_SHARE)


def orient_grid(grey: Image, grid: Array, columns: int, rows: int) -> Array | None:
    """Put a found grid (r, c, 2), px, in any order, into the board's: (rows * columns, 2), x first.

    Columns are inner corners along the board's x. Of the orders that are not mirrored, those whose
    first square is black come before the others; where the pattern looks alike in several, the one
    that stands most nearly upright is taken. None where the grid has other counts.
    """
    orders = [np.rot90(side, k) for side in (grid, grid[:, ::-1]) for k in range(4)]
    orders = [o for o in orders if o.shape[:2] == (rows, columns) and is_right_handed(o)]
    if not orders:
        return None
    black = [o for o in orders if first_is_black(grey, o)]
    best = max(black or orders, key=uprightness)
    return np.ascontiguousarray(best.reshape(-1, 2))


def axes(grid: Array) -> Array:
    """Mean steps along the grid's x and y, (2, 2), px, in rows."""
    return np.stack([np.diff(grid, axis=k).mean(axis=(0, 1)) for k in (1, 0)])


def is_right_handed(grid: Array) -> bool:
    """Whether x, y and the line of sight are a right-handed frame: the view is not mirrored."""
    return bool(np.linalg.det(axes(grid)) > 0)


def uprightness(grid: Array) -> float:
    """How much x points right and y down."""
    steps = axes(grid)
    return float(np.trace(steps / np.linalg.norm(steps, axis=1, keepdims=True)))


def first_is_black(grey: Image, grid: Array) -> bool:
    """Whether the square before the first corner is black."""
    grid_map = fit_grid_map(grey, grid)
    if grid_map is None:
        return False
    squares = block_points((0, 0, grid.shape[1], grid.shape[0]))
    contrast, _ = crossings(grey, grid_map, squares)
    parity = np.where(squares.sum(axis=1) % 2 == 0, 1, -1)
    return bool(np.nansum(parity * contrast) < 0)
