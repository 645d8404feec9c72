"""Find the target's colour in one picture by CAMSHIFT: centre, extent and share of each patch.

Model: each pixel i of the search region belongs to the target with probability p_i (the colour
model's back projection / 255). Of the connected patch in CamShift's window

    centre     c = sum p_i x_i / M,   M = sum p_i
    spread     sum p_i (x_i - c) (x_i - c)' / M
    covariance of c = sum p_i (1 - p_i) (x_i - c) (x_i - c)' / M^2 + MIN_NOISE^2

Only the patch that the window holds is measured: a neighbour of the same colour a few pixels away
does not shift it. A whole picture is searched coarsely, then by CAMSHIFT around each place.
Source: Bradski, Intel Technology Journal Q2, 1998; the moments are eqs. 13-16 of the grasping
paper.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from verify.core.records import Array, Image
from verify.grasping.tracking.colour import ColourModel, to_hsv

MIN_WEIGHT = 127  # of 255: a pixel above it belongs to the target rather than not
STOP_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 12, 1.0)  # iterations, px
MIN_PIXELS = 12  # pixels; less is noise
CLOSING_KERNEL = np.ones((3, 3), dtype=np.uint8)  # px by which lettering may split a target
MAX_EXTENT_RATIO = 1.2  # of the expected extent: a larger patch is cut to that size
MIN_NOISE = 0.02  # px, standard: 8-bit colours and demosaicing leave no less
COARSE_STEP = 4  # of the coarse search: every fourth pixel of every fourth row
MIN_COARSE_PIXELS = 3  # coarse pixels
MAX_PLACES = 8  # places that are searched closely, largest first
MAX_RELATIVE_WIDTH = 0.4  # of the picture's width: a wall of that colour is no target
SEARCH_MARGIN = 1.5  # search region over the coarse box

Box = tuple[int, int, int, int]  # x, y, width, height, px


@dataclass(frozen=True, slots=True)
class Blob:
    """A patch of the target's colour in one picture; pixels, centres at whole numbers."""

    centre: Array  # (2,), px, centroid of the back projection
    covariance: Array  # (2, 2), px², of the centre: what the pixels' doubtful membership allows
    spread: Array  # (2, 2), px², second central moments
    extent: Array  # (2,), px, width and height along the picture's rows and columns
    area: float  # px
    reach: float  # px, with what is connected with it beyond the expected extent
    box: Box  # that holds the patch
    share: float  # of the back projection in the search region, 0 to 1: the rest is elsewhere
    similarity: float  # of its mixture of colours to the target's, 0 to 1
    value: float  # DN, median of its brightness
    cut: bool  # it touches the picture's border: its centre is not the target's

    @property
    def ellipse(self) -> tuple[float, float, float]:
        """Long and short axis in px and the long one's angle in rad from x towards y.

        Those of the even ellipse with the same second moments.
        """
        values, vectors = np.linalg.eigh(self.spread)
        short, long = 4.0 * np.sqrt(np.maximum(values, 0.0))
        return float(long), float(short), float(np.arctan2(vectors[1, 1], vectors[0, 1]))


def camshift(
    image: Image, start: Box, region: Box, model: ColourModel, expected: Array | None = None
) -> Blob | None:
    """Find the target in a search region alone, from a start window; None: nothing of its colour.

    The image is (h, w, 3) BGR. `expected` (2,), px: the target's width and height, where they are
    known. What lies beyond the window of that size which holds most colour is no part of it.

    Raises:
        InputError: the picture is grey.
    """
    x, y, width, height = clip_box(region, image)
    if width < 2 or height < 2:
        return None
    hsv = to_hsv(image[y : y + height, x : x + width])
    weights = model.back_project(hsv)
    inner = clip_box((start[0] - x, start[1] - y, start[2], start[3]), weights)
    if inner[2] < 1 or inner[3] < 1:
        inner = (0, 0, width, height)
    found = cv2.CamShift(weights, inner, STOP_CRITERIA)[1]
    window = (found[0], found[1], found[2], found[3])
    mask = target_mask(weights, window)
    if mask is None:
        return None
    reach = float(np.count_nonzero(mask))
    if expected is not None:
        mask = _limit_to_extent(weights, mask, window, expected)
    at_edge = (x == 0, y == 0, x + width == image.shape[1], y + height == image.shape[0])
    return _measure_blob(hsv, weights, mask, (x, y), at_edge, model, reach)


