"""Fit centre and shape of LED spots to their pixels by Gauss-Newton, from what these suggest.

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
    HALF,
    N_PARAMETERS,
    N_WHITENED,
    NEIGHBOUR_RADIUS,
    ONE,
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
    ZERO,
    Pixels,
    Real,
    weigh_pixels,
)

FIRST_DAMPING = 1e-4
MIN_INFORMATION = 1e-9  # information in every direction: of a patch none of whose pixels counts
CORE_RADIUS2 = Real(1.5**2)  # half-widths²: the spot's own pixels, by which its fit is judged
MIN_CORE_RADIUS2 = Real(3.0**2)  # px², of the smallest: 28 pixels against 8 parameters
TOL_LAST_STEP = 10.0  # of chi² that the last step may gain: it is taken, and nothing looked at anew
LAST_STEPS = 2  # once the noise is known
MAX_STEPS = 8  # from a first look on; a clean spot takes two
MAX_STEPS_SATURATED = 20  # its top is hidden, the valley long
TOL_SATURATED = 0.001  # of chi², for saturated spots: a step may gain little and the next more
MAX_STEPS_FIRST_LOOK = 6  # steps of a first look; what has not taken shape by then is no spot
TOL_FIRST_LOOK = 1.0  # of chi² in a first look: the place is good to a sigma
START_STEEPNESS_SATURATED = math.log(5.0)  # an in-focus LED, whose flat top is real
START_STEEPNESS = math.log(2.2)  # between a Gaussian (1.39) and an in-focus LED (5)
# Priors, standard deviations. All but the slopes' concern terms that are even about the centre and
# leave it alone; they only keep a dim or a fully saturated spot from drifting off.
PRIOR_STEEPNESS = 1.0
PRIOR_PEAK = 2000.0  # DN: eight times the sensor's range
PRIOR_FLOOR = 10.0  # DN: a floor below black does not show
PRIOR_SHAPE = 2.0  # of (half-width / start)^-2
NEAR_LIMIT = 3.0  # DN below the limit: a top so near it is cut off, and higher than it seems
PEAK_FACTOR_CLIPPED, PEAK_FACTOR = 1.3, 1.05  # peak over the core's mean: cut off, and whole
MAX_SLOPE = Real(30.0)  # DN about the floor: a neighbour is no slope
MIN_LOG_STEEPNESS, MAX_LOG_STEEPNESS = 0.3, 2.5  # logarithms: no guess of a steepness is beyond
QUARTER = Real(0.25)
BLUR_BIAS = 0.1  # logarithm, by which counted pixels look steeper than the spot
HALO_DN = 0.7  # DN, of a spot's light in the pixels that its floor is guessed from
MAX_BLACK_SHARE = 0.98  # of pixels: with more, a floor below black cannot be guessed
LOGISTIC_SCALE = 1.702  # scale on which a logistic law is a normal one, to 0.01 (Camilli, 1994)


@compiled_sums
def sum_products(rows: Pixels, products: Array, kind: type[np.floating]) -> None:
    """Products of every row (m, p) with every other, (m, m); m is odd. `kind`: the sums' precision.

    Two rows by two at once: what is loaded is used twice.
    """
    last = rows.shape[0] - 1
    for a in range(0, last, 2):
        for b in range(0, a + 1, 2):
            first, right, below, both = kind(0), kind(0), kind(0), kind(0)
            for k in range(rows.shape[1]):
                first += kind(rows[a, k]) * kind(rows[b, k])
                right += kind(rows[a, k]) * kind(rows[b + 1, k])
                below += kind(rows[a + 1, k]) * kind(rows[b, k])
                both += kind(rows[a + 1, k]) * kind(rows[b + 1, k])
            products[a, b] = products[b, a] = first
            products[a, b + 1] = products[b + 1, a] = right
            products[a + 1, b] = products[b, a + 1] = below
            products[a + 1, b + 1] = products[b + 1, a + 1] = both
    for b in range(last + 1):
        total = kind(0)
        for k in range(rows.shape[1]):
            total += kind(rows[last, k]) * kind(rows[b, k])
        products[last, b] = products[b, last] = total


@compiled_sums
def multiply_rows(rows: Pixels, others: Pixels, products: Array, kind: type[np.floating]) -> None:
    """Fill in products (m, n) of rows (m, p) with others (n, p), four of n at once.

    n is a multiple of four; `kind`: the precision of the sums.
    """
    for a in range(rows.shape[0]):
        for b in range(0, others.shape[0], 4):
            first, second, third, fourth = kind(0), kind(0), kind(0), kind(0)
            for k in range(rows.shape[1]):
                first += kind(rows[a, k]) * kind(others[b, k])
                second += kind(rows[a, k]) * kind(others[b + 1, k])
                third += kind(rows[a, k]) * kind(others[b + 2, k])
                fourth += kind(rows[a, k]) * kind(others[b + 3, k])
            products[a, b], products[a, b + 1] = first, second
            products[a, b + 2], products[a, b + 3] = third, fourth


@compiled
def normal_equations(
    p: Array, rows: Pixels, kept: tuple[float, bool], prior: Array, found: tuple[Array, Array]
) -> float:
    """Sum the pixels up; `prior` (2, 10) is mean and inverse variance. Gives chi².

    `kept`: what the pixels left out add to it; whether the spot is saturated: its parameters are so
    alike then that single precision does not tell them apart. `found`, filled: information (10, 10)
    and gradient (10,).
    """
    products = np.empty((N_WHITENED, N_WHITENED))
    (out, saturated), (information, gradient) = kept, found
    if saturated:
        sum_products(rows[:N_WHITENED], products, np.float64)
    else:
        sum_products(rows[:N_WHITENED], products, Real)
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


@compiled_sums
def update_means(step: Array, rows: Pixels) -> None:
    """Let the means of the pixels that count follow a small step (10,), to first order."""
    moved = np.zeros(rows.shape[1], Real)
    for a in range(0, N_PARAMETERS, 2):
        one, other = Real(step[a]), Real(step[a + 1])
        for k in range(rows.shape[1]):
            moved[k] += one * rows[a, k] + other * rows[a + 1, k]
    for k in range(rows.shape[1]):
        rows[ROW_MEAN, k] += moved[k] * math.sqrt(rows[ROW_VARIANCE, k])


@compiled
def mark_core(p: Array, rows: Pixels) -> None:
    """Mark the pixels that are the spot's own: its core, and for the smallest a few about it."""
    x, y = Real(p[PAR_X]), Real(p[PAR_Y])
    for k in range(rows.shape[1]):
        u, w = rows[ROW_COLUMN, k] - x, rows[ROW_ROW, k] - y
        near = (rows[ROW_RADIUS2, k] < CORE_RADIUS2) | (u * u + w * w < MIN_CORE_RADIUS2)
        rows[ROW_CORE, k] = rows[ROW_VALID, k] if near else ZERO


