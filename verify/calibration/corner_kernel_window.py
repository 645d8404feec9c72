"""The pixels that speak for a corner, compiled: half a square to every side, in the board's plane.

So each piece of an edge speaks for one corner, no two corners share a pixel, and their errors are
independent. Perspective leaves edges straight; only the lens bends them, by how much is taken
from the whole view's map.
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.compiled import compiled
from verify.records import Array

HALF_WINDOW = 0.5  # squares
REACH = 10.0  # px; beyond it from both edges a pixel says nothing on them
MARKER_GUARD = 2.0  # px, blur that a ChArUco marker's bits may have
CLEARANCE = 2  # px between what is not the corner's and what speaks for it
CELLS = 7  # a side of the window, for the scatter of scores; odd, so that edges lie within cells
# what is known of each pixel, in the order of rows: px from the expected centre; DN; its cell,
# which is one with its mirror image about the corner
COLUMN, ROW, VALUE, CELL = range(4)
FACTS = 4
# the fixed part of the model: rad, directions of the edges' normals; 1/px, curvatures along them;
# px, unit of the linear terms
START_1, START_2, BEND_1, BEND_2, SCALE = range(5)
EDGES = 5


@compiled
def window_at(grey: Array, centre: Array, jacobian: Array, markers: tuple[float, float]) -> Array:
    """Pixels within half a square, near an edge, and outside ChArUco markers.

    Args:
        grey: (h, w), DN.
        centre: (2,), px, the expected one.
        jacobian: (2, 2), d px / d squares, columns along the board's x and y.
        markers: squares between a marker and its square's edge; sign of u · v (from the corner,
            board's axes) where the white squares are, 0 where none has a marker.

    Returns:
        (4, p): column, row, value, cell.
    """
    determinant = jacobian[0, 0] * jacobian[1, 1] - jacobian[0, 1] * jacobian[1, 0]
    # A pixel's distance from the edge along the board's x is across it, hence its v, and so on.
    step_u = abs(determinant) / math.hypot(jacobian[0, 1], jacobian[1, 1])
    step_v = abs(determinant) / math.hypot(jacobian[0, 0], jacobian[1, 0])
    margin, white = markers
    margin = margin * min(step_u, step_v) - MARKER_GUARD
    left, right = span(centre[0], jacobian[0], grey.shape[1])
    top, bottom = span(centre[1], jacobian[1], grey.shape[0])
    found, count = np.empty((FACTS, max(right - left, 0) * max(bottom - top, 0))), 0
    for y in range(top, bottom):
        for x in range(left, right):
            column, row = x - centre[0], y - centre[1]
            u = (column * jacobian[1, 1] - row * jacobian[0, 1]) / determinant
            v = (row * jacobian[0, 0] - column * jacobian[1, 0]) / determinant
            distance = min(abs(u) * step_u, abs(v) * step_v)
            inside = abs(u) <= HALF_WINDOW and abs(v) <= HALF_WINDOW and distance <= REACH
            if inside and (white == 0.0 or distance <= margin or u * v * white < 0.0):
                found[COLUMN, count], found[ROW, count] = column, row
                found[VALUE, count], found[CELL, count] = grey[y, x], cell(u, v)
                count += 1
    return found[:, :count].copy()


@compiled
def span(centre: float, slopes: Array, size: int) -> tuple[int, int]:
    """Columns (or rows) from the first to the one after the last that half a square may reach."""
    extent = HALF_WINDOW * (abs(slopes[0]) + abs(slopes[1]))
    return max(math.ceil(centre - extent), 0), min(math.floor(centre + extent) + 1, size)


@compiled
def cell(u: float, v: float) -> int:
    """Which cell of the window a place (squares from the corner) or its mirror image is in."""
    i = min(max(int((u / HALF_WINDOW + 1.0) * CELLS / 2.0), 0), CELLS - 1)
    j = min(max(int((v / HALF_WINDOW + 1.0) * CELLS / 2.0), 0), CELLS - 1)
    return min(i * CELLS + j, CELLS * CELLS - 1 - i * CELLS - j)


@compiled
def edges_at(jacobian: Array, bend: Array, edges: Array) -> None:
    """Fill in directions and curvatures of the two edges (5,), from the board's plane.

    `bend` (2, 2) is d² px / d squares², columns along the board's x and y.
    """
    for along in range(2):
        x, y = jacobian[0, along], jacobian[1, along]
        across = jacobian[1, 1 - along] * x - jacobian[0, 1 - along] * y
        length = math.copysign(math.hypot(x, y), across)
        x, y = -y / length, x / length
        edges[START_1 + along] = math.atan2(y, x)
        edges[BEND_1 + along] = (bend[0, along] * x + bend[1, along] * y) / (length * length)
    determinant = jacobian[0, 0] * jacobian[1, 1] - jacobian[0, 1] * jacobian[1, 0]
    edges[SCALE] = math.sqrt(abs(determinant))


@compiled
def far_from(pixels: Array, stray: NDArray[np.bool_], own: NDArray[np.bool_]) -> int:
    """Fill in which pixels (p,) keep clear of stray ones, as far as blur reaches; say how many."""
    left, top = pixels[COLUMN].min(), pixels[ROW].min()
    width, height = pixels[COLUMN].max() - left, pixels[ROW].max() - top
    side = 2 * CLEARANCE + 1
    near = np.zeros((int(height + 0.5) + side, int(width + 0.5) + side), np.bool_)
    for k in range(pixels.shape[1]):
        if stray[k]:
            x, y = int(pixels[COLUMN, k] - left + 0.5), int(pixels[ROW, k] - top + 0.5)
            near[y : y + side, x : x + side] = True
    count = 0
    for k in range(pixels.shape[1]):
        x, y = int(pixels[COLUMN, k] - left + 0.5), int(pixels[ROW, k] - top + 0.5)
        own[k] = not near[y + CLEARANCE, x + CLEARANCE]
        count += own[k]
    return count


@compiled
def only(pixels: Array, own: NDArray[np.bool_], count: int) -> Array:
    """Some of the pixels, of which there are `count`."""
    left, at = np.empty((FACTS, count)), 0
    for k in range(pixels.shape[1]):
        if own[k]:
            for fact in range(FACTS):
                left[fact, at] = pixels[fact, k]
            at += 1
    return left
