"""Which corner of a grid is which: handedness, colours, and the right way up."""

import cv2
import numpy as np
from numpy.typing import NDArray

from verify.calibration.corner_map import CornerMap, fit_map
from verify.records import Array, Image

QUARTER = 0.25  # squares from a corner, diagonally, where its four squares' brightness is read
CLEAR = 1.4  # white, white, white, black, as at a board's rim, makes 1.0; a crossing far more
MAJORITY = 0.6  # of a row's or column's corners: some may be covered or in glare


def indices(columns: int, rows: int) -> Array:
    """Board coordinates of the inner corners in squares, (columns * rows, 2), along x first."""
    y, x = np.mgrid[:rows, :columns]
    return np.stack([x.ravel(), y.ravel()], axis=1).astype(float)


def block(x: int, y: int, columns: int, rows: int) -> Array:
    """Board coordinates, in squares, of a block of corners from (x, y) on, along x first."""
    start = np.array([x, y], dtype=float)
    corners: Array = indices(columns, rows) + start
    return corners


def crossings(grey: Image, grid_map: CornerMap, squares: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Contrast of the crossings at given places of a board, and whether there is one.

    Args:
        grey: (h, w).
        grid_map: the board's plane in the image.
        squares: (n, 2), board coordinates in squares.

    Returns:
        Half the difference of both diagonals (n,), DN, positive where the square with lower x and
        y is the brighter, nan outside the image; and whether opposite squares agree so well that
        it must be a crossing.
    """
    around = np.array([[-1, -1], [1, 1], [-1, 1], [1, -1]]) * QUARTER
    places = grid_map((squares[:, None] + around).reshape(-1, 2)).reshape(-1, 4, 2)
    height, width = grey.shape
    inside = ((places >= 0) & (places <= [width - 1, height - 1])).all(axis=(1, 2))
    soft = cv2.blur(grey, (3, 3))
    x, y = (places[..., k].astype(np.float32) for k in (0, 1))
    read = cv2.remap(soft, x, y, cv2.INTER_LINEAR).astype(float)
    contrast = (read[:, 0] + read[:, 1] - read[:, 2] - read[:, 3]) / 4
    unlike = np.abs(read[:, 0] - read[:, 1]) + np.abs(read[:, 2] - read[:, 3]) + 2.0  # DN, noise
    contrast[~inside] = np.nan
    return contrast, inside & (4 * np.abs(contrast) > CLEAR * unlike)


def chequered(grey: Image, grid_map: CornerMap, squares: Array) -> NDArray[np.bool_]:
    """Where crossings are whose colours alternate as most do, (n,)."""
    contrast, there = crossings(grey, grid_map, squares)
    parity = np.where(squares.sum(axis=1) % 2 == 0, 1, -1)
    sign = np.sign(np.nansum(parity * contrast))
    good: NDArray[np.bool_] = there & (np.nan_to_num(contrast) * parity * sign > 0)
    return good


def is_whole(grey: Image, grid: Array) -> bool:
    """Whether a grid (rows, columns, 2) is a chessboard and no part of a larger one."""
    rows, columns = grid.shape[:2]
    squares = indices(columns, rows)
    grid_map = fit_map(squares, grid.reshape(-1, 2), grey.shape)
    if grid_map is None:
        return False
    return holds(grey, grid_map, (0, 0, columns, rows)) and not any(
        holds(grey, grid_map, beyond) for beyond in neighbours(0, 0, columns, rows)
    )


def neighbours(x: int, y: int, columns: int, rows: int) -> list[tuple[int, int, int, int]]:
    """The four lines of corners next to a block (x, y, columns, rows), as blocks."""
    return [
        (x - 1, y, 1, rows),
        (x + columns, y, 1, rows),
        (x, y - 1, columns, 1),
        (x, y + rows, columns, 1),
    ]


def holds(grey: Image, grid_map: CornerMap, part: tuple[int, int, int, int]) -> bool:
    """Whether crossings stand in every row and column of a block (x, y, columns, rows)."""
    columns, rows = part[2:]
    good = chequered(grey, grid_map, block(*part)).reshape(rows, columns)
    if columns == 1 or rows == 1:
        return bool(good.mean() >= MAJORITY)
    return bool(min(good.mean(axis=0).min(), good.mean(axis=1).min()) >= MAJORITY)


def oriented(grey: Image, grid: Array, columns: int, rows: int) -> Array | None:
    """Put a found grid into the board's order.

    Of the orders that are not mirrored, those whose first square is black come before the others;
    where the pattern looks alike in several, the one that stands most nearly upright is taken.

    Args:
        grey: (h, w).
        grid: (r, c, 2), px, in any order.
        columns: inner corners along the board's x.
        rows: along its y.

    Returns:
        (rows * columns, 2), px, along x first; None where the grid has other counts.
    """
    orders = [np.rot90(side, k) for side in (grid, grid[:, ::-1]) for k in range(4)]
    orders = [o for o in orders if o.shape[:2] == (rows, columns) and right_handed(o)]
    if not orders:
        return None
    black = [o for o in orders if first_is_black(grey, o)]
    best = max(black or orders, key=uprightness)
    return np.ascontiguousarray(best.reshape(-1, 2))


def axes(grid: Array) -> Array:
    """Mean steps along the grid's x and y, (2, 2), px, in rows."""
    return np.stack([np.diff(grid, axis=k).mean(axis=(0, 1)) for k in (1, 0)])


def right_handed(grid: Array) -> bool:
    """Whether x, y and the line of sight are a right-handed frame: the view is not mirrored."""
    return bool(np.linalg.det(axes(grid)) > 0)


def uprightness(grid: Array) -> float:
    """How much x points right and y down."""
    steps = axes(grid)
    return float(np.trace(steps / np.linalg.norm(steps, axis=1, keepdims=True)))


def first_is_black(grey: Image, grid: Array) -> bool:
    """Whether the square before the first corner is black."""
    rows, columns = grid.shape[:2]
    squares = indices(columns, rows)
    grid_map = fit_map(squares, grid.reshape(-1, 2), grey.shape)
    if grid_map is None:
        return False
    contrast, _ = crossings(grey, grid_map, squares)
    parity = np.where(squares.sum(axis=1) % 2 == 0, 1, -1)
    return bool(np.nansum(parity * contrast) < 0)
