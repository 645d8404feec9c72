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

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from verify.core.records import Array, Image
from verify.grasping.tracking.colour import MIN_WEIGHT, ColourModel, Mask, to_hsv

STOP_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 12, 1.0)  # iterations, px
MIN_PIXELS = 12  # pixels; less is noise
# by a pixel's weight p: what it counts for inside the outline, where a hole is the target's in
# another colour; and p (255 - p), the variance of a trial
HOLE_WEIGHT = np.where(np.arange(256) > MIN_WEIGHT, np.arange(256), 255).astype(np.uint8)
TRIAL_VARIANCE = (np.arange(256) * np.arange(255, -1, -1)).astype(np.uint16)
CLOSING_KERNEL = np.ones((3, 3), dtype=np.uint8)  # px by which lettering may split a target
MAX_EXTENT_RATIO = 1.2  # of the expected extent: a larger patch is cut to that size
MIN_NOISE = 0.02  # px, standard: 8-bit colours and demosaicing leave no less
COARSE_STEP = 4  # of the coarse search: every fourth pixel of every fourth row
MIN_COARSE_PIXELS = 3  # coarse pixels
# similarity of a mixture of colours below which coarse pixels, if so many, are not the target's
UNLIKE, MIN_COMPARED_PIXELS = 0.3, 100
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
    value: float  # DN, mean brightness of its pixels that have the target's colour
    cut: bool  # it touches the picture's border: its centre is not the target's
    truncated: bool  # with what is connected with it, it goes on beyond the region searched

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
    own = mask if expected is None else _limit_to_extent(weights, mask, window, expected)
    at_edge = _touched_sides((x, y, width, height), image)
    return _measure_blob(hsv, weights, (own, mask), (x, y), at_edge, model)


def target_mask(weights: Image, window: Box) -> Mask | None:
    """Choose the pixels that belong to what CamShift's window holds; (h, w), 255 or 0.

    The connected piece that fills the window's middle, its holes, and smaller pieces that lie in
    its box: reflections and lettering are a part of a target, its neighbours are not.
    """
    if min(window[2:]) < 1:
        return None
    likely = cv2.threshold(weights, MIN_WEIGHT, 255, cv2.THRESH_BINARY)[1]
    pieces, large = _outlines(likely)
    if len(large) > 1:  # one of them may be what lettering splits off
        pieces, large = _outlines(cv2.morphologyEx(likely, cv2.MORPH_CLOSE, CLOSING_KERNEL))
    filled = [_fill(np.zeros(weights.shape, dtype=np.uint8), [piece]) for piece in large]
    held = [_held_pixels(mask, window) for mask in filled]
    most = max(held, default=(0, 0))
    if most[1] == 0:
        return None
    if len(pieces) == 1:
        return filled[0]
    main = held.index(most)
    bx, by, bw, bh = cv2.boundingRect(large[main])
    boxes = (cv2.boundingRect(piece) for piece in pieces)
    middles = ((x + w / 2 - bx, y + h / 2 - by) for x, y, w, h in boxes)
    beside = [
        piece
        for piece, (x, y) in zip(pieces, middles, strict=True)
        if piece is not large[main] and 0 <= x < bw and 0 <= y < bh
    ]
    return _fill(filled[main], beside) if beside else filled[main]


