"""Where in a whole picture the target's colour is: coarsely, then by CAMSHIFT around each place."""

import cv2
import numpy as np

from verify.grab.camshift import Blob, Box, camshift
from verify.grab.colour import ColourModel, to_hsv
from verify.records import Array, Image

STEP = 4  # of the coarse look: every fourth pixel of every fourth row
LIKELY = 127  # of 255
FEWEST = 3  # coarse pixels
MOST = 8  # places that are looked at closely, largest first
WIDEST = 0.4  # of the picture's width: no cap, but a wall of that colour
MARGIN = 1.5  # search region over the coarse box


def find_all(
    image: Image, model: ColourModel, but: Box | None = None, expected: Array | None = None
) -> list[Blob]:
    """Find every patch of the target's colour in a picture, largest first.

    Args:
        image: (h, w, 3) BGR.
        model: the colours.
        but: what need not be looked at again.
        expected: (2,), px, the target's width and height, where they are known.

    Raises:
        InputError: the picture is grey.
    """
    found: list[Blob] = []
    for box in places(image, model):
        if but is not None and overlap(box, but):
            continue
        blob = camshift(image, box, _widened(box), model, expected)
        if blob is not None and not any(_same(blob, other) for other in found):
            found.append(blob)
    return sorted(found, key=lambda blob: -blob.area)


def places(image: Image, model: ColourModel) -> list[Box]:
    """Look coarsely for patches of a colour: boxes in pixels of the picture, largest first."""
    size = (image.shape[1] // STEP, image.shape[0] // STEP)
    coarse = to_hsv(np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_NEAREST), np.uint8))
    likely = np.asarray(model.back_project(coarse) > LIKELY, dtype=np.uint8)
    stats = cv2.connectedComponentsWithStats(likely, connectivity=8)[2][1:]  # 0: the background
    sides = stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]]
    fits = (stats[:, cv2.CC_STAT_AREA] >= FEWEST) & (sides.max(axis=1) <= WIDEST * size[0])
    patches = sorted(stats[fits].tolist(), key=lambda row: -row[cv2.CC_STAT_AREA])
    return [
        (STEP * x, STEP * y, STEP * width, STEP * height)
        for x, y, width, height, _ in patches[:MOST]
    ]


def overlap(one: Box, other: Box) -> bool:
    """Whether two boxes have a pixel in common."""
    apart = one[0] >= other[0] + other[2] or other[0] >= one[0] + one[2]
    return not (apart or one[1] >= other[1] + other[3] or other[1] >= one[1] + one[3])


def _widened(box: Box) -> Box:
    x, y, width, height = box
    dx = int(np.ceil((MARGIN - 1) / 2 * width)) + 2 * STEP
    dy = int(np.ceil((MARGIN - 1) / 2 * height)) + 2 * STEP
    return x - dx, y - dy, width + 2 * dx, height + 2 * dy


def _same(one: Blob, other: Blob) -> bool:
    """Two coarse patches can be pieces of one target."""
    x, y, width, height = other.box
    inside = x <= one.centre[0] < x + width and y <= one.centre[1] < y + height
    return bool(inside)
