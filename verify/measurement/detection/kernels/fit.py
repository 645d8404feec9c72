"""Fit spots to patches of pixels; guess where each fit starts.

With r a patch's residuals and D their derivatives by the parameters p, both over the pixels'
sigmas (`weigh_pixels`), and W the inverse variances of a prior m, each step solves

    (D' D + W + damping) dp = D' r + W (m - p)

It is most of what a pair costs.
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled, compiled_sums
from verify.core.kernels.linear_algebra import copy_to, factor, select, solve
from verify.core.records import Array
from verify.measurement.detection.kernels.pixels import (
    N_PARAMETERS,
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
    ROW_CORE,
    ROW_MEAN,
    ROW_RADIUS2,
    ROW_RESIDUAL,
    ROW_VARIANCE,
    ROW_VISIBLE,
    ROW_WHITENED,
    SENSOR_LIMIT,
    weigh_pixels,
)

FIRST_DAMPING = 1e-4
MIN_INFORMATION = 1e-9  # information in every direction: of a patch none of whose pixels counts
CORE_RADIUS = 1.5  # half-widths: the spot's own pixels, by which its fit is judged
MIN_CORE_RADIUS = 3.0  # px, of the smallest: 28 pixels against 8 parameters
MIN_NOISE_SHARE = 0.9  # share of a pixel's noise that clipping must leave for its residual to count
NEAR_LIMIT = 3.0  # DN below the limit: a top so near it is cut off, and higher than it seems
PEAK_FACTOR_CLIPPED, PEAK_FACTOR = 1.3, 1.05  # peak over the core's mean: cut off, and whole
MAX_SLOPE = 30.0  # DN about the floor: a neighbour is no slope
MIN_LOG_STEEPNESS, MAX_LOG_STEEPNESS = 0.3, 2.5  # logarithms: no guess of a steepness is beyond
BLUR_BIAS = 0.1  # logarithm, by which counted pixels look steeper than the spot
HALO_DN = 0.7  # DN, of a spot's light in the pixels that its floor is guessed from
MAX_BLACK_SHARE = 0.98  # of pixels: with more, a floor below black cannot be guessed
LOGISTIC_SCALE = 1.702  # scale on which a logistic law is a normal one, to 0.01 (Camilli, 1994)


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
    products = np.empty((ROW_WHITENED, ROW_WHITENED))
    sum_products(rows, products)
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
def limit_step(step: NDArray[np.floating], p: Array) -> bool:
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
        step /= ratio
    return bool(ratio > 1.0)


@compiled
def update_means(step: Array, rows: Array, model: Array) -> None:
    """Let the means of the pixels that count follow a small step (10,), to first order."""
    moved = np.zeros(rows.shape[1])
    for a in range(N_PARAMETERS):
        for k in range(rows.shape[1]):
            moved[k] += step[a] * rows[a, k]
    for k in range(rows.shape[1]):
        model[ROW_MEAN, k] += moved[k] * math.sqrt(model[ROW_VARIANCE, k])


@compiled
def mark_core(p: Array, pixels: Array, model: Array) -> None:
    """Mark the pixels that are the spot's own: its core, and for the smallest a few about it."""
    for k in range(pixels.shape[1]):
        x, y = pixels[2, k] - p[PAR_X], pixels[3, k] - p[PAR_Y]
        near = model[ROW_RADIUS2, k] < CORE_RADIUS**2 or x * x + y * y < MIN_CORE_RADIUS**2
        model[ROW_CORE, k] = pixels[1, k] if near else 0.0


@compiled_sums
def chi_squared(p: Array, pixels: Array, model: Array, variance: Array, prior: Array) -> float:
    """Chi² of a patch at p under given variances (p,): `model` gives the means alone."""
    total = 0.0
    for k in range(pixels.shape[1]):
        residual = pixels[0, k] - model[ROW_MEAN, k]
        square = residual * residual / variance[k]
        outside = model[ROW_RADIUS2, k] > NEIGHBOUR_RADIUS**2 and square > OUTLIER_SIGMA**2
        total += pixels[1, k] * (OUTLIER_SIGMA**2 if outside else square)
    for a in range(N_PARAMETERS):
        off = prior[0, a] - p[a]
        total += prior[1, a] * off * off
    return total


