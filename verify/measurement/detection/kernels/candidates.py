"""Find compact bright blobs of a picture, from the highest level of contrast down.

The contrast is the top hat: the image less its opening by a square, which is the greatest of the
least values about each pixel. Levels are searched from the brightest down, so that a bright blob
does not hide a faint neighbour. OpenCV's top hat takes as many steps a pixel as its square is wide,
this one three.
"""

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled
from verify.core.records import Array, Image
from verify.measurement.detection.kernels.patches import measure_half_height

MIN_WINDOW_SIDE = 3  # px, side of a window: smaller ones show no blob
BOX_MARGIN = 2  # px about a region's box: its half height may lie below the level
Labels = NDArray[np.int32]


@compiled
def top_hat(image: Image, reach: int, contrast: Image) -> None:
    """Fill in `contrast`, an image (h, w) less its opening by a square of 2 reach + 1 px.

    Borders hold nothing.
    """
    height, width = image.shape
    low, turned = np.empty((height, width), np.uint8), np.empty((width, height), np.uint8)
    column_minima(image, reach, low)
    level, uneven = low[0, 0], np.uint8(0)
    for y in range(height):
        for x in range(width):
            uneven |= low[y, x] ^ level
    if uneven == 0:  # as where there is nothing but black between the LEDs
        for y in range(height):
            for x in range(width):
                contrast[y, x] = image[y, x] - level
        return
    transpose(low, turned)
    column_minima(turned, reach, turned)
    for x in range(width):  # the greatest of the least: the least of the complement
        for y in range(height):
            turned[x, y] = 255 - turned[x, y]
    column_minima(turned, reach, turned)
    transpose(turned, low)
    column_minima(low, reach, low)
    for y in range(height):
        for x in range(width):
            contrast[y, x] = image[y, x] - (255 - low[y, x])


@compiled
def transpose(image: Image, turned: Image) -> None:
    """Make rows of columns."""
    for x in range(image.shape[1]):
        for y in range(image.shape[0]):
            turned[x, y] = image[y, x]


@compiled
def column_minima(image: Image, reach: int, least: Image) -> None:
    """Fill in the least of each column's values within `reach` rows; may be the image itself.

    Source: van Herk (1992), Gil and Werman (1993): of blocks as long as the window, the least from
    their start on and that to their end.
    """
    height, width = image.shape
    block = 2 * reach + 1
    so_far, to_come = np.empty((height, width), np.uint8), np.empty((height, width), np.uint8)
    for y in range(height):
        if y % block == 0:
            for x in range(width):
                so_far[y, x] = image[y, x]
        else:
            for x in range(width):
                so_far[y, x] = min(image[y, x], so_far[y - 1, x])
    for y in range(height - 1, -1, -1):
        if y == height - 1 or (y + 1) % block == 0:
            for x in range(width):
                to_come[y, x] = image[y, x]
        else:
            for x in range(width):
                to_come[y, x] = min(image[y, x], to_come[y + 1, x])
    for y in range(height):
        before, after = y - reach, min(y + reach, height - 1)
        if before < 0:
            for x in range(width):
                least[y, x] = so_far[after, x]
        elif before // block == after // block:
            for x in range(width):
                least[y, x] = to_come[before, x]
        else:
            for x in range(width):
                least[y, x] = min(so_far[after, x], to_come[before, x])


@compiled
def find_blobs(
    image: Image,
    windows: NDArray[np.int64],
    reach: int,
    levels: tuple[int, ...],
    shape: tuple[float, float, float],
    most: int,
) -> Array:
    """List compact bright blobs in windows of a grey picture, (m, 4), as `compact_blobs` does.

    `windows` (n, 4): x0, y0, x1, y1, upper bounds exclusive. `reach`, px: what has brightness at
    that distance all around is background. `levels` and `shape` as for `compact_blobs`. At most
    `most` are listed.
    """
    found, count = np.empty((most, 4)), 0
    for window in windows:
        x0, y0, x1, y1 = window
        if min(x1 - x0, y1 - y0) < MIN_WINDOW_SIDE:
            continue
        part = image[y0:y1, x0:x1].copy()
        contrast = np.empty_like(part)
        top_hat(part, reach, contrast)
        before = count
        count += compact_blobs(contrast, levels, shape, found[before:])
        for k in range(before, count):
            found[k, 0] += x0
            found[k, 1] += y0
    return found[:count]


@compiled
def compact_blobs(
    contrast: Image, levels: tuple[int, ...], shape: tuple[float, float, float], found: Array
) -> int:
    """List compact blobs by their contrast, and count them; a bright one's foot is no further one.

    `contrast` (h, w), DN above the surroundings; `levels`, DN, falling; `shape`: longest side of a
    blob's box, px; longest axis ratio; least area over its ellipse's. `found` (m, 4) is filled from
    the first row with as many as it holds: column and row of the centre, px; half width, px;
    height, DN.
    """
    label = np.zeros(contrast.shape, np.int32)
    stack = np.empty((contrast.size, 2), np.int32)
    seeds = np.empty((len(found), 2), np.int32)  # a pixel of each region that a blob was found in
    highest = np.empty(len(contrast), np.uint8)
    for y in range(contrast.shape[0]):
        peak = np.uint8(0)
        for x in range(contrast.shape[1]):
            peak = max(peak, contrast[y, x])
        highest[y] = peak
    number, count = 0, 0
    for level in levels:
        before = number
        for y in range(contrast.shape[0]):
            if highest[y] <= level:
                continue
            for x in range(contrast.shape[1]):
                if contrast[y, x] <= level or label[y, x] > before:
                    continue
                number += 1
                left, top, right, bottom = flood_fill(contrast, level, y, x, label, number, stack)
                if max(right - left, bottom - top) >= shape[0]:
                    continue
                listed = count == len(found)  # or this is the foot of a blob of a higher level
                for k in range(count):
                    listed = listed or label[seeds[k, 0], seeds[k, 1]] == number
                if listed:
                    continue
                x0, y0 = max(left - BOX_MARGIN, 0), max(top - BOX_MARGIN, 0)
                part = contrast[y0 : bottom + BOX_MARGIN + 1, x0 : right + BOX_MARGIN + 1]
                if measure_half_height(part, shape[1], shape[2], found[count]):
                    found[count, 0] += x0
                    found[count, 1] += y0
                    seeds[count, 0], seeds[count, 1] = y, x
                    count += 1
    return count


@compiled
def flood_fill(
    contrast: Image,
    level: int,
    y: int,
    x: int,
    label: Labels,
    number: int,
    stack: NDArray[np.int32],
) -> tuple[int, int, int, int]:
    """Label what is above a level and connected with a pixel, also by corners; give its box."""
    height, width = contrast.shape
    left, top, right, bottom = x, y, x, y
    stack[0, 0], stack[0, 1], label[y, x] = y, x, number
    waiting = 1
    while waiting > 0:
        waiting -= 1
        y, x = stack[waiting, 0], stack[waiting, 1]
        left, top, right, bottom = min(left, x), min(top, y), max(right, x), max(bottom, y)
        for v in range(max(y - 1, 0), min(y + 2, height)):
            for u in range(max(x - 1, 0), min(x + 2, width)):
                if contrast[v, u] > level and label[v, u] != number:
                    stack[waiting, 0], stack[waiting, 1], label[v, u] = v, u, number
                    waiting += 1
    return left, top, right, bottom
