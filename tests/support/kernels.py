"""Doors to compiled entries that only tests call, of steps inside the loops."""

import math

import numpy as np
from numpy.typing import NDArray

from verify.calibration.corners.find import STEP_TABLE
from verify.core.native import entry
from verify.core.records import Array, Image

Pixels = NDArray[np.float32]
Counts = NDArray[np.int32]

PRIOR_DEPTH = 0.05  # half-widths, scale of the bites that occlusion.c expects
# levels are whole thirty-fifths, differences whole: both can be counted
LEVEL_PARTS, LOWEST_LEVEL, N_LEVELS = 35, 6 * 255, 50 * 255 + 1  # a level in parts of one DN
N_DIFFERENCES = 1024  # the last stands for larger ones too: of a texture, not of noise
MIN_ABOVE_BLACK, CLASS_WIDTH = 5, 12  # DN, of classes of brightness: the first begins there; width
N_CLASSES = math.ceil((256 - MIN_ABOVE_BLACK) / CLASS_WIDTH)
FIRST_LEVEL, CLASS_PARTS = LOWEST_LEVEL + LEVEL_PARTS * MIN_ABOVE_BLACK, LEVEL_PARTS * CLASS_WIDTH

# of a corner's pixels: px from the expected centre; DN; its cell of the window
COL_COLUMN, COL_ROW, COL_VALUE, COL_CELL = range(4)
N_PIXEL_ROWS = 4
# the fixed part of the model: rad, directions of the edges' normals; 1/px, curvatures along them;
# px, unit of the linear terms
EDGE_START_1, EDGE_START_2, EDGE_BEND_1, EDGE_BEND_2, EDGE_SCALE = range(5)
N_EDGE_VALUES = 5

_factor = entry("factor")
_solve = entry("solve")
_solve_each = entry("solve_each")
_invert = entry("invert")
_covariance_of = entry("covariance_of")
_top_hat = entry("top_hat")
_flood_fill = entry("flood_fill")
_count_stencils = entry("count_stencils")
_variance_line = entry("variance_line")
_choose_spots = entry("choose_spots")
_clip = entry("clip")
_depth_posterior = entry("depth_posterior")
_window_pixels = entry("window_pixels")
_fill_edges = entry("fill_edges")
_predict_pixels = entry("predict_pixels")


def factor(matrix: Array, less: float, root: Array) -> bool:
    """Fill in the lower Cholesky factor of a matrix (n, n) with `less` taken off its diagonal.

    False where that is not positive definite; the factor has NaN then.
    """
    return bool(_factor(len(matrix), matrix, less, root))


def solve(root: Array, right: Array) -> None:
    """Solve in place for a vector (n,), by the lower Cholesky factor (n, n)."""
    _solve(len(right), root, right)


def solve_each(root: Array, right: Array) -> None:
    """Solve in place for the columns of (n, m) at once, by the lower Cholesky factor (n, n)."""
    _solve_each(len(right), right.shape[1], root, right)


def invert(root: Array, inverse: Array) -> None:
    """Fill in the inverse (n, n) of the matrix that a lower Cholesky factor (n, n) belongs to."""
    _invert(len(root), root, inverse)


def covariance_of(
    information: Array, inverse: Array, vectors: Array, known: NDArray[np.bool_]
) -> None:
    """Fill in the covariance in the directions that an information matrix (6, 6) determines.

    In 1/m² and 1/rad²; of one or two LEDs (or of LEDs on one line) it is singular: its null vectors
    are the motions that no picture shows. Filled: `inverse` (6, 6); `vectors` (6, 6), columns,
    directions in units of SCALE, only where one of them is not known; `known` (6,).
    """
    if not _covariance_of(information, inverse, vectors, known):
        raise np.linalg.LinAlgError("not finite")


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


def window_pixels(
    grey: Image, centre: Array, jacobian: Array, markers: tuple[float, float]
) -> Array:
    """A corner's pixels (4, p): column, row, value, cell; arguments as above, of one corner."""
    height, width = grey.shape
    found = np.empty((N_PIXEL_ROWS, grey.size))
    at = centre, jacobian, np.array(markers, dtype=np.float64)
    count = _window_pixels(height, width, grey, *at, grey.size, found)
    return found[:, :count].copy()


def fill_edges(jacobian: Array, bend: Array, edges: Array) -> None:
    """Fill in directions and curvatures of the two edges (5,), from the board's plane."""
    _fill_edges(jacobian, bend, edges)


def predict_pixels(pixels: Array, edges: Array, p: Array, rows: Array) -> None:
    """Expect a corner's pixels (4, p) by its edges (5,) and parameters (13,).

    Fills `rows` (14, p): derivatives by parameters, and pixels less model, DN.
    """
    _predict_pixels(pixels.shape[1], pixels, edges, p, STEP_TABLE.shape[1], STEP_TABLE, rows)
