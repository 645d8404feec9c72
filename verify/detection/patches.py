"""The pixels around each candidate, colours combined into one value of known noise."""

from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from verify.detection.candidates import Candidates
from verify.detection.kernel_patches import read_grey
from verify.detection.model import Patches
from verify.records import Array, Image, Noise

RADII = (8, 11, 14, 18, 26, 40, 62)  # px, of cut-outs: few, so that many share a batch
REACH = 2.4  # half-widths: a Gaussian has fallen to 1/50 there, a disc is long over
MARGIN = 2.5  # px of floor around that
GLANCE = 8  # steps from centre to edge of a first look: 197 pixels, whatever the size
TOGETHER = 8  # patches a batch: their derivatives stay in the processor's cache
FAINT = 0.1  # of the strongest channel: less adds noise, not information
CLIPPED = 255


@dataclass(frozen=True, slots=True)
class Cut:
    """Patches and where they came from."""

    patches: Patches
    origin: NDArray[np.intp]  # (n, 2), image x, y of each patch's centre pixel
    colour: Array  # (n, 3), mean B, G, R above the surroundings


def glance_at(image: Image, candidates: Candidates, noise: Noise) -> Cut:
    """Take some 200 pixels around every candidate, spread over its size."""
    column, row = disc(GLANCE)
    spacing = (REACH * candidates.radius + MARGIN)[:, None] / GLANCE
    offsets = [np.rint(spacing * axis).astype(np.intp) for axis in (column, row)]
    origin = np.rint(candidates.centre).astype(np.intp)
    return read_pixels(image, origin, candidates.radius, offsets[0], offsets[1], noise)


def cut_out(
    image: Image, candidates: Candidates, noise: Noise
) -> Iterator[tuple[NDArray[np.intp], Cut]]:
    """Cut all pixels of the candidates out, batch by batch of one size, with their indices."""
    needed = REACH * candidates.radius + MARGIN
    size = [min(bisect_left(RADII, one), len(RADII) - 1) for one in needed.tolist()]
    origin = np.rint(candidates.centre).astype(np.intp)
    for which in sorted(set(size)):
        members = [number for number, its in enumerate(size) if its == which]
        column, row = disc(RADII[which])
        for begin in range(0, len(members), TOGETHER):
            part = np.array(members[begin : begin + TOGETHER])
            radius = candidates.radius[part]
            yield part, read_pixels(image, origin[part], radius, column, row, noise)


@cache
def disc(radius: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Columns and rows (1, p) of the pixels of a disc; everybody's, not to be changed."""
    axis = np.arange(-radius, radius + 1)
    column, row = np.meshgrid(axis, axis)
    within = column**2 + row**2 <= radius**2
    column, row = column[within], row[within]
    column, row = column[None], row[None]
    column.flags.writeable = row.flags.writeable = False
    return column, row


def read_pixels(
    image: Image,
    origin: NDArray[np.intp],
    scale: Array,
    column: NDArray[np.intp],
    row: NDArray[np.intp],
    noise: Noise,
) -> Cut:
    """Read the image at offsets (n, p), or (1, p) for all, from the origins; colours combined."""
    known = np.empty((len(origin), 4, column.shape[1]))
    whole = np.ones(len(origin))
    if image.ndim == 2:
        colour = np.empty((len(origin), 3))
        read_grey(image, origin, scale, column, row, known, colour)
        return Cut(Patches(known, scale, whole, whole, noise), origin, colour)
    height, width = image.shape[:2]
    x, y = origin[:, :1] + column, origin[:, 1:] + row
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    pixels = image[y.clip(0, height - 1), x.clip(0, width - 1)]
    core = column**2 + row**2 <= np.square(scale)[:, None]
    known[:, 2], known[:, 3] = column, row
    if is_grey(pixels):
        known[:, 0], known[:, 1] = pixels[..., 0], inside
        colour = np.repeat(contrast(pixels[..., :1], core), 3, axis=1)
        return Cut(Patches(known, scale, whole, whole, noise), origin, colour)
    colour = contrast(pixels, core)
    weight = channel_weights(colour)
    known[:, 0] = (pixels @ weight[..., None])[..., 0]
    known[:, 1] = inside & usable(pixels, weight)
    square = np.square(weight)
    # the channels' shares of the signal are the weights themselves, up to a factor
    share = square.sum(axis=1), (square * weight).sum(axis=1) / square.sum(axis=1)
    return Cut(Patches(known, scale, *share, noise), origin, colour)


def usable(pixels: Image, weight: Array) -> NDArray[np.bool_]:
    """Which pixels (n, p, 3) are clipped in none of the channels that count, or in all of them."""
    clipped = (pixels == CLIPPED) & (weight > 0)[:, None]
    every = (clipped | (weight == 0)[:, None]).all(axis=2)
    return np.asarray(~clipped.any(axis=2) | every, dtype=np.bool_)


def is_grey(pixels: Image) -> bool:
    """Whether the channels hold one picture three times: one measurement, not three."""
    return bool(
        np.array_equal(pixels[..., 0], pixels[..., 1])
        and np.array_equal(pixels[..., 1], pixels[..., 2])
    )


def channel_weights(colour: Array) -> Array:
    """Weight of each channel, (n, 3), summing to 1: its contrast, which is best for equal noise."""
    weight = np.maximum(colour, 1e-3)  # DN: something to divide by on a flat patch
    weight[weight < FAINT * weight.max(axis=1, keepdims=True)] = 0.0
    normalised: Array = weight / weight.sum(axis=1, keepdims=True)
    return normalised


def contrast(pixels: Image, core: NDArray[np.bool_]) -> Array:
    """Mean of each channel on the spot less the patch's lower third, (n, channels) DN."""
    third = pixels.shape[1] // 3
    floor = np.partition(pixels, third, axis=1)[:, third]
    total = (pixels * core[..., None]).sum(axis=1)
    above: Array = total / np.maximum(core.sum(axis=1), 1)[:, None] - floor
    return above
