"""A corner's picture, compiled: two blurred edges that cross, between squares of two colours.

It is shade(x) + contrast(x) · cross(x), shade and contrast linear over the window. With F the
normal distribution, d1 and d2 the distances from the two edges, b1 and b2 their blur,

    cross = 1 - 2 F((d1 - e) / b1) F((-d2 - e) / b2) - 2 F((-d1 - e) / b1) F((d2 - e) / b2)

where e is by how much one colour has spread over the other: ink, or light where white saturates.
One loop does one thing, for then the processor takes several pixels at once.
"""

import math

import numpy as np
from scipy.special import ndtr

from verify.calibration.corner_kernel_window import (
    BEND_1,
    BEND_2,
    COLUMN,
    ROW,
    SCALE,
    START_1,
    START_2,
    VALUE,
)
from verify.compiled import compiled, compiled_sums
from verify.records import Array

X, Y, TURN_1, TURN_2, BLUR_1, BLUR_2, SPREAD, SHADE, SHADE_X, SHADE_Y = range(10)
CONTRAST, TILT_X, TILT_Y = range(10, 13)
PARAMETERS = 13
RESIDUAL = PARAMETERS  # the row behind the derivatives
ROWS = PARAMETERS + 1
SHARPEST = 0.7  # px: sharper than a pixel shows is not seen
# What is known of each pixel: for each edge its place along and across it, px; the share of its
# light from beyond the edge, drawn back by the spread, and from the other side, each with the
# size of its slope, 1/px
ALONG, DISTANCE, ABOVE, NEAR_ABOVE, BELOW, NEAR_BELOW = range(6)
EACH = 6
COLOUR, BY_1, BY_2 = range(2 * EACH, 2 * EACH + 3)  # contrast, DN; d picture / d distances, DN/px
KNOWN = 2 * EACH + 3
STEP, LAST = 1 / 64, 8.5  # of F's table; between its steps a series is off by 1e-15, F' by 1e-12
NODES = np.arange(-round(LAST / STEP), round(LAST / STEP) + 1) * STEP
STEPS = np.stack([ndtr(NODES), np.exp(-NODES * NODES / 2) / np.sqrt(2 * np.pi)])


@compiled
def start_values(pixels: Array, edges: Array, blur: float, p: Array) -> None:
    """Fill in what to start from (13,); the contrast's sign from the means of the quadrants."""
    cos_1, sin_1 = math.cos(edges[START_1]), math.sin(edges[START_1])
    cos_2, sin_2 = math.cos(edges[START_2]), math.sin(edges[START_2])
    high, highs, low, lows = 0.0, 0, 0.0, 0
    for k in range(pixels.shape[1]):
        x, y = pixels[COLUMN, k], pixels[ROW, k]
        same = (x * cos_1 + y * sin_1) * (x * cos_2 + y * sin_2)
        if same > 0.0:
            high, highs = high + pixels[VALUE, k], highs + 1
        elif same < 0.0:
            low, lows = low + pixels[VALUE, k], lows + 1
    high, low = high / max(highs, 1), low / max(lows, 1)
    p[:] = 0.0
    p[TURN_1], p[TURN_2] = edges[START_1], edges[START_2]
    p[BLUR_1] = p[BLUR_2] = math.log(max(blur, SHARPEST))
    p[SHADE], p[CONTRAST] = (high + low) / 2, (high - low) / 2


@compiled_sums
def place(pixels: Array, p: Array, which: int, bend: float, edge: Array) -> None:
    """Place pixels along and across the first or second edge."""
    c, s = math.cos(p[TURN_1 + which]), math.sin(p[TURN_1 + which])
    x0, y0 = p[X], p[Y]
    for k in range(pixels.shape[1]):
        x, y = pixels[COLUMN, k] - x0, pixels[ROW, k] - y0
        along = y * c - x * s
        edge[ALONG, k], edge[DISTANCE, k] = along, x * c + y * s - bend / 2 * along * along


