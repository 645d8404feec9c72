"""Entries of the compiled loops over pixels: candidates, noise, spots of a picture."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from verify.core.native import entry
from verify.core.records import Array, Image

Pixels = NDArray[np.float32]
Counts = NDArray[np.int32]

# Columns of an assessed spot, as in quality.h
COL_CENTRE_X, COL_CENTRE_Y = range(2)
COL_COVARIANCE_XX, COL_COVARIANCE_XY, COL_COVARIANCE_YX, COL_COVARIANCE_YY = range(2, 6)
COL_PEAK, COL_DIAMETER, COL_ELONGATION, COL_MISFIT = range(6, 10)
COL_SATURATED, COL_MERGED, COL_SOUND, COL_COUNT = range(10, 14)
COL_STRETCH_X, COL_STRETCH_Y = range(14, 16)
N_COLUMNS = 16
PRIOR_DEPTH = 0.05  # half-widths, scale of the bites that occlusion.c expects
MIN_WINDOW_SIDE = 3  # px, side of a window: smaller ones show no blob
MAX_BOXES = 64  # boxes that are searched one by one; with more, as one

Boxes = NDArray[np.int64]
Shape = tuple[float, float, float, float]

# levels are whole thirty-fifths, differences whole: both can be counted
LEVEL_PARTS, LOWEST_LEVEL, N_LEVELS = 35, 6 * 255, 50 * 255 + 1  # a level in parts of one DN
N_DIFFERENCES = 1024  # the last stands for larger ones too: of a texture, not of noise
MIN_ABOVE_BLACK, CLASS_WIDTH = 5, 12  # DN, of classes of brightness: the first begins there; width
N_CLASSES = math.ceil((256 - MIN_ABOVE_BLACK) / CLASS_WIDTH)
FIRST_LEVEL, CLASS_PARTS = LOWEST_LEVEL + LEVEL_PARTS * MIN_ABOVE_BLACK, LEVEL_PARTS * CLASS_WIDTH

_contrast_boxes = entry("contrast_boxes")
_find_blobs = entry("find_blobs")
_compact_blobs = entry("compact_blobs")
_top_hat = entry("top_hat")
_flood_fill = entry("flood_fill")


def contrast_boxes(image: Image, reach: int, level: int) -> Boxes:
    """Boxes (n, 4), disjoint, outside which no pixel's contrast exceeds a level, DN.

    `image` (h, w), `reach` as for `find_blobs`. Columns: x0, y0, x1, y1, px, upper bounds
    exclusive. The whole picture is the one box where they would be many or large.
    """
    boxes = np.empty((MAX_BOXES, 4), np.int64)
    return boxes[: _contrast_boxes(*image.shape, image, reach, level, boxes)]


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
    background only: 0, or 2 `reach`. `reach`, px: what has brightness at that distance all around
    is background. `levels` and `shape` as for `compact_blobs`. At most `most` are listed.
    """
    image, windows = np.ascontiguousarray(image), np.ascontiguousarray(windows)
    found, steps = np.empty((most, 4)), np.array(levels, np.int64)
    count = _find_blobs(
        *image.shape, image, len(windows), windows, margin, reach, len(steps), steps, *shape,
        most, found,
    )  # fmt: skip
    return found[:count]


def compact_blobs(contrast: Image, levels: tuple[int, ...], shape: Shape, found: Array) -> int:
    """List compact blobs by their contrast, and count them; a bright one's foot is no further one.

    `contrast` (h, w), DN above the surroundings; `levels`, DN, falling; `shape`: longest side of a
    blob's box, px, at a level and at half height; longest axis ratio; least area over its
    ellipse's. `found` (m, 4) is filled from the first row with as many as it holds: column and row
    of the centre, px; half width, px; height, DN.
    """
    steps = np.array(levels, np.int64)
    return _compact_blobs(*contrast.shape, contrast, len(steps), steps, *shape, len(found), found)


def top_hat(image: Image, window: tuple[int, int, int, int], margin: int, reach: int) -> Image:
    """Contrast in a window (h, w): the image less its opening by a square of 2 reach + 1 px.

    `window`: x0, y0, x1, y1, px, upper bounds exclusive, inside the image. A `margin` about it
    counts: 0, or 2 reach. Borders hold nothing.
    """
    x0, y0, x1, y1 = window
    contrast = np.empty((y1 - y0, x1 - x0), np.uint8)
    _top_hat(*image.shape, image, *window, margin, reach, contrast)
    return contrast