def _outlines(likely: Any) -> tuple[Sequence[Any], list[Any]]:
    """Outlines of connected pieces, (n, 1, 2) px each: all of them, and those that are no noise."""
    pieces = cv2.findContours(likely, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    return pieces, [piece for piece in pieces if _count_pixels(piece) >= MIN_PIXELS]


def _fill(mask: Mask, pieces: list[Any]) -> Mask:
    """Set a mask's pixels inside outlines (n, 1, 2), px, to 255."""
    return np.asarray(cv2.drawContours(mask, pieces, -1, 255, cv2.FILLED), dtype=np.uint8)


def _held_pixels(mask: Mask, window: Box) -> tuple[int, int]:
    """Count a mask's pixels in a window's middle, and in all of it."""
    x, y, width, height = window
    part = mask[y : y + height, x : x + width]
    middle = part[height // 4 : height - height // 4, width // 4 : width - width // 4]
    return cv2.countNonZero(middle), cv2.countNonZero(part)


def _count_pixels(outline: Any) -> float:
    """Pixels of a piece by its outline (n, 1, 2), px, itself and its holes included."""
    return cv2.contourArea(outline) + len(outline) / 2 + 1


def _limit_to_extent(weights: Image, mask: Mask, window: Box, expected: Array) -> Mask:
    """Keep of a patch what a window of the expected size holds, by mean shift from the middle."""
    width, height = (math.ceil(MAX_EXTENT_RATIO * side) for side in expected.tolist())
    wx, wy, ww, wh = window
    if ww <= width and wh <= height:
        return mask
    start = clip_box((wx + (ww - width) // 2, wy + (wh - height) // 2, width, height), weights)
    _, (x, y, width, height) = cv2.meanShift(cv2.bitwise_and(weights, mask), start, STOP_CRITERIA)
    kept = np.zeros_like(mask)
    kept[y : y + height, x : x + width] = mask[y : y + height, x : x + width]
    return kept if kept.any() else mask


def clip_box(box: Box, image: Mask) -> Box:
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
    masks: tuple[Mask, Mask],
    corner: tuple[int, int],
    at_edge: tuple[bool, bool, bool, bool],
    model: ColourModel,
) -> Blob:
    """Measure what a mask holds; `masks`: its own, and the one with what is connected with it."""
    mask, whole = masks
    own_box = bx, by, bw, bh = cv2.boundingRect(mask)
    whole_box = own_box if whole is mask else cv2.boundingRect(whole)
    part = np.s_[by : by + bh, bx : bx + bw]
    colours, inside = hsv[part], mask[part]
    belief = cv2.bitwise_and(weights[part], inside)
    filled = np.asarray(
        cv2.bitwise_and(cv2.LUT(weights[part], HOLE_WEIGHT), inside), dtype=np.uint8
    )
    moments = cv2.moments(filled)
    total = moments["m00"]
    x, y = moments["m10"] / total, moments["m01"] / total
    xx, xy, yy = (moments[name] / total for name in ("mu20", "mu11", "mu02"))
    area = float(cv2.countNonZero(inside))
    touched, reached = _touched_sides(own_box, mask), _touched_sides(whole_box, mask)
    return Blob(
        centre=np.array([x + (corner[0] + bx), y + (corner[1] + by)]),
        covariance=_centroid_covariance(filled, x, y, total),
        spread=np.array([[xx, xy], [xy, yy]]),
        extent=np.array([bw, bh], dtype=float),
        area=area,
        reach=area if whole is mask else float(cv2.countNonZero(whole)),
        box=(corner[0] + bx, corner[1] + by, bw, bh),
        share=cv2.sumElems(belief)[0] / max(cv2.sumElems(weights)[0], 1.0),
        similarity=model.similarity(colours, inside),
        value=cv2.mean(colours, belief)[2],
        cut=any(a and b for a, b in zip(touched, at_edge, strict=True)),
        truncated=any(a and not b for a, b in zip(reached, at_edge, strict=True)),
    )


def _touched_sides(box: Sequence[int], mask: Mask) -> tuple[bool, bool, bool, bool]:
    """Which sides of a mask a box in it touches: left, top, right, bottom."""
    x, y, width, height = box
    return x == 0, y == 0, x + width == mask.shape[1], y + height == mask.shape[0]


def _centroid_covariance(weights: Image, x: float, y: float, total: float) -> Array:
    """Covariance of the centroid, (2, 2) px²: each pixel is a trial of variance p (1 - p)."""
    trials = cv2.moments(cv2.LUT(weights, TRIAL_VARIANCE))
    m00, m10, m01 = trials["m00"], trials["m10"], trials["m01"]
    xx = (trials["m20"] - 2 * x * m10 + x * x * m00) / total**2 + MIN_NOISE**2
    yy = (trials["m02"] - 2 * y * m01 + y * y * m00) / total**2 + MIN_NOISE**2
    xy = (trials["m11"] - x * m01 - y * m10 + x * y * m00) / total**2
    return np.array([[xx, xy], [xy, yy]])


def find_blobs(image: Image, model: ColourModel, but: Box | None = None) -> list[Blob]:
    """Find every patch of the target's colour in a picture (h, w, 3) BGR, largest first.

    The box `but` need not be searched again.

    Raises:
        InputError: the picture is grey.
    """
    found: list[Blob] = []
    for box in coarse_boxes(image, model):
        if but is not None and cv2.rectangleIntersectionArea(box, but) > 0:
            continue
        blob = camshift(image, box, _widen(box), model)
        if blob is not None and not any(_centre_in_box(blob, other.box) for other in found):
            found.append(blob)
    return sorted(found, key=lambda blob: -blob.area)


def coarse_boxes(image: Image, model: ColourModel) -> list[Box]:
    """Search coarsely for patches of a colour: boxes in pixels of the picture, largest first."""
    size = (image.shape[1] // COARSE_STEP, image.shape[0] // COARSE_STEP)
    coarse = to_hsv(np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_NEAREST), np.uint8))
    weights = model.back_project(coarse)
    likely = np.asarray(
        cv2.threshold(weights, MIN_WEIGHT, 255, cv2.THRESH_BINARY)[1], dtype=np.uint8
    )
    pieces = cv2.findContours(likely, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    sized = sorted(((_count_pixels(p), cv2.boundingRect(p)) for p in pieces), reverse=True)
    found: list[Box] = []
    for count, (x, y, width, height) in sized:
        if count < MIN_COARSE_PIXELS or max(width, height) > MAX_RELATIVE_WIDTH * size[0]:
            continue
        part = np.s_[y : y + height, x : x + width]
        if count < MIN_COMPARED_PIXELS or model.similarity(coarse[part], likely[part]) > UNLIKE:
            box = (COARSE_STEP * x, COARSE_STEP * y, COARSE_STEP * width, COARSE_STEP * height)
            found.append(box)
    return found[:MAX_PLACES]


def _widen(box: Box) -> Box:
    x, y, width, height = box
    dx = int(np.ceil((SEARCH_MARGIN - 1) / 2 * width)) + 2 * COARSE_STEP
    dy = int(np.ceil((SEARCH_MARGIN - 1) / 2 * height)) + 2 * COARSE_STEP
    return x - dx, y - dy, width + 2 * dx, height + 2 * dy


def _centre_in_box(blob: Blob, box: Box) -> bool:
    x, y, width, height = box
    return bool(x <= blob.centre[0] < x + width and y <= blob.centre[1] < y + height)
