"""Find compact bright blobs that may be LEDs.

A blob stands above its own surroundings (top hat) at one of a few levels of contrast.
"""

import math
from functools import cache

import cv2
import numpy as np

from verify.core.records import Array, Image
from verify.measurement.detection.kernels.entries import (
    MIN_WINDOW_SIDE,
    BlobSearch,
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


def find_candidates(image: Image, windows: Array | None) -> Array:
    """List compact bright blobs of an image, inside the windows only if there are any.

    (h, w) grey or (h, w, 3) BGR is searched by its brightest channel. `windows` (m, 4): x0, y0, x1,
    y1, px, cut at the image's border; None is all. Gives, (n, 4), highest contrast first: column
    and row of the centre, px; half the width at half height, px; contrast above the surroundings,
    DN.
    """
    height, width = image.shape[:2]
    if windows is None:
        windows = np.array([[0.0, 0.0, width, height]])
    inside = np.clip(windows, 0.0, [width, height, width, height])
    boxes = np.concatenate([np.floor(inside[:, :2]), np.ceil(inside[:, 2:])], axis=1).astype(int)
    parts = [find_in_large_window(image, box) for box in boxes.tolist()]
    found = np.concatenate([np.empty((0, 4)), *parts])
    return found[np.argsort(-found[:, 3], kind="stable")[:MAX_CANDIDATES]]


def are_small(windows: Array) -> bool:
    """Whether windows (m, 4) are searched at full size, each as a whole."""
    return all((x1 - x0) * (y1 - y0) <= MAX_SMALL_AREA for x0, y0, x1, y1 in windows.tolist())


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
    search = blob_search(factor)
    reach, levels, shape, most = search
    boxes = contrast_boxes(part, reach, LEVELS[-1])
    if boxes[:1].tolist() == [[0, 0, width, height]]:  # OpenCV is quicker for all of a picture
        square = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
        contrast = np.asarray(cv2.morphologyEx(part, cv2.MORPH_TOPHAT, square), np.uint8)
        found = compact_blobs(contrast, levels, shape, most)
    else:
        found = find_blobs(part, boxes, 2 * reach, search)
    found[:, :3] *= factor
    # a pixel of the halved picture is centred between the two it came from
    found[:, 0] += x0 + (factor - 1) / 2
    found[:, 1] += y0 + (factor - 1) / 2
    width_px, (least, largest) = 2.0 * found[:, 2], DIAMETER_RANGE
    # to one pixel of the picture that was searched
    return found[(least - factor <= width_px) & (width_px <= largest + factor)]


@cache
def blob_search(factor: int) -> BlobSearch:
    """What blobs are searched by in a picture that is smaller by a factor."""
    largest = DIAMETER_RANGE[1] / factor
    reach = int(BACKGROUND_FACTOR * largest) // 2
    longest = largest * math.sqrt(MAX_AXIS_RATIO / MIN_FILL) + 1.0
    shape = 4.0 * reach + 2.0, longest, MAX_AXIS_RATIO, MIN_FILL
    return BlobSearch(reach, np.array(LEVELS, np.int64), shape, MAX_BLOBS)
