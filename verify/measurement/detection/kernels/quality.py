"""Judge fitted spots: centre and covariance, diameter, whether a spot has the shape of one LED.

With misfit m the residuals' mean square over their variance, the covariance is enlarged

    by 1 + c max(m - 1 - MAX_CHI2_SIGMA sqrt(2 / freedom), 0),  of merged spots by c m,
       and STRETCH_SHARE stretch x diameter added (`doubt_shapes`)

with c = CORRELATED_PIXELS; in a JPEG, where the misfit of clean spots has the median M, by

    s M (1 + c max(m / M - MAX_LOSSY_MISFIT, 0)),  s = LOSSY_SHARE

Quantisation wipes out fine detail and so adds errors that are mostly even about a spot, or finer
than what a shift of its centre changes. s is measured: simulated spots of 4 to 14 px, quality 60 to
98, where ± 1.96 u so holds 94 to 97 %.
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled
from verify.core.kernels.linear_algebra import factor, solve
from verify.core.records import Array
from verify.measurement.detection.kernels.fit import MIN_INFORMATION, core_counts
from verify.measurement.detection.kernels.pixels import (
    N_PARAMETERS,
    PAR_PEAK,
    PAR_X,
    PAR_XX,
    PAR_XY,
    PAR_Y,
    PAR_YY,
    SENSOR_LIMIT,
)

Flags = NDArray[np.bool_]

# parameters that a spot's own pixels pay for; the slopes live on the surroundings. With few pixels
# left, of a spot far over the limit, its foot pays for them
N_FITTED = 8.0
MAX_REDUCED_CHI2 = 6.0  # reduced chi² of a shape that no clean LED has
MAX_RESIDUAL_RATIO = 0.035  # rms residual over peak; both must hold: a bright LED shows any flaw
MIN_PEAK = 8.0  # sigma of the peak: chance does not reach it in a picture
MAX_SHIFT = 1.5  # half-widths: a fit that left its candidate has found something else
MAX_AXIS_RATIO = 2.0  # axis ratio of the fitted profile; a blurred LED stays below, streaks do not
# A shape that the profiles lack (a stalk before the LED, a reflection beside it) leaves errors
# larger than noise, in neighbouring pixels alike: the covariance covers them too. What is left of a
# clipped spot is too little to judge its shape by.
MAX_CHI2_SIGMA = 3.0  # standard deviations of a reduced chi² that noise alone reaches
LOSSY_SHARE = 0.8  # of a JPEG's squared errors, which move a centre
MIN_LOSSY_MISFIT = 0.5  # noise is not estimated twice too large
MAX_LOSSY_MISFIT = 3.0  # times the usual: more is a shape, not quantisation
CORRELATED_PIXELS = 20.0  # pixels that a wrong shape lifts together, so that they do not average
# Light beside an LED, or an edge before it, stretches it alone, and motion all. Flat LEDs seen from
# aside differ too, each by its angle, but are no longer than others, and nearly fit.
MIN_ALIKE = 3  # spots: fewer do not show what is usual
MAX_STRETCH = 0.05  # diameters
MAX_LENGTH, MAX_SURE_LENGTH = 1.2, 1.04  # of the longest width, over the usual one: alone; misfit
MAX_LONGER_SIGMA = 2.0  # standard deviations of that misfit
MAX_STRETCHED_MISFIT = 3.5  # of a shape that is not longer, over the usual one
# Two equal lights d apart add d²/4 to the second moment along their line, and their middle is d/2
# off: the widths give that as 0.36 stretch x diameter of Gaussians, 0.13 of discs; half an axis.
STRETCH_SHARE = 0.15
MIN_BORDER = 1.2  # half-widths that must be inside the image
MIN_SEPARATION = 0.5  # diameters of the smaller one: closer spots are one spot found twice

# columns of an assessed spot: centre (px), covariance (px²), peak (DN), full width at half height
# (px), axis ratio, reduced chi²; flags (0 or 1): pixels at the sensor's limit, no single LED's
# shape, a spot at all; how many of its own pixels clipping leaves alone; by how much the longest
# width exceeds the shortest (px), times cosine and sine of twice the longest one's direction
COL_CENTRE_X, COL_CENTRE_Y = range(2)
COL_COVARIANCE_XX, COL_COVARIANCE_XY, COL_COVARIANCE_YX, COL_COVARIANCE_YY = range(2, 6)
COL_PEAK, COL_DIAMETER, COL_ELONGATION, COL_MISFIT = range(6, 10)
COL_SATURATED, COL_MERGED, COL_SOUND, COL_COUNT = range(10, 14)
COL_STRETCH_X, COL_STRETCH_Y = range(14, 16)
N_COLUMNS = 16


@compiled
def centre_covariance(information: Array, row: Array) -> None:
    """Covariance of the centre, other parameters free, px²; nan where it is not finite."""
    finite = True
    for a in range(N_PARAMETERS):
        for b in range(N_PARAMETERS):
            finite = finite and math.isfinite(information[a, b])
    row[COL_COVARIANCE_XX : COL_COVARIANCE_YY + 1] = np.nan
    if not finite:
        return
    root, column = np.empty((N_PARAMETERS, N_PARAMETERS)), np.zeros(N_PARAMETERS)
    factor(information, -MIN_INFORMATION, root)
    column[PAR_X] = 1.0
    solve(root, column)
    row[COL_COVARIANCE_XX], row[COL_COVARIANCE_XY] = column[PAR_X], column[PAR_Y]
    column[:] = 0.0
    column[PAR_Y] = 1.0
    solve(root, column)
    row[COL_COVARIANCE_YX], row[COL_COVARIANCE_YY] = row[COL_COVARIANCE_XY], column[PAR_Y]


@compiled
def assess_shape(counted: Array, peak: float, pixels: float, row: Array) -> None:
    """Say how far the shape is that of one LED, and enlarge the covariance by what it is not.

    `counted` (4,), of `core_counts`; `peak`, DN; `pixels`, that misfit beyond
    chance lifts together; `row` (16,), changed.
    """
    count, squares, square_dn, full = counted[0], counted[1], counted[2], counted[3]
    freedom = count - N_FITTED
    paid = max(freedom, 1.0)
    misfit = squares / paid if freedom >= N_FITTED else 1.0
    rough = math.sqrt(square_dn / paid)
    merged = misfit > MAX_REDUCED_CHI2 and rough > MAX_RESIDUAL_RATIO * min(peak, SENSOR_LIMIT)
    excess = max(misfit - 1.0 - MAX_CHI2_SIGMA * math.sqrt(2.0 / paid), 0.0) if full == 0.0 else 0.0
    larger = CORRELATED_PIXELS * misfit if merged else 1.0 + pixels * excess
    for k in range(COL_COVARIANCE_XX, COL_COVARIANCE_YY + 1):
        row[k] *= larger
    row[COL_MISFIT], row[COL_COUNT] = misfit, count
    row[COL_SATURATED], row[COL_MERGED] = 1.0 if full > 0.0 else 0.0, 1.0 if merged else 0.0


@compiled
def assess_all(
    parameters: Array,
    information: Array,
    pixels: Array,
    model: Array,
    scale: Array,
    origin: NDArray[np.int64],
    size: tuple[int, int],
    lifted: float,
) -> Array:
    """Assess n fits, (n, 16).

    `parameters` (n, 10); `information` (n, 10, 10); `pixels` (n, 4, p), as fitted; `model`
    (n, 10, p), of the pixels at the parameters; `scale` (n,), px; `origin` (n, 2), px, of each
    patch's centre pixel; `size`: width and height of the picture, px; `lifted`, pixels, as for
    `assess_shape`.
    """
    assessed = np.empty((len(parameters), N_COLUMNS))
    counted = core_counts(pixels, model)
    for n in range(len(parameters)):
        p, row = parameters[n], assessed[n]
        x, y = origin[n, 0] + p[PAR_X], origin[n, 1] + p[PAR_Y]
        mean = (p[PAR_XX] + p[PAR_YY]) / 2.0
        split = math.hypot((p[PAR_XX] - p[PAR_YY]) / 2.0, p[PAR_XY])
        positive = mean > split
        long = scale[n] / math.sqrt(mean - split) if positive else scale[n]
        short = scale[n] / math.sqrt(mean + split) if positive else scale[n]
        row[COL_CENTRE_X], row[COL_CENTRE_Y], row[COL_PEAK] = x, y, p[PAR_PEAK]
        row[COL_DIAMETER], row[COL_ELONGATION] = long + short, long / short
        turn = -2.0 * (long - short) / split if split > 0.0 else 0.0
        row[COL_STRETCH_X] = turn * (p[PAR_XX] - p[PAR_YY]) / 2.0
        row[COL_STRETCH_Y] = turn * p[PAR_XY]
        centre_covariance(information[n], row)
        assess_shape(counted[n], p[PAR_PEAK], lifted, row)
        rim = MIN_BORDER * long - 0.5
        inside = x > rim and y > rim and x < size[0] - 1.0 - rim and y < size[1] - 1.0 - rim
        finite = True
        for value in p:
            finite = finite and math.isfinite(value)
        sound = (
            positive
            and inside
            and finite
            and p[PAR_PEAK] * math.sqrt(information[n, PAR_PEAK, PAR_PEAK]) > MIN_PEAK
            and long < MAX_AXIS_RATIO * short
            and math.hypot(p[PAR_X], p[PAR_Y]) < MAX_SHIFT * scale[n] + 1.0
        )
        row[COL_SOUND] = 1.0 if sound else 0.0
    return assessed


def lossy_scale(assessed: Array) -> Array:
    """By how much the covariances of a JPEG's n spots (n, 16) are those of white noise, (n,)."""
    misfit, merged = assessed[:, COL_MISFIT], assessed[:, COL_MERGED] > 0
    whole = (assessed[:, COL_SATURATED] == 0) & ~merged
    usual = max(float(np.median(misfit[whole])), MIN_LOSSY_MISFIT) if whole.any() else 1.0
    odd = np.where(whole, np.maximum(misfit / usual - MAX_LOSSY_MISFIT, 0.0), 0.0)
    scale: Array = np.where(merged, 1.0, LOSSY_SHARE * usual * (1.0 + CORRELATED_PIXELS * odd))
    return scale


