"""Find compact bright blobs that may be LEDs.

A blob stands above its own surroundings (top hat) at one of a few levels of contrast.
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from verify.core.records import Array, Image
from verify.measurement.detection.kernels.entries import (
    MIN_WINDOW_SIDE,
    Shape,
    compact_blobs,
    contrast_boxes,
    find_blobs,
)

LEVELS = (160, 80, 40, 18)  # DN of contrast, octaves: a bright blob must not hide a dim neighbour
# 18 DN: a dim LED of peak 60 keeps twice this after halving; noise of 2.5 DN, halved, 14 sigma.
MAX_FULL_SIZE_AREA = 200_000  # px; larger: searched at half size, which keeps any LED >= 3 px
MAX_AXIS_RATIO = 2.5  # at half height; an LED blurred by motion over its own length stays below
MIN_FILL = 0.6  # blob area over its ellipse's: an LED fills it, a bent or branched blob does not
DIAMETER_RANGE = (2.0, 40.0)  # px; least that sampling supports, and a 5 mm LED at 13 cm
BACKGROUND_FACTOR = 1.5  # background window over the largest diameter: no LED survives in it
MAX_SMALL_AREA = 40_000  # px, of a window: larger ones are searched where something is bright
MAX_BLOBS = 1024  # blobs listed in one window, those of higher levels first
MAX_CANDIDATES = 64  # blobs fitted, best contrast first: bounds the time in a cluttered room


def find_candidates(image: Image, windows: NDArray[np.int64] | None) -> Array:
    """List compact bright blobs of an image, inside the windows only if there are any.

    (h, w) grey or (h, w, 3) BGR is searched by its brightest channel. `windows` (m, 4): x0, y0, x1,
    y1, inside the image, upper bounds exclusive; None is all. Gives, (n, 4), highest contrast
    first: column and row of the centre, px; half the width at half height, px; contrast above the
    surroundings, DN.
    """
    if windows is None:
        windows = np.array([[0, 0, image.shape[1], image.shape[0]]])
    boxes = windows.tolist()
    largest_area = max(((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in boxes), default=0)
    if image.ndim == 2 and largest_area <= MAX_SMALL_AREA:
        blobs = find_blobs(image, windows, 0, *blob_arguments(1))
        found = of_diameter(blobs, 1)
    else:
        parts = [find_in_large_window(image, box) for box in boxes]
        found = np.concatenate([np.empty((0, 4)), *parts])
    return found[np.argsort(-found[:, 3], kind="stable")[:MAX_CANDIDATES]]


def of_diameter(blobs: Array, step: int) -> Array:
    """Blobs (n, 4) whose full width is within DIAMETER_RANGE, to one pixel of `step` px."""
    smallest, largest = DIAMETER_RANGE
    off = np.abs(2.0 * blobs[:, 2] - (largest + smallest) / 2.0)
    return blobs[off <= (largest - smallest) / 2.0 + step]


def find_in_large_window(image: Image, window: list[int]) -> Array:
    """Find blobs in a window of any picture, halved if large, as `find_candidates` does."""
    x0, y0, x1, y1 = window
    factor = 2 if (x1 - x0) * (y1 - y0) > MAX_FULL_SIZE_AREA else 1
    part = image[y0:y1, x0:x1]
    height, width = part.shape[0] // factor, part.shape[1] // factor
    if min(height, width) < MIN_WINDOW_SIDE:
        return np.empty((0, 4))
    if factor > 1:
        whole = part[: height * factor, : width * factor]
        part = np.asarray(
            cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.uint8
        )
    if part.ndim == 3:
        blue, green, red = cv2.split(part)
        part = np.asarray(cv2.max(cv2.max(blue, green), red), np.uint8)
    part = np.ascontiguousarray(part)
    reach, levels, shape, most = blob_arguments(factor)
    boxes = contrast_boxes(part, reach, LEVELS[-1])
    if boxes[:1].tolist() == [[0, 0, width, height]]:  # OpenCV is quicker for all of a picture
        square = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
        contrast = np.asarray(cv2.morphologyEx(part, cv2.MORPH_TOPHAT, square), np.uint8)
        found = np.empty((most, 4))
        found = found[: compact_blobs(contrast, levels, shape, found)]
    else:
        found = find_blobs(part, boxes, 2 * reach, reach, levels, shape, most)
    found[:, :3] *= factor
    # a pixel of the halved picture is centred between the two it came from
    found[:, 0] += x0 + (factor - 1) / 2
    found[:, 1] += y0 + (factor - 1) / 2
    return of_diameter(found, factor)


def blob_arguments(factor: int) -> tuple[int, tuple[int, ...], Shape, int]:
    """Last arguments of `find_blobs` in a picture that is smaller by a factor."""
    largest = DIAMETER_RANGE[1] / factor
    reach = int(BACKGROUND_FACTOR * largest) // 2
    longest = largest * math.sqrt(MAX_AXIS_RATIO / MIN_FILL) + 1.0
    return reach, LEVELS, (4.0 * reach + 2.0, longest, MAX_AXIS_RATIO, MIN_FILL), MAX_BLOBS