@compiled_sums
def chi_squared(p: Array, rows: Pixels, variance: Pixels, prior: Array) -> float:
    """Chi² of a patch at p under given variances (p,): `rows` give the means alone."""
    total, most = ZERO, OUTLIER_SIGMA * OUTLIER_SIGMA
    for k in range(rows.shape[1]):
        residual = rows[ROW_VALUE, k] - rows[ROW_MEAN, k]
        square = residual * residual / variance[k]
        outside = rows[ROW_RADIUS2, k] > NEIGHBOUR_RADIUS * NEIGHBOUR_RADIUS
        total += rows[ROW_VALID, k] * (most if outside & (square > most) else square)
    chi2 = float(total)
    for a in range(N_PARAMETERS):
        off = prior[0, a] - p[a]
        chi2 += prior[1, a] * off * off
    return chi2


@compiled
def fit_spot(fits: Fits, n: int, noise: Array, table: Pixels, steps: int, tolerance: float) -> None:
    """Continue a spot's fit by Gauss-Newton with Levenberg's damping, until it settles.

    `noise` (3,): read variance, gain and black of one channel; `table`: of the profiles. `steps`:
    at most, 0 weighs the pixels where the fit is. `tolerance`: of chi² that a step may still gain:
    it is taken, and the pixels are not weighed again, but that their means follow.
    """
    best, scale, prior, rows = fits.parameters[n], fits.scale[n], fits.prior[n], rows_of(fits, n)
    information, gradient = fits.information[n], fits.gradient[n]
    tried, tried_gradient = np.empty(N_PARAMETERS), np.empty(N_PARAMETERS)
    tried_information, full = np.empty((N_PARAMETERS, N_PARAMETERS)), fits.saturated[n]
    next_equations = tried_information, tried_gradient
    root, step, own = np.empty_like(tried_information), np.empty(N_PARAMETERS), np.empty(3)
    own[0], own[1], own[2] = fits.share[n, 0] * noise[0], fits.share[n, 1] * noise[1], noise[2]
    out = weigh_pixels(best, scale, own, table, rows)
    chi2 = normal_equations(best, rows, (out, full), prior, (information, gradient))
    variance, accepted = np.empty(rows.shape[1], Real), chi2
    copy_to(variance, rows[ROW_VARIANCE])
    damping, refused, fits.settled[n] = FIRST_DAMPING, False, False
    for _ in range(steps):
        gained, shortened = find_step(best, information, gradient, damping, (root, step))
        if gained <= tolerance * (1.0 + chi2 / rows.shape[1]) and not shortened:
            for a in range(N_PARAMETERS):
                best[a] += step[a]
            chi2 -= gained
            update_means(step, rows)
            fits.settled[n] = True
            break
        for a in range(N_PARAMETERS):
            tried[a] = best[a] + step[a]
        out = weigh_pixels(tried, scale, own, table, rows)
        trial = normal_equations(tried, rows, (out, full), prior, next_equations)
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
def fit_from_start(fits: Fits, n: int, noise: Array, table: Pixels) -> None:
    """Fit a spot from where its parameters are.

    A clear spot comes within a step of its optimum. A saturated spot is fitted from two starts, as
    its hidden top may be steep or flat.
    """
    fit_spot(fits, n, noise, table, MAX_STEPS, TOL_LAST_STEP)
    if not fits.saturated[n]:
        return
    fit_spot(fits, n, noise, table, MAX_STEPS_SATURATED, TOL_SATURATED)
    rows, flat = rows_of(fits, n), fits.parameters[n].copy()
    held, information, gradient = rows.copy(), fits.information[n].copy(), fits.gradient[n].copy()
    chi2, steep = fits.chi2[n], fits.parameters[n]
    copy_to(steep, fits.prior[n, 0])
    steep[PAR_STEEPNESS] = START_STEEPNESS_SATURATED
    steep[PAR_PEAK] = SENSOR_LIMIT - steep[PAR_FLOOR]
    fit_spot(fits, n, noise, table, MAX_STEPS_SATURATED, TOL_SATURATED)
    if chi2 <= fits.chi2[n]:
        copy_to(steep, flat)
        copy_to(fits.gradient[n], gradient)
        for a in range(N_PARAMETERS):
            copy_to(fits.information[n, a], information[a])
        for a in range(len(rows)):
            copy_to(rows[a], held[a])
        fits.chi2[n], fits.settled[n] = chi2, False


