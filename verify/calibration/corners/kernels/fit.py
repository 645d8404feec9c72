"""Fit a corner's crossing by Gauss-Newton with Levenberg's damping; say how well it is known.

With r the pixels' residuals and J their derivatives by the 13 parameters, each step solves
(J'J + damping diag J'J) dp = J'r. Pixels that are no part of the corner are left out, and it is
fitted again. A calibration fits thousands of corners of hundreds of pixels: in numpy every step
would pass over all of them dozens of times.
"""

import numpy as np
from numpy.typing import NDArray

from verify.calibration.corners.kernels.model import (
    CELLS_PER_SIDE,
    COL_CELL,
    EDGE_SCALE,
    HALF_WINDOW,
    N_EDGE_VALUES,
    N_KNOWN_ROWS,
    N_PARAMETERS,
    N_ROWS,
    PAR_BLUR_1,
    PAR_BLUR_2,
    PAR_CONTRAST,
    PAR_SPREAD,
    PAR_X,
    PAR_Y,
    ROW_RESIDUAL,
    fill_edges,
    keep_clear,
    predict_pixels,
    select_pixels,
    start_values,
    window_pixels,
)
from verify.core.jit import compiled, compiled_sums
from verify.core.kernels.linear_algebra import copy_to, factor, invert, median, solve
from verify.core.records import Array

START_BLUR = 0.06  # squares: wide enough to draw in a start that is some pixels off
MAX_LOG_BLUR = 4.0  # either way, of the log of a blur in px
MAX_ITERATIONS = 25  # a good start takes three
TOL_STEP = 1e-3  # px; the step after it is below 1e-5
MAX_DEVIATION = 0.5  # of the contrast: what differs more is no part of the corner (a border, dirt)
EDGE_SIGMA = 0.5  # px that an edge's pixels may be off: sharpening and saturation deform it
OUTLIER_SIGMA = 5.0  # sigma, and more than that
MAD_OVER_SIGMA = 0.67449  # median of |x| over sigma, Gaussian
N_REJECTIONS = 2  # the first fit was led astray by what it leaves out
MIN_OWN_SHARE = 0.6  # of the pixels that must belong to the corner
MIN_PIXELS = 40  # three a parameter
# columns of a result: covariance of its centre where the residuals' variance is one, that
# variance (DN²), and the scatter of the centre's scores from cell to cell, found and expected
COL_XX, COL_XY, COL_YY, COL_VARIANCE, COL_FOUND, COL_EXPECTED = range(6)
N_COLUMNS = 6


@compiled
def fit_crossing(
    grey: Array,
    at: tuple[Array, Array, Array],
    markers: tuple[float, float],
    known_before: bool,
    steps: Array,
    p: Array,
    result: Array,
) -> bool:
    """Fit a corner in an image (h, w), DN; returns whether there is one.

    `at` is centre, jacobian and bend of `find.CornerPrediction`, `markers` as for `window_pixels`,
    `steps` the table of F. The parameters p (13,), see model.py, are filled, and so is result (6,)
    where there is a crossing; `known_before`: p is of an earlier fit, whose centre is the expected
    one.
    """
    centre, jacobian, bend = at
    pixels, edges = window_pixels(grey, centre, jacobian, markers), np.empty(N_EDGE_VALUES)
    if pixels.shape[1] < MIN_PIXELS:
        return False
    fill_edges(jacobian, bend, edges)
    if known_before:
        p[PAR_X], p[PAR_Y] = 0.0, 0.0
    else:
        start_values(pixels, edges, START_BLUR * edges[EDGE_SCALE], p)
    settled, rows = converge(pixels, edges, steps, p)
    for _ in range(N_REJECTIONS):
        if not settled:
            return False
        all_pixels = pixels.shape[1]
        own = np.empty(all_pixels, np.bool_)
        count = keep_clear(pixels, mark_strays(p, rows), own)
        if count < max(MIN_PIXELS, MIN_OWN_SHARE * all_pixels):
            return False  # most of it is something else
        if count == all_pixels:
            break
        pixels = select_pixels(pixels, own, count)
        settled, rows = converge(pixels, edges, steps, p)
    determinant = jacobian[0, 0] * jacobian[1, 1] - jacobian[0, 1] * jacobian[1, 0]
    u = (p[PAR_X] * jacobian[1, 1] - p[PAR_Y] * jacobian[0, 1]) / determinant
    v = (p[PAR_Y] * jacobian[0, 0] - p[PAR_X] * jacobian[1, 0]) / determinant
    inside = max(abs(u), abs(v)) <= HALF_WINDOW / 2  # well within the window
    return settled and inside and centre_covariance(pixels, rows, result)


@compiled
def mark_strays(p: Array, rows: Array) -> NDArray[np.bool_]:
    """Which pixels (p,) are no part of the corner that was fitted."""
    residual = np.empty(rows.shape[1])
    for k in range(rows.shape[1]):
        residual[k] = abs(rows[ROW_RESIDUAL, k])
    spread = OUTLIER_SIGMA * median(residual) / MAD_OVER_SIGMA
    usual = max(MAX_DEVIATION * abs(p[PAR_CONTRAST]), spread)
    stray = np.empty(len(residual), np.bool_)
    for k in range(len(residual)):
        stray[k] = residual[k] > usual + EDGE_SIGMA * abs(rows[PAR_SPREAD, k])
    return stray


