"""Measure the spots of a picture in one go: fit its candidates, assess, correct and choose them."""

import math

import numpy as np

from verify.core.jit import compiled
from verify.core.kernels.linear_algebra import copy_to
from verify.core.records import Array
from verify.measurement.detection.kernels.background import correct_for_room
from verify.measurement.detection.kernels.fit import (
    LAST_STEPS,
    MAX_STEPS_FIRST_LOOK,
    TOL_FIRST_LOOK,
    TOL_LAST_STEP,
    fit_from_start,
    fit_spot,
)
from verify.measurement.detection.kernels.neighbours import separate_neighbours
from verify.measurement.detection.kernels.noise import background_noise, refine_noise
from verify.measurement.detection.kernels.occlusion import correct_for_bites
from verify.measurement.detection.kernels.patches import Fits, Picture, cut_patches
from verify.measurement.detection.kernels.pixels import N_PARAMETERS
from verify.measurement.detection.kernels.quality import (
    COL_CENTRE_X,
    COL_COVARIANCE_XX,
    COL_SOUND,
    CORRELATED_PIXELS,
    assess_all,
    choose_spots,
    doubt_shapes,
    widen_lossy,
)
from verify.measurement.detection.kernels.start import expect_spot


@compiled
def measure_spots(
    picture: Picture,
    candidates: Array,
    noise: Array,
    table: Array,
    wanted: tuple[float, float, int, bool, bool],
    unknown: bool,
    found: tuple[Array, Array],
) -> int:
    """Measure the spots of a picture, and count them.

    `candidates` (n, 4): centre, column and row, px; half width, px; contrast, DN. `noise` (4,):
    read variance, DN², gain and black, DN, of one channel, filled in where they are `unknown`.
    `table`: of the profiles. `wanted`: least and largest diameter, px; how many at most; whether
    the whole picture was searched, so that only those are fitted in which a first look sees a spot;
    whether it was a JPEG.

    `found` (limit, 16) and (limit, 3), filled: the spots as in quality.py, by falling peak; their
    colours, DN.
    """
    least, largest, limit, glance, lossy = wanted
    if unknown:
        background_noise(picture, lossy, noise)
    fits = fit_candidates(picture, candidates, noise, table, glance)
    if len(fits.scale) == 0:
        return 0
    width, height = picture.width, picture.height
    if unknown:
        refine_noise(fits, assess_all(fits, width, height, CORRELATED_PIXELS), noise, noise[3])
    for n in range(len(fits.scale)):
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
    doubt_shapes(rows)
    correct_for_bites(fits, kept, rows, moments)
    correct_for_room(picture, candidates, fits, kept, rows, moments)
    for m in range(len(kept)):
        for i in range(2):
            rows[m, COL_CENTRE_X + i] += moments[m, i, 0]
            for j in range(2):
                rows[m, COL_COVARIANCE_XX + 2 * i + j] += moments[m, i, 1 + j]
    return len(kept)


@compiled
def fit_candidates(
    picture: Picture, candidates: Array, noise: Array, table: Array, glance: bool
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
