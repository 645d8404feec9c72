"""Score a partial occlusion of each spot's rim in each direction.

A bite of depth b in direction s lowers pixel k by b v_k(s). With D the derivatives by the spot's
parameters and r the residual, all over the pixels' sigmas, the parameters eliminated,

    information = v'v - v'D (D'D)⁻¹ D'v,  gradient = v'r - r'D (D'D)⁻¹ D'v

of the log-likelihood in b.
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled, compiled_sums
from verify.core.kernels.linear_algebra import factor, solve_each
from verify.core.records import Array
from verify.measurement.detection.kernels.fit import multiply_rows
from verify.measurement.detection.kernels.pixels import (
    N_PARAMETERS,
    PAR_PEAK,
    PAR_X,
    PAR_Y,
    ROW_RADIUS2,
    ROW_RESIDUAL,
    ROW_SLOPE,
    ROW_U,
    ROW_USED,
    ROW_VARIANCE,
    ROW_VISIBLE,
    ROW_W,
    ROW_WHITENED,
)
from verify.measurement.detection.kernels.quality import COL_MERGED, COL_MISFIT, COL_SATURATED

MIN_RADIUS = 1e-9  # half-widths: nearer the very centre no bite changes anything
OCCLUSION_WIDTH = 0.3  # rad, standard deviation: a stalk of a third to a half of its LED's diameter
RIM_RADIUS = 1.8  # half-widths: no rim beyond
MIN_INFORMATION = 0.05  # share of a bite's information that the fit's own parameters must leave


@compiled
def occlusion_change(
    peak: float, model: Array, near: NDArray[np.int64], sides: Array, sunk: Array
) -> None:
    """Change of pixels by a bite in each direction, per depth and over each pixel's sigma.

    `peak`, DN; `model` (10, p), of the pixels; `near` (m,), the pixels meant; `sides` (d, 2), unit
    vectors, of bites as wide as von Mises' bump, a Gaussian round a circle; `sunk` (d, m), filled.
    """
    u, w, depth = np.empty(len(near)), np.empty(len(near)), np.empty(len(near))
    for at in range(len(near)):
        k = near[at]
        length = max(math.sqrt(model[ROW_U, k] ** 2 + model[ROW_W, k] ** 2), MIN_RADIUS)
        u[at], w[at] = model[ROW_U, k] / length, model[ROW_W, k] / length
        weight = model[ROW_VISIBLE, k] * math.sqrt(model[ROW_USED, k] / model[ROW_VARIANCE, k])
        # a smaller radius is a larger t: d(t²) = 2 t² times the relative depth
        depth[at] = 2.0 * peak * model[ROW_SLOPE, k] * model[ROW_RADIUS2, k] * weight
    sharp = 1.0 / (OCCLUSION_WIDTH * OCCLUSION_WIDTH)
    for side in range(len(sides)):
        depth_profile(u, w, depth, sides[side, 0], sides[side, 1], sharp, sunk[side])


@compiled_sums
def depth_profile(
    u: Array, w: Array, depth: Array, x: float, y: float, sharp: float, sunk: Array
) -> None:
    """Let the depth of pixels in direction (u, w) fall off on both sides of a direction (x, y).

    The exponential is a series' 32nd power, good to 2e-9 down to -22, its least argument at a
    width of 0.3 rad: plain arithmetic, which the processor does on several pixels at once.
    """
    for at in range(len(u)):
        z = (x * u[at] + y * w[at] - 1.0) * sharp * (1.0 / 32.0)
        z4, low = z * z * z * z, 1.0 + z * (1.0 + z * (1 / 2 + z * (1 / 6)))
        middle = 1 / 24 + z * (1 / 120 + z * (1 / 720 + z * (1 / 5040)))
        high = 1 / 40320 + z * (1 / 362880 + z * (1 / 3628800 + z * (1 / 39916800)))
        power = low + z4 * (middle + z4 * high)
        power *= power
        power *= power
        power *= power
        power *= power
        sunk[at] = depth[at] * power * power


@compiled_sums
def cross_products(
    whitened: Array, near: NDArray[np.int64], sunk: Array, cross: Array, whole: Array
) -> None:
    """Products of every row (11, p) with every bite (d, m), and of every bite with itself."""
    rows = np.empty((ROW_WHITENED, len(near)))
    for a in range(ROW_WHITENED):
        for at in range(len(near)):
            rows[a, at] = whitened[a, near[at]]
    multiply_rows(rows, sunk, cross)
    for side in range(len(sunk)):
        total = 0.0
        for at in range(len(near)):
            total += sunk[side, at] * sunk[side, at]
        whole[side] = total


@compiled
def score_all(
    numbers: NDArray[np.int64],
    assessed: Array,
    parameters: Array,
    information: Array,
    gradient: Array,
    model: Array,
    whitened: Array,
    sides: Array,
    score: tuple[Array, Array, Array],
) -> None:
    """Score bites in d directions by the residuals of some of n fits.

    `numbers` (m,), of the fits to score; others belong to no fit here. `assessed` (m, 16), by
    `assess_all`: saturated and merged ones show no bites. Of the fits: `parameters` and `gradient`
    (n, 10), `information` (n, 10, 10), `model` (n, 10, p), `whitened` (n, 11, p). `sides` (d, 2),
    unit vectors. `score` (m, d), (m, d), (m, d, 2): gradient, information, pull; filled where
    enough is left.
    """
    directions = len(sides)
    found = np.empty(model.shape[2], np.int64)
    cross, whole = np.empty((ROW_WHITENED, directions)), np.empty(directions)
    root, follow = np.empty((N_PARAMETERS, N_PARAMETERS)), np.empty((N_PARAMETERS, directions))
    left, slope = np.empty(directions), np.empty(directions)
    for m in range(len(numbers)):
        n = numbers[m]
        if not 0 <= n < len(parameters):
            continue
        if assessed[m, COL_SATURATED] + assessed[m, COL_MERGED] > 0.0:
            continue
        count = 0
        for k in range(model.shape[2]):
            if model[n, ROW_RADIUS2, k] < RIM_RADIUS * RIM_RADIUS:
                found[count] = k
                count += 1
        near = found[:count]
        sunk = np.empty((directions, len(near)))
        occlusion_change(parameters[n, PAR_PEAK], model[n], near, sides, sunk)
        cross_products(whitened[n], near, sunk, cross, whole)
        factor(information[n], 0.0, root)
        for a in range(N_PARAMETERS):
            for b in range(follow.shape[1]):
                follow[a, b] = cross[a, b]
        solve_each(root, follow)
        for side in range(directions):
            left[side], slope[side] = whole[side], cross[ROW_RESIDUAL, side]
        for a in range(N_PARAMETERS):
            for side in range(directions):
                left[side] -= cross[a, side] * follow[a, side]
                slope[side] -= gradient[n, a] * follow[a, side]
        worth = max(assessed[m, COL_MISFIT], 1.0)
        for side in range(directions):
            if left[side] > MIN_INFORMATION * whole[side]:
                score[0][m, side], score[1][m, side] = slope[side] / worth, left[side] / worth
                score[2][m, side, 0] = -follow[PAR_X, side]
                score[2][m, side, 1] = -follow[PAR_Y, side]