@compiled
def converge(pixels: Array, edges: Array, steps: Array, p: Array) -> tuple[bool, Array]:
    """Find the parameters by Gauss-Newton with Levenberg's damping.

    Pixels (4, p), edges (5,), `steps` the table of F; p (13,) holds the start, and the best met
    afterwards. Returns whether it settled, and the model's rows (14, p) there.
    """
    count = pixels.shape[1]
    known, rows = np.empty((N_KNOWN_ROWS, count)), np.empty((N_ROWS, count))
    tried = np.empty_like(rows)
    products, damped = np.empty((N_ROWS, N_ROWS)), np.empty((N_PARAMETERS, N_PARAMETERS))
    root, step, trial = np.empty_like(damped), np.empty(N_PARAMETERS), np.empty(N_PARAMETERS)
    damping = 1e-3
    predict_pixels(pixels, edges, p, steps, known, rows)
    sum_products(rows, products)
    for _ in range(MAX_ITERATIONS):
        for a in range(N_PARAMETERS):
            for b in range(N_PARAMETERS):
                damped[a, b] = products[a, b]
            damped[a, a] *= 1.0 + damping
            step[a] = products[ROW_RESIDUAL, a]
        if not factor(damped, 0.0, root):
            return False, rows
        solve(root, step)
        for a in range(N_PARAMETERS):
            trial[a] = p[a] + step[a]
        away = max(abs(trial[PAR_X]), abs(trial[PAR_Y]), abs(trial[PAR_SPREAD]))
        blur = max(abs(trial[PAR_BLUR_1]), abs(trial[PAR_BLUR_2]))
        if not (away < edges[EDGE_SCALE] and blur < MAX_LOG_BLUR):  # another corner, or no lens
            damping *= 30.0
            continue
        predict_pixels(pixels, edges, trial, steps, known, tried)
        better = sum_of_squares(tried[ROW_RESIDUAL]) <= products[ROW_RESIDUAL, ROW_RESIDUAL]
        if better:
            copy_to(p, trial)
            rows, tried = tried, rows
            sum_products(rows, products)
        if max(abs(step[PAR_X]), abs(step[PAR_Y])) < TOL_STEP and damping < 1.0:
            return True, rows
        damping = damping / 10.0 if better else damping * 30.0
    return False, rows


@compiled_sums
def sum_of_squares(values: Array) -> float:
    """Sum of squares."""
    total = 0.0
    for value in values:
        total += value * value
    return total


@compiled_sums
def sum_products(rows: Array, products: Array) -> None:
    """Products of every row (14, p) with every other, (14, 14).

    Two rows by two at once: what is loaded is used twice.
    """
    for a in range(0, N_ROWS, 2):
        for b in range(0, a + 1, 2):
            first, right, below, both = 0.0, 0.0, 0.0, 0.0
            for k in range(rows.shape[1]):
                first += rows[a, k] * rows[b, k]
                right += rows[a, k] * rows[b + 1, k]
                below += rows[a + 1, k] * rows[b, k]
                both += rows[a + 1, k] * rows[b + 1, k]
            products[a, b] = products[b, a] = first
            products[a, b + 1] = products[b + 1, a] = right
            products[a + 1, b] = products[b, a + 1] = below
            products[a + 1, b + 1] = products[b + 1, a + 1] = both


@compiled
def centre_covariance(pixels: Array, rows: Array, result: Array) -> bool:
    """Fill in the centre's covariance, and how its scores scatter over the window.

    Were residuals independent, the sum over cells of the centre's squared scores would be what
    the information says, less what the fit took. JPEG, demosaicing and sharpening tie neighbours
    together: then it is more. A cell and its mirror image about the corner count as one, so what
    is even about the corner (the blur's true shape, gamma), which moves the centre nowhere,
    cancels. (Sandwich estimator with clusters; Liang and Zeger, Biometrika 73, 1986, with the
    expectation of the meat taken exactly.)
    """
    products, inverse = np.empty((N_ROWS, N_ROWS)), np.empty((N_PARAMETERS, N_PARAMETERS))
    sum_products(rows, products)
    root = np.empty_like(inverse)
    if not factor(products[:N_PARAMETERS, :N_PARAMETERS].copy(), 0.0, root):
        return False
    invert(root, inverse)
    count = rows.shape[1]
    scores = np.zeros((CELLS_PER_SIDE * CELLS_PER_SIDE // 2 + 1, 2))
    taken = np.zeros((len(scores), 2, N_PARAMETERS))
    for k in range(count):
        cell = int(pixels[COL_CELL, k])
        for axis in range(2):
            influence = 0.0  # d centre / d pixel
            for a in range(N_PARAMETERS):
                influence += inverse[axis, a] * rows[a, k]
            scores[cell, axis] += influence * rows[ROW_RESIDUAL, k]
            for a in range(N_PARAMETERS):
                taken[cell, axis, a] += influence * rows[a, k]
    variance = products[ROW_RESIDUAL, ROW_RESIDUAL] / (count - N_PARAMETERS)
    # in units of the centre's variance, so that all corners of a view speak alike
    unit, spent = inverse[PAR_X, PAR_X] + inverse[PAR_Y, PAR_Y], 0.0
    for cell in range(len(scores)):
        for axis in range(2):
            form = 0.0
            for i in range(N_PARAMETERS):
                for j in range(N_PARAMETERS):
                    form += taken[cell, axis, i] * inverse[i, j] * taken[cell, axis, j]
            spent += form
    result[COL_XX], result[COL_XY] = inverse[PAR_X, PAR_X], inverse[PAR_X, PAR_Y]
    result[COL_YY] = inverse[PAR_Y, PAR_Y]
    result[COL_VARIANCE], result[COL_EXPECTED] = variance, 1.0 - spent / unit
    result[COL_FOUND] = sum_of_squares(scores.ravel()) / (unit * variance)
    return True
