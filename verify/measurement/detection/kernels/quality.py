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

from verify.core.jit import compiled, compiled_sums
from verify.core.kernels.linear_algebra import factor, median, solve
from verify.core.records import Array
from verify.measurement.detection.kernels.fit import MIN_INFORMATION
from verify.measurement.detection.kernels.patches import Fits, Index, rows_of
from verify.measurement.detection.kernels.pixels import (
    N_PARAMETERS,
    PAR_PEAK,
    PAR_X,
    PAR_XX,
    PAR_XY,
    PAR_Y,
    PAR_YY,
    ROW_CORE,
    ROW_MEAN,
    ROW_VALUE,
    ROW_VARIANCE,
    ROW_VISIBLE,
    SENSOR_LIMIT,
    ZERO,
    Pixels,
    Real,
)

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
# aside differ too, each by its angle, but are no longer than others, and the same on both sides:
# chi² of a bite seldom exceeds 10 at any angle, and seldom stays below 15 behind an edge.
MIN_ALIKE = 3  # spots: fewer do not show what is usual
MAX_STRETCH = 0.05  # diameters
MAX_LENGTH, MAX_SURE_LENGTH = 1.2, 1.04  # of the longest width, over the usual one: alone; misfit
MAX_LONGER_SIGMA = 2.0  # standard deviations of that misfit
MAX_ASYMMETRY = 12.0  # chi² of a bite out of a stretched spot, over the usual misfit
MIN_STRETCH_SIGMA = 15.0  # of the centre: noise stretches a spot by 2.4 to 3.4 of them
# Two equal lights d apart add d²/4 to the second moment along their line, and their middle is d/2
# off: the widths give that as 0.36 stretch x diameter of Gaussians, 0.13 of discs; half an axis.
STRETCH_SHARE = 0.15
MIN_BORDER = 1.2  # half-widths that must be inside the image
MIN_NOISE_SHARE = Real(
    0.9
)  # share of a pixel's noise that clipping must leave for its residual to count
MIN_SEPARATION = 0.5  # diameters of the smaller one: closer spots are one spot found twice
MAX_PART = 0.75  # of a disc's diameter: a smaller spot on it is a part of it
MAX_PART_PEAK = 1.5  # of a disc's peak, that a part of it may seem to have

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
    for k in range(COL_COVARIANCE_XX, COL_COVARIANCE_YY + 1):
        row[k] = math.nan
    if not finite:
        return
    root, column = np.empty((N_PARAMETERS, N_PARAMETERS)), np.zeros((2, N_PARAMETERS))
    factor(information, -MIN_INFORMATION, root)
    column[0, PAR_X], column[1, PAR_Y] = 1.0, 1.0
    solve(root, column[0])
    solve(root, column[1])
    row[COL_COVARIANCE_XX], row[COL_COVARIANCE_XY] = column[0, PAR_X], column[0, PAR_Y]
    row[COL_COVARIANCE_YX], row[COL_COVARIANCE_YY] = column[0, PAR_Y], column[1, PAR_Y]


@compiled_sums
def core_counts(rows: Pixels) -> tuple[float, float, float, float]:
    """Count what judges a spot by its own pixels.

    Pixels that clipping leaves alone; their squared residuals over the variance, summed; the
    same in DN²; and how many of all are at the sensor's limit.
    """
    count, squares, square_dn, full = ZERO, ZERO, ZERO, ZERO
    for k in range(rows.shape[1]):
        core = rows[ROW_CORE, k]
        alone = core if rows[ROW_VISIBLE, k] > MIN_NOISE_SHARE else ZERO
        off = rows[ROW_VALUE, k] - rows[ROW_MEAN, k]
        full += core if rows[ROW_VALUE, k] >= SENSOR_LIMIT else ZERO
        count += alone
        squares += alone * off * off / rows[ROW_VARIANCE, k]
        square_dn += alone * off * off
    return float(count), float(squares), float(square_dn), float(full)


@compiled
def assess_shape(rows: Pixels, peak: float, pixels: float, row: Array) -> None:
    """Say how far the shape is that of one LED, and enlarge the covariance by what it is not.

    `rows` (25, p); `peak`, DN; `pixels`, that misfit beyond chance lifts together; `row` (16,),
    changed.
    """
    count, squares, square_dn, full = core_counts(rows)
    freedom = count - N_FITTED
    paid = max(freedom, 1.0)
    misfit = squares / paid if freedom >= N_FITTED else 1.0
    rough = math.sqrt(square_dn / paid)
    merged = misfit > MAX_REDUCED_CHI2 and rough > MAX_RESIDUAL_RATIO * min(
        peak, float(SENSOR_LIMIT)
    )
    excess = max(misfit - 1.0 - MAX_CHI2_SIGMA * math.sqrt(2.0 / paid), 0.0) if full == 0.0 else 0.0
    larger = CORRELATED_PIXELS * misfit if merged else 1.0 + pixels * excess
    for k in range(COL_COVARIANCE_XX, COL_COVARIANCE_YY + 1):
        row[k] *= larger
    row[COL_MISFIT], row[COL_COUNT] = misfit, count
    row[COL_SATURATED], row[COL_MERGED] = 1.0 if full > 0.0 else 0.0, 1.0 if merged else 0.0


