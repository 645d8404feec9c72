"""Say what is expected of a spot's parameters from its pixels, and where its fit starts."""

import math

import numpy as np

from verify.core.jit import compiled
from verify.core.kernels.linear_algebra import copy_to
from verify.core.records import Array
from verify.measurement.detection.kernels.patches import Fits, rows_of
from verify.measurement.detection.kernels.pixels import (
    N_PARAMETERS,
    PAR_FLOOR,
    PAR_PEAK,
    PAR_SLOPE_X,
    PAR_SLOPE_Y,
    PAR_STEEPNESS,
    PAR_X,
    PAR_XX,
    PAR_Y,
    PAR_YY,
    ROW_COLUMN,
    ROW_ROW,
    ROW_VALID,
    ROW_VALUE,
    SENSOR_LIMIT,
)

START_STEEPNESS = math.log(2.2)  # between a Gaussian (1.39) and an in-focus LED (5)
# Priors, standard deviations. All but the slopes' concern terms that are even about the centre and
# leave it alone; they only keep a dim or a fully saturated spot from drifting off.
PRIOR_STEEPNESS = 1.0
PRIOR_PEAK = 2000.0  # DN: eight times the sensor's range
PRIOR_FLOOR = 10.0  # DN: a floor below black does not show
PRIOR_SHAPE = 2.0  # of (half-width / start)^-2
NEAR_LIMIT = 3.0  # DN below the limit: a top so near it is cut off, and higher than it seems
PEAK_FACTOR_CLIPPED, PEAK_FACTOR = 1.3, 1.05  # peak over the core's mean: cut off, and whole
MAX_SLOPE = 30.0  # DN about the floor: a neighbour is no slope
MIN_LOG_STEEPNESS, MAX_LOG_STEEPNESS = 0.3, 2.5  # logarithms: no guess of a steepness is beyond
BLUR_BIAS = 0.1  # logarithm, by which counted pixels look steeper than the spot
HALO_DN = 0.7  # DN, of a spot's light in the pixels that its floor is guessed from
MAX_BLACK_SHARE = 0.98  # of pixels: with more, a floor below black cannot be guessed
LOGISTIC_SCALE = 1.702  # scale on which a logistic law is a normal one, to 0.01 (Camilli, 1994)


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
    top = floor_priors(value, rows[ROW_VALID], column, row, scale, floor, weight)
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
        start_values(value, column, row, scale, floor, top, start)


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
