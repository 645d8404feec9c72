"""Cut the pixels around candidates out of a picture, and keep what is fitted to them.

The colours of a pixel are combined into one value, weighed by the spot's contrast in each, of which
the noise follows.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled
from verify.core.kernels.linear_algebra import select
from verify.core.records import Array, Image
from verify.measurement.detection.kernels.pixels import (
    N_PARAMETERS,
    N_ROWS,
    ROW_COLUMN,
    ROW_ROW,
    ROW_VALID,
    ROW_VALUE,
    SENSOR_LIMIT,
    Pixels,
    Real,
)

RADII = (8, 11, 14, 18, 26, 40, 62)  # px, of cut-outs: an LED that moves keeps its pixels' number
PATCH_REACH = 2.4  # half-widths: a Gaussian has fallen to 1/50 there, a disc is long over
PATCH_MARGIN = 2.5  # px of floor around that
FIRST_LOOK_STEPS = 8  # steps from centre to edge of a first look: 197 pixels, whatever the size
# sums of half-widths between two spots, of which one's light reaches the other's pixels
MIN_APART, MAX_APART = 1.2, 4.0
MIN_CHANNEL_WEIGHT = 0.1  # of the strongest channel: less adds noise, not information
MIN_CONTRAST = 1e-3  # DN: something to divide by on a flat patch
Index = NDArray[np.int64]


class Picture(NamedTuple):
    """A picture's pixels, one behind the other."""

    values: Image  # (h w c,), DN
    width: int
    height: int
    channels: int


class Fits(NamedTuple):
    """What is fitted to n spots' pixels."""

    origin: Index  # (n, 2), px, of each patch's centre pixel
    scale: Array  # (n,), px, half-width that the fit starts from
    share: Array  # (n, 2), by which combining colours changes a channel's read variance and gain
    colour: Array  # (n, 3), DN, mean B, G, R above the surroundings
    level: Array  # (n,), DN, that three tenths of the pixels stay below
    begin: Index  # (n + 1,), where each spot's pixels begin
    pool: Pixels  # rows (25, p) of each spot's pixels, one spot behind the other
    prior: Array  # (n, 2, 10), mean and inverse variance of the parameters
    saturated: NDArray[np.bool_]  # (n,), whether some pixels on the spot are at the sensor's limit
    settled: NDArray[np.bool_]  # (n,), whether a further step would gain nothing that counts
    parameters: Array  # (n, 10), x and y in px from the patch's centre pixel
    information: Array  # (n, 10, 10), inverse covariance, priors included
    gradient: Array  # (n, 10), of the quasi-likelihood
    chi2: Array  # (n,)


@compiled
def empty_fits(size: Index) -> Fits:
    """Make room for n spots of so many pixels, (n,)."""
    n = len(size)
    begin = np.zeros(n + 1, np.int64)
    for k in range(n):
        begin[k + 1] = begin[k] + size[k]
    return Fits(
        np.empty((n, 2), np.int64), np.empty(n), np.empty((n, 2)), np.empty((n, 3)), np.empty(n),
        begin, np.empty(N_ROWS * begin[n], Real), np.empty((n, 2, N_PARAMETERS)),
        np.empty(n, np.bool_), np.empty(n, np.bool_), np.empty((n, N_PARAMETERS)),
        np.empty((n, N_PARAMETERS, N_PARAMETERS)), np.empty((n, N_PARAMETERS)), np.empty(n),
    )  # fmt: skip


@compiled
def rows_of(fits: Fits, n: int) -> Pixels:
    """Rows (25, p) of a spot's pixels, as in pixels.py."""
    begin, end = fits.begin[n], fits.begin[n + 1]
    return fits.pool[N_ROWS * begin : N_ROWS * end].reshape((N_ROWS, end - begin))


@compiled
def cut_patches(picture: Picture, spots: Array, first_look: bool) -> Fits:
    """Cut out the pixels around n spots; for a first look some 200 each, spread over its size.

    `spots` (n, 4): centre, column and row, px; half width, px; contrast, DN.
    """
    n = len(spots)
    reach, size = np.empty(n, np.int64), np.empty(n, np.int64)
    for k in range(n):
        if first_look:
            reach[k] = FIRST_LOOK_STEPS
        else:
            reach[k] = RADII[-1]
            for radius in RADII[::-1]:
                if radius >= PATCH_REACH * spots[k, 2] + PATCH_MARGIN:
                    reach[k] = radius
        size[k] = disc_size(reach[k])
    fits = empty_fits(size)
    for k in range(n):
        needed = PATCH_REACH * spots[k, 2] + PATCH_MARGIN
        spacing = needed / FIRST_LOOK_STEPS if first_look else 1.0
        for axis in range(2):
            fits.origin[k, axis] = np.int64(np.rint(spots[k, axis]))
        fits.scale[k] = spots[k, 2]
        rows = rows_of(fits, k)
        disc_offsets(reach[k], spacing, rows)
        read_patch(picture, fits, k, rows)
        if not first_look:
            leave_neighbours(fits.origin[k], k, spots, rows)
    return fits


@compiled
def disc_size(reach: int) -> int:
    """How many pixels a disc has."""
    count = 0
    for row in range(-reach, reach + 1):
        count += 2 * int(math.sqrt(reach * reach - row * row)) + 1
    return count