def doubt_shapes(assessed: Array) -> None:
    """Flag those of a picture's spots (n, 16) that are stretched alone; widen what is merged."""
    stretch, clear = assessed[:, COL_STRETCH_X:], assessed[:, COL_MERGED] == 0
    off, width = np.hypot(*stretch.T), assessed[:, COL_DIAMETER]
    stretched = off > MAX_STRETCH * width
    if np.all(clear & ~stretched):
        return
    if np.sum(clear) >= MIN_ALIKE:
        off = np.minimum(off, np.hypot(*(stretch - np.median(stretch[clear], axis=0)).T))
        misfit = assessed[:, COL_MISFIT] / max(float(np.median(assessed[clear, COL_MISFIT])), 1.0)
        chance = 1.0 + MAX_LONGER_SIGMA * np.sqrt(2.0 / np.maximum(assessed[:, COL_COUNT], 1.0))
        length = 2.0 * width / (1.0 + 1.0 / assessed[:, COL_ELONGATION])
        length /= np.median(length[clear])
        odd = (misfit > MAX_STRETCHED_MISFIT) | (length > MAX_LENGTH)
        odd |= (misfit > chance) & (length > MAX_SURE_LENGTH)
        assessed[odd & (off > MAX_STRETCH * width), COL_MERGED] = 1.0
    doubt = np.where(assessed[:, COL_MERGED] > 0, STRETCH_SHARE * off * width, 0.0)
    assessed[:, [COL_COVARIANCE_XX, COL_COVARIANCE_YY]] += doubt[:, None]


def mark_duplicates(assessed: Array) -> Flags:
    """Say which of the spots (n, 16) are another one, fitting better or equal and first, again."""
    misfit, width = assessed[:, COL_MISFIT], assessed[:, COL_DIAMETER]
    apart = assessed[:, None, : COL_CENTRE_Y + 1] - assessed[:, : COL_CENTRE_Y + 1]
    near = np.hypot(apart[..., 0], apart[..., 1]) < MIN_SEPARATION * np.minimum(
        width[:, None], width
    )
    rank = np.argsort(np.argsort(misfit, kind="stable"))
    return np.asarray((near & (rank[:, None] > rank)).any(axis=1), dtype=np.bool_)
