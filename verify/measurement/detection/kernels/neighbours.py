"""Tell spots apart whose light reaches each other's pixels: each is fitted without the others'."""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled
from verify.core.kernels.linear_algebra import copy_to
from verify.core.records import Array
from verify.measurement.detection.kernels.fit import LAST_STEPS, TOL_LAST_STEP, fit_spot
from verify.measurement.detection.kernels.patches import MAX_APART, MIN_APART, Fits, rows_of
from verify.measurement.detection.kernels.pixels import (
    PAR_PEAK,
    PAR_STEEPNESS,
    PAR_X,
    PAR_XX,
    PAR_XY,
    PAR_Y,
    PAR_YY,
    ROW_COLUMN,
    ROW_ROW,
    ROW_VALUE,
)
from verify.measurement.detection.kernels.quality import COL_ELONGATION, COL_MERGED, COL_SOUND
from verify.measurement.detection.profile import MIN_LOG_STEEPNESS, RADIUS_STEP, ROW_STEP

MAX_CLEAN_ELONGATION = 1.2  # of spots whose light is taken off others: glints are longer
SEPARATION_PASSES = 4  # of spots touching at a third of their height; two suffice farther apart
MIN_NEIGHBOUR = 0.15  # of a spot's peak, of another one's: less may be texture of the room
MIN_LIGHT = 0.5  # DN of a neighbour: less is not worth taking off, least of all below black
TINY = 1e-9  # of an inverse square of a half-width, where a fit has none


@compiled
def separate_neighbours(fits: Fits, assessed: Array, noise: Array, table: Array) -> bool:
    """Fit clean spots near each other anew, each without the light that the others have there.

    In place; says whether there are any. Spots nearer than MIN_APART are not told apart.
    """
    count = len(assessed)
    near = np.empty((count, count), np.bool_)
    if not find_neighbours(fits, assessed, near):
        return False
    read, shape = np.empty(fits.begin[count]), np.empty_like(fits.parameters)
    for n in range(count):
        copy_to(read[fits.begin[n] : fits.begin[n + 1]], rows_of(fits, n)[ROW_VALUE])
    for _ in range(SEPARATION_PASSES):
        for n in range(count):
            copy_to(shape[n], fits.parameters[n])
        for n in range(count):
            taken, value = False, rows_of(fits, n)[ROW_VALUE]
            copy_to(value, read[fits.begin[n] : fits.begin[n + 1]])
            for other in range(count):
                if near[n, other]:
                    taken = take_light(fits, n, other, shape[other], table) or taken
            if taken:
                fit_spot(fits, n, noise, table, LAST_STEPS, TOL_LAST_STEP)
        if not find_neighbours(fits, assessed, near):
            break
    return True


@compiled
def find_neighbours(fits: Fits, assessed: Array, near: NDArray[np.bool_]) -> bool:
    """Fill in which clean spots' light reaches which others' pixels, (n, n); whether any does."""
    count, found = len(assessed), False
    clean, radius = np.empty(count, np.bool_), np.empty(count)
    for n in range(count):
        p, row = fits.parameters[n], assessed[n]
        radius[n] = fits.scale[n] * math.sqrt(2.0 / max(p[PAR_XX] + p[PAR_YY], TINY))
        clean[n] = row[COL_SOUND] > 0.0 and row[COL_MERGED] == 0.0
        clean[n] = clean[n] and row[COL_ELONGATION] < MAX_CLEAN_ELONGATION
    for n in range(count):
        for other in range(count):
            p, its = fits.parameters[n], fits.parameters[other]
            x = fits.origin[n, 0] + p[PAR_X] - fits.origin[other, 0] - its[PAR_X]
            y = fits.origin[n, 1] + p[PAR_Y] - fits.origin[other, 1] - its[PAR_Y]
            apart = math.hypot(x, y) / (radius[n] + radius[other])
            near[n, other] = clean[n] and clean[other] and MIN_APART < apart < MAX_APART
            near[n, other] &= its[PAR_PEAK] > MIN_NEIGHBOUR * p[PAR_PEAK]
            found = found or near[n, other]
    return found


@compiled
def take_light(fits: Fits, n: int, other: int, shape: Array, table: Array) -> bool:
    """Take another spot's light, of that shape (10,), off a spot's pixels; whether it has any."""
    rows, taken, scale = rows_of(fits, n), False, fits.scale[other]
    x = fits.origin[other, 0] + shape[PAR_X] - fits.origin[n, 0]
    y = fits.origin[other, 1] + shape[PAR_Y] - fits.origin[n, 1]
    place = (shape[PAR_STEEPNESS] - MIN_LOG_STEEPNESS) / ROW_STEP
    place = min(max(place, 0.0), table.shape[1] - 1.001)
    line, last = int(place), table.shape[2] - 1
    for k in range(rows.shape[1]):
        u, w = (rows[ROW_COLUMN, k] - x) / scale, (rows[ROW_ROW, k] - y) / scale
        t = math.sqrt(
            max(shape[PAR_XX] * u * u + 2.0 * shape[PAR_XY] * u * w + shape[PAR_YY] * w * w, 0.0)
        )
        at = min(t / RADIUS_STEP, last - 1e-9)
        low, light = int(at), 0.0
        for sample in range(2):
            height = table[0, line, low + sample] + (place - line) * table[1, line, low + sample]
            light += shape[PAR_PEAK] * height * (at - low if sample == 1 else 1.0 - at + low)
        if light > MIN_LIGHT:
            rows[ROW_VALUE, k] -= light
            taken = True
    return taken