def target_mask(weights: Image, window: Box) -> NDArray[np.uint8] | None:
    """Choose the pixels that belong to what CamShift's window holds; (h, w), 255 or 0.

    The connected piece that fills the window's middle, its holes, and smaller pieces that lie in
    its box: reflections and lettering are a part of a target, its neighbours are not.
    """
    if min(window[2:]) < 1:
        return None
    likely = np.asarray(weights > MIN_WEIGHT, dtype=np.uint8)
    closed = cv2.morphologyEx(likely, cv2.MORPH_CLOSE, CLOSING_KERNEL)
    _, labels, stats, middles = cv2.connectedComponentsWithStats(closed, connectivity=8)
    piece = _main_component(np.asarray(labels), np.asarray(stats), window)
    if piece is None:
        return None
    bx, by, bw, bh = stats[piece, :4]
    within = (middles[:, 0] >= bx) & (middles[:, 0] < bx + bw)
    within &= (middles[:, 1] >= by) & (middles[:, 1] < by + bh)
    within[0] = False  # the background
    within[piece] = True
    held = np.asarray(within[labels], dtype=np.uint8) * np.uint8(255)
    outlines, _ = cv2.findContours(held, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return np.asarray(cv2.drawContours(held, outlines, -1, 255, cv2.FILLED), dtype=np.uint8)


def _main_component(labels: NDArray[Any], stats: NDArray[Any], window: Box) -> int | None:
    """The label with most pixels in the middle of a window, or in all of it; None for noise."""
    x, y, width, height = window
    middle = labels[
        y + height // 4 : y + height - height // 4, x + width // 4 : x + width - width // 4
    ]
    for part in (middle, labels[y : y + height, x : x + width]):
        counts = np.bincount(part.reshape(-1), minlength=len(stats))
        counts[stats[:, cv2.CC_STAT_AREA] < MIN_PIXELS] = 0
        counts[0] = 0  # the background
        if counts.any():
            return int(counts.argmax())
    return None


def _limit_to_extent(
    weights: Image, mask: NDArray[np.uint8], window: Box, expected: Array
) -> NDArray[np.uint8]:
    """Keep of a patch what a window of the expected size holds, by mean shift from the middle."""
    width, height = (int(side) for side in np.ceil(MAX_EXTENT_RATIO * expected))
    wx, wy, ww, wh = window
    if ww <= width and wh <= height:
        return mask
    start = clip_box((wx + (ww - width) // 2, wy + (wh - height) // 2, width, height), weights)
    _, (x, y, width, height) = cv2.meanShift(cv2.bitwise_and(weights, mask), start, STOP_CRITERIA)
    kept = np.zeros_like(mask)
    kept[y : y + height, x : x + width] = mask[y : y + height, x : x + width]
    return kept if kept.any() else mask


def clip_box(box: Box, image: NDArray[np.uint8]) -> Box:
    """Cut a box to the picture; width or height 0 where nothing is left."""
    x, y, width, height = box
    left, top = max(x, 0), max(y, 0)
    right, bottom = min(x + width, image.shape[1]), min(y + height, image.shape[0])
    return left, top, max(right - left, 0), max(bottom - top, 0)


def box_around(centre: Array, reach: Array) -> Box:
    """Make the box that reaches (2,) px to either side of a centre (2,) px."""
    low = np.floor(centre - reach).astype(int)
    high = np.ceil(centre + reach).astype(int) + 1
    return int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])


def _measure_blob(
    hsv: Image,
    weights: Image,
    mask: NDArray[np.uint8],
    corner: tuple[int, int],
    at_edge: tuple[bool, bool, bool, bool],
    model: ColourModel,
    reach: float,
) -> Blob:
    bx, by, bw, bh = cv2.boundingRect(mask)
    part = np.s_[by : by + bh, bx : bx + bw]
    chosen = mask[part] > 0
    hole = chosen & (weights[part] <= MIN_WEIGHT)  # in the outline: the target's, not its colour
    belief = np.where(chosen, weights[part] / 255.0, 0.0)
    filled = np.where(hole, 1.0, belief)
    moments = cv2.moments(filled)
    total = moments["m00"]
    middle = np.array([moments["m10"], moments["m01"]]) / total
    spread = np.array([[moments["mu20"], moments["mu11"]], [moments["mu11"], moments["mu02"]]])
    height, width = mask.shape
    touched = (bx == 0, by == 0, bx + bw == width, by + bh == height)
    everything = float(weights.sum()) / 255.0
    return Blob(
        centre=middle + np.array([corner[0] + bx, corner[1] + by]),
        covariance=_centroid_covariance(filled, middle, total),
        spread=spread / total,
        extent=np.array([bw, bh], dtype=float),
        area=float(np.count_nonzero(chosen)),
        reach=reach,
        box=(corner[0] + bx, corner[1] + by, bw, bh),
        share=float(belief.sum()) / max(everything, 1e-9),
        similarity=model.similarity(hsv[part], np.asarray(chosen, dtype=np.uint8)),
        value=_median(hsv[part][..., 2][chosen]),
        cut=any(a and b for a, b in zip(touched, at_edge, strict=True)),
    )


def _median(values: Image) -> float:
    """The median of whole numbers up to 255, by counting: several times as fast as by sorting."""
    below = np.cumsum(np.bincount(values, minlength=256))
    return float(np.searchsorted(below, below[-1] / 2))


def _centroid_covariance(belief: Array, middle: Array, total: float) -> Array:
    """Covariance of the centroid, (2, 2) px²: each pixel is a trial of variance p (1 - p)."""
    x = np.arange(belief.shape[1]) - middle[0]
    y = np.arange(belief.shape[0]) - middle[1]
    variance = belief * (1.0 - belief) / total**2
    by_column, by_row = variance.sum(axis=0), variance.sum(axis=1)
    mixed = float(y @ variance @ x)
    found = np.array([[float(by_column @ x**2), mixed], [mixed, float(by_row @ y**2)]])
    return found + np.eye(2) * MIN_NOISE**2


def find_blobs(
    image: Image, model: ColourModel, but: Box | None = None, expected: Array | None = None
) -> list[Blob]:
    """Find every patch of the target's colour in a picture (h, w, 3) BGR, largest first.

    The box `but` need not be searched again; the target's size (2,) px is expected where known.

    Raises:
        InputError: the picture is grey.
    """
    found: list[Blob] = []
    for box in coarse_boxes(image, model):
        if but is not None and boxes_overlap(box, but):
            continue
        blob = camshift(image, box, _widen(box), model, expected)
        if blob is not None and not any(_centre_in_box(blob, other.box) for other in found):
            found.append(blob)
    return sorted(found, key=lambda blob: -blob.area)


def coarse_boxes(image: Image, model: ColourModel) -> list[Box]:
    """Search coarsely for patches of a colour: boxes in pixels of the picture, largest first."""
    size = (image.shape[1] // COARSE_STEP, image.shape[0] // COARSE_STEP)
    coarse = to_hsv(np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_NEAREST), np.uint8))
    likely = np.asarray(model.back_project(coarse) > MIN_WEIGHT, dtype=np.uint8)
    stats = cv2.connectedComponentsWithStats(likely, connectivity=8)[2][1:]  # 0: the background
    sides = stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]]
    fits = (stats[:, cv2.CC_STAT_AREA] >= MIN_COARSE_PIXELS) & (
        sides.max(axis=1) <= MAX_RELATIVE_WIDTH * size[0]
    )
    patches = sorted(stats[fits].tolist(), key=lambda row: -row[cv2.CC_STAT_AREA])
    return [
        (COARSE_STEP * x, COARSE_STEP * y, COARSE_STEP * width, COARSE_STEP * height)
        for x, y, width, height, _ in patches[:MAX_PLACES]
    ]


def boxes_overlap(one: Box, other: Box) -> bool:
    """Whether two boxes have a pixel in common."""
    apart = one[0] >= other[0] + other[2] or other[0] >= one[0] + one[2]
    return not (apart or one[1] >= other[1] + other[3] or other[1] >= one[1] + one[3])


def _widen(box: Box) -> Box:
    x, y, width, height = box
    dx = int(np.ceil((SEARCH_MARGIN - 1) / 2 * width)) + 2 * COARSE_STEP
    dy = int(np.ceil((SEARCH_MARGIN - 1) / 2 * height)) + 2 * COARSE_STEP
    return x - dx, y - dy, width + 2 * dx, height + 2 * dy


def _centre_in_box(blob: Blob, box: Box) -> bool:
    x, y, width, height = box
    return bool(x <= blob.centre[0] < x + width and y <= blob.centre[1] < y + height)
