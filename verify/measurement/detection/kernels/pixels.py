"""Expect the pixels of a patch from a spot's parameters, and weigh them by their noise.

A pixel at (u, w) half-widths from the centre, t² = xx u² + 2 xy u w + yy w², has before clipping

    mean mu = floor + slope . d + peak f(t),  variance = read + gain max(mu - black, 0)

and after clipping at 0 or 255 the mean and variance of the clipped normal law, in closed form.
Each loop has one statement, so that the processor takes several pixels at once, and single
precision, of which it takes twice as many. All that is known of a spot's p pixels is in one array
(25, p): derivatives, residuals, what was read, the model.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from verify.core.jit import compiled, compiled_sums
from verify.core.records import Array
from verify.measurement.detection.profile import (
    MAX_RADIUS,
    MIN_LOG_STEEPNESS,
    RADIUS_STEP,
    ROW_STEP,
)

Real = np.float32  # of pixels; of all constants beside them too, or sums are of double precision
Pixels = NDArray[np.float32]
ZERO, HALF, ONE = Real(0.0), Real(0.5), Real(1.0)
PAR_X, PAR_Y, PAR_PEAK, PAR_FLOOR, PAR_SLOPE_X, PAR_SLOPE_Y = range(6)
PAR_XX, PAR_XY, PAR_YY, PAR_STEEPNESS = range(6, 10)
N_PARAMETERS = 10
ROW_RESIDUAL = N_PARAMETERS  # the row behind the derivatives by the parameters
N_WHITENED = N_PARAMETERS + 1  # rows over each pixel's sigma
LATE_ROWS = slice(PAR_FLOOR, PAR_STEEPNESS)  # free until the pixels are weighed
# value, DN; 1 where inside the image and not clipped in part; px from the patch's centre pixel
ROW_VALUE, ROW_VALID, ROW_COLUMN, ROW_ROW = range(11, 15)
# the model of each pixel, by the parameters
ROW_MEAN, ROW_VARIANCE, ROW_SIGNAL, ROW_USED, ROW_VISIBLE = range(15, 20)
ROW_U, ROW_W, ROW_RADIUS2, ROW_SLOPE, ROW_CORE = range(20, 25)
N_ROWS = 25
NEIGHBOUR_RADIUS = Real(1.7)  # half-widths; beyond, what does not fit is a neighbour, left out
OUTLIER_SIGMA = Real(5.0)  # sigma, of a pixel there
SENSOR_LIMIT = Real(255.0)  # DN
QUANTISATION = 1 / 12  # DN², the least variance that whole numbers have
LEAST_VARIANCE = Real(QUANTISATION)
CLIP_REACH = Real(4.5)  # sigma from a limit within which clipping is computed
MIN_Z = Real(-9.0)  # sigma: below, a clipped pixel shows nothing
STEPS_PER_UNIT = Real(256.0)  # entries of a table of the normal law
STEP = Real(1 / 256)
SIXTH = Real(1 / 6)
SAMPLES_PER_RADIUS = Real(1.0 / RADIUS_STEP)
SAMPLE_STEP = Real(RADIUS_STEP)
LAST_RADIUS = Real(MAX_RADIUS)
LAST_STEP = Real(2 * MAX_RADIUS * RADIUS_STEP)  # in square radius
N_FREE_ROWS = 6  # rows that are written over
_NODES = np.arange(-9.0, 4.5 + 1.5 / 256, 1 / 256)
NORMAL = np.column_stack([ndtr(_NODES), np.exp(-_NODES * _NODES / 2.0) / math.sqrt(2.0 * math.pi)])


@compiled
def clip(mean: Pixels, variance: Pixels, visible: Pixels, free: Pixels) -> None:
    """Clip normal variables to the sensor's range.

    `mean` (p,), mu, DN, and `variance` (p,), DN², are those of the clipped variables afterwards;
    `visible` (p,) is filled with d mean / d mu; `free` (6, p) is written over.
    """
    room, count, near = free[0], len(mean), 0
    for k in range(count):  # the farther limit is always out of reach
        room[k] = min(SENSOR_LIMIT - mean[k], mean[k])
    for k in range(count):
        near += (room[k] < ZERO) | (room[k] * room[k] < CLIP_REACH * CLIP_REACH * variance[k])
    for k in range(count):
        visible[k] = ONE
    if near == 0:
        return
    sigma, z, inside, density, excess = free[1], free[2], free[3], free[4], free[5]
    for k in range(count):
        sigma[k] = math.sqrt(variance[k])
    for k in range(count):
        z[k] = min(max(room[k] / sigma[k], MIN_Z), CLIP_REACH)
    normal_law(z, inside, density)
    for k in range(count):
        excess[k] = room[k] * inside[k] + density[k] * sigma[k]
    for k in range(count):
        # E[u²] less E[u]², u the clipped room. No less than rounding: a deviation there is the
        # model's, not the noise's.
        clipped = max(variance[k] * inside[k] + excess[k] * (room[k] - excess[k]), LEAST_VARIANCE)
        variance[k] = clipped if z[k] < CLIP_REACH else variance[k]
    for k in range(count):
        clipped = SENSOR_LIMIT - excess[k] if SENSOR_LIMIT - mean[k] < mean[k] else excess[k]
        mean[k] = clipped if z[k] < CLIP_REACH else mean[k]
    for k in range(count):
        visible[k] = inside[k] if z[k] < CLIP_REACH else ONE


@compiled
def normal_law(z: Pixels, below: Pixels, density: Pixels) -> None:
    """Share of a standard normal variable below each z (p,), and its density there, to 1e-9.

    A Taylor series about the next entry of a table.
    """
    entry = np.empty(len(z), np.int32)
    for k in range(len(z)):
        entry[k] = np.int32((z[k] - MIN_Z) * STEPS_PER_UNIT + HALF)
    for k in range(len(z)):
        below[k], density[k] = NORMAL[entry[k], 0], NORMAL[entry[k], 1]
    for k in range(len(z)):
        node = Real(entry[k]) * STEP + MIN_Z
        off, here = z[k] - node, density[k]
        curved = off * (node * node - ONE)
        density[k] = here * (ONE + off * (HALF * curved - node))
        below[k] += here * off * (ONE + off * (curved * SIXTH - HALF * node))


@compiled
def expect_pixels(p: Array, noise: Array, rows: Pixels) -> None:
    """Expect each pixel's mean and variance, as the sensor would clip it."""
    read, gain, black, peak = Real(noise[0]), Real(noise[1]), Real(noise[2]), Real(p[PAR_PEAK])
    floor, slope_x, slope_y = Real(p[PAR_FLOOR]), Real(p[PAR_SLOPE_X]), Real(p[PAR_SLOPE_Y])
    count = rows.shape[1]
    for k in range(count):
        plane = floor + slope_x * rows[ROW_COLUMN, k] + slope_y * rows[ROW_ROW, k]
        rows[ROW_MEAN, k] = plane + peak * rows[PAR_PEAK, k]
    for k in range(count):
        signal = max(rows[ROW_MEAN, k] - black, ZERO)
        rows[ROW_SIGNAL, k], rows[ROW_VARIANCE, k] = signal, read + gain * signal
    for k in range(count):
        rows[ROW_RESIDUAL, k] = rows[ROW_VARIANCE, k]
    clip(rows[ROW_MEAN], rows[ROW_VARIANCE], rows[ROW_VISIBLE], rows[LATE_ROWS])