def flood_fill(
    contrast: Image, level: int, y: int, x: int, label: NDArray[np.int32], number: int
) -> tuple[int, ...]:
    """Label what is above a level and connected with a pixel, also by corners; give its box."""
    box = np.empty(4, np.int64)
    _flood_fill(*contrast.shape, contrast, level, y, x, label, number, box)
    return tuple(box.tolist())


_count_stencils = entry("count_stencils")
_variance_line = entry("variance_line")


def count_stencils(rows: Image, apart: int, levels: Counts, differences: Counts) -> int:
    """Count levels and fourth differences of five neighbours in a row, wherever nothing is clipped.

    `rows` (r, w), DN, of which one block of 64 pixels in each `apart` is looked at. Filled:
    `levels` (N_LEVELS,), of the local cubic's value, in parts; `differences` (N_CLASSES,
    N_DIFFERENCES), of their size, DN, by classes of brightness. Gives how many pixels were looked
    at.
    """
    return _count_stencils(*rows.shape, rows, apart, levels, differences)


def variance_line(
    residual2: Array, signal: Array, begin: NDArray[np.int64], line: Array, usual: Array
) -> None:
    """Regress squared residuals (k,), DN², on signal (k,), DN, misfitting spots left out.

    `begin` (n + 1,): where each spot's pixels begin; `line` (2,), changed: dark variance and gain,
    the start; `usual` (2,): one over their standard uncertainties.
    """
    _variance_line(len(begin) - 1, residual2, signal, begin, line, usual)


# ---- a picture's spots
_measure_spots = entry("measure_spots")
_choose_spots = entry("choose_spots")
_clip = entry("clip")
_depth_posterior = entry("depth_posterior")


class Picture(NamedTuple):
    """A picture's pixels, one behind the other."""

    values: Image  # (h w c,), DN
    width: int
    height: int
    channels: int


def measure_spots(
    picture: Picture,
    candidates: Array,
    noise: Array,
    table: Pixels,
    wanted: tuple[float, float, int, bool, bool],
    unknown: bool,
    found: tuple[Array, Array],
) -> int:
    """Measure the spots of a picture, and count them.

    `candidates` (n, 4): centre, column and row, px; half width, px; contrast, DN. `noise` (4,):
    read variance, DN², gain and black, DN, of one channel, filled in where they are `unknown`.
    `table`: of the profiles. `wanted`: least and largest diameter, px; how many at most; whether
    the whole picture was searched, so that of many or large ones only those are fitted in which a
    first look sees a spot; whether it was a JPEG.

    `found` (limit, 16) and (limit, 3), filled: the spots by falling peak, columns as above; their
    colours, DN.
    """
    return _measure_spots(
        *picture, len(candidates), candidates, noise, *table.shape[:2], table, *wanted, unknown,
        *found,
    )  # fmt: skip


def choose_spots(assessed: Array, least: float, largest: float, limit: int) -> NDArray[np.int64]:
    """Choose the most LED-like of n spots (n, 16), no more than the limit, by falling peak.

    `least` and `largest` diameter, px.
    """
    kept = np.empty(len(assessed), np.int64)
    return kept[: _choose_spots(len(assessed), assessed, least, largest, limit, kept)]


def clip(mean: Pixels, variance: Pixels, visible: Pixels) -> None:
    """Clip p normal variables to the sensor's range.

    `mean` (p,), mu, DN, and `variance` (p,), DN², are those of the clipped variables afterwards;
    `visible` (p,) is filled with d mean / d mu.
    """
    _clip(len(mean), mean, variance, visible)


def depth_posterior(gradient: float, information: float) -> tuple[float, float, float]:
    """Log-evidence for a bite over none, mean and mean square of its depth, half-widths.

    `gradient` and `information`: of the depth, as in occlusion.c.
    """
    found = np.empty(3)
    _depth_posterior(gradient, information, found)
    evidence, mean, square = found.tolist()
    return evidence, mean, square
