"""Search for a chessboard's corners, to a pixel or so, by OpenCV's finders.

No model is fitted here: a finder's answer counts where the map of `grid` shows crossings of
alternating colour in all of its rows and columns and in none of the lines around it. The finders
are tried from the quickest on, then the one that withstands most on variants of the image (half the
size, equalised, twice the size).
"""

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import cv2
import numpy as np

from verify.calibration.corners import grid as grids
from verify.core.records import Array, Image

MIN_CORNERS = 3  # inner corners a side, OpenCV's least
MAX_CORNERS = 60  # inner corners a side at which growing stops
# flags and inner corners a side that a general search starts from; the last takes longest
SEEDS = (
    *((flags, seed) for flags in (0, cv2.CALIB_CB_NORMALIZE_IMAGE) for seed in (4, 3, 5)),
    (cv2.CALIB_CB_EXHAUSTIVE, 4),
)
MIN_CONTRAST = 4  # DN, of a picture at an eighth of its size: less is noise on one grey
MAX_START_ERROR = 0.1  # squares by which a corner may be off for its fit to begin
Finder = Callable[..., Any]  # picture and counts to whether there is a board, and its corners
# by black quadrangles: in a few ms where the light is even; and boards cut by the image's border
QUICK_FINDER: Finder = partial(cv2.findChessboardCorners, flags=0)
QUAD_FINDER: Finder = partial(
    cv2.findChessboardCorners, flags=cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
)
# by sectors: noise, blur and steep views; dim boards beside bright things
SECTOR_FINDER: Finder = partial(cv2.findChessboardCornersSB, flags=cv2.CALIB_CB_EXHAUSTIVE)
DIM_FINDER: Finder = partial(cv2.findChessboardCornersSB, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)


def find_grid(grey: Image, columns: int, rows: int) -> Array | None:
    """Find all inner corners of a plain chessboard in an image (h, w).

    Returns (rows, columns, 2), px, in no certain order; None where this very board is not in view.
    """
    if min(columns, rows) < MIN_CORNERS or is_blank(grey):
        return None
    counts = (columns, rows)
    cv2.setRNGSeed(0)  # OpenCV draws random numbers: the same picture is to give the same answer
    finders = (QUICK_FINDER, MAX_START_ERROR), (SECTOR_FINDER, math.inf), (DIM_FINDER, math.inf)
    for finder, max_error in finders:
        grid = _find_whole(grey, grey, 1.0, counts, finder, max_error)
        if grid is not None:
            return grid
    other = find_by_growing(grey)
    if other is not None and sorted(other.shape[:2]) == sorted(counts):
        return other
    grid = _find_whole(grey, grey, 1.0, counts, QUAD_FINDER)
    if grid is not None or other is not None:
        return grid  # where a board of other counts is in view, there is no need to search harder
    for picture, scale in picture_variants(grey):
        # enlarged noise is full of quadrangles
        for finder in (SECTOR_FINDER, QUAD_FINDER) if scale <= 1.0 else (SECTOR_FINDER,):
            grid = _find_whole(grey, picture, scale, counts, finder)
            if grid is not None:
                return grid
    return None