@compiled
def whiten_rows(p: Array, scale: float, rows: Pixels) -> float:
    """Leave out neighbours' pixels, and put every row over its pixels' sigmas.

    On entry `rows` hold, beside the profile's derivatives, the unclipped variances. Gives how many
    valid pixels are left out.
    """
    peak, lever, count = Real(p[PAR_PEAK]), Real(-2.0 * p[PAR_PEAK] / scale), rows.shape[1]
    steep = Real(p[PAR_PEAK] / ROW_STEP)
    for k in range(count):
        residual = rows[ROW_VALUE, k] - rows[ROW_MEAN, k]
        far = residual * residual > OUTLIER_SIGMA * OUTLIER_SIGMA * rows[ROW_RESIDUAL, k]
        outer = rows[ROW_RADIUS2, k] > NEIGHBOUR_RADIUS * NEIGHBOUR_RADIUS
        rows[ROW_USED, k] = ZERO if far & outer else rows[ROW_VALID, k]
    for k in range(count):
        rows[ROW_RESIDUAL, k] = rows[ROW_USED, k] * math.sqrt(ONE / rows[ROW_VARIANCE, k])
    for k in range(count):
        rows[PAR_FLOOR, k] = rows[ROW_RESIDUAL, k] * rows[ROW_VISIBLE, k]
    for k in range(count):
        rows[ROW_RESIDUAL, k] *= rows[ROW_VALUE, k] - rows[ROW_MEAN, k]
    for k in range(count):
        rows[PAR_YY, k] = rows[PAR_FLOOR, k] * rows[ROW_SLOPE, k]
    for k in range(count):
        rows[PAR_X, k], rows[PAR_Y, k] = (
            lever * rows[PAR_YY, k] * rows[PAR_X, k],
            lever * rows[PAR_YY, k] * rows[PAR_Y, k],
        )
    for k in range(count):
        rows[PAR_PEAK, k] *= rows[PAR_FLOOR, k]
    for k in range(count):
        rows[PAR_STEEPNESS, k] = steep * rows[PAR_FLOOR, k] * rows[PAR_STEEPNESS, k]
    for k in range(count):
        rows[PAR_SLOPE_X, k] = rows[PAR_FLOOR, k] * rows[ROW_COLUMN, k]
    for k in range(count):
        rows[PAR_SLOPE_Y, k] = rows[PAR_FLOOR, k] * rows[ROW_ROW, k]
    for k in range(count):
        rows[PAR_YY, k] *= peak
    for k in range(count):
        rows[PAR_XX, k] = rows[PAR_YY, k] * rows[ROW_U, k] * rows[ROW_U, k]
    for k in range(count):
        rows[PAR_XY, k] = (rows[PAR_YY, k] + rows[PAR_YY, k]) * rows[ROW_U, k] * rows[ROW_W, k]
    for k in range(count):
        rows[PAR_YY, k] *= rows[ROW_W, k] * rows[ROW_W, k]
    return count_rejected(rows)