@compiled
def disc_offsets(reach: int, spacing: float, rows: Pixels) -> None:
    """Fill in columns and rows of a disc's pixels, so far apart, px, as whole numbers."""
    k, place = 0, np.empty(2 * reach + 1, Real)
    for step in range(2 * reach + 1):
        place[step] = np.rint(spacing * (step - reach))
    for row in range(2 * reach + 1):
        half = int(math.sqrt(reach * reach - (row - reach) ** 2))
        for column in range(reach - half, reach + half + 1):
            rows[ROW_COLUMN, k], rows[ROW_ROW, k] = place[column], place[row]
            k += 1


@compiled
def read_patch(picture: Picture, fits: Fits, n: int, rows: Pixels) -> None:
    """Read a spot's pixels, colours combined; those beyond the border are not valid."""
    place, size = np.empty(rows.shape[1], np.int64), (picture.width, picture.height)
    for k in range(len(place)):
        x = fits.origin[n, 0] + np.int64(rows[ROW_COLUMN, k])
        y = fits.origin[n, 1] + np.int64(rows[ROW_ROW, k])
        inside = (x >= 0) & (x < size[0]) & (y >= 0) & (y < size[1])
        x, y = min(max(x, 0), size[0] - 1), min(max(y, 0), size[1] - 1)
        place[k], rows[ROW_VALID, k] = picture.channels * (y * size[0] + x), inside
    counts, weight = np.empty(256, np.int64), np.zeros(3)
    colours = 1 if is_grey(picture, place) else 3
    for c in range(3):
        if c < colours:
            fits.colour[n, c] = channel_contrast(picture, c, place, fits.scale[n], rows, counts)
        else:
            fits.colour[n, c] = fits.colour[n, 0]
    if colours == 1:
        for k in range(len(place)):
            rows[ROW_VALUE, k] = picture.values[place[k]]
        fits.share[n, 0], fits.share[n, 1] = 1.0, 1.0
        fits.level[n] = ranked(counts, len(place) * 3 // 10)
        return
    channel_weights(fits.colour[n], weight)
    for k in range(len(place)):
        total, clipped, clear = 0.0, False, False
        for c in range(3):
            value = picture.values[place[k] + c]
            total += weight[c] * value
            clipped = clipped or (weight[c] > 0.0 and value == SENSOR_LIMIT)
            clear = clear or (weight[c] > 0.0 and value < SENSOR_LIMIT)
        rows[ROW_VALUE, k] = total
        if clipped and clear:
            rows[ROW_VALID, k] = 0.0
    # the channels' shares of the signal are the weights themselves, up to a factor
    square, cube = 0.0, 0.0
    for c in range(3):
        square += weight[c] ** 2
        cube += weight[c] ** 3
    fits.share[n, 0], fits.share[n, 1] = square, cube / square
    fits.level[n] = select(rows[ROW_VALUE], len(place) * 3 // 10)


@compiled
def is_grey(picture: Picture, place: Index) -> bool:
    """Whether the channels hold one picture three times: one measurement, not three."""
    if picture.channels > 1:
        values = picture.values
        for k in place:
            if values[k] != values[k + 1] or values[k] != values[k + 2]:
                return False
    return True


@compiled
def channel_contrast(
    picture: Picture, channel: int, place: Index, scale: float, rows: Pixels, counts: Index
) -> float:
    """Mean of a channel on the spot less the patch's lower third, DN; its values are counted."""
    for value in range(len(counts)):
        counts[value] = 0
    total, core = 0.0, 0
    for k in range(len(place)):
        value = picture.values[place[k] + channel]
        counts[value] += 1
        near = rows[ROW_COLUMN, k] ** 2 + rows[ROW_ROW, k] ** 2 <= scale * scale
        total += value if near else 0.0
        core += near
    return total / max(core, 1) - ranked(counts, len(place) // 3)


@compiled
def ranked(counts: Index, rank: int) -> int:
    """Which of counted whole numbers has a rank, from 0."""
    until, value = counts[0], 0
    while until <= rank:
        value += 1
        until += counts[value]
    return value


@compiled
def channel_weights(colour: Array, weight: Array) -> None:
    """Fill in the weight of each channel (3,): its contrast, which is best for equal noise."""
    most, total = MIN_CONTRAST, 0.0
    for c in range(3):
        most = max(most, colour[c])
    for c in range(3):
        weight[c] = max(colour[c], MIN_CONTRAST)
        weight[c] = weight[c] if weight[c] >= MIN_CHANNEL_WEIGHT * most else 0.0
        total += weight[c]
    for c in range(3):
        weight[c] /= total


@compiled
def leave_neighbours(origin: Index, own: int, spots: Array, rows: Pixels) -> None:
    """Mark as invalid the pixels of a patch that another spot's light reaches first.

    What overlaps is not told apart here.
    """
    x, y, radius = spots[own, 0], spots[own, 1], spots[own, 2]
    for other in range(len(spots)):
        off = math.hypot(spots[other, 0] - x, spots[other, 1] - y) / (radius + spots[other, 2])
        if not MIN_APART < off < MAX_APART:
            continue
        for k in range(rows.shape[1]):
            column, row = origin[0] + rows[ROW_COLUMN, k], origin[1] + rows[ROW_ROW, k]
            far = math.hypot(column - spots[other, 0], row - spots[other, 1]) / spots[other, 2]
            if far < PATCH_REACH and far < math.hypot(column - x, row - y) / radius:
                rows[ROW_VALID, k] = 0.0
