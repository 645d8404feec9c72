"""What a patch's pixels lead one to expect of its spot before it is fitted, compiled."""

import numpy as np

from verify.compiled import compiled
from verify.detection.kernel_clip import SENSOR_LIMIT
from verify.detection.kernel_pixels import FLOOR, PEAK, SLOPE_X, SLOPE_Y
from verify.records import Array

FULL = 3.0  # DN below the limit: a top so near it is cut off, and higher than it seems
HIDDEN, SEEN = 1.3, 1.05  # peak over what the core shows: of a cut-off top, and of another
DEEPEST = 30.0  # DN about the floor: a neighbour is no slope


@compiled
def expect_all(pixels: Array, scale: Array, mean: Array, weight: Array) -> None:
    """Fill in peak, floor, and how firmly the slopes are held.

    Args:
        pixels: (n, 4, p): value, 1 where valid, column, row.
        scale: (n,), px, half-width that the fit starts from.
        mean: (n, 10), filled in part.
        weight: (n, 10), likewise.
    """
    size = pixels.shape[2]
    third = size * 3 // 10
    for n in range(len(pixels)):
        value, valid, column, row = pixels[n, 0], pixels[n, 1], pixels[n, 2], pixels[n, 3]
        floor = np.partition(value, third)[third]
        core, ring = (0.5 * scale[n] + 0.5) ** 2, (2.3 * scale[n] + 1.0) ** 2
        total, count = 0.0, 0.0
        lean_x, lean_y, lever_x, lever_y = 0.0, 0.0, 0.0, 0.0
        for k in range(size):
            if valid[k] <= 0.0:
                continue
            x, y = column[k], row[k]
            distance2 = x * x + y * y
            if distance2 <= core:
                total += value[k]
                count += 1.0
            elif distance2 > ring:
                excess = min(max(value[k] - floor, -DEEPEST), DEEPEST)
                lean_x += excess * x
                lean_y += excess * y
                lever_x += x * x
                lever_y += y * y
        top = total / max(count, 1.0)
        mean[n, FLOOR] = floor
        mean[n, PEAK] = (HIDDEN if top > SENSOR_LIMIT - FULL else SEEN) * max(top - floor, 1.0)
        # A slope costs the centre information, so it is let in as far as the surroundings have one.
        weight[n, SLOPE_X] = 1.0 / ((lean_x / max(lever_x, 1.0)) ** 2 + 1e-8)
        weight[n, SLOPE_Y] = 1.0 / ((lean_y / max(lever_y, 1.0)) ** 2 + 1e-8)
