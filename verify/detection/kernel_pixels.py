"""What is expected of a patch's pixels at a spot's parameters, and what they weigh, compiled.

The arithmetic of model.py. One loop does one thing, for then the processor takes several pixels at
once.
"""

import math

from verify.compiled import compiled, compiled_sums
from verify.detection.kernel_clip import clip
from verify.detection.profile import LAST, LOWEST, ROW_STEP, STEP
from verify.records import Array

X, Y, PEAK, FLOOR, SLOPE_X, SLOPE_Y, XX, XY, YY, STEEPNESS = range(10)
PARAMETERS = 10
RESIDUAL = PARAMETERS  # the row behind the derivatives
WHITENED = PARAMETERS + 1
LATE = slice(FLOOR, STEEPNESS)  # rows of derivatives that are free until the pixels are weighed
# what is known of each pixel, in the order of a state's rows
MEAN, VARIANCE, SIGNAL, USED, VISIBLE, U, W, RADIUS2, SLOPE, OWN = range(10)
KNOWN = 10
FOOT = 1.7  # half-widths; beyond, what does not fit is a neighbour and is left out
OUTLIER = 5.0  # sigma, likewise


@compiled
def place(p: Array, pixels: Array, scale: float, known: Array, rows: Array) -> None:
    """Place a patch's pixels on the spot: u, w, t² and, in rows that are free still, t and lean."""
    x, y, xx, xy, yy = p[X], p[Y], p[XX], p[XY], p[YY]
    inverse, count = 1.0 / scale, pixels.shape[1]
    for k in range(count):
        known[U, k], known[W, k] = (pixels[2, k] - x) * inverse, (pixels[3, k] - y) * inverse
    for k in range(count):
        u, w = known[U, k], known[W, k]
        rows[X, k], rows[Y, k] = xx * u + xy * w, xy * u + yy * w
    for k in range(count):
        radius2 = rows[X, k] * known[U, k] + rows[Y, k] * known[W, k]
        known[RADIUS2, k] = radius2 if radius2 > 0.0 else 0.0
    for k in range(count):
        rows[RESIDUAL, k] = math.sqrt(known[RADIUS2, k])


@compiled
def look_up(log_steepness: float, table: Array, known: Array, rows: Array) -> None:
    """Look f, df / d(t²) and df / d(ln steepness) up, first order in t², at the pixels' t."""
    samples = table.shape[2]
    found = min(max((log_steepness - LOWEST) / ROW_STEP, 0.0), table.shape[1] - 1.001)
    line = int(found)
    share = found - line
    for k in range(rows.shape[1]):
        radius = rows[RESIDUAL, k]
        # the last sample also where the radius is no number
        index = int(radius * (1.0 / STEP) + 0.5) if radius < LAST else samples - 1
        sample = index * STEP
        # past the table the profile stands
        beyond = min(known[RADIUS2, k] - sample * sample, 2 * LAST * STEP)
        step = table[1, line, index]
        slope = table[2, line, index] + share * table[3, line, index]
        known[SLOPE, k], rows[STEEPNESS, k] = slope, step * (1.0 / ROW_STEP)
        rows[PEAK, k] = table[0, line, index] + share * step + slope * beyond


@compiled
def expect(p: Array, pixels: Array, noise: Array, known: Array, rows: Array) -> None:
    """Expect each pixel's mean and variance, as the sensor would clip it."""
    read, gain, black = noise[0], noise[1], noise[2]
    peak, floor, slope_x, slope_y = p[PEAK], p[FLOOR], p[SLOPE_X], p[SLOPE_Y]
    count = pixels.shape[1]
    for k in range(count):
        known[MEAN, k] = (
            floor + slope_x * pixels[2, k] + slope_y * pixels[3, k] + peak * rows[PEAK, k]
        )
    for k in range(count):
        signal = known[MEAN, k] - black
        signal = signal if signal > 0.0 else 0.0
        known[SIGNAL, k], known[VARIANCE, k] = signal, read + gain * signal
    rows[RESIDUAL] = known[VARIANCE]
    clip(known[MEAN], known[VARIANCE], known[VISIBLE], rows[LATE])


@compiled
def whiten(p: Array, pixels: Array, scale: float, known: Array, rows: Array) -> float:
    """Leave out what does not fit, and put every row over its pixels' sigmas.

    Returns:
        How many valid pixels are left out.
    """
    peak, lever, count = p[PEAK], -2.0 * p[PEAK] / scale, pixels.shape[1]
    leave_out(pixels, known, rows)
    for k in range(count):
        rows[RESIDUAL, k] = known[USED, k] * math.sqrt(1.0 / known[VARIANCE, k])
    for k in range(count):
        rows[FLOOR, k] = rows[RESIDUAL, k] * known[VISIBLE, k]
    for k in range(count):
        rows[RESIDUAL, k] *= pixels[0, k] - known[MEAN, k]
    for k in range(count):
        rows[YY, k] = rows[FLOOR, k] * known[SLOPE, k]
    for k in range(count):
        rows[X, k], rows[Y, k] = lever * rows[YY, k] * rows[X, k], lever * rows[YY, k] * rows[Y, k]
    for k in range(count):
        rows[PEAK, k] *= rows[FLOOR, k]
    for k in range(count):
        rows[STEEPNESS, k] = peak * rows[FLOOR, k] * rows[STEEPNESS, k]
    for k in range(count):
        rows[SLOPE_X, k] = rows[FLOOR, k] * pixels[2, k]
    for k in range(count):
        rows[SLOPE_Y, k] = rows[FLOOR, k] * pixels[3, k]
    for k in range(count):
        rows[YY, k] *= peak
    for k in range(count):
        rows[XX, k] = rows[YY, k] * known[U, k] * known[U, k]
    for k in range(count):
        rows[XY, k] = 2.0 * rows[YY, k] * known[U, k] * known[W, k]
    for k in range(count):
        rows[YY, k] *= known[W, k] * known[W, k]
    return left_out(pixels, known)


@compiled
def leave_out(pixels: Array, known: Array, rows: Array) -> None:
    """Mark the pixels that count: valid, and not a neighbour's; `rows` hold their variances."""
    for k in range(pixels.shape[1]):
        residual = pixels[0, k] - known[MEAN, k]
        far, foot = residual * residual > OUTLIER**2 * rows[RESIDUAL, k], known[RADIUS2, k]
        known[USED, k] = pixels[1, k] * (0.0 if far & (foot > FOOT**2) else 1.0)


@compiled_sums
def left_out(pixels: Array, known: Array) -> float:
    """How many valid pixels do not count."""
    total = 0.0
    for k in range(pixels.shape[1]):
        total += pixels[1, k] - known[USED, k]
    return total


@compiled
def weigh(
    p: Array, pixels: Array, scale: float, noise: Array, table: Array, known: Array, rows: Array
) -> float:
    """Place one patch's pixels on the spot that p (10,) describes, and weigh them.

    Args:
        p: the parameters.
        pixels: (4, p): value, 1 where valid, column, row.
        scale: px, half-width that the fit starts from.
        noise: (3,): read variance, gain, black.
        table: (4, rows, samples), of the profiles.
        known: (10, p), filled but for OWN.
        rows: (11, p), filled: derivatives and residual, over each pixel's sigma.

    Returns:
        What the pixels that are left out add to chi².
    """
    place(p, pixels, scale, known, rows)
    look_up(p[STEEPNESS], table, known, rows)
    expect(p, pixels, noise, known, rows)
    return OUTLIER**2 * whiten(p, pixels, scale, known, rows)