def _default_prior() -> Array:
    """Mean and inverse variance of what every spot is expected to have, (2, 10)."""
    prior = np.zeros((2, N_PARAMETERS))
    prior[0, PAR_STEEPNESS], prior[0, PAR_XX], prior[0, PAR_YY] = START_STEEPNESS, 1.0, 1.0
    prior[1, PAR_PEAK], prior[1, PAR_FLOOR] = PRIOR_PEAK**-2, PRIOR_FLOOR**-2
    prior[1, PAR_STEEPNESS], prior[1, PAR_XX : PAR_YY + 1] = PRIOR_STEEPNESS**-2, PRIOR_SHAPE**-2
    return prior


DEFAULT_PRIOR = _default_prior()


@compiled
def expect_spot(fits: Fits, n: int, read: float) -> None:
    """Set a spot's prior and start by its pixels; `read`, DN, is the deviation of a dark pixel."""
    rows, scale, floor = rows_of(fits, n), fits.scale[n], fits.level[n]
    mean, weight, start = fits.prior[n, 0], fits.prior[n, 1], fits.parameters[n]
    copy_to(mean, DEFAULT_PRIOR[0])
    copy_to(weight, DEFAULT_PRIOR[1])
    copy_to(start, DEFAULT_PRIOR[0])
    value, column, row = rows[ROW_VALUE], rows[ROW_COLUMN], rows[ROW_ROW]
    top = floor_priors(rows, scale, floor, weight)
    mean[PAR_FLOOR] = floor
    cut_off = top > SENSOR_LIMIT - NEAR_LIMIT
    mean[PAR_PEAK] = (PEAK_FACTOR_CLIPPED if cut_off else PEAK_FACTOR) * max(top - floor, 1.0)
    full = False
    for k in range(len(value)):
        if value[k] >= SENSOR_LIMIT:
            full = full or column[k] * column[k] + row[k] * row[k] <= scale * scale
    fits.saturated[n] = full
    start[PAR_PEAK], start[PAR_FLOOR] = mean[PAR_PEAK], floor
    if not full:  # a cut-off top shows nothing of its sides
        start[PAR_FLOOR] = (floor if floor > 0.0 else floor_below_black(value, read)) - HALO_DN
        start[PAR_PEAK] = top - start[PAR_FLOOR]
        start_values(rows, scale, floor, top, start)