@compiled_sums
def count_rejected(rows: Pixels) -> float:
    """How many valid pixels do not count."""
    total = ZERO
    for k in range(rows.shape[1]):
        total += rows[ROW_VALID, k] - rows[ROW_USED, k]
    return float(total)


@compiled
def weigh_pixels(p: Array, scale: float, noise: Array, table: Pixels, rows: Pixels) -> float:
    """Place one patch's pixels on the spot that p (10,) describes, and weigh them.

    `scale`, px, half-width that the fit starts from; `noise` (3,): read variance, gain, black;
    `table` (rows, samples, 4), of the profiles; `rows` (25, p): derivatives and residual, over each
    pixel's sigma, and the model but for ROW_CORE are filled in. Gives what the pixels that are left
    out add to chi².
    """
    x, y, inverse, count = Real(p[PAR_X]), Real(p[PAR_Y]), Real(1.0 / scale), rows.shape[1]
    xx, xy, yy = Real(p[PAR_XX]), Real(p[PAR_XY]), Real(p[PAR_YY])
    for k in range(count):
        rows[ROW_U, k] = (rows[ROW_COLUMN, k] - x) * inverse
        rows[ROW_W, k] = (rows[ROW_ROW, k] - y) * inverse
    for k in range(count):
        u, w = rows[ROW_U, k], rows[ROW_W, k]
        rows[PAR_X, k], rows[PAR_Y, k] = xx * u + xy * w, xy * u + yy * w
    for k in range(count):
        radius2 = rows[PAR_X, k] * rows[ROW_U, k] + rows[PAR_Y, k] * rows[ROW_W, k]
        rows[ROW_RADIUS2, k] = radius2 if radius2 > ZERO else ZERO
    # f, df / d(t²) and df / d(ln steepness) from the table, to first order in t²
    place = (p[PAR_STEEPNESS] - MIN_LOG_STEEPNESS) / ROW_STEP
    place = min(max(place, 0.0), table.shape[0] - 1.001)
    line, last, sample = int(place), np.int32(table.shape[1] - 1), np.empty(count, np.int32)
    share = Real(place - line)
    for k in range(count):
        radius = math.sqrt(rows[ROW_RADIUS2, k])
        # the last sample also where the radius is no number
        near = np.int32(radius * SAMPLES_PER_RADIUS + HALF)
        sample[k] = near if radius < LAST_RADIUS else last
    for k in range(count):
        one = table[line, sample[k]]
        rows[PAR_PEAK, k], rows[ROW_SLOPE, k] = one[0] + share * one[1], one[2] + share * one[3]
        rows[PAR_STEEPNESS, k] = one[1]
    for k in range(count):
        # past the table the profile stays constant
        at = Real(sample[k]) * SAMPLE_STEP
        beyond = min(rows[ROW_RADIUS2, k] - at * at, LAST_STEP)
        rows[PAR_PEAK, k] += rows[ROW_SLOPE, k] * beyond
    expect_pixels(p, noise, rows)
    return float(OUTLIER_SIGMA * OUTLIER_SIGMA) * whiten_rows(p, scale, rows)
