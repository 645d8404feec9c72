"""Fit centre and shape of LED spots to their pixels by Gauss-Newton.

Model of the pixel at column c and row r, px from the patch's centre pixel:

    value = clip(round(mu + noise), 0, 255),   noise ~ N(0, read² + gain (mu - black))
    mu    = floor + slope_x c + slope_y r + peak f(t; e^s)
    t²    = xx u² + 2 xy u w + yy w²,   u = (c - x) / scale,   w = (r - y) / scale

f is the radial profile of profile.py: f(0) = 1, f(1) = 1/2. `scale` is the half-width, px, that the
fit starts from. Parameter vector, one row a spot:

    index  name         meaning                                      unit
    0, 1   x, y         centre                                       px from the centre pixel
    2      peak         height of the profile                        DN
    3      floor        background at the centre pixel               DN
    4, 5   slope_x, _y  slope of the background                      DN/px
    6-8    xx, xy, yy   inverse square of the half-width ellipse     scale^-2
    9      s            ln of the steepness -d ln f / d ln t at t=1  1

Mean and variance of a clipped pixel have closed forms; (observed - mean) / variance times the
derivative of the mean is the quasi-score. Weights come from the model, not from the observed value,
which would favour pixels whose noise happened to be low. A pixel deep in saturation or below black
has a mean that no parameter changes: it carries no information and needs no mask.

With r a patch's residuals and D their derivatives by the parameters p, both over the pixels'
sigmas (`weigh_pixels`), and W the inverse variances of a prior m, each step solves

    (D' D + W + damping) dp = D' r + W (m - p)

It is most of what a pair costs.
"""

import math

import numpy as np

from verify.core.jit import compiled, compiled_sums
from verify.core.kernels.linear_algebra import copy_to, factor, solve
from verify.core.records import Array
from verify.measurement.detection.kernels.patches import Fits, rows_of
from verify.measurement.detection.kernels.pixels import (
    N_PARAMETERS,
    N_WHITENED,
    NEIGHBOUR_RADIUS,
    OUTLIER_SIGMA,
    PAR_FLOOR,
    PAR_PEAK,
    PAR_SLOPE_X,
    PAR_SLOPE_Y,
    PAR_STEEPNESS,
    PAR_X,
    PAR_XX,
    PAR_XY,
    PAR_Y,
    PAR_YY,
    ROW_COLUMN,
    ROW_CORE,
    ROW_MEAN,
    ROW_RADIUS2,
    ROW_RESIDUAL,
    ROW_ROW,
    ROW_VALID,
    ROW_VALUE,
    ROW_VARIANCE,
    SENSOR_LIMIT,
    weigh_pixels,
)

FIRST_DAMPING = 1e-4
MIN_INFORMATION = 1e-9  # information in every direction: of a patch none of whose pixels counts
CORE_RADIUS = 1.5  # half-widths: the spot's own pixels, by which its fit is judged
MIN_CORE_RADIUS = 3.0  # px, of the smallest: 28 pixels against 8 parameters
TOL_LAST_STEP = 10.0  # of chi² that the last step may gain: it is taken, and nothing looked at anew
LAST_STEPS = 2  # once the noise is known
MAX_STEPS = 8  # from a first look on; a clean spot takes two
MAX_STEPS_SATURATED = 20  # its top is hidden, the valley long
TOL_SATURATED = 0.001  # of chi², for saturated spots: a step may gain little and the next more
MAX_STEPS_FIRST_LOOK = 6  # steps of a first look; what has not taken shape by then is no spot
TOL_FIRST_LOOK = 1.0  # of chi² in a first look: the place is good to a sigma
START_STEEPNESS_SATURATED = math.log(5.0)  # an in-focus LED, whose flat top is real


@compiled_sums
def sum_products(rows: Array, products: Array) -> None:
    """Products of every row (m, p) with every other, (m, m); m is odd.

    Two rows by two at once: what is loaded is used twice.
    """
    last = rows.shape[0] - 1
    for a in range(0, last, 2):
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
    for b in range(last + 1):
        total = 0.0
        for k in range(rows.shape[1]):
            total += rows[last, k] * rows[b, k]
        products[last, b] = products[b, last] = total


