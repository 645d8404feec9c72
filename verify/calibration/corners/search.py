"""Where a chessboard's corners are, to a pixel or so: OpenCV's finders, asked in several ways."""

from collections.abc import Callable, Iterator

import cv2
import numpy as np

from verify.calibration.corners.grid import (
    CornerMap,
    block_points,
    fit_map,
    grid_points,
    has_crossings,
    is_whole,
    neighbour_lines,
)
from verify.core.records import Array, Image

MIN_CORNERS = 3  # inner corners a side, OpenCV's least
MAX_CORNERS = 60  # likewise, where growing stops
SEED_CORNERS = (4, 3, 5)  # inner corners a side that a general search starts from
PLAIN = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
Finder = Callable[[Image, tuple[int, int]], Array | None]


def find_grid(grey: Image, columns: int, rows: int) -> Array | None:
    """Find all inner corners of a plain chessboard.

    Args:
        grey: (h, w).
        columns: inner corners one way.
        rows: the other way.

    Returns:
        (rows, columns, 2), px, in no certain order; None where this very board is not in view.
    """
    if min(columns, rows) < MIN_CORNERS:
        return None
    counts = (columns, rows)
    for finder in (sector_finder, normalised_sector_finder):
        grid = try_finder(finder, grey, grey, 1.0, counts)
        if grid is not None:
            return grid
    other = find_by_growing(grey)
    if other is not None and sorted(other.shape[:2]) == sorted(counts):
        return other
    grid = try_finder(quad_finder, grey, grey, 1.0, counts)
    if grid is not None or other is not None:
        return grid  # where a board of other counts is in view, there is no need to look harder
    for picture, scale in picture_variants(grey):
        for finder in (sector_finder, normalised_sector_finder, quad_finder):
            grid = try_finder(finder, grey, picture, scale, counts)
            if grid is not None:
                return grid
    return None


def try_finder(
    finder: Finder, grey: Image, picture: Image, scale: float, counts: tuple[int, int]
) -> Array | None:
    """A finder's answer in the image's own pixels, where it is the whole of a board."""
    corners = finder(picture, counts)
    if corners is None:
        return None
    grid = undo_scale(corners, scale).reshape(counts[1], counts[0], 2)
    return grid if is_whole(grey, grid) else None


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
    original: Array = (corners + 0.5) / scale - 0.5
    return original


def sector_finder(picture: Image, counts: tuple[int, int]) -> Array | None:
    """OpenCV's sector-based finder; it withstands noise, blur and steep views."""
    found, corners = cv2.findChessboardCornersSB(picture, counts, flags=cv2.CALIB_CB_EXHAUSTIVE)
    return np.asarray(corners, dtype=float).reshape(-1, 2) if found else None


def normalised_sector_finder(picture: Image, counts: tuple[int, int]) -> Array | None:
    """The same after equalising: dark or overexposed boards."""
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE
    found, corners = cv2.findChessboardCornersSB(picture, counts, flags=flags)
    return np.asarray(corners, dtype=float).reshape(-1, 2) if found else None


def quad_finder(picture: Image, counts: tuple[int, int]) -> Array | None:
    """OpenCV's older finder, by black quadrangles: boards cut by the image's border."""
    found, corners = cv2.findChessboardCorners(picture, counts, flags=PLAIN)
    return np.asarray(corners, dtype=float).reshape(-1, 2) if found else None


def find_by_growing(grey: Image) -> Array | None:
    """Find a chessboard of whatever counts: part of one first, then line after line.

    Returns:
        (rows, columns, 2), px; None where no chessboard is in view.
    """
    for flags in (0, cv2.CALIB_CB_EXHAUSTIVE, cv2.CALIB_CB_NORMALIZE_IMAGE):
        for seed in SEED_CORNERS:
            found, corners, meta = cv2.findChessboardCornersSBWithMeta(
                grey, (seed, seed), cv2.CALIB_CB_LARGER | flags
            )
            if not found:
                continue
            rows, columns = meta.shape
            if corners.size != 2 * rows * columns:
                continue
            grid = grow_grid(grey, np.asarray(corners, dtype=float).reshape(rows, columns, 2))
            if grid is not None and is_whole(grey, grid):
                return grid
    return None


def grow_grid(grey: Image, grid: Array) -> Array | None:
    """Drop lines that are none, then add lines as long as the pattern goes on."""
    rows, columns = grid.shape[:2]
    grid_map = fit_map(grid_points(columns, rows), grid.reshape(-1, 2), grey.shape)
    while grid_map is not None and min(rows, columns) >= MIN_CORNERS:
        bad = [
            side
            for side, line in enumerate(outer_lines(columns, rows))
            if not has_crossings(grey, grid_map, line)
        ]
        if not bad:
            break
        keep = [slice(0 in bad, columns - (1 in bad)), slice(2 in bad, rows - (3 in bad))]
        grid = grid[keep[1], keep[0]]
        rows, columns = grid.shape[:2]
        if min(rows, columns) >= MIN_CORNERS:
            grid_map = fit_map(grid_points(columns, rows), grid.reshape(-1, 2), grey.shape)
    if grid_map is None or min(rows, columns) < MIN_CORNERS:
        return None
    while max(grid.shape[:2]) < MAX_CORNERS:
        longer = add_line(grey, grid, grid_map)
        if longer is None:
            return grid
        grid = longer
        rows, columns = grid.shape[:2]
        grid_map = fit_map(grid_points(columns, rows), grid.reshape(-1, 2), grey.shape)
        if grid_map is None:
            return None
    return None


def outer_lines(columns: int, rows: int) -> list[tuple[int, int, int, int]]:
    """The first and last column and row of a grid, as blocks (x, y, columns, rows)."""
    return [
        (0, 0, 1, rows),
        (columns - 1, 0, 1, rows),
        (0, 0, columns, 1),
        (0, rows - 1, columns, 1),
    ]


def add_line(grey: Image, grid: Array, grid_map: CornerMap) -> Array | None:
    """A grid with one more line of corners, on the first side where the pattern goes on."""
    rows, columns = grid.shape[:2]
    for side, line in enumerate(neighbour_lines(0, 0, columns, rows)):
        if not has_crossings(grey, grid_map, line):
            continue
        squares = block_points(*line)
        places = grid_map(squares)
        height, width = grey.shape
        if (places < 1).any() or (places > [width - 2, height - 2]).any():
            continue
        step = np.linalg.norm(grid_map.jacobian(squares), axis=1)
        half = max(int(0.35 * step.min()), 2)
        sharper = cv2.cornerSubPix(
            grey,
            places.astype(np.float32).reshape(-1, 1, 2),
            (half, half),
            (-1, -1),
            (cv2.TERM_CRITERIA_COUNT, 10, 0.0),
        ).reshape(-1, 2)
        if np.linalg.norm(sharper - places, axis=1).max() > half:
            sharper = places.astype(np.float32)
        axis = 1 if side < 2 else 0
        new = sharper.astype(float).reshape((rows, 1, 2) if axis else (1, columns, 2))
        return np.concatenate([new, grid] if side % 2 == 0 else [grid, new], axis=axis)
    return None
