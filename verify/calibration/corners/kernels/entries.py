"""Entries of the compiled corner model and its fit."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from verify.core.native import entry
from verify.core.records import Array, Image

# of a corner's pixels: px from the expected centre; DN; its cell of the window
COL_COLUMN, COL_ROW, COL_VALUE, COL_CELL = range(4)
N_PIXEL_ROWS = 4
# the fixed part of the model: rad, directions of the edges' normals; 1/px, curvatures along them;
# px, unit of the linear terms
EDGE_START_1, EDGE_START_2, EDGE_BEND_1, EDGE_BEND_2, EDGE_SCALE = range(5)
N_EDGE_VALUES = 5
PAR_X, PAR_Y = range(2)
N_PARAMETERS = 13
ROW_RESIDUAL = N_PARAMETERS  # the row behind the derivatives
N_ROWS = N_PARAMETERS + 1
# columns of a result: covariance of its centre where the residuals' variance is one, that
# variance (DN²), and the scatter of the centre's scores from cell to cell, found and expected
COL_XX, COL_XY, COL_YY, COL_VARIANCE, COL_FOUND, COL_EXPECTED = range(6)
N_COLUMNS = 6
# of the table of the normal distribution F; between its steps a series is off by 1e-15, F' by 1e-12
TABLE_STEP, TABLE_END = 1 / 64, 8.5
_N_STEPS = round(TABLE_END / TABLE_STEP)
_NODES = np.arange(-_N_STEPS, _N_STEPS + 1) * TABLE_STEP
STEP_TABLE = np.stack([ndtr(_NODES), np.exp(-_NODES * _NODES / 2) / np.sqrt(2 * np.pi)])

_fit_crossings = entry("fit_crossings")
_window_pixels = entry("window_pixels")
_fill_edges = entry("fill_edges")
_predict_pixels = entry("predict_pixels")


def fit_crossings(
    grey: Image,
    at: tuple[Array, Array, Array],
    markers: Array,
    fitted: NDArray[np.bool_],
    parameters: Array,
    results: Array,
) -> None:
    """Fit the corners of a view (h, w), DN, all of whose pixels weigh the same.

    `at`: expected centres (n, 2), px, good to a tenth of a square; d px / d squares (n, 2, 2),
    columns along the board's x and y; d² px / d squares² (n, 2, 2), likewise. `markers` (n, 2):
    squares between a marker and its square's edge; sign of u · v (from the corner, board's axes)
    where the white squares are, 0 where none has a marker. Parameters (n, 13), see model.h, and
    results (n, 6) are filled where there is a crossing, and `fitted` (n,) says where; where it is
    true beforehand the parameters are of an earlier fit, whose centre is the expected one.
    """
    places = (np.ascontiguousarray(values) for values in at)
    height, width = grey.shape
    corners = len(fitted), *places, markers, STEP_TABLE.shape[1], STEP_TABLE
    _fit_crossings(height, width, grey, *corners, fitted, parameters, results)


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