@compiled_sums
def blur(
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
    inverse = 1.0 / width
    for k in range(len(distance)):
        z = min(max((sign * distance[k] - spread) * inverse, -LAST), LAST)
        at = int((z + LAST) * (1.0 / STEP) + 0.5)
        u = at * STEP - LAST
        d, uu = z - u, u * u
        second, third = (uu - 1.0) / 2.0, (3.0 - uu) * u / 6.0
        fourth = ((uu - 6.0) * uu + 3.0) / 24.0
        higher = second / 3.0 + d * (third / 4.0 + d * fourth / 5.0)
        share[k] = steps[0, at] + steps[1, at] * d * (1.0 + d * (d * higher - u / 2.0))
        higher = second + d * (third + d * fourth)
        near[k] = steps[1, at] * inverse * (1.0 + d * (d * higher - u))


@compiled
def model(pixels: Array, edges: Array, p: Array, steps: Array, known: Array, rows: Array) -> None:
    """Expect a corner's pixels.

    Args:
        pixels: (4, p), see corner_kernel_window.py.
        edges: (5,), likewise.
        p: (13,), the parameters.
        steps: the table of F.
        known: (15, p), filled.
        rows: (14, p), filled: derivatives by the parameters, and pixels less model, DN.
    """
    for which in range(2):
        edge, width = known[which * EACH : (which + 1) * EACH], math.exp(p[BLUR_1 + which])
        place(pixels, p, which, edges[BEND_1 + which], edge)
        blur(width, p[SPREAD], 1.0, steps, edge[DISTANCE], edge[ABOVE], edge[NEAR_ABOVE])
        blur(width, p[SPREAD], -1.0, steps, edge[DISTANCE], edge[BELOW], edge[NEAR_BELOW])
    one, two = known[:EACH], known[EACH : 2 * EACH]
    colour(pixels, p, 1.0 / edges[SCALE], one, two, known[COLOUR], rows)
    by_distance(one, two, known[COLOUR], known[BY_1])
    by_distance(two, one, known[COLOUR], known[BY_2])
    by_place(p, edges, known, rows)
    by_blur(p[SPREAD], one, two, known[COLOUR], rows[BLUR_1])
    by_blur(p[SPREAD], two, one, known[COLOUR], rows[BLUR_2])
    by_spread(one, two, known[COLOUR], rows[SPREAD])


@compiled_sums
def colour(
    pixels: Array, p: Array, per_px: float, one: Array, two: Array, contrast: Array, rows: Array
) -> None:
    """Fill in the picture: its linear terms, its residual, and each pixel's contrast."""
    shade, shade_x, shade_y = p[SHADE], p[SHADE_X], p[SHADE_Y]
    middle, tilt_x, tilt_y = p[CONTRAST], p[TILT_X], p[TILT_Y]
    count = pixels.shape[1]
    rows[SHADE] = 1.0
    for k in range(count):
        rows[SHADE_X, k], rows[SHADE_Y, k] = pixels[COLUMN, k] * per_px, pixels[ROW, k] * per_px
    for k in range(count):
        contrast[k] = middle + tilt_x * rows[SHADE_X, k] + tilt_y * rows[SHADE_Y, k]
    for k in range(count):
        # Of the quadrants between the edges one diagonal pair is drawn over the other's ground.
        drawn = one[ABOVE, k] * two[BELOW, k] + one[BELOW, k] * two[ABOVE, k]
        rows[CONTRAST, k] = 1.0 - 2.0 * drawn
    for k in range(count):
        rows[TILT_X, k] = rows[CONTRAST, k] * rows[SHADE_X, k]
        rows[TILT_Y, k] = rows[CONTRAST, k] * rows[SHADE_Y, k]
    for k in range(count):
        ground = shade + shade_x * rows[SHADE_X, k] + shade_y * rows[SHADE_Y, k]
        rows[RESIDUAL, k] = pixels[VALUE, k] - ground - contrast[k] * rows[CONTRAST, k]


@compiled_sums
def by_distance(edge: Array, other: Array, contrast: Array, by: Array) -> None:
    """Fill in how the picture changes with the distance from an edge, DN/px."""
    for k in range(len(by)):
        slope = edge[NEAR_BELOW, k] * other[ABOVE, k] - edge[NEAR_ABOVE, k] * other[BELOW, k]
        by[k] = 2.0 * contrast[k] * slope


@compiled_sums
def by_place(p: Array, edges: Array, known: Array, rows: Array) -> None:
    """Fill in the derivatives by the crossing's place and by the edges' turns."""
    bend_1, bend_2 = edges[BEND_1], edges[BEND_2]
    cos_1, sin_1, cos_2, sin_2 = (
        math.cos(p[TURN_1]), math.sin(p[TURN_1]), math.cos(p[TURN_2]), math.sin(p[TURN_2])
    )  # fmt: skip
    count = known.shape[1]
    along_1, along_2, off_1, off_2 = ALONG, EACH + ALONG, DISTANCE, EACH + DISTANCE
    for k in range(count):
        rows[X, k] = -(cos_1 + bend_1 * sin_1 * known[along_1, k]) * known[BY_1, k]
    for k in range(count):
        rows[X, k] -= (cos_2 + bend_2 * sin_2 * known[along_2, k]) * known[BY_2, k]
    for k in range(count):
        rows[Y, k] = (bend_1 * cos_1 * known[along_1, k] - sin_1) * known[BY_1, k]
    for k in range(count):
        rows[Y, k] += (bend_2 * cos_2 * known[along_2, k] - sin_2) * known[BY_2, k]
    for k in range(count):
        straight = known[off_1, k] + bend_1 / 2 * known[along_1, k] * known[along_1, k]
        rows[TURN_1, k] = known[BY_1, k] * known[along_1, k] * (1.0 + bend_1 * straight)
    for k in range(count):
        straight = known[off_2, k] + bend_2 / 2 * known[along_2, k] * known[along_2, k]
        rows[TURN_2, k] = known[BY_2, k] * known[along_2, k] * (1.0 + bend_2 * straight)


@compiled_sums
def by_blur(spread: float, edge: Array, other: Array, contrast: Array, by: Array) -> None:
    """Fill in the derivative by the logarithm of an edge's blur."""
    for k in range(len(by)):
        down = (edge[DISTANCE, k] - spread) * edge[NEAR_ABOVE, k] * other[BELOW, k]
        up = (edge[DISTANCE, k] + spread) * edge[NEAR_BELOW, k] * other[ABOVE, k]
        by[k] = 2.0 * contrast[k] * (down - up)


@compiled_sums
def by_spread(one: Array, two: Array, contrast: Array, by: Array) -> None:
    """Fill in the derivative by the spread of one colour over the other."""
    for k in range(len(by)):
        first = one[NEAR_ABOVE, k] * two[BELOW, k] + one[NEAR_BELOW, k] * two[ABOVE, k]
        second = two[NEAR_ABOVE, k] * one[BELOW, k] + two[NEAR_BELOW, k] * one[ABOVE, k]
        by[k] = 2.0 * contrast[k] * (first + second)
