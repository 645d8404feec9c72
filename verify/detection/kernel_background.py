"""What is brighter than its surroundings, compiled: three steps a pixel, whatever the window.

OpenCV's top hat takes as many as its window is wide. The same values.
"""

import numpy as np

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
    low, turned = np.empty((height, width), np.uint8), np.empty((width, height), np.uint8)
    least_along(image, reach, low)
    if even(low):  # as where there is nothing but black between the LEDs
        level = low[0, 0]
        for y in range(height):
            for x in range(width):
                contrast[y, x] = image[y, x] - level
        return
    turn(low, turned)
    least_along(turned, reach, turned)
    complement(turned)  # the greatest of the least: the least of the complement
    least_along(turned, reach, turned)
    turn(turned, low)
    least_along(low, reach, low)
    for y in range(height):
        for x in range(width):
            contrast[y, x] = image[y, x] - (255 - low[y, x])


@compiled
def even(image: Image) -> bool:
    """Whether all pixels are alike."""
    level, uneven = image[0, 0], np.uint8(0)
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            uneven |= image[y, x] ^ level
    return bool(uneven == 0)


@compiled
def turn(image: Image, turned: Image) -> None:
    """Make rows of columns."""
    for x in range(image.shape[1]):
        for y in range(image.shape[0]):
            turned[x, y] = image[y, x]


@compiled
def complement(image: Image) -> None:
    """Make dark bright."""
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            image[y, x] = 255 - image[y, x]


@compiled
def least_along(image: Image, reach: int, least: Image) -> None:
    """Fill in the least of each column's values within `reach` rows; may be the image itself.

    Source: van Herk (1992), Gil and Werman (1993): of blocks as long as the window, the least from
    their begin on and that to their end.
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
