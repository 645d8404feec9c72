"""Find compact bright blobs that may be LEDs, and cut out the pixels around each for the fit.

A blob stands above its own surroundings (top hat) at one of a few levels of contrast. The colours
of a pixel are combined into one value, of which the noise follows.
"""

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from verify.core.records import Array, Image, Noise
from verify.measurement.detection.fit import TOL_LAST_STEP, Patches, SpotFit, continue_fit
from verify.measurement.detection.kernels.candidates import (
    MIN_WINDOW_SIDE,
    compact_blobs,
    contrast_boxes,
    find_blobs,
)
from verify.measurement.detection.kernels.pixels import PAR_PEAK, PAR_XX, PAR_YY
from verify.measurement.detection.profile import spot_light

LEVELS = (160, 80, 40, 18)  # DN of contrast, octaves: a bright blob must not hide a dim neighbour
# 18 DN: a dim LED of peak 60 keeps twice this after halving; noise of 2.5 DN, halved, 14 sigma.
MAX_FULL_SIZE_AREA = 200_000  # px; larger: searched at half size, which keeps any LED >= 3 px
MAX_AXIS_RATIO = 2.5  # at half height; an LED blurred by motion over its own length stays below
MIN_FILL = 0.6  # blob area over its ellipse's: an LED fills it, a bent or branched blob does not
DEFAULT_DIAMETER = (2.0, 40.0)  # px; least that sampling supports, and a 5 mm LED at 13 cm
BACKGROUND_FACTOR = 1.5  # background window over the largest diameter: no LED survives in it
MAX_SMALL_AREA = 40_000  # px, of a window: larger ones are searched where something is bright
MAX_BLOBS = 1024  # blobs listed in one window, those of higher levels first
MAX_CANDIDATES = 64  # blobs fitted, best contrast first: bounds the time in a cluttered room


@dataclass(frozen=True, slots=True)
class Candidates:
    """Rough places of LED-like blobs, highest contrast first."""

    centre: Array  # (n, 2), px
    radius: Array  # (n,), px, half the width at half height
    contrast: Array  # (n,), DN above the surroundings

    def __len__(self) -> int:
        """Count the candidates."""
        return len(self.centre)