@compiled_sums
def floor_priors(rows: Pixels, scale: float, floor: float, weight: Array) -> float:
    """Hold the slopes (10,) as firmly as the pixels about the spot have none; give its top, DN."""
    core, ring = Real((0.5 * scale + 0.5) ** 2), Real((2.3 * scale + 1.0) ** 2)
    total, count, level = ZERO, ZERO, Real(floor)
    lean_x, lean_y, lever_x, lever_y = ZERO, ZERO, ZERO, ZERO
    for k in range(rows.shape[1]):
        x, y, valid = rows[ROW_COLUMN, k], rows[ROW_ROW, k], rows[ROW_VALID, k]
        distance2, value = x * x + y * y, rows[ROW_VALUE, k]
        inner = valid if distance2 <= core else ZERO
        outer = valid if (distance2 > ring) & (distance2 > core) else ZERO
        excess = min(max(value - level, -MAX_SLOPE), MAX_SLOPE) * outer
        total += inner * value
        count += inner
        lean_x += excess * x
        lean_y += excess * y
        lever_x += outer * x * x
        lever_y += outer * y * y
    # A slope costs the centre information, so it is let in as far as the surroundings have one.
    weight[PAR_SLOPE_X] = 1.0 / (float(lean_x / max(lever_x, ONE)) ** 2 + 1e-8)
    weight[PAR_SLOPE_Y] = 1.0 / (float(lean_y / max(lever_y, ONE)) ** 2 + 1e-8)
    return float(total / max(count, ONE))


@compiled
def floor_below_black(value: Pixels, read: float) -> float:
    """Guess the floor where black cuts it off, from how many pixels are black."""
    black = 0.0
    for k in range(len(value)):
        black += value[k] < 0.5
    share = min(black / len(value), MAX_BLACK_SHARE)
    return 0.5 - read * math.log(share / (1.0 - share)) / LOGISTIC_SCALE


@compiled_sums
def start_values(rows: Pixels, scale: float, floor: float, top: float, start: Array) -> None:
    """Guess a spot's place from its pixels over 1/4 of its height, its steepness from how many.

    `rows` (25, p); `floor` and `top`, DN; `scale`, px, half-width that the fit starts from; `start`
    (10,), changed where the pixels show it.
    """
    height, near, wide, narrow = Real(top - floor), Real((2.2 * scale) ** 2), ZERO, ZERO
    foot, half, light, right, down = Real(floor) + QUARTER * height, HALF * height, ZERO, ZERO, ZERO
    for k in range(rows.shape[1]):
        x, y, over = rows[ROW_COLUMN, k], rows[ROW_ROW, k], rows[ROW_VALUE, k] - foot
        one = ONE if (over > ZERO) & (x * x + y * y < near) else ZERO
        wide += one
        narrow += one if over > half else ZERO
        light += one * over
        right += one * over * x
        down += one * over * y
    if light > 0.0:
        start[PAR_X], start[PAR_Y] = right / light, down / light
    if 4.0 <= narrow < wide:
        # areas go with the square of radii
        guess = math.log(2.0 * math.log(3.0) / math.log(wide / narrow)) - BLUR_BIAS
        start[PAR_STEEPNESS] = min(max(guess, MIN_LOG_STEEPNESS), MAX_LOG_STEEPNESS)
