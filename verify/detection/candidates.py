"""Where LEDs may be: compact bright things above their own surroundings, roughly placed."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from verify.detection.kernel_background import top_hat
from verify.detection.kernel_blob import half_height
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
    found: list[tuple[float, float, float, float]] = []
    if windows is None:
        height, width = image.shape[:2]
        windows = np.array([[0, 0, width, height]])
    for x0, y0, x1, y1 in windows:
        part = image[y0:y1, x0:x1]
        factor = 2 if (x1 - x0) * (y1 - y0) > HALVING_AREA else 1
        for x, y, radius, contrast in blobs(part, factor, largest):
            if 2 * radius + factor >= smallest and 2 * radius - factor <= largest:
                found.append((x + x0, y + y0, radius, contrast))
    rows = np.array(sorted(found, key=lambda row: -row[3])[:MOST]).reshape(-1, 4)
    return Candidates(rows[:, :2], rows[:, 2], rows[:, 3])


def blobs(part: Image, factor: int, largest: float) -> list[tuple[float, float, float, float]]:
    """Find compact blobs by their contrast: x, y, radius (px) and contrast (DN) of each."""
    height, width = part.shape[0] // factor, part.shape[1] // factor
    if min(height, width) < 3:
        return []
    small: Image = part
    if factor > 1:
        size = (width * factor, height * factor)
        whole = part[: size[1], : size[0]]
        small = np.asarray(
            cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.uint8
        )
    if small.ndim == 3:
        blue, green, red = cv2.split(small)
        small = np.asarray(cv2.max(cv2.max(blue, green), red), np.uint8)
    side = int(LARGER_THAN_LED * largest / factor) | 1
    contrast = above_surroundings(small, side)
    taken: list[tuple[float, float, float, float]] = []
    for level in LEVELS:
        _, above = cv2.threshold(contrast, level, 255, cv2.THRESH_BINARY)
        outlines, _ = cv2.findContours(above, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        for outline in outlines:
            x, y, box_width, box_height = cv2.boundingRect(outline)
            box = (x, y, box_width, box_height)
            if max(box[2:]) > 2 * side or holds_any(np.asarray(outline, np.int32), box, taken):
                continue
            blob = half_height_blob(contrast, box)
            if blob is not None:
                taken.append(blob)
    shift = (
        factor - 1
    ) / 2  # a pixel of the halved picture is centred between the two it came from
    return [(x * factor + shift, y * factor + shift, r * factor, c) for x, y, r, c in taken]


def above_surroundings(image: Image, side: int) -> Image:
    """Contrast of what is smaller than a square of `side` px, an odd number: the top hat, DN."""
    if image.size > FEW_PIXELS:
        window = np.ones((side, side), np.uint8)
        return np.asarray(cv2.morphologyEx(image, cv2.MORPH_TOPHAT, window), np.uint8)
    contrast = np.empty_like(image, order="C")
    top_hat(np.ascontiguousarray(image), side // 2, contrast)
    return contrast


def holds_any(
    outline: NDArray[np.int32],
    box: tuple[int, int, int, int],
    taken: list[tuple[float, float, float, float]],
) -> bool:
    """Whether a blob found at a higher level lies inside the outline: then this is its foot."""
    x, y, width, height = box
    return any(
        x - 1 <= blob[0] <= x + width
        and y - 1 <= blob[1] <= y + height
        and cv2.pointPolygonTest(outline, blob[:2], measureDist=True) > -1.0
        for blob in taken
    )


def half_height_blob(
    contrast: Image, box: tuple[int, int, int, int]
) -> tuple[float, float, float, float] | None:
    """Measure the brightest blob in a box at half its height; None where it is not compact."""
    x, y, width, height = box
    x0, y0 = max(x - 2, 0), max(y - 2, 0)  # 2 px: the half height may lie below the level
    told = np.empty(4)
    part = contrast[y0 : y + height + 2, x0 : x + width + 2]
    if not half_height(part, LONGEST, SMALLEST_FILL, told):
        return None
    return float(told[0]) + x0, float(told[1]) + y0, float(told[2]), float(told[3])
