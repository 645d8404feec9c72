"""Model a corner's pixels: two blurred edges that cross, between squares of two colours.

A pixel is shade(x) + contrast(x) cross(x), shade and contrast linear over the window. With F the
normal distribution, d1 and d2 the distances from the two edges, b1 and b2 their blur,

    cross = 1 - 2 F((d1 - e) / b1) F((-d2 - e) / b2) - 2 F((-d1 - e) / b1) F((d2 - e) / b2)

where e is by how much one colour has spread over the other: ink, or light where white saturates.

Its pixels are those within half a square in the board's plane: each piece of an edge belongs to
one corner, no two corners share a pixel, and their errors are independent. Perspective leaves
edges straight; the lens bends them, by how much is taken from the whole view's map.

A calibration evaluates it several times for each of thousands of corners: that is why it is
compiled. One loop does one thing, for then the processor takes several pixels at once.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from verify.core.jit import compiled, compiled_sums
from verify.core.records import Array

HALF_WINDOW = 0.5  # squares
MAX_EDGE_DISTANCE = 10.0  # px; beyond it from both edges a pixel says nothing on them
MARKER_GUARD = 2.0  # px, blur that a ChArUco marker's bits may have
CLEARANCE = 2  # px between what is not the corner's and what speaks for it
CELLS_PER_SIDE = 7  # of the window, for the scatter of scores; odd: edges lie within cells
# what is known of each pixel, in the order of rows: px from the expected centre; DN; its cell,
# which is one with its mirror image about the corner
COL_COLUMN, COL_ROW, COL_VALUE, COL_CELL = range(4)
N_COLUMNS = 4
# the fixed part of the model: rad, directions of the edges' normals; 1/px, curvatures along them;
# px, unit of the linear terms
EDGE_START_1, EDGE_START_2, EDGE_BEND_1, EDGE_BEND_2, EDGE_SCALE = range(5)
N_EDGE_VALUES = 5
PAR_X, PAR_Y, PAR_TURN_1, PAR_TURN_2, PAR_BLUR_1, PAR_BLUR_2, PAR_SPREAD = range(7)
PAR_SHADE, PAR_SHADE_X, PAR_SHADE_Y, PAR_CONTRAST, PAR_TILT_X, PAR_TILT_Y = range(7, 13)
N_PARAMETERS = 13
ROW_RESIDUAL = N_PARAMETERS  # the row behind the derivatives
N_ROWS = N_PARAMETERS + 1
# What is known of each pixel: for each edge its place along and across it, px; the share of its
# light from beyond the edge, drawn back by the spread, and from the other side, each with the
# size of its slope, 1/px
ROW_ALONG, ROW_DISTANCE, ROW_ABOVE, ROW_NEAR_ABOVE, ROW_BELOW, ROW_NEAR_BELOW = range(6)
ROWS_PER_EDGE = 6
# contrast, DN; d picture / d distances, DN/px
ROW_COLOUR, ROW_BY_1, ROW_BY_2 = range(2 * ROWS_PER_EDGE, 2 * ROWS_PER_EDGE + 3)
N_KNOWN_ROWS = 2 * ROWS_PER_EDGE + 3
# of F's table; between its steps a series is off by 1e-15, F' by 1e-12
TABLE_STEP, TABLE_END = 1 / 64, 8.5
_N_STEPS = round(TABLE_END / TABLE_STEP)
_NODES = np.arange(-_N_STEPS, _N_STEPS + 1) * TABLE_STEP
STEP_TABLE = np.stack([ndtr(_NODES), np.exp(-_NODES * _NODES / 2) / np.sqrt(2 * np.pi)])


@compiled
def window_pixels(
    grey: NDArray[Any], centre: Array, jacobian: Array, markers: tuple[float, float]
) -> Array:
    """Pixels within half a square, near an edge, and outside ChArUco markers.

    The image is (h, w), DN, the expected centre (2,), px, the jacobian (2, 2) d px / d squares,
    columns along the board's x and y. `markers`: squares between a marker and its square's edge;
    sign of u · v (from the corner, board's axes) where the white squares are, 0 where none has a
    marker. Returns (4, p): column, row, value, cell.
    """
    determinant = jacobian[0, 0] * jacobian[1, 1] - jacobian[0, 1] * jacobian[1, 0]
    # A pixel's distance from the edge along the board's x is across it, hence its v, and so on.
    step_u = abs(determinant) / math.hypot(jacobian[0, 1], jacobian[1, 1])
    step_v = abs(determinant) / math.hypot(jacobian[0, 0], jacobian[1, 0])
    margin, white = markers
    margin = margin * min(step_u, step_v) - MARKER_GUARD
    left, right = pixel_range(centre[0], jacobian[0], grey.shape[1])
    top, bottom = pixel_range(centre[1], jacobian[1], grey.shape[0])
    found, count = np.empty((N_COLUMNS, max(right - left, 0) * max(bottom - top, 0))), 0
    for y in range(top, bottom):
        for x in range(left, right):
            column, row = x - centre[0], y - centre[1]
            u = (column * jacobian[1, 1] - row * jacobian[0, 1]) / determinant
            v = (row * jacobian[0, 0] - column * jacobian[1, 0]) / determinant
            distance = min(abs(u) * step_u, abs(v) * step_v)
            inside = (
                abs(u) <= HALF_WINDOW and abs(v) <= HALF_WINDOW and distance <= MAX_EDGE_DISTANCE
            )
            if inside and (white == 0.0 or distance <= margin or u * v * white < 0.0):
                found[COL_COLUMN, count], found[COL_ROW, count] = column, row
                i = int((u / HALF_WINDOW + 1.0) * CELLS_PER_SIDE / 2.0)
                j = int((v / HALF_WINDOW + 1.0) * CELLS_PER_SIDE / 2.0)
                i = min(max(i, 0), CELLS_PER_SIDE - 1) * CELLS_PER_SIDE
                cell = i + min(max(j, 0), CELLS_PER_SIDE - 1)
                # one with its mirror image about the corner
                cell = min(cell, CELLS_PER_SIDE * CELLS_PER_SIDE - 1 - cell)
                found[COL_VALUE, count], found[COL_CELL, count] = grey[y, x], cell
                count += 1
    return found[:, :count].copy()


@compiled
def pixel_range(centre: float, slopes: Array, size: int) -> tuple[int, int]:
    """Columns (or rows) from the first to the one after the last that half a square may reach."""
    extent = HALF_WINDOW * (abs(slopes[0]) + abs(slopes[1]))
    return max(math.ceil(centre - extent), 0), min(math.floor(centre + extent) + 1, size)


@compiled
def fill_edges(jacobian: Array, bend: Array, edges: Array) -> None:
    """Fill in directions and curvatures of the two edges (5,), from the board's plane.

    `bend` (2, 2) is d² px / d squares², columns along the board's x and y.
    """
    for along in range(2):
        x, y = jacobian[0, along], jacobian[1, along]
        across = jacobian[1, 1 - along] * x - jacobian[0, 1 - along] * y
        length = math.copysign(math.hypot(x, y), across)
        x, y = -y / length, x / length
        edges[EDGE_START_1 + along] = math.atan2(y, x)
        edges[EDGE_BEND_1 + along] = (bend[0, along] * x + bend[1, along] * y) / (length * length)
    determinant = jacobian[0, 0] * jacobian[1, 1] - jacobian[0, 1] * jacobian[1, 0]
    edges[EDGE_SCALE] = math.sqrt(abs(determinant))


@compiled
def keep_clear(pixels: Array, stray: NDArray[np.bool_], own: NDArray[np.bool_]) -> int:
    """Fill in which pixels (p,) keep clear of stray ones, as far as blur reaches; say how many."""
    left, right, top, bottom = math.inf, -math.inf, math.inf, -math.inf
    for k in range(pixels.shape[1]):
        left, right = min(left, pixels[COL_COLUMN, k]), max(right, pixels[COL_COLUMN, k])
        top, bottom = min(top, pixels[COL_ROW, k]), max(bottom, pixels[COL_ROW, k])
    width, height, side = right - left, bottom - top, 2 * CLEARANCE + 1
    near = np.zeros((int(height + 0.5) + side, int(width + 0.5) + side), np.bool_)
    for k in range(pixels.shape[1]):
        if stray[k]:
            x, y = int(pixels[COL_COLUMN, k] - left + 0.5), int(pixels[COL_ROW, k] - top + 0.5)
            near[y : y + side, x : x + side] = True
    count = 0
    for k in range(pixels.shape[1]):
        x, y = int(pixels[COL_COLUMN, k] - left + 0.5), int(pixels[COL_ROW, k] - top + 0.5)
        own[k] = not near[y + CLEARANCE, x + CLEARANCE]
        count += own[k]
    return count


@compiled
def select_pixels(pixels: Array, own: NDArray[np.bool_], count: int) -> Array:
    """Copy those of the pixels that are marked, `count` of them."""
    left, at = np.empty((N_COLUMNS, count)), 0
    for k in range(pixels.shape[1]):
        if own[k]:
            for fact in range(N_COLUMNS):
                left[fact, at] = pixels[fact, k]
            at += 1
    return left


@compiled
def start_values(pixels: Array, edges: Array, blurs: tuple[float, float, float], p: Array) -> None:
    """Fill in what to start from (13,); the contrast from the means of the quadrants.

    `blurs`: of the edges along the board's x and y, as logarithms, and the spread of the brighter
    colour.
    """
    cos_1, sin_1 = math.cos(edges[EDGE_START_1]), math.sin(edges[EDGE_START_1])
    cos_2, sin_2 = math.cos(edges[EDGE_START_2]), math.sin(edges[EDGE_START_2])
    high, highs, low, lows = 0.0, 0, 0.0, 0
    for k in range(pixels.shape[1]):
        x, y = pixels[COL_COLUMN, k], pixels[COL_ROW, k]
        same = (x * cos_1 + y * sin_1) * (x * cos_2 + y * sin_2)
        if same > 0.0:
            high, highs = high + pixels[COL_VALUE, k], highs + 1
        elif same < 0.0:
            low, lows = low + pixels[COL_VALUE, k], lows + 1
    high, low = high / max(highs, 1), low / max(lows, 1)
    p[:] = 0.0
    p[PAR_TURN_1], p[PAR_TURN_2] = edges[EDGE_START_1], edges[EDGE_START_2]
    p[PAR_SHADE], p[PAR_CONTRAST] = (high + low) / 2, (high - low) / 2
    p[PAR_BLUR_1], p[PAR_BLUR_2] = blurs[0], blurs[1]
    p[PAR_SPREAD] = math.copysign(blurs[2], blurs[2] * p[PAR_CONTRAST])


@compiled_sums
def place_pixels(pixels: Array, p: Array, which: int, bend: float, edge: Array) -> None:
    """Place pixels along and across the first or second edge."""
    c, s = math.cos(p[PAR_TURN_1 + which]), math.sin(p[PAR_TURN_1 + which])
    x0, y0 = p[PAR_X], p[PAR_Y]
    for k in range(pixels.shape[1]):
        x, y = pixels[COL_COLUMN, k] - x0, pixels[COL_ROW, k] - y0
        along = y * c - x * s
        edge[ROW_ALONG, k], edge[ROW_DISTANCE, k] = along, x * c + y * s - bend / 2 * along * along


@compiled_sums
def blurred_step(
    width: float,
    spread: float,
    sign: float,
    steps: Array,
    distance: Array,
    share: Array,
    near: Array,
) -> None:
    """Fill in F((sign · distance - spread) / width), (p,), and the size of its slope, (p,).

    Source: Taylor's series about the nearest step; F's derivatives are Hermite's polynomials times
    its slope.
    """
    inverse, count = 1.0 / width, len(distance)
    nearest = np.empty(count, np.int32)  # look-ups apart: the processor takes sums several at once
    for k in range(count):
        z = min(max((sign * distance[k] - spread) * inverse, -TABLE_END), TABLE_END)
        nearest[k] = np.int32((z + TABLE_END) * (1.0 / TABLE_STEP) + 0.5)
        share[k] = z
    for k in range(count):
        near[k] = steps[1, nearest[k]]
    for k in range(count):
        u = nearest[k] * TABLE_STEP - TABLE_END
        d, uu, slope = share[k] - u, u * u, near[k]
        second, third = (uu - 1.0) / 2.0, (3.0 - uu) * u / 6.0
        fourth = ((uu - 6.0) * uu + 3.0) / 24.0
        higher = second / 3.0 + d * (third / 4.0 + d * fourth / 5.0)
        share[k] = slope * d * (1.0 + d * (d * higher - u / 2.0))
        higher = second + d * (third + d * fourth)
        near[k] = slope * inverse * (1.0 + d * (d * higher - u))
    for k in range(count):
        share[k] += steps[0, nearest[k]]


@compiled
def predict_pixels(
    pixels: Array, edges: Array, p: Array, steps: Array, known: Array, rows: Array
) -> None:
    """Expect a corner's pixels (4, p) by its edges (5,), parameters p (13,) and F's table of steps.

    Fills `known` (15, p) and `rows` (14, p): derivatives by parameters, and pixels less model, DN.
    """
    spread = p[PAR_SPREAD]
    for which in range(2):
        edge = known[which * ROWS_PER_EDGE : (which + 1) * ROWS_PER_EDGE]
        width = math.exp(p[PAR_BLUR_1 + which])
        place_pixels(pixels, p, which, edges[EDGE_BEND_1 + which], edge)
        distance = edge[ROW_DISTANCE]
        blurred_step(width, spread, 1.0, steps, distance, edge[ROW_ABOVE], edge[ROW_NEAR_ABOVE])
        blurred_step(width, spread, -1.0, steps, distance, edge[ROW_BELOW], edge[ROW_NEAR_BELOW])
    one, two = known[:ROWS_PER_EDGE], known[ROWS_PER_EDGE : 2 * ROWS_PER_EDGE]
    fill_colour(pixels, p, 1.0 / edges[EDGE_SCALE], one, two, known[ROW_COLOUR], rows)
    derivative_by_distance(one, two, known[ROW_COLOUR], known[ROW_BY_1])
    derivative_by_distance(two, one, known[ROW_COLOUR], known[ROW_BY_2])
    derivative_by_place(p, edges, known, rows)
    derivative_by_blur(spread, one, two, known[ROW_COLOUR], rows[PAR_BLUR_1])
    derivative_by_blur(spread, two, one, known[ROW_COLOUR], rows[PAR_BLUR_2])
    derivative_by_spread(one, two, known[ROW_COLOUR], rows[PAR_SPREAD])


@compiled_sums
def fill_colour(
    pixels: Array, p: Array, per_px: float, one: Array, two: Array, contrast: Array, rows: Array
) -> None:
    """Fill in the picture: its linear terms, its residual, and each pixel's contrast."""
    shade, shade_x, shade_y = p[PAR_SHADE], p[PAR_SHADE_X], p[PAR_SHADE_Y]
    middle, tilt_x, tilt_y = p[PAR_CONTRAST], p[PAR_TILT_X], p[PAR_TILT_Y]
    count = pixels.shape[1]
    rows[PAR_SHADE] = 1.0
    for k in range(count):
        rows[PAR_SHADE_X, k] = pixels[COL_COLUMN, k] * per_px
        rows[PAR_SHADE_Y, k] = pixels[COL_ROW, k] * per_px
    for k in range(count):
        contrast[k] = middle + tilt_x * rows[PAR_SHADE_X, k] + tilt_y * rows[PAR_SHADE_Y, k]
    for k in range(count):
        # Of the quadrants between the edges one diagonal pair is drawn over the other's ground.
        drawn = one[ROW_ABOVE, k] * two[ROW_BELOW, k] + one[ROW_BELOW, k] * two[ROW_ABOVE, k]
        rows[PAR_CONTRAST, k] = 1.0 - 2.0 * drawn
    for k in range(count):
        rows[PAR_TILT_X, k] = rows[PAR_CONTRAST, k] * rows[PAR_SHADE_X, k]
        rows[PAR_TILT_Y, k] = rows[PAR_CONTRAST, k] * rows[PAR_SHADE_Y, k]
    for k in range(count):
        ground = shade + shade_x * rows[PAR_SHADE_X, k] + shade_y * rows[PAR_SHADE_Y, k]
        rows[ROW_RESIDUAL, k] = pixels[COL_VALUE, k] - ground - contrast[k] * rows[PAR_CONTRAST, k]


@compiled_sums
def derivative_by_distance(edge: Array, other: Array, contrast: Array, by: Array) -> None:
    """Fill in how the picture changes with the distance from an edge, DN/px."""
    for k in range(len(by)):
        slope = (
            edge[ROW_NEAR_BELOW, k] * other[ROW_ABOVE, k]
            - edge[ROW_NEAR_ABOVE, k] * other[ROW_BELOW, k]
        )
        by[k] = 2.0 * contrast[k] * slope


@compiled_sums
def derivative_by_place(p: Array, edges: Array, known: Array, rows: Array) -> None:
    """Fill in the derivatives by the crossing's place and by the edges' turns."""
    bend_1, bend_2 = edges[EDGE_BEND_1], edges[EDGE_BEND_2]
    cos_1, sin_1 = math.cos(p[PAR_TURN_1]), math.sin(p[PAR_TURN_1])
    cos_2, sin_2 = math.cos(p[PAR_TURN_2]), math.sin(p[PAR_TURN_2])
    count = known.shape[1]
    along_1, along_2 = ROW_ALONG, ROWS_PER_EDGE + ROW_ALONG
    off_1, off_2 = ROW_DISTANCE, ROWS_PER_EDGE + ROW_DISTANCE
    for k in range(count):
        rows[PAR_X, k] = -(cos_1 + bend_1 * sin_1 * known[along_1, k]) * known[ROW_BY_1, k]
    for k in range(count):
        rows[PAR_X, k] -= (cos_2 + bend_2 * sin_2 * known[along_2, k]) * known[ROW_BY_2, k]
    for k in range(count):
        rows[PAR_Y, k] = (bend_1 * cos_1 * known[along_1, k] - sin_1) * known[ROW_BY_1, k]
    for k in range(count):
        rows[PAR_Y, k] += (bend_2 * cos_2 * known[along_2, k] - sin_2) * known[ROW_BY_2, k]
    for k in range(count):
        straight = known[off_1, k] + bend_1 / 2 * known[along_1, k] * known[along_1, k]
        rows[PAR_TURN_1, k] = known[ROW_BY_1, k] * known[along_1, k] * (1.0 + bend_1 * straight)
    for k in range(count):
        straight = known[off_2, k] + bend_2 / 2 * known[along_2, k] * known[along_2, k]
        rows[PAR_TURN_2, k] = known[ROW_BY_2, k] * known[along_2, k] * (1.0 + bend_2 * straight)


@compiled_sums
def derivative_by_blur(
    spread: float, edge: Array, other: Array, contrast: Array, by: Array
) -> None:
    """Fill in the derivative by the logarithm of an edge's blur."""
    for k in range(len(by)):
        down = (edge[ROW_DISTANCE, k] - spread) * edge[ROW_NEAR_ABOVE, k] * other[ROW_BELOW, k]
        up = (edge[ROW_DISTANCE, k] + spread) * edge[ROW_NEAR_BELOW, k] * other[ROW_ABOVE, k]
        by[k] = 2.0 * contrast[k] * (down - up)


@compiled_sums
def derivative_by_spread(one: Array, two: Array, contrast: Array, by: Array) -> None:
    """Fill in the derivative by the spread of one colour over the other."""
    for k in range(len(by)):
        first = (
            one[ROW_NEAR_ABOVE, k] * two[ROW_BELOW, k] + one[ROW_NEAR_BELOW, k] * two[ROW_ABOVE, k]
        )
        second = (
            two[ROW_NEAR_ABOVE, k] * one[ROW_BELOW, k] + two[ROW_NEAR_BELOW, k] * one[ROW_ABOVE, k]
        )
        by[k] = 2.0 * contrast[k] * (first + second)
