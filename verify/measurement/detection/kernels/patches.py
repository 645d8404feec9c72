"""Measure a blob at half its height, and read the pixels about each candidate.

Of the pixels above half the peak and connected with it, holes filled, A many:

    half width = sqrt(A / pi),  moments = sum (d d') / A + 1/12,  d px from their mean
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled
from verify.core.records import Array, Image

MIN_PIXELS = 12  # px; fewer show no shape
OUTSIDE, INSIDE, BLOB = 0, 1, 2
Labels = NDArray[np.uint8]


@compiled
def measure_half_height(part: Image, longest: float, fill: float, blob: Array) -> bool:
    """Measure the brightest blob of a picture at half its height; False: none, or not compact.

    `part` (h, w), DN above the surroundings; `longest` axis ratio; `fill`, least area over its
    ellipse's; `blob` (4,), filled: centre's column and row, px; half width, px; height, DN.
    """
    height, width = part.shape
    at_y, at_x, peak = 0, 0, np.int64(-1)
    for y in range(height):
        for x in range(width):
            if part[y, x] > peak:
                at_y, at_x, peak = y, x, part[y, x]
    label = np.full((height + 2, width + 2), INSIDE, np.uint8)  # with a rim that is no part of it
    stack = np.empty((label.size, 2), np.int64)
    flood_outside(part, peak, label, stack)
    flood_blob(label, at_y + 1, at_x + 1, stack)
    area, x_sum, y_sum = 0, 0, 0
    for y in range(height):
        for x in range(width):
            if label[y + 1, x + 1] == BLOB and 2 * part[y, x] > peak:
                area, x_sum, y_sum = area + 1, x_sum + x, y_sum + y
    if area == 0 or area == height * width:
        return False
    blob[0], blob[1], blob[3] = x_sum / area, y_sum / area, peak
    blob[2] = math.sqrt(area / math.pi)
    xx, xy, yy = 0.0, 0.0, 0.0
    for y in range(height):
        for x in range(width):
            if label[y + 1, x + 1] == BLOB and 2 * part[y, x] > peak:
                xx += (x - blob[0]) * (x - blob[0])
                xy += (x - blob[0]) * (y - blob[1])
                yy += (y - blob[1]) * (y - blob[1])
    # a pixel is a square, not a point: its own variance is 1/12
    xx, xy, yy = xx / area + 1 / 12, xy / area, yy / area + 1 / 12
    mean, split = (xx + yy) / 2.0, math.hypot((xx - yy) / 2.0, xy)
    long, short = 2.0 * math.sqrt(mean + split), 2.0 * math.sqrt(max(mean - split, 0.0))
    return area < MIN_PIXELS or (long <= longest * short and area >= fill * math.pi * long * short)


@compiled
def flood_outside(part: Image, peak: np.int64, label: Labels, stack: NDArray[np.int64]) -> None:
    """Mark what of the lower pixels is connected to the rim, side by side: the rest are holes."""
    height, width = label.shape
    count = 1
    stack[0, 0], stack[0, 1], label[0, 0] = 0, 0, OUTSIDE
    while count > 0:
        count -= 1
        y, x = stack[count, 0], stack[count, 1]
        for dy, dx in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            v, u = y + dy, x + dx
            if v < 0 or u < 0 or v >= height or u >= width or label[v, u] != INSIDE:
                continue
            rim = v == 0 or u == 0 or v == height - 1 or u == width - 1
            if rim or 2 * part[v - 1, u - 1] <= peak:
                stack[count, 0], stack[count, 1], label[v, u] = v, u, OUTSIDE
                count += 1


@compiled
def flood_blob(label: Labels, y: int, x: int, stack: NDArray[np.int64]) -> None:
    """Mark what is connected with a pixel, also by corners, and the holes in it."""
    count = 1
    stack[0, 0], stack[0, 1], label[y, x] = y, x, BLOB
    while count > 0:
        count -= 1
        y, x = stack[count, 0], stack[count, 1]
        for v in range(y - 1, y + 2):  # the rim about it is outside
            for u in range(x - 1, x + 2):
                if label[v, u] == INSIDE:
                    stack[count, 0], stack[count, 1], label[v, u] = v, u, BLOB
                    count += 1


@compiled
def read_grey(
    image: Image,
    origin: NDArray[np.int64],
    scale: Array,
    column: NDArray[np.int64],
    row: NDArray[np.int64],
    pixels: Array,
    contrast: Array,
) -> None:
    """Read n patches of p pixels each from an image (h, w).

    `origin` (n, 2), px, column and row of each patch's centre pixel; `scale` (n,), px: within, a
    pixel is the spot's; `column` and `row` (n, p) or, the same for all, (1, p): px from the origin.
    Filled: `pixels` (n, 4, p): value, the nearest pixel's outside the image; 1 inside of it; column
    and row; and `contrast` (n, 3): mean of the spot's pixels less the value that a third are below.
    """
    height, width = image.shape
    for n in range(len(origin)):
        counts = np.zeros(256, np.int64)
        own = n if len(column) > 1 else 0
        total, members = 0.0, 0
        for k in range(column.shape[1]):
            right, down = column[own, k], row[own, k]
            x, y = origin[n, 0] + right, origin[n, 1] + down
            inside = x >= 0 and x < width and y >= 0 and y < height
            value = image[min(max(y, 0), height - 1), min(max(x, 0), width - 1)]
            pixels[n, 0, k], pixels[n, 1, k] = value, 1.0 if inside else 0.0
            pixels[n, 2, k], pixels[n, 3, k] = right, down
            counts[value] += 1
            if right * right + down * down <= scale[n] * scale[n]:
                total += value
                members += 1
        below, floor = 0, -1
        while below <= column.shape[1] // 3:
            floor += 1
            below += counts[floor]
        contrast[n] = total / max(members, 1) - floor  # in all three channels
