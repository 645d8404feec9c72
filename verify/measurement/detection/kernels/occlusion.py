"""Score a partial occlusion of each spot's rim in each direction, and average over them.

A bite of depth b in direction s lowers pixel k by b v_k(s). With D the derivatives by the spot's
parameters and r the residual, all over the pixels' sigmas, the parameters eliminated,

    information = v'v - v'D (D'D)⁻¹ D'v,  gradient = v'r - r'D (D'D)⁻¹ D'v

of the log-likelihood in b; its posterior, with a half-normal prior on b, is a clipped normal law.
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled, compiled_sums
from verify.core.kernels.linear_algebra import factor, solve_each
from verify.core.records import Array
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

MIN_Z = -30.0  # standard deviations: below, the complementary error function ends
MIN_RADIUS = 1e-9  # half-widths: nearer the very centre no bite changes anything
OCCLUSION_WIDTH = 0.3  # rad, standard deviation: a stalk of a third to a half of its LED's diameter
RIM_RADIUS = 1.8  # half-widths: no rim beyond
MIN_INFORMATION = 0.05  # share of a bite's information that the fit's own parameters must leave
PRIOR_DEPTH = 0.05  # half-widths, scale of what is expected; far deeper ones show without a prior
P_SHARED = 0.1  # prior probability that something hides one side of an image's LEDs
P_OCCLUDED = 0.8  # of an LED's being bitten then
P_SINGLE = 0.02  # of an LED's being bitten, where no side is shared


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
    """Products of every row (11, p) with every bite (d, m), and of every bite with itself.

    Two bites at once, d being even: a row that is loaded is used twice.
    """
    row = np.empty(len(near))
    for a in range(ROW_WHITENED):
        for at in range(len(near)):
            row[at] = whitened[a, near[at]]
        for side in range(0, len(sunk), 2):
            one, other = 0.0, 0.0
            for at in range(len(near)):
                one += row[at] * sunk[side, at]
                other += row[at] * sunk[side + 1, at]
            cross[a, side], cross[a, side + 1] = one, other
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
        eliminate_parameters(cross, whole, follow, gradient[n], left, slope)
        worth = max(assessed[m, COL_MISFIT], 1.0)
        for side in range(directions):
            if left[side] > MIN_INFORMATION * whole[side]:
                score[0][m, side], score[1][m, side] = slope[side] / worth, left[side] / worth
                score[2][m, side, 0] = -follow[PAR_X, side]
                score[2][m, side, 1] = -follow[PAR_Y, side]


@compiled
def eliminate_parameters(
    cross: Array, whole: Array, follow: Array, gradient: Array, left: Array, slope: Array
) -> None:
    """Fill in each bite's information and slope (d,) once a spot's parameters give way to it.

    `cross` (11, d), products of derivatives and residual with each bite; `whole` (d,), of each bite
    with itself; `follow` (10, d), how the parameters give way; `gradient` (10,), of the spot's fit;
    `left` and `slope`, filled.
    """
    for b in range(len(left)):
        left[b], slope[b] = whole[b], cross[ROW_RESIDUAL, b]
    for a in range(N_PARAMETERS):
        for side in range(len(whole)):
            left[side] -= cross[a, side] * follow[a, side]
        for side in range(len(whole)):
            slope[side] -= gradient[a] * follow[a, side]


@compiled
def depth_posterior(gradient: Array, information: Array) -> tuple[Array, Array, Array]:
    """Suppose a bite of unknown depth in each direction of each spot, (n, d) throughout.

    From the gradient of the log-likelihood at depth 0 and the information on the depth: the
    half-normal prior and the Gaussian likelihood make a normal law cut off at 0. Gives the
    log-likelihood ratio of a bite to none; the depth's posterior mean and mean square.
    """
    spots, directions = gradient.shape
    evidence, mean = np.empty((spots, directions)), np.empty((spots, directions))
    square = np.empty((spots, directions))
    for n in range(spots):
        for side in range(directions):
            sigma = 1.0 / math.sqrt(information[n, side] + 1.0 / (PRIOR_DEPTH * PRIOR_DEPTH))
            z = gradient[n, side] * sigma
            cut_off = log_normal_cdf(z) + z * z / 2.0
            evidence[n, side] = math.log(2.0 * sigma / PRIOR_DEPTH) + cut_off
            hazard = math.exp(-cut_off) / math.sqrt(2.0 * math.pi)
            mean[n, side] = sigma * (z + hazard)
            square[n, side] = sigma * sigma * (1.0 + z * (z + hazard))
    return evidence, mean, square


@compiled
def log_normal_cdf(z: float) -> float:
    """Logarithm of the share of a standard normal law that is below z."""
    if z > MIN_Z:
        return math.log(0.5 * math.erfc(-z / math.sqrt(2.0)))
    # Mills' ratio as an asymptotic series: the next term is under 1e-6 of it here
    x = 1.0 / (z * z)
    series = -x * (1.0 - x * (3.0 - x * 15.0))
    return -z * z / 2.0 - math.log(-z * math.sqrt(2.0 * math.pi)) + math.log1p(series)


@compiled
def average_shifts(
    probability: Array, depth: Array, depth2: Array, pull: Array
) -> tuple[Array, Array]:
    """Average each spot's shift (n, 2), px, over its bites; with its covariance (n, 2, 2), px².

    (n, d): probability of a bite, its mean depth and mean square; `pull` (n, d, 2), px a depth.
    """
    spots, directions = probability.shape
    shift, covariance = np.empty((spots, 2)), np.empty((spots, 2, 2))
    for n in range(spots):
        for i in range(2):
            shift[n, i] = 0.0
            for side in range(directions):
                shift[n, i] += pull[n, side, i] * probability[n, side] * depth[n, side]
        for i in range(2):
            for j in range(2):
                covariance[n, i, j] = -shift[n, i] * shift[n, j]
                for side in range(directions):
                    spread = probability[n, side] * depth2[n, side]
                    covariance[n, i, j] += pull[n, side, i] * spread * pull[n, side, j]
    return shift, covariance


@compiled
def occlusion_probability(evidence: Array) -> Array:
    """Posterior probability of each spot's bite in each direction, (n, d).

    Shared out among no bite, one of each spot's own, and bites on one side of all spots. `evidence`
    (n, d): log-likelihood ratio of each spot's bite in each direction to none.
    """
    spots, directions = evidence.shape
    probability = np.empty((spots, directions))
    sides = np.full(directions, math.log(P_SHARED / directions))
    own, free = math.log(P_SINGLE / directions), np.full(spots, math.log(1.0 - P_SINGLE))
    missed, struck = math.log(1.0 - P_OCCLUDED), math.log(P_OCCLUDED)
    nothing_shared = math.log(1.0 - P_SHARED)
    for n in range(spots):
        for side in range(directions):
            sides[side] += log_sum_exp(missed, struck + evidence[n, side])
            free[n] = log_sum_exp(free[n], own + evidence[n, side])
        nothing_shared += free[n]
    total = nothing_shared
    for side in range(directions):
        total = log_sum_exp(total, sides[side])
    for n in range(spots):
        for side in range(directions):
            hit = struck + evidence[n, side]
            with_others = sides[side] - total + hit - log_sum_exp(missed, hit)
            alone = nothing_shared - total + own + evidence[n, side] - free[n]
            probability[n, side] = math.exp(with_others) + math.exp(alone)
    return probability


@compiled
def log_sum_exp(one: float, other: float) -> float:
    """Logarithm of the sum of two numbers of which the logarithms are given."""
    return max(one, other) + math.log1p(math.exp(-abs(one - other)))
