"""Find compact bright blobs of a picture, from the highest level of contrast down.

The contrast is the top hat: the image less its opening by a square, which is the greatest of the
least values about each pixel. Levels are searched from the brightest down, so that a bright blob
does not hide a faint neighbour. OpenCV's top hat takes as many steps a pixel as its square is wide,
this one the logarithm of it.

A large picture is searched where a block of pixels may exceed the lowest level: its greatest value
less the opening of the blocks' least values, which is at most that of the pixels.

A blob is measured at half its height. Of the pixels above half the peak and connected with it,
holes filled, A many:

    half width = sqrt(A / pi),  moments = sum (d d') / A + 1/12,  d px from their mean
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled
from verify.core.records import Array, Image
from verify.measurement.kernels.alignment import merge_boxes

MIN_WINDOW_SIDE = 3  # px, side of a window: smaller ones show no blob
BLOCK = 16  # px, side of a block
MAX_BOXES = 64  # boxes that are searched one by one; with more, as one
MAX_SHARE = 0.4  # of a picture, that these boxes and what is about them may cover
BOX_MARGIN = 2  # px about a region's box: its half height may lie below the level
MAX_REFUSED = 64  # regions without a blob that are kept in mind in a window: each slows the search
MIN_PIXELS = 12  # px; fewer show no shape
OUTSIDE, INSIDE = 0, 1
Boxes = NDArray[np.int64]
Box = tuple[int, int, int, int]
Labels = NDArray[np.int32]
Shape = tuple[float, float, float, float]


@compiled
def top_hat(image: Image, window: Box, margin: int, reach: int) -> Image:
    """Contrast in a window (h, w): the image less its opening by a square of 2 reach + 1 px.

    `window`: x0, y0, x1, y1, px, upper bounds exclusive, inside the image. A `margin` about it
    counts: 0, or no less than 2 reach. Borders hold nothing.
    """
    x0, y0, x1, y1 = window
    left, top = max(x0 - margin, 0), max(y0 - margin, 0)
    part = image[top : y1 + margin, left : x1 + margin]
    # where least values are asked for: the window, and as far as it looks for the greatest of them
    west, north = max(x0 - reach, left), max(y0 - reach, top)
    wide = min(x1 + reach, left + part.shape[1]) - west
    high = min(y1 + reach, top + part.shape[0]) - north
    pad = reach - north + top, reach - west + left
    least = erode(part, pad, (high, wide), reach)
    for y in range(high):  # the greatest value is the least of the complement
        for x in range(wide):
            least[y, x] = 255 - least[y, x]
    shape = y1 - y0, x1 - x0
    contrast = erode(least, (reach - y0 + north, reach - x0 + west), shape, reach)
    for y in range(shape[0]):
        for x in range(shape[1]):
            contrast[y, x] += image[y0 + y, x0 + x] - 255
    return contrast


@compiled
def erode(values: Image, pad: tuple[int, int], shape: tuple[int, int], reach: int) -> Image:
    """Least value, (h, w) of that shape, in each square of 2 reach + 1 px; nothing is beyond.

    `pad`: rows above `values`, and columns left of them, where the first square begins.
    """
    (above, beside), (high, wide), side = pad, shape, 2 * reach + 1
    along = least_ahead(values, (0, beside), (len(values), wide + side - 1), 1, side)
    return least_ahead(along[:, :wide], (above, 0), (high + side - 1, wide), wide, side)[:high]


@compiled
def least_ahead(
    part: Image, pad: tuple[int, int], shape: tuple[int, int], step: int, count: int
) -> Image:
    """Least of `count` values from each one on, `step` apart, as a picture (h, w) of `shape`.

    A step of 1 goes along rows, one of w down columns. `part` stands behind `pad` rows and columns
    of nothing (255) in that picture. What has fewer values ahead of it, at the end, means nothing.
    """
    values = np.full(shape[0] * shape[1], 255, np.uint8)
    for y in range(part.shape[0]):
        begin = (pad[0] + y) * shape[1] + pad[1]
        row = values[begin : begin + part.shape[1]]
        for x in range(part.shape[1]):
            row[x] = part[y, x]
    have, end, spare = 1, len(values), np.empty_like(values)
    while have < count:
        more = min(have, count - have)
        end -= more * step  # beyond it too few are ahead
        least_of(values[:end], values[more * step :], spare[:end])
        values, spare = spare, values
        have += more
    return values.reshape(shape)


@compiled
def least_of(values: Image, others: Image, least: Image) -> None:
    """Fill in the lesser of two values each, (n,)."""
    for i in range(len(least)):
        least[i] = min(values[i], others[i])


@compiled
def contrast_boxes(image: Image, reach: int, level: int) -> Boxes:
    """Boxes (n, 4), disjoint, outside which no pixel's contrast exceeds a level, DN.

    `image` (h, w), `reach` as for `find_blobs`. Columns: x0, y0, x1, y1, px, upper bounds
    exclusive. A box includes what is within BOX_MARGIN of such pixels. The whole picture is the one
    box where they would be many or large.
    """
    height, width = image.shape
    shape = -(-height // BLOCK), -(-width // BLOCK)
    most, least = np.zeros(shape, np.uint8), np.empty(shape, np.uint8)
    above, below = np.empty(width, np.uint8), np.empty(width, np.uint8)
    for row in range(shape[0]):
        above[:], below[:] = 0, 255
        for y in range(row * BLOCK, min((row + 1) * BLOCK, height)):
            for x in range(width):
                above[x], below[x] = max(above[x], image[y, x]), min(below[x], image[y, x])
        for column in range(shape[1]):
            low = below[column * BLOCK]
            for x in range(column * BLOCK, min((column + 1) * BLOCK, width)):
                most[row, column], low = max(most[row, column], above[x]), min(low, below[x])
            least[row, column] = low
    contrast = top_hat(least, (0, 0, shape[1], shape[0]), 0, -(-reach // BLOCK))
    for row in range(shape[0]):
        for column in range(shape[1]):
            contrast[row, column] += most[row, column] - least[row, column]
    label, stack = np.zeros(shape, np.int32), np.empty((contrast.size, 2), np.int32)
    boxes, count, area = np.empty((MAX_BOXES + 1, 4)), 0, 0.0
    for row in range(shape[0]):
        for column in range(shape[1]):
            if contrast[row, column] <= level or label[row, column] > 0 or count > MAX_BOXES:
                continue
            x0, y0, x1, y1 = flood_fill(contrast, level, row, column, label, 1, stack)
            boxes[count, 0] = max(BLOCK * x0 - BOX_MARGIN, 0)
            boxes[count, 1] = max(BLOCK * y0 - BOX_MARGIN, 0)
            boxes[count, 2] = min(BLOCK * (x1 + 1) + BOX_MARGIN, width)
            boxes[count, 3] = min(BLOCK * (y1 + 1) + BOX_MARGIN, height)
            count += 1
    apart = boxes[: merge_boxes(boxes[:count])]
    for x0, y0, x1, y1 in apart:
        area += (x1 - x0 + 4 * reach) * (y1 - y0 + 4 * reach)
    if count > MAX_BOXES or area > MAX_SHARE * image.size:
        return np.array([[0, 0, width, height]])
    return apart.astype(np.int64)


@compiled
def find_blobs(
    image: Image,
    windows: Boxes,
    margin: int,
    reach: int,
    levels: tuple[int, ...],
    shape: Shape,
    most: int,
) -> Array:
    """List compact bright blobs in windows of a grey picture, (m, 4), as `compact_blobs` does.

    `windows` (n, 4): x0, y0, x1, y1, upper bounds exclusive; a `margin`, px, about them is
    background only. `reach`, px: what has brightness at that distance all around is background.
    `levels` and `shape` as for `compact_blobs`. At most `most` are listed.
    """
    found, count = np.empty((most, 4)), 0
    for window in windows:
        x0, y0, x1, y1 = window
        if min(x1 - x0, y1 - y0) < MIN_WINDOW_SIDE:
            continue
        before, contrast = count, top_hat(image, (x0, y0, x1, y1), margin, reach)
        count += compact_blobs(contrast, levels, shape, found[before:])
        for k in range(before, count):
            found[k, 0] += x0
            found[k, 1] += y0
    return found[:count]


@compiled
def compact_blobs(contrast: Image, levels: tuple[int, ...], shape: Shape, found: Array) -> int:
    """List compact blobs by their contrast, and count them; a bright one's foot is no further one.

    `contrast` (h, w), DN above the surroundings; `levels`, DN, falling; `shape`: longest side of a
    blob's box, px, at a level and at half height; longest axis ratio; least area over its
    ellipse's. `found` (m, 4) is filled from the first row with as many as it holds: column and row
    of the centre, px; half width, px; height, DN.
    """
    label = np.zeros(contrast.shape, np.int32)
    stack = np.empty((contrast.size, 2), np.int32)
    # a pixel of each region that is settled: a blob was found in it, or no lower level shows one
    seeds, settled = np.empty((len(found) + MAX_REFUSED, 2), np.int32), 0
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
                known = count == len(found)  # or this is the foot of a region of a higher level
                for k in range(settled):
                    known = known or label[seeds[k, 0], seeds[k, 1]] == number
                if known:
                    continue
                x0, y0 = max(left - BOX_MARGIN, 0), max(top - BOX_MARGIN, 0)
                part = contrast[y0 : bottom + BOX_MARGIN + 1, x0 : right + BOX_MARGIN + 1].copy()
                compact = measure_half_height(part, shape, found[count])
                refused = 2 * level <= found[count, 3] and settled - count < MAX_REFUSED
                if compact or refused:
                    seeds[settled, 0], seeds[settled, 1] = y, x
                    settled += 1
                if compact:
                    found[count, 0] += x0
                    found[count, 1] += y0
                    count += 1
    return count


@compiled
def measure_half_height(part: Image, shape: Shape, blob: Array) -> bool:
    """Measure the brightest blob of a picture at half its height; False: none, or not compact.

    `part` (h, w), DN above the surroundings; `shape` as for `compact_blobs`; `blob` (4,), filled:
    centre's column and row, px; half width, px; height, DN.
    """
    height, width = part.shape
    at_y, at_x, peak = 0, 0, -1
    for y in range(height):
        for x in range(width):
            if part[y, x] > peak:
                at_y, at_x, peak = y, x, int(part[y, x])
    blob[3] = peak
    region, stack = np.zeros(part.shape, np.int32), np.empty((part.size, 2), np.int32)
    box = flood_fill(part, peak // 2, at_y, at_x, region, 1, stack)
    if max(box[2] - box[0], box[3] - box[1]) >= shape[1]:
        return False
    alone = True
    for y in range(height):
        for x in range(width):
            alone = alone and (2 * part[y, x] <= peak or region[y, x] == 1)
    if not alone:  # a hole of the region may hold the others
        fill_holes(part, peak, at_y, at_x, region)
    area, x_sum, y_sum = 0, 0, 0
    for y in range(height):
        for x in range(width):
            if region[y, x] > 0 and 2 * part[y, x] > peak:
                area, x_sum, y_sum = area + 1, x_sum + x, y_sum + y
    if area == 0 or area == height * width:
        return False
    blob[0], blob[1] = x_sum / area, y_sum / area
    blob[2] = math.sqrt(area / math.pi)
    xx, xy, yy = 0.0, 0.0, 0.0
    for y in range(height):
        for x in range(width):
            if region[y, x] > 0 and 2 * part[y, x] > peak:
                xx += (x - blob[0]) * (x - blob[0])
                xy += (x - blob[0]) * (y - blob[1])
                yy += (y - blob[1]) * (y - blob[1])
    # a pixel is a square, not a point: its own variance is 1/12
    xx, xy, yy = xx / area + 1 / 12, xy / area, yy / area + 1 / 12
    mean, split = (xx + yy) / 2.0, math.hypot((xx - yy) / 2.0, xy)
    long, short = 2.0 * math.sqrt(mean + split), 2.0 * math.sqrt(max(mean - split, 0.0))
    return area < MIN_PIXELS or (
        long <= shape[2] * short and area >= shape[3] * math.pi * long * short
    )


@compiled
def fill_holes(part: Image, peak: int, y: int, x: int, region: Labels) -> None:
    """Label as 1 what is connected with a pixel once the holes of what is above half are filled."""
    height, width = part.shape
    filled = np.full((height + 2, width + 2), INSIDE, np.uint8)  # with a rim that is no part of it
    label, stack = np.zeros(filled.shape, np.int32), np.empty((filled.size, 2), np.int32)
    flood_outside(part, peak, filled, stack)
    flood_fill(filled, OUTSIDE, y + 1, x + 1, label, 1, stack)
    for v in range(height):
        for u in range(width):
            region[v, u] = label[v + 1, u + 1]


@compiled
def flood_outside(part: Image, peak: int, label: Image, stack: Labels) -> None:
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
def flood_fill(
    contrast: Image,
    level: int,
    y: int,
    x: int,
    label: Labels,
    number: int,
    stack: Labels,
) -> tuple[int, int, int, int]:
    """Label what is above a level and connected with a pixel, also by corners; give its box."""
    height, width = contrast.shape
    left, top, right, bottom = x, y, x, y
    stack[0, 0], stack[0, 1], label[y, x] = y, x, number
    waiting = 1
    while waiting > 0:
        waiting -= 1
        y, west = stack[waiting, 0], stack[waiting, 1]
        east = west
        while west > 0 and contrast[y, west - 1] > level and label[y, west - 1] != number:
            west -= 1
            label[y, west] = number
        while east < width - 1 and contrast[y, east + 1] > level and label[y, east + 1] != number:
            east += 1
            label[y, east] = number
        left, top, right, bottom = min(left, west), min(top, y), max(right, east), max(bottom, y)
        for v in (y - 1, y + 1):
            if not 0 <= v < height:
                continue
            run = False  # of pixels not yet labelled: its first one stands for it
            for u in range(max(west - 1, 0), min(east + 2, width)):
                if contrast[v, u] > level and label[v, u] != number:
                    if not run:
                        stack[waiting, 0], stack[waiting, 1], label[v, u] = v, u, number
                        waiting += 1
                    run = True
                else:
                    run = False
    return left, top, right, bottom
