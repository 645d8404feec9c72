"""The pixels around each candidate, colours combined into one value of known noise."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from verify.detection.candidates import Candidates
from verify.detection.fit import Patches
from verify.records import Array, Image, Noise

RADII = (7, 9, 12, 15, 19, 25, 34, 46, 62)  # px, of cut-outs: few sizes, so that many share a batch
REACH = 2.4  # half-widths beyond which a spot shows nothing: a Gaussian has fallen to 2e-2 sigma² …
MARGIN = 2.5  # px of floor around that
TOGETHER = 8  # patches a batch: their derivatives stay in the processor's cache
FAINT = 0.1  # of the strongest channel: less adds noise, not information
CLIPPED = 255


def cut_out(
    image: Image, candidates: Candidates, noise: Noise
) -> Iterator[tuple[Patches, NDArray[np.intp], Array]]:
    """Cut the candidates out, batch by batch of one size.

    Yields:
        Patches; image coordinates of their centre pixels, (n, 2); mean B, G, R above floor, (n, 3).
    """
    wanted = REACH * candidates.radius + MARGIN
    size = np.searchsorted(RADII, wanted).clip(max=len(RADII) - 1)
    for which in np.unique(size):
        members = np.flatnonzero(size == which)
        for begin in range(0, len(members), TOGETHER):
            part = members[begin : begin + TOGETHER]
            origin = np.rint(candidates.centre[part]).astype(np.intp)
            patches, colour = patches_at(image, origin, candidates.radius[part], RADII[which], noise)
            yield patches, origin, colour


def patches_at(
    image: Image, origin: NDArray[np.intp], scale: Array, radius: int, noise: Noise
) -> tuple[Patches, Array]:
    """Cut round patches of one radius out of the image; with each one's colour."""
    axis = np.arange(-radius, radius + 1)
    column, row = (a.ravel() for a in np.meshgrid(axis, axis))
    round_ = column**2 + row**2 <= radius**2
    column, row = column[round_], row[round_]
    height, width = image.shape[:2]
    x, y = origin[:, :1] + column, origin[:, 1:] + row
    valid = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    if not valid.all():
        np.clip(x, 0, width - 1, out=x)
        np.clip(y, 0, height - 1, out=y)
    pixels = image[y, x]
    core = column**2 + row**2 <= np.square(scale)[:, None]
    share = np.ones(len(origin)), np.ones(len(origin))
    if pixels.ndim == 2 or is_grey(pixels):
        pixels = pixels if pixels.ndim == 2 else pixels[..., 0]
        colour = np.repeat(contrast(pixels[..., None], core), 3, axis=1)
        value = pixels.astype(float)
    else:
        colour = contrast(pixels, core)
        weight = channel_weights(colour)
        clipped = (pixels == CLIPPED) & (weight > 0)[:, None]
        valid &= ~clipped.any(axis=2) | (clipped | (weight == 0)[:, None]).all(axis=2)
        value = (pixels @ weight[..., None])[..., 0]
        square = np.square(weight)
        # The channels' shares of the signal are the weights themselves, up to a factor.
        share = square.sum(axis=1), (square * weight).sum(axis=1) / square.sum(axis=1)
    offset = column.astype(float), row.astype(float)
    return Patches(value, valid, *offset, scale, *share, noise), colour


def is_grey(pixels: Image) -> bool:
    """Whether a colour image holds one picture three times: then it is one measurement, not three."""
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