@compiled_sums
def multiply_rows(rows: Array, others: Array, products: Array) -> None:
    """Fill in products (m, n) of rows (m, p) with others (n, p), four of n at once.

    n is a multiple of four.
    """
    for a in range(rows.shape[0]):
        for b in range(0, others.shape[0], 4):
            first, second, third, fourth = 0.0, 0.0, 0.0, 0.0
            for k in range(rows.shape[1]):
                first += rows[a, k] * others[b, k]
                second += rows[a, k] * others[b + 1, k]
                third += rows[a, k] * others[b + 2, k]
                fourth += rows[a, k] * others[b + 3, k]
            products[a, b], products[a, b + 1] = first, second
            products[a, b + 2], products[a, b + 3] = third, fourth


@compiled
def normal_equations(
    p: Array, rows: Array, out: float, prior: Array, information: Array, gradient: Array
) -> float:
    """Sum the pixels up; `prior` (2, 10) is mean and inverse variance. Gives chi²."""
    products = np.empty((N_WHITENED, N_WHITENED))
    sum_products(rows[:N_WHITENED], products)
    chi2 = products[ROW_RESIDUAL, ROW_RESIDUAL] + out
    for a in range(N_PARAMETERS):
        off = prior[0, a] - p[a]
        for b in range(N_PARAMETERS):
            information[a, b] = products[a, b]
        information[a, a] += prior[1, a]
        gradient[a] = products[ROW_RESIDUAL, a] + prior[1, a] * off
        chi2 += prior[1, a] * off * off
    return float(chi2)


@compiled
def limit_step(step: Array, p: Array) -> bool:
    """Shorten a step where the linearisation no longer means anything; tells whether it did."""
    least = min(p[PAR_XX], p[PAR_YY])
    ratio = max(abs(step[PAR_X]), abs(step[PAR_Y])) / 1.5  # px
    ratio = max(ratio, abs(step[PAR_PEAK]) / (0.7 * p[PAR_PEAK]))
    ratio = max(ratio, abs(step[PAR_FLOOR]) / 30.0)  # DN
    ratio = max(ratio, max(abs(step[PAR_SLOPE_X]), abs(step[PAR_SLOPE_Y])) / 5.0)  # DN a px
    ratio = max(
        ratio, max(abs(step[PAR_XX]), abs(step[PAR_XY]), abs(step[PAR_YY])) / (0.45 * least)
    )
    ratio = max(ratio, abs(step[PAR_STEEPNESS]) / 0.5)
    if ratio > 1.0:
        for a in range(N_PARAMETERS):
            step[a] /= ratio
    return bool(ratio > 1.0)


@compiled
def update_means(step: Array, rows: Array) -> None:
    """Let the means of the pixels that count follow a small step (10,), to first order."""
    moved = np.zeros(rows.shape[1])
    for a in range(N_PARAMETERS):
        for k in range(rows.shape[1]):
            moved[k] += step[a] * rows[a, k]
    for k in range(rows.shape[1]):
        rows[ROW_MEAN, k] += moved[k] * math.sqrt(rows[ROW_VARIANCE, k])


@compiled
def mark_core(p: Array, rows: Array) -> None:
    """Mark the pixels that are the spot's own: its core, and for the smallest a few about it."""
    for k in range(rows.shape[1]):
        x, y = rows[ROW_COLUMN, k] - p[PAR_X], rows[ROW_ROW, k] - p[PAR_Y]
        near = rows[ROW_RADIUS2, k] < CORE_RADIUS**2 or x * x + y * y < MIN_CORE_RADIUS**2
        rows[ROW_CORE, k] = rows[ROW_VALID, k] if near else 0.0


@compiled_sums
def chi_squared(p: Array, rows: Array, variance: Array, prior: Array) -> float:
    """Chi² of a patch at p under given variances (p,): `rows` give the means alone."""
    total = 0.0
    for k in range(rows.shape[1]):
        residual = rows[ROW_VALUE, k] - rows[ROW_MEAN, k]
        square = residual * residual / variance[k]
        outside = rows[ROW_RADIUS2, k] > NEIGHBOUR_RADIUS**2 and square > OUTLIER_SIGMA**2
        total += rows[ROW_VALID, k] * (OUTLIER_SIGMA**2 if outside else square)
    for a in range(N_PARAMETERS):
        off = prior[0, a] - p[a]
        total += prior[1, a] * off * off
    return total


