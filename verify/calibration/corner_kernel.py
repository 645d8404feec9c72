"""A corner's fit, compiled: the way to the crossing, what is left out, how well it is known."""

import numpy as np
from numpy.typing import NDArray

from verify.calibration.corner_kernel_model import (
    BLUR_1,
    BLUR_2,
    CONTRAST,
    KNOWN,
    PARAMETERS,
    RESIDUAL,
    ROWS,
    SPREAD,
    X,
    Y,
    model,
    start_values,
)
from verify.calibration.corner_kernel_window import (
    CELL,
    CELLS,
    EDGES,
    HALF_WINDOW,
    SCALE,
    edges_at,
    far_from,
    only,
    window_at,
)
from verify.compiled import compiled, compiled_sums
from verify.records import Array
from verify.small_matrices import factor, invert, solve

START_BLUR = 0.06  # squares: wide enough to draw in a start that is some pixels off
BLUREST = 4.0  # either way, of the log of a blur in px
ITERATIONS = 25  # a good start takes three
SETTLED = 1e-3  # px; the step after it is below 1e-5
STRAY = 0.5  # of the contrast: what differs more is no part of the corner (a border, dirt)
UNEVEN = 0.5  # px that an edge's pixels may be off: sharpening and saturation deform it
OUTLIER = 5.0  # sigma, and more than that
MAD = 0.67449  # median of |x| over sigma, Gaussian
CLEARINGS = 2  # the first fit was led astray by what it leaves out
OWN = 0.6  # of the pixels that must belong to the corner
LEAST_PIXELS = 40  # three a parameter
# what is told of a corner: covariance of its centre where the residuals' variance is one, that
# variance (DN²), and the scatter of the centre's scores from cell to cell, found and expected
XX, XY, YY, VARIANCE, FOUND, EXPECTED = range(6)
TOLD = 6


@compiled
def fit(
    grey: Array,
    at: tuple[Array, Array, Array],
    markers: tuple[float, float],
    known_before: bool,
    steps: Array,
    p: Array,
    told: Array,
) -> bool:
    """Fit a corner.

    Args:
        grey: (h, w), DN.
        at: centre, jacobian and bend, see `saddle.Place`.
        markers: as for `window_at`.
        known_before: whether p is of an earlier fit, whose centre is the expected one.
        steps: the table of F.
        p: (13,), filled: the parameters, see corner_kernel_model.py.
        told: (6,), filled.

    Returns:
        Whether there is a crossing; nothing is told where there is none.
    """
    centre, jacobian, bend = at
    pixels, edges = window_at(grey, centre, jacobian, markers), np.empty(EDGES)
    if pixels.shape[1] < LEAST_PIXELS:
        return False
    edges_at(jacobian, bend, edges)
    if known_before:
        p[X], p[Y] = 0.0, 0.0
    else:
        start_values(pixels, edges, START_BLUR * edges[SCALE], p)
    settled, rows = converge(pixels, edges, steps, p)
    for _ in range(CLEARINGS):
        if not settled:
            return False
        all_pixels = pixels.shape[1]
        own = np.empty(all_pixels, np.bool_)
        count = far_from(pixels, strays(p, rows), own)
        if count < max(LEAST_PIXELS, OWN * all_pixels):
            return False  # most of it is something else
        if count == all_pixels:
            break
        pixels = only(pixels, own, count)
        settled, rows = converge(pixels, edges, steps, p)
    return settled and near(jacobian, p) and judge(pixels, rows, told)


@compiled
def near(jacobian: Array, p: Array) -> bool:
    """Whether the crossing is well within the window."""
    determinant = jacobian[0, 0] * jacobian[1, 1] - jacobian[0, 1] * jacobian[1, 0]
    u = (p[X] * jacobian[1, 1] - p[Y] * jacobian[0, 1]) / determinant
    v = (p[Y] * jacobian[0, 0] - p[X] * jacobian[1, 0]) / determinant
    return bool(max(abs(u), abs(v)) <= HALF_WINDOW / 2)


@compiled
def strays(p: Array, rows: Array) -> NDArray[np.bool_]:
    """Which pixels (p,) are no part of the corner that was fitted."""
    residual = np.abs(rows[RESIDUAL])
    usual = max(STRAY * abs(p[CONTRAST]), OUTLIER * np.median(residual) / MAD)
    stray = np.empty(len(residual), np.bool_)
    for k in range(len(residual)):
        stray[k] = residual[k] > usual + UNEVEN * abs(rows[SPREAD, k])
    return stray