@compiled
def assess_all(fits: Fits, width: int, height: int, lifted: float) -> Array:
    """Assess n fits, (n, 16).

    `width` and `height` of the picture, px; `lifted`, pixels, as for `assess_shape`.
    """
    n = len(fits.scale)
    assessed = np.empty((n, N_COLUMNS))
    for k in range(n):
        p, row, scale = fits.parameters[k], assessed[k], fits.scale[k]
        x, y = fits.origin[k, 0] + p[PAR_X], fits.origin[k, 1] + p[PAR_Y]
        mean = (p[PAR_XX] + p[PAR_YY]) / 2.0
        split = math.hypot((p[PAR_XX] - p[PAR_YY]) / 2.0, p[PAR_XY])
        positive = mean > split
        long = scale / math.sqrt(mean - split) if positive else scale
        short = scale / math.sqrt(mean + split) if positive else scale
        row[COL_CENTRE_X], row[COL_CENTRE_Y], row[COL_PEAK] = x, y, p[PAR_PEAK]
        row[COL_DIAMETER], row[COL_ELONGATION] = long + short, long / short
        turn = -2.0 * (long - short) / split if split > 0.0 else 0.0
        row[COL_STRETCH_X] = turn * (p[PAR_XX] - p[PAR_YY]) / 2.0
        row[COL_STRETCH_Y] = turn * p[PAR_XY]
        centre_covariance(fits.information[k], row)
        assess_shape(rows_of(fits, k), p[PAR_PEAK], lifted, row)
        rim = MIN_BORDER * long - 0.5
        inside = x > rim and y > rim and x < width - 1.0 - rim and y < height - 1.0 - rim
        finite = True
        for value in p:
            finite = finite and math.isfinite(value)
        sound = (
            positive
            and inside
            and finite
            and p[PAR_PEAK] * math.sqrt(fits.information[k, PAR_PEAK, PAR_PEAK]) > MIN_PEAK
            and long < MAX_AXIS_RATIO * short
            and math.hypot(p[PAR_X], p[PAR_Y]) < MAX_SHIFT * scale + 1.0
        )
        row[COL_SOUND] = 1.0 if sound else 0.0
    return assessed


@compiled
def median_where(values: Array, column: int, wanted: Array) -> float:
    """Median of a column of n rows, of those whose `wanted` (n,) is over 0; nan of none."""
    some, count = np.empty(len(values)), 0
    for n in range(len(values)):
        if wanted[n] > 0.0:
            some[count] = values[n, column]
            count += 1
    return median(some[:count]) if count > 0 else math.nan


@compiled
def widen_lossy(assessed: Array) -> None:
    """Make the covariances of a JPEG's n spots (n, 16) those of its errors, which are not white."""
    whole = np.empty(len(assessed))
    for n in range(len(assessed)):
        whole[n] = 1.0 - max(assessed[n, COL_SATURATED], assessed[n, COL_MERGED])
    usual = median_where(assessed, COL_MISFIT, whole)
    usual = 1.0 if math.isnan(usual) else max(usual, MIN_LOSSY_MISFIT)
    for n in range(len(assessed)):
        odd = max(assessed[n, COL_MISFIT] / usual - MAX_LOSSY_MISFIT, 0.0) * whole[n]
        scale = LOSSY_SHARE * usual * (1.0 + CORRELATED_PIXELS * odd)
        for k in range(COL_COVARIANCE_XX, COL_COVARIANCE_YY + 1):
            assessed[n, k] *= 1.0 if assessed[n, COL_MERGED] > 0.0 else scale


@compiled
def least_stretch(row: Array, asymmetry: float) -> float:
    """Least stretch of a spot, px, that is doubted: beyond noise, where nothing else would show."""
    if asymmetry < math.inf:
        return float(MAX_STRETCH * row[COL_DIAMETER])
    return MIN_STRETCH_SIGMA * math.sqrt((row[COL_COVARIANCE_XX] + row[COL_COVARIANCE_YY]) / 2.0)


