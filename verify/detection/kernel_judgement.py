"""What a fit says about its spot, compiled: the arithmetic of judgement.py, a patch at a time."""

import math

import numpy as np
from numpy.typing import NDArray

from verify.compiled import compiled
from verify.detection.kernel import UNTOLD, tally
from verify.detection.kernel_clip import SENSOR_LIMIT
from verify.detection.kernel_pixels import PARAMETERS, PEAK, XX, XY, YY, X, Y
from verify.records import Array
from verify.small_matrices import factor, solve

Truths = NDArray[np.bool_]

# columns of a told spot
CENTRE_X, CENTRE_Y, COVARIANCE_XX, COVARIANCE_XY, COVARIANCE_YX, COVARIANCE_YY = range(6)
HEIGHT, DIAMETER, ELONGATION, MISFIT, SATURATED, MERGED, SOUND, COUNT = range(6, 14)
TOLD = 14


@compiled
def known_centre(information: Array, told: Array) -> None:
    """Covariance of the centre, other parameters free, px²; nan where nothing is known."""
    known = True
    for a in range(PARAMETERS):
        for b in range(PARAMETERS):
            known = known and math.isfinite(information[a, b])
    told[COVARIANCE_XX : COVARIANCE_YY + 1] = np.nan
    if not known:
        return
    root, column = np.empty((PARAMETERS, PARAMETERS)), np.zeros(PARAMETERS)
    factor(information, -UNTOLD, root)
    column[X] = 1.0
    solve(root, column)
    told[COVARIANCE_XX], told[COVARIANCE_XY] = column[X], column[Y]
    column[:] = 0.0
    column[Y] = 1.0
    solve(root, column)
    told[COVARIANCE_YX], told[COVARIANCE_YY] = told[COVARIANCE_XY], column[Y]


@compiled
def tell_shape(counted: Array, peak: float, limits: tuple[float, ...], told: Array) -> None:
    """Say how far the shape is that of one LED, and enlarge the covariance by what it is not.

    Args:
        counted: (4,), of `tally`.
        peak: DN.
        limits: FITTED, MISFIT, ROUGH, CHANCE, TOGETHER of judgement.py.
        told: (14,), changed.
    """
    fitted, most, rough_most, chance, together = limits
    count, squares, square_dn, full = counted[0], counted[1], counted[2], counted[3]
    freedom = count - fitted
    paid = max(freedom, 1.0)
    misfit = squares / paid if freedom >= fitted else 1.0
    rough = math.sqrt(square_dn / paid)
    merged = misfit > most and rough > rough_most * min(peak, SENSOR_LIMIT)
    excess = max(misfit - 1.0 - chance * math.sqrt(2.0 / paid), 0.0) if full == 0.0 else 0.0
    told[COVARIANCE_XX : COVARIANCE_YY + 1] *= (
        together * misfit if merged else 1.0 + together * excess
    )
    told[MISFIT], told[COUNT] = misfit, count
    told[SATURATED], told[MERGED] = 1.0 if full > 0.0 else 0.0, 1.0 if merged else 0.0


@compiled
def tell_all(
    parameters: Array,
    information: Array,
    pixels: Array,
    known: Array,
    scale: Array,
    origin: NDArray[np.int64],
    size: tuple[int, int],
    limits: tuple[float, ...],
    bounds: tuple[float, float, float, float],
    told: Array,
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
        limits: as for `tell_shape`.
        bounds: FAINTEST, LONGEST, WANDERED, BORDER of judgement.py.
        told: (n, 14), filled.
    """
    faintest, longest, wandered, border = bounds
    counted = tally(pixels, known)
    for n in range(len(parameters)):
        p, row = parameters[n], told[n]
        x, y = origin[n, 0] + p[X], origin[n, 1] + p[Y]
        mean, split = (p[XX] + p[YY]) / 2.0, math.hypot((p[XX] - p[YY]) / 2.0, p[XY])
        positive = mean > split
        long = scale[n] / math.sqrt(mean - split) if positive else scale[n]
        short = scale[n] / math.sqrt(mean + split) if positive else scale[n]
        row[CENTRE_X], row[CENTRE_Y], row[HEIGHT] = x, y, p[PEAK]
        row[DIAMETER], row[ELONGATION] = long + short, long / short
        known_centre(information[n], row)
        tell_shape(counted[n], p[PEAK], limits, row)
        rim = border * long - 0.5
        inside = x > rim and y > rim and x < size[0] - 1.0 - rim and y < size[1] - 1.0 - rim
        finite = True
        for value in p:
            finite = finite and math.isfinite(value)
        sound = (
            positive
            and inside
            and finite
            and p[PEAK] * math.sqrt(information[n, PEAK, PEAK]) > faintest
            and long < longest * short
            and math.hypot(p[X], p[Y]) < wandered * scale[n] + 1.0
        )
        row[SOUND] = 1.0 if sound else 0.0


@compiled
def twins(told: Array, apart: float, twin: Truths) -> None:
    """Mark spots that are another, better fitting one found twice; of equals the first is it.

    Args:
        told: (n, 14).
        apart: diameters of the smaller one: spots are no closer.
        twin: (n,), filled.
    """
    for a in range(len(told)):
        one, twin[a] = told[a], False
        for b in range(len(told)):
            other = told[b]
            better = other[MISFIT] < one[MISFIT] or (other[MISFIT] == one[MISFIT] and b < a)
            off = math.hypot(one[CENTRE_X] - other[CENTRE_X], one[CENTRE_Y] - other[CENTRE_Y])
            if better and off < apart * min(one[DIAMETER], other[DIAMETER]):
                twin[a] = True


@compiled
def number_brightest(told: Array, fewest: float, most: int, number: NDArray[np.int64]) -> None:
    """Number the brightest of n spots, brightest first, from 0; -1 are the others.

    Args:
        told: (n, 14).
        fewest: pixels: a spot has more of its own that clipping leaves alone.
        most: how many are numbered.
        number: (n,), filled.
    """
    brightness = np.empty(len(told))
    for n in range(len(told)):
        row, number[n] = told[n], -1
        speaks = row[SOUND] > 0.0 and row[COUNT] > fewest
        brightness[n] = row[HEIGHT] / row[ELONGATION] if speaks else -np.inf
    rank = 0
    for n in np.argsort(-brightness, kind="mergesort")[:most]:
        if brightness[n] > -np.inf:
            number[n] = rank
            rank += 1


@compiled
def choose(
    told: Array, diameter: tuple[float, float], apart: float, limit: int, chosen: NDArray[np.int64]
) -> int:
    """Choose the most LED-like of n spots, and list them by falling peak.

    Args:
        told: (n, 14).
        diameter: px, least and largest.
        apart: as for `twins`.
        limit: how many at most.
        chosen: (n,), filled from the begin with as many as are chosen.

    Returns:
        How many.
    """
    for n in range(len(told)):
        fits = diameter[0] <= told[n, DIAMETER] <= diameter[1]
        chosen[n] = n if told[n, SOUND] > 0.0 and fits else -1
    sound = chosen[chosen >= 0]
    twin = np.empty(len(sound), np.bool_)
    twins(told[sound], apart, twin)
    single = sound[~twin]
    rank = np.empty(len(single))
    for k in range(len(single)):
        row = told[single[k]]
        rank[k] = -row[HEIGHT] / (1.0 + row[MISFIT]) / row[ELONGATION]
    best = single[np.argsort(rank, kind="mergesort")[:limit]]
    falling = best[np.argsort(-told[best, HEIGHT], kind="mergesort")]
    chosen[: len(falling)] = falling
    return len(falling)