@compiled
def fit_patches(
    p: Array,
    pixels: Array,
    scale: Array,
    shares: tuple[Array, Array],
    noise: tuple[float, float, float],
    table: Array,
    prior: tuple[Array, Array],
    limits: tuple[int, float],
    state: tuple[Array, Array, Array, Array, Array],
) -> None:
    """Fit n patches by Gauss-Newton with Levenberg's damping, each until it settles.

    p (n, 10): start; afterwards the best. `pixels` (n, 4, p), as for `weigh_pixels`; `scale` (n,),
    px. `shares` (n,) and (n,): by which patches' read variance and gain are those of one channel.
    `noise`: read variance, gain and black of one channel. `table`: of the profiles. `prior` (n, 10)
    and (n, 10): mean and inverse variance. `limits`: steps at most, 0 weighs the pixels at p; of
    chi² that a step may still gain: it is taken, and the pixels are not weighed again.

    `state`, filled: `model` and `rows` as by `weigh_pixels`, where the last step but such a one
    ended, the means alone where that one does; information (n, 10, 10), gradient (n, 10) and chi²
    (n,).
    """
    tried_information = np.empty((N_PARAMETERS, N_PARAMETERS))
    root, tried_gradient = np.empty_like(tried_information), np.empty(N_PARAMETERS)
    step = np.empty(N_PARAMETERS)
    own, held = np.empty(3), np.empty((2, N_PARAMETERS))
    for n in range(len(p)):
        best, patch, model, rows = p[n], pixels[n], state[0][n], state[1][n]
        information, gradient = state[2][n], state[3][n]
        own[0], own[1], own[2] = shares[0][n] * noise[0], shares[1][n] * noise[1], noise[2]
        copy_to(held[0], prior[0][n])
        copy_to(held[1], prior[1][n])
        out = weigh_pixels(best, patch, scale[n], own, table, model, rows)
        chi2 = normal_equations(best, rows, out, held, information, gradient)
        variance, accepted = model[ROW_VARIANCE].copy(), chi2
        damping, refused = FIRST_DAMPING, False
        for _ in range(limits[0]):
            damped = information.copy()
            for a in range(N_PARAMETERS):
                damped[a, a] = damped[a, a] * (1.0 + damping) + MIN_INFORMATION
            factor(damped, 0.0, root)
            copy_to(step, gradient)
            solve(root, step)
            shortened = limit_step(step, best)
            gained = float(step @ gradient)  # what the step takes from chi²
            if gained <= limits[1] * (1.0 + chi2 / pixels.shape[2]) and not shortened:
                best += step
                chi2 -= gained
                update_means(step, rows, model)
                break
            tried = best + step
            out = weigh_pixels(tried, patch, scale[n], own, table, model, rows)
            trial = normal_equations(tried, rows, out, held, tried_information, tried_gradient)
            # The weights move with the model, and chi² with them: a step is judged by those that
            # it was found with.
            refused = not chi_squared(tried, patch, model, variance, held) <= 1.1 * accepted + 1.0
            if refused:
                damping *= 30.0
                continue
            copy_to(best, tried)
            chi2, accepted, damping = trial, trial, damping / 10.0
            for a in range(N_PARAMETERS):
                copy_to(information[a], tried_information[a])
            copy_to(gradient, tried_gradient)
            copy_to(variance, model[ROW_VARIANCE])
        if refused:
            weigh_pixels(best, patch, scale[n], own, table, model, rows)
        mark_core(best, patch, model)
        state[4][n] = chi2


@compiled
def core_counts(pixels: Array, model: Array) -> Array:
    """Count what judges n spots by their own pixels, (n, 4).

    Pixels that clipping leaves alone; their squared residuals over the variance, summed; the
    same in DN²; and how many of all are at the sensor's limit.
    """
    counts = np.zeros((len(pixels), 4))
    for n in range(len(pixels)):
        for k in range(pixels.shape[2]):
            if model[n, ROW_CORE, k] == 0.0:
                continue
            counts[n, 3] += pixels[n, 0, k] >= SENSOR_LIMIT
            if model[n, ROW_VISIBLE, k] > MIN_NOISE_SHARE:
                square = (pixels[n, 0, k] - model[n, ROW_MEAN, k]) ** 2
                counts[n, 0] += 1.0
                counts[n, 1] += square / model[n, ROW_VARIANCE, k]
                counts[n, 2] += square
    return counts


