"""Where LEDs may be: compact bright things above their own surroundings, roughly placed."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from verify.detection.kernel_background import top_hat
from verify.detection.kernel_levels import LEAST, compact_blobs, highest, search
from verify.records import Array, Image

LEVELS = (160, 80, 40, 18)  # DN of contrast, octaves: a bright thing must not hide a dim neighbour
# 18 DN: a dim LED of peak 60 keeps twice this after halving; noise of 2.5 DN, halved, 14 sigma.
HALVING_AREA = 200_000  # px; larger pictures are searched at half size, which keeps any LED >= 3 px
LONGEST = 2.5  # axis ratio at half height; an LED seen through a blur of its own length stays below
SMALLEST_FILL = (
    0.6  # blob area over its ellipse's: an LED fills it, a bent or branched thing does not
)
DEFAULT_DIAMETER = (
    2.0,
    40.0,
)  # px; 2 is the least that the sampling supports, 40 a 5 mm LED at 13 cm
LARGER_THAN_LED = (
    1.5  # background window over the largest diameter: nothing of an LED survives in it
)
FEW_PIXELS = 40_000  # of a window: above, OpenCV is as quick, whatever an LED measures
ROOM = 1024  # blobs told apart in one window, those of higher levels first
MOST = 64  # blobs fitted at most, best contrast first: bounds the time in a cluttered room


@dataclass(frozen=True, slots=True)
class Candidates:
    """Rough places of LED-like blobs, highest contrast first."""

    centre: Array  # (n, 2), px
    radius: Array  # (n,), px, half the width at half height
    contrast: Array  # (n,), DN above the surroundings

    def __len__(self) -> int:
        """Count the candidates."""
        return len(self.centre)

    def taken(self, which: NDArray[np.intp]) -> "Candidates":
        """Some of the candidates."""
        return Candidates(self.centre[which], self.radius[which], self.contrast[which])


def find_candidates(
    image: Image, windows: NDArray[np.int64] | None, diameter_px: tuple[float, float] | None
) -> Candidates:
    """List compact bright blobs of an image, inside the windows only if there are any.

    Args:
        image: (h, w) grey or (h, w, 3) BGR, searched by its brightest channel.
        windows: (m, 4), x0, y0, x1, y1, inside the image, upper bounds exclusive; None is all.
        diameter_px: least and largest full width; None is anything an LED may be.
    """
    smallest, largest = diameter_px or DEFAULT_DIAMETER
    if windows is None:
        windows = np.array([[0, 0, image.shape[1], image.shape[0]]])
    boxes = windows.tolist()
    area = [(x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in boxes]
    if image.ndim == 2 and max(area, default=0) <= FEW_PIXELS:
        found = in_small(image, windows, largest)
        halved = np.ones(len(found), dtype=np.intp)
    else:
        factor = [2 if pixels > HALVING_AREA else 1 for pixels in area]
        parts = [in_large(image, *one, largest) for one in zip(boxes, factor, strict=True)]
        found = np.concatenate([np.empty((0, 4)), *parts])
        halved = np.repeat(np.array(factor, np.intp), [len(part) for part in parts])
    best = np.empty((MOST, 4))
    best = best[: highest(found, halved, (float(smallest), float(largest)), best)]
    return Candidates(best[:, :2], best[:, 2].copy(), best[:, 3])


def in_small(image: Image, windows: NDArray[np.int64], largest: float) -> Array:
    """Find blobs in small windows of a grey picture, (n, 4): x, y, radius (px), contrast (DN)."""
    side = background_side(largest)
    found = np.empty((ROOM, 4))
    shape = float(2 * side), LONGEST, SMALLEST_FILL
    return found[: search(image, windows, side // 2, LEVELS, shape, found)]


def in_large(image: Image, window: list[int], factor: int, largest: float) -> Array:
    """Find blobs in a window of a picture of any kind, made smaller by a factor; likewise."""
    x0, y0, x1, y1 = window
    part = image[y0:y1, x0:x1]
    height, width = part.shape[0] // factor, part.shape[1] // factor
    if min(height, width) < LEAST:
        return np.empty((0, 4))
    if factor > 1:
        whole = part[: height * factor, : width * factor]
        part = np.asarray(
            cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.uint8
        )
    if part.ndim == 3:
        blue, green, red = cv2.split(part)
        part = np.asarray(cv2.max(cv2.max(blue, green), red), np.uint8)
    side = background_side(largest / factor)
    found = np.empty((ROOM, 4))
    shape = float(2 * side), LONGEST, SMALLEST_FILL
    found = found[: compact_blobs(above_surroundings(part, side), LEVELS, shape, found)]
    found[:, :3] *= factor
    # a pixel of the halved picture is centred between the two it came from
    found[:, :2] += (factor - 1) / 2 + np.array([x0, y0])
    return found


def background_side(largest: float) -> int:
    """Side of the square that surroundings are taken from, an odd number of px."""
    return int(LARGER_THAN_LED * largest) | 1


def above_surroundings(image: Image, side: int) -> Image:
    """Contrast of what is smaller than a square of `side` px, an odd number: the top hat, DN."""
    if image.size > FEW_PIXELS:
        window = np.ones((side, side), np.uint8)
        return np.asarray(cv2.morphologyEx(image, cv2.MORPH_TOPHAT, window), np.uint8)
    contrast = np.empty_like(image, order="C")
    top_hat(np.ascontiguousarray(image), side // 2, contrast)
    return contrast
