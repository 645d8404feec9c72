"""The pixels of a grey picture around each candidate, compiled."""

import numpy as np
from numpy.typing import NDArray

from verify.compiled import compiled
from verify.records import Array, Image


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
    """Read n patches of p pixels each.

    Args:
        image: (h, w).
        origin: (n, 2), px, column and row of each patch's centre pixel.
        scale: (n,), px: within, a pixel is the spot's.
        column: (n, p) or, the same for all, (1, p): px from the origin.
        row: likewise.
        pixels: (n, 4, p), filled: value, the nearest pixel's outside the image; 1 inside of it;
            column and row.
        contrast: (n, 3), filled: mean of the spot's pixels less the value that a third are below.
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
