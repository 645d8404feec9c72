"""What is brighter than its surroundings, compiled: three steps a pixel, whatever the window.

OpenCV's top hat takes as many as its window is wide. The same values.
"""

import numpy as np
from numpy.typing import NDArray

from verify.compiled import compiled
from verify.records import Image


@compiled
def top_hat(image: Image, reach: int, contrast: Image) -> None:
    """Fill in an image less its opening by a square of 2 reach + 1 px; borders hold nothing.

    Args:
        image: (h, w).
        reach: px.
        contrast: (h, w), filled.
    """
    height, width = image.shape
    rows, low = np.empty_like(image), np.empty_like(image)
    least_along(image, reach, rows)
    least_along(rows.T, reach, low.T)
    # the greatest of the least: the least of the complement
    for y in range(height):
        for x in range(width):
            low[y, x] = 255 - low[y, x]
    least_along(low, reach, rows)
    least_along(rows.T, reach, low.T)
    for y in range(height):
        for x in range(width):
            contrast[y, x] = image[y, x] - (255 - low[y, x])


@compiled
def least_along(image: NDArray[np.uint8], reach: int, least: NDArray[np.uint8]) -> None:
    """Fill in the least of each column's values within `reach` rows.

    Source: van Herk (1992), Gil and Werman (1993): of blocks as long as the window, the least from
    their begin on and that to their end.
    """
    height, width = image.shape
    block = 2 * reach + 1
    so_far, to_come = np.empty((height, width), np.uint8), np.empty((height, width), np.uint8)
    for y in range(height):
        begins = y % block == 0
        for x in range(width):
            so_far[y, x] = image[y, x] if begins else min(so_far[y - 1, x], image[y, x])
    for y in range(height - 1, -1, -1):
        ends = y == height - 1 or (y + 1) % block == 0
        for x in range(width):
            to_come[y, x] = image[y, x] if ends else min(to_come[y + 1, x], image[y, x])
    for y in range(height):
        before, after = y - reach, min(y + reach, height - 1)
        if before < 0:
            least[y] = so_far[after]
        elif before // block == after // block:
            least[y] = to_come[before]
        else:
            for x in range(width):
                least[y, x] = min(so_far[after, x], to_come[before, x])
