"""Measure the spots of a picture in one go: fit its candidates, assess, correct and choose them.

Spots whose light reaches each other's pixels are fitted anew, each without that of the others.
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled
from verify.core.kernels.linear_algebra import copy_to
from verify.core.records import Array
from verify.measurement.detection.kernels.background import correct_for_room
from verify.measurement.detection.kernels.fit import (
    LAST_STEPS,
    MAX_STEPS_FIRST_LOOK,
    TOL_FIRST_LOOK,
    TOL_LAST_STEP,
    expect_spot,
    fit_from_start,
    fit_spot,
)
from verify.measurement.detection.kernels.noise import background_noise, refine_noise
from verify.measurement.detection.kernels.occlusion import (
    N_DIRECTIONS,
    correct_for_bites,
    score_spots,
)
from verify.measurement.detection.kernels.patches import (
    MAX_APART,
    MIN_APART,
    PATCH_MARGIN,
    PATCH_REACH,
    Fits,
    Picture,
    cut_patches,
    rows_of,
)
from verify.measurement.detection.kernels.pixels import (
    N_PARAMETERS,
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
    Pixels,
    Real,
)
from verify.measurement.detection.kernels.quality import (
    COL_CENTRE_X,
    COL_COVARIANCE_XX,
    COL_ELONGATION,
    COL_MERGED,
    COL_SOUND,
    CORRELATED_PIXELS,
    assess_all,
    choose_spots,
    doubt_shapes,
    widen_lossy,
)
from verify.measurement.detection.profile import MIN_LOG_STEEPNESS, RADIUS_STEP, ROW_STEP


@compiled
def measure_spots(
    picture: Picture,
    candidates: Array,
    noise: Array,
    table: Pixels,
    wanted: tuple[float, float, int, bool, bool],
    unknown: bool,
    found: tuple[Array, Array],
) -> int:
    """Measure the spots of a picture, and count them.

    `candidates` (n, 4): centre, column and row, px; half width, px; contrast, DN. `noise` (4,):
    read variance, DN², gain and black, DN, of one channel, filled in where they are `unknown`.
    `table`: of the profiles. `wanted`: least and largest diameter, px; how many at most; whether
    the whole picture was searched, so that of many or large ones only those are fitted in which a
    first look sees a spot; whether it was a JPEG.

    `found` (limit, 16) and (limit, 3), filled: the spots as in quality.py, by falling peak; their
    colours, DN.
    """
    least, largest, limit, whole, lossy = wanted
    if unknown:
        background_noise(picture, lossy, noise)
    pixels = 0.0
    for n in range(len(candidates)):
        pixels += math.pi * (PATCH_REACH * candidates[n, 2] + PATCH_MARGIN) ** 2
    glance = whole and pixels > MAX_AT_ONCE
    fits = fit_candidates(picture, candidates, noise, table, glance)
    if len(fits.scale) == 0:
        return 0
    width, height = picture.width, picture.height
    if unknown:
        refine_noise(fits, assess_all(fits, width, height, CORRELATED_PIXELS), noise, noise[3])
    for n in range(len(fits.scale)):
        if unknown or not fits.settled[n]:
            fit_spot(fits, n, noise, table, LAST_STEPS, TOL_LAST_STEP)
    lifted = 0.0 if lossy else CORRELATED_PIXELS
    assessed = assess_all(fits, width, height, lifted)
    if separate_neighbours(fits, assessed, noise, table):
        assessed = assess_all(fits, width, height, lifted)
    kept = choose_spots(assessed, least, largest, limit)
    rows, moments = found[0][: len(kept)], np.zeros((len(kept), 2, 3))
    for m in range(len(kept)):
        copy_to(rows[m], assessed[kept[m]])
        copy_to(found[1][m], fits.colour[kept[m]])
    if lossy:
        widen_lossy(rows)
    score = np.empty((len(kept), 4, N_DIRECTIONS))
    doubt_shapes(rows, score_spots(fits, kept, rows, score))
    correct_for_bites(score, rows, moments)
    correct_for_room(picture, candidates, fits, kept, rows, moments)
    for m in range(len(kept)):
        for i in range(2):
            rows[m, COL_CENTRE_X + i] += moments[m, i, 0]
            for j in range(2):
                rows[m, COL_COVARIANCE_XX + 2 * i + j] += moments[m, i, 1 + j]
    return len(kept)


MAX_AT_ONCE = 5000.0  # pixels of a picture's candidates that are fitted without a first look
MAX_CLEAN_ELONGATION = 1.2  # of spots whose light is taken off others: glints are longer
SEPARATION_PASSES = 4  # of spots touching at a third of their height; two suffice farther apart
MIN_NEIGHBOUR = 0.15  # of a spot's peak, of another one's: less may be texture of the room
MIN_LIGHT = 0.5  # DN of a neighbour: less is not worth taking off, least of all below black
TINY = 1e-9  # of an inverse square of a half-width, where a fit has none


@compiled
def fit_candidates(
    picture: Picture, candidates: Array, noise: Array, table: Pixels, glance: bool
) -> Fits:
    """Fit the candidates, on a glance only those in which a first look sees a spot."""
    read, start = math.sqrt(noise[0]), np.empty((len(candidates), N_PARAMETERS))
    if glance:
        first, count = cut_patches(picture, candidates, True), 0
        sound = np.empty_like(candidates)
        for n in range(len(candidates)):
            expect_spot(first, n, read)
            fit_spot(first, n, noise, table, MAX_STEPS_FIRST_LOOK, TOL_FIRST_LOOK)
        assessed = assess_all(first, picture.width, picture.height, CORRELATED_PIXELS)
        for n in range(len(candidates)):
            if assessed[n, COL_SOUND] > 0.0:
                copy_to(sound[count], candidates[n])
                copy_to(start[count], first.parameters[n])
                count += 1
        candidates = sound[:count]
    fits = cut_patches(picture, candidates, False)
    for n in range(len(candidates)):
        expect_spot(fits, n, read)
        if glance:
            copy_to(fits.parameters[n], start[n])
        fit_from_start(fits, n, noise, table)
    return fits


@compiled
def separate_neighbours(fits: Fits, assessed: Array, noise: Array, table: Pixels) -> bool:
    """Fit clean spots near each other anew, each without the light that the others have there.

    In place; says whether there are any. Spots nearer than MIN_APART are not told apart.
    """
    count = len(assessed)
    near = np.empty((count, count), np.bool_)
    if not find_neighbours(fits, assessed, near):
        return False
    read, shape = np.empty(fits.begin[count], Real), np.empty_like(fits.parameters)
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
def take_light(fits: Fits, n: int, other: int, shape: Array, table: Pixels) -> bool:
    """Take another spot's light, of that shape (10,), off a spot's pixels; whether it has any."""
    rows, taken, scale = rows_of(fits, n), False, fits.scale[other]
    x = fits.origin[other, 0] + shape[PAR_X] - fits.origin[n, 0]
    y = fits.origin[other, 1] + shape[PAR_Y] - fits.origin[n, 1]
    place = (shape[PAR_STEEPNESS] - MIN_LOG_STEEPNESS) / ROW_STEP
    place = min(max(place, 0.0), table.shape[0] - 1.001)
    line, last = int(place), table.shape[1] - 1
    for k in range(rows.shape[1]):
        u, w = (rows[ROW_COLUMN, k] - x) / scale, (rows[ROW_ROW, k] - y) / scale
        t = math.sqrt(
            max(shape[PAR_XX] * u * u + 2.0 * shape[PAR_XY] * u * w + shape[PAR_YY] * w * w, 0.0)
        )
        at = min(t / RADIUS_STEP, last - 1e-9)
        low, light = int(at), 0.0
        for sample in range(2):
            one = table[line, low + sample]
            height = one[0] + (place - line) * one[1]
            light += shape[PAR_PEAK] * height * (at - low if sample == 1 else 1.0 - at + low)
        if light > MIN_LIGHT:
            rows[ROW_VALUE, k] -= light
            taken = True
    return taken