@compiled
def converge(pixels: Array, edges: Array, steps: Array, p: Array) -> tuple[bool, Array]:
    """Find the parameters by Gauss-Newton with Levenberg's damping.

    Args:
        pixels: (4, p).
        edges: (5,).
        steps: the table of F.
        p: (13,), to begin with; the best met, afterwards.

    Returns:
        Whether it settled, and the model's rows (14, p) there.
    """
    count = pixels.shape[1]
    known, rows, tried = np.empty((KNOWN, count)), np.empty((ROWS, count)), np.empty((ROWS, count))
    products, damped = np.empty((ROWS, ROWS)), np.empty((PARAMETERS, PARAMETERS))
    root, step, trial = np.empty_like(damped), np.empty(PARAMETERS), np.empty(PARAMETERS)
    damping = 1e-3
    model(pixels, edges, p, steps, known, rows)
    sum_products(rows, products)
    for _ in range(ITERATIONS):
        for a in range(PARAMETERS):
            for b in range(PARAMETERS):
                damped[a, b] = products[a, b]
            damped[a, a] *= 1.0 + damping
            step[a] = products[RESIDUAL, a]
        if not factor(damped, 0.0, root):
            return False, rows
        solve(root, step)
        for a in range(PARAMETERS):
            trial[a] = p[a] + step[a]
        if not sane(trial, edges[SCALE]):
            damping *= 30.0
            continue
        model(pixels, edges, trial, steps, known, tried)
        better = square(tried[RESIDUAL]) <= products[RESIDUAL, RESIDUAL]
        if better:
            p[:] = trial
            rows, tried = tried, rows
            sum_products(rows, products)
        if max(abs(step[X]), abs(step[Y])) < SETTLED and damping < 1.0:
            return True, rows
        damping = damping / 10.0 if better else damping * 30.0
    return False, rows


@compiled
def sane(p: Array, scale: float) -> bool:
    """Whether a fit is still at the corner it started at, with a blur that lenses have."""
    near_it = max(abs(p[X]), abs(p[Y]), abs(p[SPREAD])) < scale
    return bool(near_it and max(abs(p[BLUR_1]), abs(p[BLUR_2])) < BLUREST)


@compiled_sums
def square(values: Array) -> float:
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
    for a in range(0, ROWS, 2):
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
def judge(pixels: Array, rows: Array, told: Array) -> bool:
    """Tell the centre's covariance, and how its scores scatter over the window.

    Were residuals independent, the sum over cells of the centre's squared scores would be what
    the information says, less what the fit took. JPEG, demosaicing and sharpening tie neighbours
    together: then it is more. A cell and its mirror image about the corner count as one, so what
    is even about the corner (the blur's true shape, gamma), which moves the centre nowhere,
    cancels. (Sandwich estimator with clusters; Liang and Zeger, Biometrika 73, 1986, with the
    expectation of the meat taken exactly.)
    """
    products, inverse = np.empty((ROWS, ROWS)), np.empty((PARAMETERS, PARAMETERS))
    sum_products(rows, products)
    root = np.empty_like(inverse)
    if not factor(products[:PARAMETERS, :PARAMETERS], 0.0, root):
        return False
    invert(root, inverse)
    count = rows.shape[1]
    scores = np.zeros((CELLS * CELLS // 2 + 1, 2))
    taken = np.zeros((len(scores), 2, PARAMETERS))
    for k in range(count):
        cell = int(pixels[CELL, k])
        for axis in range(2):
            influence = 0.0  # d centre / d pixel
            for a in range(PARAMETERS):
                influence += inverse[axis, a] * rows[a, k]
            scores[cell, axis] += influence * rows[RESIDUAL, k]
            for a in range(PARAMETERS):
                taken[cell, axis, a] += influence * rows[a, k]
    variance = products[RESIDUAL, RESIDUAL] / (count - PARAMETERS)
    # in units of the centre's variance, so that all corners of a view speak alike
    unit, spent = inverse[X, X] + inverse[Y, Y], 0.0
    for cell in range(len(scores)):
        for axis in range(2):
            spent += weighed(inverse, taken[cell, axis])
    told[XX], told[XY], told[YY] = inverse[X, X], inverse[X, Y], inverse[Y, Y]
    told[VARIANCE], told[EXPECTED] = variance, 1.0 - spent / unit
    told[FOUND] = square(scores.ravel()) / (unit * variance)
    return True


@compiled
def weighed(matrix: Array, vector: Array) -> float:
    """A vector (n,) by a matrix (n, n) by the vector."""
    total = 0.0
    for i in range(len(vector)):
        for j in range(len(vector)):
            total += vector[i] * matrix[i, j] * vector[j]
    return total