def is_blank(grey: Image) -> bool:
    """Whether an image (h, w) shows nothing at all: to search it for a board takes longest."""
    height, width = (max(side // 8, 1) for side in grey.shape)
    small = cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA)
    return bool(np.ptp(small) < MIN_CONTRAST)


def _find_whole(
    grey: Image,
    picture: Image,
    scale: float,
    counts: tuple[int, int],
    finder: Finder,
    max_error: float = math.inf,
) -> Array | None:
    """Search a variant of an image, `scale` times its size, for the whole of a board.

    Returns (rows, columns, 2), px of the image `grey` (h, w), in which it is checked, or None;
    counts are columns and rows. No corner may be off the map through all by more than `max_error`,
    squares.
    """
    found, corners = finder(picture, counts)
    if not found:
        return None
    places = undo_scale(np.asarray(corners, dtype=float).reshape(-1, 2), scale)
    grid = places.reshape(counts[1], counts[0], 2)
    grid_map = grids.fit_grid_map(grey, grid)
    if grid_map is None or not grids.is_whole(grey, grid_map, *counts):
        return None
    mapped = grid_map(grids.block_points((0, 0, *counts))).reshape(grid.shape)
    square = min(np.linalg.norm(np.diff(grid, axis=k), axis=2).min() for k in (0, 1))
    return grid if np.linalg.norm(grid - mapped, axis=2).max() / square < max_error else None


def picture_variants(grey: Image) -> Iterator[tuple[Image, float]]:
    """Forms of an image that blurred, dark or small boards are found in, with their scale."""
    half = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    yield to_8_bits(half), 0.5
    even = cv2.createCLAHE(clipLimit=4.0, tileGridSize=(8, 8)).apply(grey)
    yield to_8_bits(cv2.GaussianBlur(even, (0, 0), 1.0)), 1.0
    if max(grey.shape) <= 1280:  # a small board: the finders want some ten pixels a square
        yield to_8_bits(cv2.resize(grey, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)), 2.0


def to_8_bits(picture: cv2.typing.MatLike) -> Image:
    """The same as 8 bits."""
    return np.asarray(picture, dtype=np.uint8)


def undo_scale(corners: Array, scale: float) -> Array:
    """Carry places in a resized picture back; pixel centres are at whole numbers in both."""
    return (corners + 0.5) / scale - 0.5


def find_by_growing(grey: Image) -> Array | None:
    """Find a chessboard of whatever counts: part of one first, then line after line.

    Returns (rows, columns, 2), px; None where no chessboard is in view.
    """
    if is_blank(grey):
        return None
    cv2.setRNGSeed(0)
    for flags, seed in SEEDS:
        found, corners, meta = cv2.findChessboardCornersSBWithMeta(
            grey, (seed, seed), cv2.CALIB_CB_LARGER | flags
        )
        rows, columns = meta.shape if found else (0, 0)
        if not found or corners.size != 2 * rows * columns:
            continue
        grid = grow_grid(grey, np.asarray(corners, dtype=float).reshape(rows, columns, 2))
        grid_map = None if grid is None else grids.fit_grid_map(grey, grid)
        if grid is not None and grid_map is not None:
            rows, columns = grid.shape[:2]
            if grids.is_whole(grey, grid_map, columns, rows):
                return grid
    return None


def grow_grid(grey: Image, grid: Array) -> Array | None:
    """Drop outer lines without crossings, then add lines as long as the pattern continues."""
    grid_map = grids.fit_grid_map(grey, grid)
    while grid_map is not None and min(grid.shape[:2]) >= MIN_CORNERS:
        rows, columns = grid.shape[:2]
        outer = [(0, 0, 1, rows), (columns - 1, 0, 1, rows)]
        outer += [(0, 0, columns, 1), (0, rows - 1, columns, 1)]
        bad = [not grids.has_crossings(grey, grid_map, line) for line in outer]
        if not any(bad):
            break
        left, right, top, bottom = bad
        grid = grid[top : rows - bottom, left : columns - right]
        if min(grid.shape[:2]) >= MIN_CORNERS:
            grid_map = grids.fit_grid_map(grey, grid)
    if grid_map is None or min(grid.shape[:2]) < MIN_CORNERS:
        return None
    while grid_map is not None and max(grid.shape[:2]) < MAX_CORNERS:
        longer = add_line(grey, grid, grid_map)
        if longer is None:
            return grid
        grid, grid_map = longer, grids.fit_grid_map(grey, longer)
    return None


def add_line(grey: Image, grid: Array, grid_map: grids.CornerMap) -> Array | None:
    """Add one line of corners on the first side where the pattern continues; None: nowhere."""
    rows, columns = grid.shape[:2]
    beside = [(-1, 0, 1, rows), (columns, 0, 1, rows), (0, -1, columns, 1), (0, rows, columns, 1)]
    for side, line in enumerate(beside):
        if not grids.has_crossings(grey, grid_map, line):
            continue
        squares = grids.block_points(line)
        places = grid_map(squares)
        height, width = grey.shape
        if (places < 1).any() or (places > [width - 2, height - 2]).any():
            continue
        step = np.linalg.norm(grid_map.jacobian(squares), axis=1)
        half = max(int(0.35 * step.min()), 2)
        stop = cv2.TERM_CRITERIA_COUNT, 10, 0.0
        rough = places.astype(np.float32).reshape(-1, 1, 2)  # OpenCV refuses a stride of 0
        sharper = cv2.cornerSubPix(grey, rough, (half, half), (-1, -1), stop).reshape(-1, 2)
        if np.linalg.norm(sharper - places, axis=1).max() > half:
            sharper = places.astype(np.float32)
        axis = 1 if side < 2 else 0
        new = sharper.astype(float).reshape((rows, 1, 2) if axis else (1, columns, 2))
        return np.concatenate([new, grid] if side % 2 == 0 else [grid, new], axis=axis)
    return None