def find_candidates(
    image: Image, windows: NDArray[np.int64] | None, diameter_px: tuple[float, float] | None
) -> Candidates:
    """List compact bright blobs of an image, inside the windows only if there are any.

    (h, w) grey or (h, w, 3) BGR is searched by its brightest channel. `windows` (m, 4): x0, y0, x1,
    y1, inside the image, upper bounds exclusive; None is all. `diameter_px`: least and largest full
    width; None is anything an LED may be.
    """
    smallest, largest = diameter_px or DEFAULT_DIAMETER
    if windows is None:
        windows = np.array([[0, 0, image.shape[1], image.shape[0]]])
    boxes = windows.tolist()
    area = [(x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in boxes]
    if image.ndim == 2 and max(area, default=0) <= MAX_SMALL_AREA:
        found = find_blobs(image, windows, 0, *blob_arguments(largest))
        halved = np.ones(len(found), dtype=np.intp)
    else:
        factor = [2 if pixels > MAX_FULL_SIZE_AREA else 1 for pixels in area]
        parts = [
            find_in_large_window(image, *one, largest) for one in zip(boxes, factor, strict=True)
        ]
        found = np.concatenate([np.empty((0, 4)), *parts])
        halved = np.repeat(np.array(factor, np.intp), [len(part) for part in parts])
    width = 2.0 * found[:, 2]
    chosen = found[(width + halved >= smallest) & (width - halved <= largest)]  # to a pixel
    best = chosen[np.argsort(-chosen[:, 3], kind="stable")[:MAX_CANDIDATES]]
    return Candidates(best[:, :2], best[:, 2].copy(), best[:, 3])


def find_in_large_window(image: Image, window: list[int], factor: int, largest: float) -> Array:
    """Find blobs in a window of any picture, made smaller by a factor, as `find_blobs` does."""
    x0, y0, x1, y1 = window
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
    reach, levels, shape, most = blob_arguments(largest / factor)
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
    found[:, :2] += (factor - 1) / 2 + np.array([x0, y0])
    return found


def blob_arguments(largest: float) -> tuple[int, tuple[int, ...], tuple[float, float, float], int]:
    """Last arguments of `find_blobs` for LEDs of a largest width, px."""
    reach = int(BACKGROUND_FACTOR * largest) // 2
    return reach, LEVELS, (4.0 * reach + 2.0, MAX_AXIS_RATIO, MIN_FILL), MAX_BLOBS


RADII = (8, 11, 14, 18, 26, 40, 62)  # px, of cut-outs: few, so that many share a batch
PATCH_REACH = 2.4  # half-widths: a Gaussian has fallen to 1/50 there, a disc is long over
PATCH_MARGIN = 2.5  # px of floor around that
# sums of half-widths between two spots, of which one's light reaches the other's pixels
MIN_APART, MAX_APART = 1.2, 4.0
SEPARATION_PASSES = 4  # of spots touching at a third of their height; two suffice farther apart
MIN_NEIGHBOUR = 0.15  # of a spot's peak, of another one's: less may be texture of the room
MIN_LIGHT = 0.5  # DN of a neighbour: less is not worth taking off, least of all below black
TINY = 1e-9  # of an inverse square of a half-width, where a fit has none
FIRST_LOOK_STEPS = 8  # steps from centre to edge of a first look: 197 pixels, whatever the size
BATCH_PATCHES = 8  # patches a batch: their derivatives stay in the processor's cache
MIN_CHANNEL_WEIGHT = 0.1  # of the strongest channel: less adds noise, not information
CLIPPED_DN = 255


@dataclass(frozen=True, slots=True)
class LocatedPatches:
    """Patches and where they came from."""

    patches: Patches
    origin: NDArray[np.intp]  # (n, 2), image x, y of each patch's centre pixel
    colour: Array  # (n, 3), mean B, G, R above the surroundings


def cut_first_look(image: Image, candidates: Candidates, noise: Noise) -> LocatedPatches:
    """Take some 200 pixels around every candidate, spread over its size."""
    column, row = disc_offsets(FIRST_LOOK_STEPS)
    spacing = (PATCH_REACH * candidates.radius + PATCH_MARGIN)[:, None] / FIRST_LOOK_STEPS
    offsets = [np.rint(spacing * axis).astype(np.intp) for axis in (column, row)]
    origin = np.rint(candidates.centre).astype(np.intp)
    return read_pixels(image, origin, candidates.radius, offsets[0], offsets[1], noise)


def cut_patches(
    image: Image, candidates: Candidates, noise: Noise
) -> Iterator[tuple[NDArray[np.intp], LocatedPatches]]:
    """Cut all pixels of the candidates out, batch by batch of one size, with their indices."""
    needed = PATCH_REACH * candidates.radius + PATCH_MARGIN
    size = [min(bisect_left(RADII, one), len(RADII) - 1) for one in needed.tolist()]
    origin = np.rint(candidates.centre).astype(np.intp)
    for which in sorted(set(size)):
        members = [number for number, its in enumerate(size) if its == which]
        column, row = disc_offsets(RADII[which])
        for begin in range(0, len(members), BATCH_PATCHES):
            part = np.array(members[begin : begin + BATCH_PATCHES])
            radius = candidates.radius[part]
            located = read_pixels(image, origin[part], radius, column, row, noise)
            _leave_neighbours(located, part, candidates)
            yield part, located


def _leave_neighbours(located: LocatedPatches, part: NDArray[np.intp], spots: Candidates) -> None:
    """Mark as invalid the pixels of a batch's patches that another spot's light reaches first.

    `part` (n,): which of the spots the patches belong to. What overlaps is not told apart here.
    """
    apart = spots.centre[part, None] - spots.centre
    far = np.hypot(apart[..., 0], apart[..., 1]) / (spots.radius[part, None] + spots.radius)
    for patch, other in zip(*np.nonzero((far > MIN_APART) & (far < MAX_APART)), strict=True):
        place = located.patches.pixels[patch, 2:] + located.origin[patch][:, None]
        both = np.array([part[patch], other])
        off = np.linalg.norm(place - spots.centre[both][:, :, None], axis=1)
        own, others = off / spots.radius[both][:, None]
        located.patches.pixels[patch, 1, (others < PATCH_REACH) & (others < own)] = 0.0


def separate_neighbours(
    batches: Sequence[tuple[LocatedPatches, SpotFit]], sound: NDArray[np.bool_], noise: Noise
) -> bool:
    """Fit sound spots near each other anew, each without the light that the others have there.

    In place; says whether there are any. Spots nearer than MIN_APART are not told apart.
    """
    whole = [cut.patches.value.copy() for cut, _ in batches]
    scale = np.concatenate([cut.patches.scale for cut, _ in batches])
    for _ in range(SEPARATION_PASSES):
        centre = np.concatenate([cut.origin + fit.parameters[:, :2] for cut, fit in batches])
        shape = np.concatenate([fit.parameters for _, fit in batches])
        radius = scale * np.sqrt(2.0 / np.maximum(shape[:, PAR_XX] + shape[:, PAR_YY], TINY))
        apart = np.hypot(*(centre[:, None] - centre).T) / (radius[:, None] + radius)
        near, begin = sound[:, None] & sound & (apart > MIN_APART) & (apart < MAX_APART), 0
        near &= shape[:, PAR_PEAK] > MIN_NEIGHBOUR * shape[:, None, PAR_PEAK]
        if not near.any():
            return False
        for (cut, fit), value in zip(batches, whole, strict=True):
            pairs = zip(*np.nonzero(near[begin : begin + len(value)]), strict=True)
            begin += len(value)
            cut.patches.value[:] = value
            for patch, other in pairs:
                place = cut.patches.pixels[patch, 2:] + (cut.origin[patch] - centre[other])[:, None]
                light = spot_light(shape[other], place / scale[other])
                cut.patches.value[patch] -= np.where(light > MIN_LIGHT, light, 0.0)
            if np.any(cut.patches.value != value):
                continue_fit(cut.patches, fit, noise, 2, TOL_LAST_STEP)
    return True


@cache
def disc_offsets(radius: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Columns and rows (1, p) of the pixels of a disc; shared, not to be changed."""
    axis = np.arange(-radius, radius + 1)
    column, row = np.meshgrid(axis, axis)
    within = column**2 + row**2 <= radius**2
    return column[within][None], row[within][None]


def read_pixels(
    image: Image,
    origin: NDArray[np.intp],
    scale: Array,
    column: NDArray[np.intp],
    row: NDArray[np.intp],
    noise: Noise,
) -> LocatedPatches:
    """Read the image at offsets (n, p), or (1, p) for all, from the origins; colours combined."""
    values = np.empty((len(origin), 4, column.shape[1]))
    whole = np.ones(len(origin))
    height, width = image.shape[:2]
    x, y = origin[:, :1] + column, origin[:, 1:] + row
    inside = np.ones(x.shape, dtype=np.bool_)
    if min(x.min(), y.min()) < 0 or x.max() >= width or y.max() >= height:
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        x, y = x.clip(0, width - 1), y.clip(0, height - 1)
    pixels = image.reshape(-1, *image.shape[2:]).take(y * width + x, axis=0)
    core = column**2 + row**2 <= np.square(scale)[:, None]
    values[:, 2], values[:, 3] = column, row
    if image.ndim == 2 or is_grey(pixels):
        one = pixels.reshape(*pixels.shape[:2], -1)[..., :1]
        values[:, 0], values[:, 1] = one[..., 0], inside
        colour = np.repeat(channel_contrast(one, core), 3, axis=1)
        return LocatedPatches(Patches(values, scale, whole, whole, noise), origin, colour)
    colour = channel_contrast(pixels, core)
    weight = channel_weights(colour)
    values[:, 0] = (pixels @ weight[..., None])[..., 0]
    values[:, 1] = inside & usable_pixels(pixels, weight)
    square = np.square(weight)
    # the channels' shares of the signal are the weights themselves, up to a factor
    share = square.sum(axis=1), (square * weight).sum(axis=1) / square.sum(axis=1)
    return LocatedPatches(Patches(values, scale, *share, noise), origin, colour)


def usable_pixels(pixels: Image, weight: Array) -> NDArray[np.bool_]:
    """Which pixels (n, p, 3) are clipped in none of the channels that count, or in all of them."""
    clipped = (pixels == CLIPPED_DN) & (weight > 0)[:, None]
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
    weight[weight < MIN_CHANNEL_WEIGHT * weight.max(axis=1, keepdims=True)] = 0.0
    normalised: Array = weight / weight.sum(axis=1, keepdims=True)
    return normalised


def channel_contrast(pixels: Image, core: NDArray[np.bool_]) -> Array:
    """Mean of each channel on the spot less the patch's lower third, (n, channels) DN."""
    third = pixels.shape[1] // 3
    floor = np.partition(pixels, third, axis=1)[:, third]
    total = (pixels * core[..., None]).sum(axis=1)
    above: Array = total / np.maximum(core.sum(axis=1), 1)[:, None] - floor
    return above