@compiled
def priors_from_pixels(
    pixels: Array, scale: Array, read: float, usual: tuple[Array, Array]
) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Say what is expected of each spot's parameters, and where its fit may start.

    `pixels` (n, 4, p): value, 1 where valid, column, row; `scale` (n,), px, half-width that the fit
    starts from; `read`, DN, standard deviation of a dark pixel; `usual` (10,) and (10,), mean and
    inverse variance of any spot's parameters. Gives mean and inverse variance of these ones',
    start, (n, 10) each; whether pixels on the spot are at the sensor's limit, (n,).
    """
    shape = len(pixels), N_PARAMETERS
    mean, weight, start = np.empty(shape), np.empty(shape), np.empty(shape)
    full = np.empty(len(pixels), np.bool_)
    for n in range(len(pixels)):
        value, valid, column, row = pixels[n, 0], pixels[n, 1], pixels[n, 2], pixels[n, 3]
        copy_to(mean[n], usual[0])
        copy_to(weight[n], usual[1])
        copy_to(start[n], usual[0])
        floor = select(value, len(value) * 3 // 10)
        top = floor_priors(value, valid, column, row, scale[n], floor, weight[n])
        mean[n, PAR_FLOOR] = floor
        mean[n, PAR_PEAK] = (
            PEAK_FACTOR_CLIPPED if top > SENSOR_LIMIT - NEAR_LIMIT else PEAK_FACTOR
        ) * max(top - floor, 1.0)
        full[n] = False
        for k in range(len(value)):
            if value[k] >= SENSOR_LIMIT:
                near = column[k] * column[k] + row[k] * row[k] <= scale[n] * scale[n]
                full[n] = full[n] or near
        start[n, PAR_PEAK], start[n, PAR_FLOOR] = mean[n, PAR_PEAK], floor
        if not full[n]:  # a cut-off top shows nothing of its sides
            start[n, PAR_FLOOR] = (
                floor if floor > 0.0 else floor_below_black(value, read)
            ) - HALO_DN
            start[n, PAR_PEAK] = top - start[n, PAR_FLOOR]
            start_values(value, column, row, scale[n], floor, top, start[n])
    return mean, weight, start, full


@compiled
def floor_priors(
    value: Array, valid: Array, column: Array, row: Array, scale: float, floor: float, weight: Array
) -> float:
    """Hold the slopes (10,) as firmly as the pixels about the spot have none; give its top, DN."""
    core, ring = (0.5 * scale + 0.5) ** 2, (2.3 * scale + 1.0) ** 2
    total, count = 0.0, 0.0
    lean_x, lean_y, lever_x, lever_y = 0.0, 0.0, 0.0, 0.0
    for k in range(len(value)):
        if valid[k] <= 0.0:
            continue
        x, y = column[k], row[k]
        distance2 = x * x + y * y
        if distance2 <= core:
            total += value[k]
            count += 1.0
        elif distance2 > ring:
            excess = min(max(value[k] - floor, -MAX_SLOPE), MAX_SLOPE)
            lean_x += excess * x
            lean_y += excess * y
            lever_x += x * x
            lever_y += y * y
    # A slope costs the centre information, so it is let in as far as the surroundings have one.
    weight[PAR_SLOPE_X] = 1.0 / ((lean_x / max(lever_x, 1.0)) ** 2 + 1e-8)
    weight[PAR_SLOPE_Y] = 1.0 / ((lean_y / max(lever_y, 1.0)) ** 2 + 1e-8)
    return float(total / max(count, 1.0))


@compiled
def floor_below_black(value: Array, read: float) -> float:
    """Guess the floor where black cuts it off, from how many pixels are black."""
    black = 0.0
    for k in range(len(value)):
        black += value[k] < 0.5
    share = min(black / len(value), MAX_BLACK_SHARE)
    return 0.5 - read * math.log(share / (1.0 - share)) / LOGISTIC_SCALE


@compiled
def start_values(
    value: Array, column: Array, row: Array, scale: float, floor: float, top: float, start: Array
) -> None:
    """Guess a spot's place from its pixels over 1/4 of its height, its steepness from how many.

    `value` (p,), `floor` and `top`, DN; `column` and `row` (p,), px; `scale`, px, half-width that
    the fit starts from; `start` (10,), changed where the pixels show it.
    """
    height, wide, narrow = top - floor, 0.0, 0.0
    light, right, down = 0.0, 0.0, 0.0
    near = (2.2 * scale) ** 2
    for k in range(len(value)):
        over = value[k] - floor - 0.25 * height
        if over > 0.0 and column[k] * column[k] + row[k] * row[k] < near:
            wide += 1.0
            narrow += over > 0.5 * height
            light += over
            right += over * column[k]
            down += over * row[k]
    if light > 0.0:
        start[PAR_X], start[PAR_Y] = right / light, down / light
    if 4.0 <= narrow < wide:
        # areas go with the square of radii
        guess = math.log(2.0 * math.log(3.0) / math.log(wide / narrow)) - BLUR_BIAS
        start[PAR_STEEPNESS] = min(max(guess, MIN_LOG_STEEPNESS), MAX_LOG_STEEPNESS)
