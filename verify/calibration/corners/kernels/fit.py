"""Fit a corner's crossing by Gauss-Newton with Levenberg's damping; say how well it is known.

With r the pixels' residuals and J their derivatives by the 13 parameters, each step solves
(J'J + damping diag J'J) dp = J'r. Pixels that are no part of the corner are left out, and it is
fitted again. A calibration fits thousands of corners of hundreds of pixels: in numpy every step
would pass over all of them dozens of times.
"""

import math

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
MIN_BLUR = 0.7  # px: what is sharper shows no difference in pixels
MAX_LOG_BLUR = 4.0  # either way, of the log of a blur in px
MAX_ITERATIONS = 25  # a good start takes three
TOL_STEP = 1e-3  # px; the step after it is below 1e-5
TOL_GAIN = 1e-5  # of the sum of squares
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
def fit_crossings(
    grey: NDArray[np.uint8],
    at: tuple[Array, Array, Array],
    markers: Array,
    steps: Array,
    fitted: NDArray[np.bool_],
    parameters: Array,
    results: Array,
) -> None:
    """Fit the corners of a view (h, w), DN, all of whose pixels weigh the same.

    `at`: expected centres (n, 2), px, good to a tenth of a square; d px / d squares (n, 2, 2),
    columns along the board's x and y; d² px / d squares² (n, 2, 2), likewise. `markers` (n, 2) as
    for `window_pixels`, `steps` the table of F. Parameters (n, 13), see model.py, and results
    (n, 6) are filled where there is a crossing, and `fitted` (n,) says where; where it is true
    beforehand the parameters are of an earlier fit, whose centre is the expected one.
    """
    centres, jacobians, bends = at
    edges, usual, known = np.empty(N_EDGE_VALUES), (0.0, 0.0, 0.0), False
    for i in range(len(centres)):
        p, jacobian = parameters[i], jacobians[i]
        pixels = window_pixels(grey, centres[i], jacobian, (markers[i, 0], markers[i, 1]))
        fill_edges(jacobian, bends[i], edges)
        if fitted[i]:
            p[PAR_X], p[PAR_Y] = 0.0, 0.0
            fitted[i] = fit_crossing(pixels, jacobian, edges, steps, p, results[i])
            continue
        if known:
            start_values(pixels, edges, usual, p)
            fitted[i] = fit_crossing(pixels, jacobian, edges, steps, p, results[i])
        if not fitted[i]:
            blur = math.log(max(START_BLUR * edges[EDGE_SCALE], MIN_BLUR))
            start_values(pixels, edges, (blur, blur, 0.0), p)
            fitted[i] = fit_crossing(pixels, jacobian, edges, steps, p, results[i])
        if fitted[i]:  # the lens blurs the next corner much alike
            known = True
            spread = math.copysign(p[PAR_SPREAD], p[PAR_SPREAD] * p[PAR_CONTRAST])
            usual = (p[PAR_BLUR_1], p[PAR_BLUR_2], spread)


@compiled
def fit_crossing(
    pixels: Array, jacobian: Array, edges: Array, steps: Array, p: Array, result: Array
) -> bool:
    """Fit a corner's pixels (4, p) by the start in p (13,); returns whether there is one."""
    if pixels.shape[1] < MIN_PIXELS:
        return False
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
    afterwards. Returns whether it settled, and the model's rows (14, p) within TOL_STEP of it.
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
        if is_small(step, products) and damping < 1.0:
            copy_to(p, trial)  # the picture there is the same
            return True, rows
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
        damping = damping / 10.0 if better else damping * 30.0
    return False, rows


@compiled
def is_small(step: Array, products: Array) -> bool:
    """Whether a step moves the place by next to nothing, and gains next to nothing."""
    gain = 0.0
    for a in range(N_PARAMETERS):
        gain += step[a] * products[ROW_RESIDUAL, a]
    still = max(abs(step[PAR_X]), abs(step[PAR_Y])) < TOL_STEP
    return bool(still and gain < TOL_GAIN * products[ROW_RESIDUAL, ROW_RESIDUAL])


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
    count, cells = rows.shape[1], CELLS_PER_SIDE * CELLS_PER_SIDE // 2 + 1
    influence = np.zeros((2, count))  # d centre / d pixel
    for axis in range(2):
        for a in range(N_PARAMETERS):
            add_scaled(influence[axis], inverse[axis, a], rows[a])
    taken = np.zeros((cells, 2, N_ROWS))  # by the fit, and the scores behind
    for k in range(count):
        cell = int(pixels[COL_CELL, k])
        for a in range(N_ROWS):
            taken[cell, 0, a] += influence[0, k] * rows[a, k]
            taken[cell, 1, a] += influence[1, k] * rows[a, k]
    variance = products[ROW_RESIDUAL, ROW_RESIDUAL] / (count - N_PARAMETERS)
    # in units of the centre's variance, so that all corners of a view speak alike
    unit, spent, scattered = inverse[PAR_X, PAR_X] + inverse[PAR_Y, PAR_Y], 0.0, 0.0
    for cell in range(cells):
        for axis in range(2):
            for i in range(N_PARAMETERS):
                form = 0.0
                for j in range(N_PARAMETERS):
                    form += inverse[i, j] * taken[cell, axis, j]
                spent += taken[cell, axis, i] * form
            scattered += taken[cell, axis, ROW_RESIDUAL] ** 2
    result[COL_XX], result[COL_XY] = inverse[PAR_X, PAR_X], inverse[PAR_X, PAR_Y]
    result[COL_YY] = inverse[PAR_Y, PAR_Y]
    result[COL_VARIANCE], result[COL_EXPECTED] = variance, 1.0 - spent / unit
    result[COL_FOUND] = scattered / (unit * variance)
    return True


@compiled_sums
def add_scaled(total: Array, factor: float, values: Array) -> None:
    """Add a multiple of some values (n,) to others."""
    for k in range(len(total)):
        total[k] += factor * values[k]