@compiled
def doubt_shapes(assessed: Array, asymmetry: Array) -> None:
    """Flag those of a picture's spots (n, 16) that are stretched alone; widen what is merged.

    `asymmetry` (n,), chi² of a bite out of each, for noise as stated; inf where none would show.
    """
    count, alike, doubtful = len(assessed), 0, False
    off, clear, length = np.empty(count), np.empty(count), np.empty((count, 1))
    for n in range(count):
        row = assessed[n]
        off[n], clear[n] = math.hypot(row[COL_STRETCH_X], row[COL_STRETCH_Y]), 1.0 - row[COL_MERGED]
        length[n, 0] = 2.0 * row[COL_DIAMETER] / (1.0 + 1.0 / row[COL_ELONGATION])
        alike += clear[n] > 0.0
        doubtful = doubtful or clear[n] == 0.0 or off[n] > least_stretch(row, asymmetry[n])
    if not doubtful:
        return
    x, y, usual = 0.0, 0.0, math.inf  # none is longer than usual where nothing shows what that is
    if alike >= MIN_ALIKE:
        x, y = (
            median_where(assessed, COL_STRETCH_X, clear),
            median_where(assessed, COL_STRETCH_Y, clear),
        )
        usual = median_where(length, 0, clear)
    misfit = max(1.0, median_where(assessed, COL_MISFIT, clear))  # 1 of none
    for n in range(count):
        row = assessed[n]
        off[n] = min(off[n], math.hypot(row[COL_STRETCH_X] - x, row[COL_STRETCH_Y] - y))
        chance = 1.0 + MAX_LONGER_SIGMA * math.sqrt(2.0 / max(row[COL_COUNT], 1.0))
        over, longer = row[COL_MISFIT] / misfit, length[n, 0] / usual
        odd = asymmetry[n] > MAX_ASYMMETRY * misfit or longer > MAX_LENGTH
        odd = odd or (over > chance and longer > MAX_SURE_LENGTH)
        if odd and off[n] > least_stretch(row, asymmetry[n]):
            row[COL_MERGED] = 1.0
        if row[COL_MERGED] > 0.0:
            doubt = STRETCH_SHARE * off[n] * row[COL_DIAMETER]
            row[COL_COVARIANCE_XX] += doubt
            row[COL_COVARIANCE_YY] += doubt


@compiled
def first_by(values: Array, index: Index, most: int) -> int:
    """Put the `most` of n indices whose values are least first, in order; ties as they come.

    `index` (n,) is changed: its first entries are those meant. Gives their number.
    """
    count = 0
    for n in range(len(index)):
        one, at = index[n], min(count, most)
        while at > 0 and values[one] < values[index[at - 1]]:
            if at < most:
                index[at] = index[at - 1]
            at -= 1
        if at < most:
            index[at] = one
            count = min(count + 1, most)
    return count


@compiled
def is_found_again(assessed: Array, spots: Index, n: int) -> bool:
    """Whether a spot is another one of m spots: a part of its disc, or fitting better or first."""
    row = assessed[n]
    for k in spots:
        other = assessed[k]
        if k == n or is_part(other, row):
            continue
        if is_part(row, other):
            return True
        off = math.hypot(
            row[COL_CENTRE_X] - other[COL_CENTRE_X], row[COL_CENTRE_Y] - other[COL_CENTRE_Y]
        )
        better = other[COL_MISFIT] < row[COL_MISFIT]
        better = better or (k < n and other[COL_MISFIT] == row[COL_MISFIT])
        if better and off < MIN_SEPARATION * min(row[COL_DIAMETER], other[COL_DIAMETER]):
            return True
    return False


@compiled
def is_part(row: Array, other: Array) -> bool:
    """Whether a spot lies on the disc of another, larger one, whose shape is that of one LED.

    A few pixels of a disc's rim fit a small spot, with so little freedom that nothing misfits.
    """
    off = math.hypot(
        row[COL_CENTRE_X] - other[COL_CENTRE_X], row[COL_CENTRE_Y] - other[COL_CENTRE_Y]
    )
    smaller = row[COL_DIAMETER] < MAX_PART * other[COL_DIAMETER]
    smaller = smaller and row[COL_PEAK] < MAX_PART_PEAK * other[COL_PEAK]  # no LED before a glow
    return bool(smaller and other[COL_MERGED] == 0.0 and off < other[COL_DIAMETER] / 2.0)


@compiled
def choose_spots(assessed: Array, least: float, largest: float, limit: int) -> Index:
    """Choose the most LED-like of n spots (n, 16), no more than the limit, by falling peak.

    `least` and `largest` diameter, px.
    """
    total, count, single = len(assessed), 0, 0
    sound, chosen = np.empty(total, np.int64), np.empty(total, np.int64)
    rank, height = np.empty(total), np.empty(total)
    for n in range(total):
        row = assessed[n]
        if row[COL_SOUND] > 0.0 and least <= row[COL_DIAMETER] <= largest:
            sound[count] = n
            count += 1
        height[n] = -row[COL_PEAK]
        rank[n] = -row[COL_PEAK] / (1.0 + row[COL_MISFIT]) / row[COL_ELONGATION]
    for n in sound[:count]:
        if not is_found_again(assessed, sound[:count], n):
            chosen[single] = n
            single += 1
    kept = chosen[: first_by(rank, chosen[:single], limit)]
    first_by(height, kept, len(kept))
    return kept
