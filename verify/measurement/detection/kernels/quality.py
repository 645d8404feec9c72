"""Judge fitted spots: centre and covariance, diameter, whether a spot has the shape of one LED.

With misfit m the residuals' mean square over their variance, the covariance is enlarged

    by 1 + TOGETHER max(m - 1 - CHANCE sqrt(2 / freedom), 0),  of merged spots by TOGETHER m

All fits of an image are judged in one call, since in numpy the calls would take longer than the
arithmetic of so few spots.
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

# columns of a judged spot
COL_CENTRE_X, COL_CENTRE_Y = range(2)
COL_COVARIANCE_XX, COL_COVARIANCE_XY, COL_COVARIANCE_YX, COL_COVARIANCE_YY = range(2, 6)
COL_PEAK, COL_DIAMETER, COL_ELONGATION, COL_MISFIT = range(6, 10)
COL_SATURATED, COL_MERGED, COL_SOUND, COL_COUNT = range(10, 14)
N_COLUMNS = 14


@compiled
def centre_covariance(information: Array, row: Array) -> None:
    """Covariance of the centre, other parameters free, px²; nan where nothing is known."""
    known = True
    for a in range(N_PARAMETERS):
        for b in range(N_PARAMETERS):
            known = known and math.isfinite(information[a, b])
    row[COL_COVARIANCE_XX : COL_COVARIANCE_YY + 1] = np.nan
    if not known:
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
def assess_shape(counted: Array, peak: float, limits: tuple[float, ...], row: Array) -> None:
    """Say how far the shape is that of one LED, and enlarge the covariance by what it is not.

    Args:
        counted: (4,), of `core_counts`.
        peak: DN.
        limits: FITTED, COL_MISFIT, ROUGH, CHANCE, TOGETHER of quality.py.
        row: (14,), changed.
    """
    fitted, most, rough_most, chance, together = limits
    count, squares, square_dn, full = counted[0], counted[1], counted[2], counted[3]
    freedom = count - fitted
    paid = max(freedom, 1.0)
    misfit = squares / paid if freedom >= fitted else 1.0
    rough = math.sqrt(square_dn / paid)
    merged = misfit > most and rough > rough_most * min(peak, SENSOR_LIMIT)
    excess = max(misfit - 1.0 - chance * math.sqrt(2.0 / paid), 0.0) if full == 0.0 else 0.0
    larger = together * misfit if merged else 1.0 + together * excess
    for k in range(COL_COVARIANCE_XX, COL_COVARIANCE_YY + 1):
        row[k] *= larger
    row[COL_MISFIT], row[COL_COUNT] = misfit, count
    row[COL_SATURATED], row[COL_MERGED] = 1.0 if full > 0.0 else 0.0, 1.0 if merged else 0.0


@compiled
def assess_all(
    parameters: Array,
    information: Array,
    pixels: Array,
    known: Array,
    scale: Array,
    origin: NDArray[np.int64],
    size: tuple[int, int],
    limits: tuple[float, ...],
    bounds: tuple[float, float, float, float],
    judged: Array,
) -> None:
    """Judge n fits.

    Args:
        parameters: (n, 10).
        information: (n, 10, 10).
        pixels: (n, 4, p), as fitted.
        known: (n, 10, p), of the pixels at the parameters.
        scale: (n,), px.
        origin: (n, 2), px, of each patch's centre pixel.
        size: width and height of the picture, px.
        limits: as for `assess_shape`.
        bounds: FAINTEST, LONGEST, WANDERED, BORDER of quality.py.
        judged: (n, 14), filled.
    """
    faintest, longest, wandered, border = bounds
    counted = core_counts(pixels, known)
    for n in range(len(parameters)):
        p, row = parameters[n], judged[n]
        x, y = origin[n, 0] + p[PAR_X], origin[n, 1] + p[PAR_Y]
        mean = (p[PAR_XX] + p[PAR_YY]) / 2.0
        split = math.hypot((p[PAR_XX] - p[PAR_YY]) / 2.0, p[PAR_XY])
        positive = mean > split
        long = scale[n] / math.sqrt(mean - split) if positive else scale[n]
        short = scale[n] / math.sqrt(mean + split) if positive else scale[n]
        row[COL_CENTRE_X], row[COL_CENTRE_Y], row[COL_PEAK] = x, y, p[PAR_PEAK]
        row[COL_DIAMETER], row[COL_ELONGATION] = long + short, long / short
        centre_covariance(information[n], row)
        assess_shape(counted[n], p[PAR_PEAK], limits, row)
        rim = border * long - 0.5
        inside = x > rim and y > rim and x < size[0] - 1.0 - rim and y < size[1] - 1.0 - rim
        finite = True
        for value in p:
            finite = finite and math.isfinite(value)
        sound = (
            positive
            and inside
            and finite
            and p[PAR_PEAK] * math.sqrt(information[n, PAR_PEAK, PAR_PEAK]) > faintest
            and long < longest * short
            and math.hypot(p[PAR_X], p[PAR_Y]) < wandered * scale[n] + 1.0
        )
        row[COL_SOUND] = 1.0 if sound else 0.0


@compiled
def mark_duplicates(judged: Array, apart: float, twin: Flags) -> None:
    """Mark spots that are another, better fitting one found twice; of equals the first is it.

    Args:
        judged: (n, 14).
        apart: diameters of the smaller one: spots are no closer.
        twin: (n,), filled.
    """
    for a in range(len(judged)):
        one, twin[a] = judged[a], False
        for b in range(len(judged)):
            other = judged[b]
            better = other[COL_MISFIT] < one[COL_MISFIT] or (
                other[COL_MISFIT] == one[COL_MISFIT] and b < a
            )
            off = math.hypot(
                one[COL_CENTRE_X] - other[COL_CENTRE_X], one[COL_CENTRE_Y] - other[COL_CENTRE_Y]
            )
            if better and off < apart * min(one[COL_DIAMETER], other[COL_DIAMETER]):
                twin[a] = True
