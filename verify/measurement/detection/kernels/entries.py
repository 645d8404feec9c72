"""Entries of the compiled loops over pixels: candidates, noise, spots of a picture."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from verify.core.native import entry
from verify.core.records import Array, Flags, Image

Pixels = NDArray[np.float32]

# Columns of an assessed spot, as in quality.h
COL_CENTRE_X, COL_CENTRE_Y = range(2)
COL_COVARIANCE_XX, COL_COVARIANCE_XY, COL_COVARIANCE_YX, COL_COVARIANCE_YY = range(2, 6)
COL_PEAK, COL_DIAMETER, COL_ELONGATION, COL_MISFIT = range(6, 10)
COL_SATURATED, COL_MERGED, COL_SOUND, COL_COUNT = range(10, 14)
COL_STRETCH_X, COL_STRETCH_Y = range(14, 16)
N_COLUMNS = 18
MIN_WINDOW_SIDE = 3  # px, side of a window: smaller ones show no blob
MAX_BOXES = 64  # boxes that are searched one by one; with more, as one

Boxes = NDArray[np.int64]
# centre, covariance; peak, diameter, misfit; saturated, merged; colour
SpotArrays = tuple[Array, Array, Array, Flags, Array]
SpotFields = tuple[Array, Array, Array, Array, Array, Flags, Flags, Array]
Shape = tuple[float, float, float, float]

_contrast_boxes = entry("contrast_boxes")
_find_blobs = entry("find_blobs")
_compact_blobs = entry("compact_blobs")


def contrast_boxes(image: Image, reach: int, level: int) -> Boxes:
    """Boxes (n, 4), disjoint, outside which no pixel's contrast exceeds a level, DN.

    `image` (h, w), `reach` as for `find_blobs`. Columns: x0, y0, x1, y1, px, upper bounds
    exclusive. The whole picture is the one box where they would be many or large.
    """
    boxes = np.empty((MAX_BOXES, 4), np.int64)
    return boxes[: _contrast_boxes(*image.shape, image, reach, level, boxes)]


class BlobSearch(NamedTuple):
    """What blobs are searched by."""

    reach: int  # px: what has brightness at that distance all around is background
    levels: NDArray[np.int64]  # DN of contrast, falling
    shape: Shape  # as for `compact_blobs`
    most: int  # blobs listed


def find_blobs(image: Image, windows: Boxes, margin: int, search: BlobSearch) -> Array:
    """List compact bright blobs in windows of a grey picture, (m, 4), as `compact_blobs` does.

    `windows` (n, 4): x0, y0, x1, y1, upper bounds exclusive; a `margin`, px, about them is
    background only: 0, or twice the reach.
    """
    reach, levels, shape, most = search
    found = np.empty((most, 4))
    count = _find_blobs(
        *image.shape, image, len(windows), windows, margin, reach, len(levels), levels, *shape,
        most, found,
    )  # fmt: skip
    return found[:count]


def compact_blobs(contrast: Image, levels: NDArray[np.int64], shape: Shape, most: int) -> Array:
    """List compact blobs by their contrast, at most so many; a bright one's foot is no further one.

    `contrast` (h, w), DN above the surroundings; `levels`, DN, falling; `shape`: longest side of a
    blob's box, px, at a level and at half height; longest axis ratio; least area over its
    ellipse's. Columns: column and row of the centre, px; half width, px; height, DN.
    """
    found = np.empty((most, 4))
    count = _compact_blobs(*contrast.shape, contrast, len(levels), levels, *shape, most, found)
    return found[:count]


# ---- a picture's spots
_measure_spots = entry("measure_spots")
_measure_in_windows = entry("measure_in_windows")


class Picture(NamedTuple):
    """A picture's pixels, one behind the other."""

    values: Image  # (h, w) or (h, w, c), DN
    width: int
    height: int
    channels: int


class SpotLimits(NamedTuple):
    """Which spots are wanted."""

    least: float  # px, of the diameter
    largest: float
    most: int


def measure_spots(
    picture: Picture,
    candidates: Array,
    noise: tuple[Array, bool],
    table: Pixels,
    limits: SpotLimits,
    kind: tuple[bool, bool],
) -> SpotFields:
    """Measure the spots of a picture, by falling peak.

    `candidates` (n, 4): centre, column and row, px; half width, px; contrast, DN. `noise`: read
    variance, DN², gain and black, DN, of one channel, (4,); whether it is not known, and filled in.
    `table`: of the profiles. `kind`: whether the whole picture was searched, so that of many or
    large candidates only those are fitted in which a first look sees a spot; whether the picture
    was a JPEG.

    Gives the fields of `Spots`, in their order, up to the colour.
    """
    arrays, (values, unknown) = _spot_arrays(limits.most), noise
    count = _measure_spots(
        *picture, len(candidates), candidates, values, *table.shape[:2], table, *limits, *kind,
        unknown, *arrays,
    )  # fmt: skip
    return _spot_fields(arrays, count)


def measure_in_windows(
    picture: Picture,
    windows: Array,
    search: tuple[BlobSearch, int],
    noise: tuple[Array, bool],
    table: Pixels,
    limits: SpotLimits,
    lossy: bool,
) -> SpotFields:
    """Measure the spots in small windows of a grey picture, as `measure_spots` does.

    `windows` (n, 4): x0, y0, x1, y1, px, cut at the border; `search`: what candidates are searched
    by, and how many are fitted, those of the highest contrast.
    """
    arrays, (values, unknown), (image, width, height, _) = _spot_arrays(limits.most), noise, picture
    (reach, levels, shape, listed), most = search
    lines, samples, _ = table.shape
    count = _measure_in_windows(
        image, width, height, len(windows), windows, reach, len(levels), levels, *shape, listed,
        most, values, lines, samples, table, *limits, lossy, unknown, *arrays,
    )  # fmt: skip
    return _spot_fields(arrays, count)


def _spot_arrays(most: int) -> SpotArrays:
    """Room for so many spots."""
    figures, flags = np.empty((3, most)), np.empty((2, most), np.bool_)
    return np.empty((most, 2)), np.empty((most, 2, 2)), figures, flags, np.empty((most, 3))


def _spot_fields(arrays: SpotArrays, count: int) -> SpotFields:
    centre, covariance, figures, flags, colour = arrays
    peak, diameter, misfit = figures[:, :count]
    saturated, merged = flags[:, :count]
    return (
        centre[:count], covariance[:count], peak, diameter, misfit, saturated, merged,
        colour[:count],
    )  # fmt: skip