@compiled
def fit_spot(fits: Fits, n: int, noise: Array, table: Array, steps: int, settled: float) -> None:
    """Continue a spot's fit by Gauss-Newton with Levenberg's damping, until it settles.

    `noise` (3,): read variance, gain and black of one channel; `table`: of the profiles. `steps`:
    at most, 0 weighs the pixels where the fit is. `settled`: of chi² that a step may still gain: it
    is taken, and the pixels are not weighed again, but that their means follow.
    """
    best, scale, prior, rows = fits.parameters[n], fits.scale[n], fits.prior[n], rows_of(fits, n)
    information, gradient = fits.information[n], fits.gradient[n]
    tried, tried_gradient = np.empty(N_PARAMETERS), np.empty(N_PARAMETERS)
    tried_information = np.empty((N_PARAMETERS, N_PARAMETERS))
    root, step, own = np.empty_like(tried_information), np.empty(N_PARAMETERS), np.empty(3)
    own[0], own[1], own[2] = fits.share[n, 0] * noise[0], fits.share[n, 1] * noise[1], noise[2]
    out = weigh_pixels(best, scale, own, table, rows)
    chi2 = normal_equations(best, rows, out, prior, information, gradient)
    variance, accepted = np.empty(rows.shape[1]), chi2
    copy_to(variance, rows[ROW_VARIANCE])
    damping, refused = FIRST_DAMPING, False
    for _ in range(steps):
        gained, shortened = find_step(best, information, gradient, damping, (root, step))
        if gained <= settled * (1.0 + chi2 / rows.shape[1]) and not shortened:
            for a in range(N_PARAMETERS):
                best[a] += step[a]
            chi2 -= gained
            update_means(step, rows)
            break
        for a in range(N_PARAMETERS):
            tried[a] = best[a] + step[a]
        out = weigh_pixels(tried, scale, own, table, rows)
        trial = normal_equations(tried, rows, out, prior, tried_information, tried_gradient)
        # The weights move with the model, and chi² with them: a step is judged by those that it was
        # found with.
        refused = not chi_squared(tried, rows, variance, prior) <= 1.1 * accepted + 1.0
        if refused:
            damping *= 30.0
            continue
        copy_to(best, tried)
        chi2, accepted, damping = trial, trial, damping / 10.0
        for a in range(N_PARAMETERS):
            copy_to(information[a], tried_information[a])
        copy_to(gradient, tried_gradient)
        copy_to(variance, rows[ROW_VARIANCE])
    if refused:
        weigh_pixels(best, scale, own, table, rows)
    mark_core(best, rows)
    fits.chi2[n] = chi2


@compiled
def find_step(
    p: Array, information: Array, gradient: Array, damping: float, found: tuple[Array, Array]
) -> tuple[float, bool]:
    """Find the next step: what it takes from chi², and whether it was shortened.

    `found`, filled in: a factor (10, 10), and the step (10,).
    """
    root, step = found
    damped = np.empty((N_PARAMETERS, N_PARAMETERS))
    for a in range(N_PARAMETERS):
        copy_to(damped[a], information[a])
        damped[a, a] = damped[a, a] * (1.0 + damping) + MIN_INFORMATION
    factor(damped, 0.0, root)
    copy_to(step, gradient)
    solve(root, step)
    shortened, gained = limit_step(step, p), 0.0
    for a in range(N_PARAMETERS):
        gained += step[a] * gradient[a]
    return gained, shortened


@compiled
def fit_from_start(fits: Fits, n: int, noise: Array, table: Array) -> None:
    """Fit a spot from where its parameters are.

    A clear spot comes within a step of its optimum: it is continued once the noise is known. A
    saturated spot is fitted from two starts, as its hidden top may be steep or flat.
    """
    fit_spot(fits, n, noise, table, MAX_STEPS, TOL_LAST_STEP)
    if not fits.saturated[n]:
        return
    fit_spot(fits, n, noise, table, MAX_STEPS_SATURATED, TOL_SATURATED)
    rows, flat = rows_of(fits, n), fits.parameters[n].copy()
    held, information, gradient = rows.copy(), fits.information[n].copy(), fits.gradient[n].copy()
    chi2, steep = fits.chi2[n], fits.parameters[n]
    copy_to(steep, fits.prior[n, 0])
    steep[PAR_STEEPNESS], steep[PAR_PEAK] = (
        START_STEEPNESS_SATURATED,
        SENSOR_LIMIT - steep[PAR_FLOOR],
    )
    fit_spot(fits, n, noise, table, MAX_STEPS_SATURATED, TOL_SATURATED)
    if chi2 <= fits.chi2[n]:
        copy_to(steep, flat)
        copy_to(fits.gradient[n], gradient)
        for a in range(N_PARAMETERS):
            copy_to(fits.information[n, a], information[a])
        for a in range(len(rows)):
            copy_to(rows[a], held[a])
        fits.chi2[n] = chi2
