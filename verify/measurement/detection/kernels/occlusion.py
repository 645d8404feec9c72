"""Score a partial occlusion of each spot's rim in each direction, and average over them.

A bite of depth b in direction s lowers pixel k by b v_k(s). With D the derivatives by the spot's
parameters and r the residual, all over the pixels' sigmas, the parameters eliminated,

    information = v'v - v'D (D'D)⁻¹ D'v,  gradient = v'r - r'D (D'D)⁻¹ D'v

of the log-likelihood in b; its posterior, with a half-normal prior on b, is a clipped normal law.
Each spot of every image is asked for a bite in dozens of directions: in numpy each function here
takes several times as long.
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


@compiled
def occlusion_change(
    peak: float, known: Array, near: NDArray[np.int64], sides: Array, width: float, sunk: Array
) -> None:
    """Change of pixels by a bite in each direction, per depth and over each pixel's sigma.

    Args:
        peak: DN.
        known: (10, p), of the pixels.
        near: (m,), the pixels meant.
        sides: (d, 2), unit vectors.
        width: rad, of a bite: von Mises' bump, a Gaussian round a circle.
        sunk: (d, m), filled.
    """
    u, w, depth = np.empty(len(near)), np.empty(len(near)), np.empty(len(near))
    for at in range(len(near)):
        k = near[at]
        length = max(math.sqrt(known[ROW_U, k] ** 2 + known[ROW_W, k] ** 2), MIN_RADIUS)
        u[at], w[at] = known[ROW_U, k] / length, known[ROW_W, k] / length
        weight = known[ROW_VISIBLE, k] * math.sqrt(known[ROW_USED, k] / known[ROW_VARIANCE, k])
        # a smaller radius is a larger t: d(t²) = 2 t² times the relative depth
        depth[at] = 2.0 * peak * known[ROW_SLOPE, k] * known[ROW_RADIUS2, k] * weight
    for side in range(len(sides)):
        depth_profile(
            u, w, depth, sides[side, 0], sides[side, 1], 1.0 / (width * width), sunk[side]
        )


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
    judged: Array,
    parameters: Array,
    information: Array,
    gradient: Array,
    known: Array,
    whitened: Array,
    sides: Array,
    limits: tuple[float, float, float],
    score: tuple[Array, Array, Array],
) -> None:
    """Ask the residuals of some of n fits for bites in d directions.

    Args:
        numbers: (m,), of the fits asked; others belong to no fit here.
        judged: (m, 14), of `assess_all`: saturated and merged ones say nothing of bites.
        parameters: (n, 10).
        information: (n, 10, 10).
        gradient: (n, 10).
        known: (n, 10, p).
        whitened: (n, 11, p).
        sides: (d, 2), unit vectors.
        limits: reach, half-widths; a bite's width, rad; least share of its information left.
        score: (m, d), (m, d), (m, d, 2): gradient, information, pull; filled where enough is left.
    """
    reach, width, least = limits
    directions = len(sides)
    found = np.empty(known.shape[2], np.int64)
    cross, whole = np.empty((ROW_WHITENED, directions)), np.empty(directions)
    root, follow = np.empty((N_PARAMETERS, N_PARAMETERS)), np.empty((N_PARAMETERS, directions))
    left, slope = np.empty(directions), np.empty(directions)
    for m in range(len(numbers)):
        n = numbers[m]
        if not 0 <= n < len(parameters) or judged[m, COL_SATURATED] + judged[m, COL_MERGED] > 0.0:
            continue
        count = 0
        for k in range(known.shape[2]):
            if known[n, ROW_RADIUS2, k] < reach * reach:
                found[count] = k
                count += 1
        near = found[:count]
        sunk = np.empty((directions, len(near)))
        occlusion_change(parameters[n, PAR_PEAK], known[n], near, sides, width, sunk)
        cross_products(whitened[n], near, sunk, cross, whole)
        factor(information[n], 0.0, root)
        for a in range(N_PARAMETERS):
            for b in range(follow.shape[1]):
                follow[a, b] = cross[a, b]
        solve_each(root, follow)
        eliminate_parameters(cross, whole, follow, gradient[n], left, slope)
        worth = max(judged[m, COL_MISFIT], 1.0)
        for side in range(directions):
            if left[side] > least * whole[side]:
                score[0][m, side], score[1][m, side] = slope[side] / worth, left[side] / worth
                score[2][m, side, 0] = -follow[PAR_X, side]
                score[2][m, side, 1] = -follow[PAR_Y, side]


@compiled
def eliminate_parameters(
    cross: Array, whole: Array, follow: Array, gradient: Array, left: Array, slope: Array
) -> None:
    """Fill in each bite's information and slope (d,) once a spot's parameters give way to it.

    Args:
        cross: (11, d), products of derivatives and residual with each bite.
        whole: (d,), of each bite with itself.
        follow: (10, d), how the parameters give way.
        gradient: (10,), of the spot's fit.
        left: filled.
        slope: filled.
    """
    for b in range(len(left)):
        left[b], slope[b] = whole[b], cross[ROW_RESIDUAL, b]
    for a in range(N_PARAMETERS):
        for side in range(len(whole)):
            left[side] -= cross[a, side] * follow[a, side]
        for side in range(len(whole)):
            slope[side] -= gradient[a] * follow[a, side]


@compiled
def fill_depth_posterior(
    gradient: Array, information: Array, scale: float, evidence: Array, mean: Array, square: Array
) -> None:
    """Suppose a bite of unknown depth in each direction of each spot, (n, d) throughout.

    Args:
        gradient: of the log-likelihood at depth 0.
        information: on the depth.
        scale: of depths expected, of a half-normal law.
        evidence: filled: log-likelihood ratio of a bite to none.
        mean: filled: of the depth, posterior.
        square: filled: of the depth squared, likewise.
    """
    spots, directions = gradient.shape
    for n in range(spots):
        for side in range(directions):
            sigma = 1.0 / math.sqrt(information[n, side] + 1.0 / (scale * scale))
            z = gradient[n, side] * sigma
            cut_off = log_normal_cdf(z) + z * z / 2.0
            evidence[n, side] = math.log(2.0 * sigma / scale) + cut_off
            hazard = math.exp(-cut_off) / math.sqrt(2.0 * math.pi)
            mean[n, side] = sigma * (z + hazard)
            square[n, side] = sigma * sigma * (1.0 + z * (z + hazard))


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
    probability: Array, depth: Array, depth2: Array, pull: Array, shift: Array, doubt: Array
) -> None:
    """Average each spot's shift over its bites, and say how far that is in doubt.

    Args:
        probability: (n, d), of a bite.
        depth: (n, d), its mean.
        depth2: (n, d), its mean square.
        pull: (n, d, 2), px a depth.
        shift: (n, 2), filled, px.
        doubt: (n, 2, 2), filled, px².
    """
    spots, directions = probability.shape
    for n in range(spots):
        for i in range(2):
            shift[n, i] = 0.0
            for side in range(directions):
                shift[n, i] += pull[n, side, i] * probability[n, side] * depth[n, side]
        for i in range(2):
            for j in range(2):
                doubt[n, i, j] = -shift[n, i] * shift[n, j]
                for side in range(directions):
                    spread = probability[n, side] * depth2[n, side]
                    doubt[n, i, j] += pull[n, side, i] * spread * pull[n, side, j]


@compiled
def share_probability(
    evidence: Array, prior: tuple[float, float, float], probability: Array
) -> None:
    """Share one out among no bite, each spot's own, and one side of all.

    Args:
        evidence: (n, d), log-likelihood ratio of each spot's bite in each direction to none.
        prior: probabilities of a bite shared by all, of each spot in it, and of one of its own.
        probability: (n, d), filled: of each spot's bite in each direction.
    """
    shared, struck, single = prior
    spots, directions = evidence.shape
    sides = np.full(directions, math.log(shared / directions))
    own, free = math.log(single / directions), np.full(spots, math.log(1.0 - single))
    nothing_shared = math.log(1.0 - shared)
    for n in range(spots):
        for side in range(directions):
            sides[side] += log_sum_exp(math.log(1.0 - struck), math.log(struck) + evidence[n, side])
            free[n] = log_sum_exp(free[n], own + evidence[n, side])
        nothing_shared += free[n]
    total = nothing_shared
    for side in range(directions):
        total = log_sum_exp(total, sides[side])
    for n in range(spots):
        for side in range(directions):
            hit = math.log(struck) + evidence[n, side]
            with_others = sides[side] - total + hit - log_sum_exp(math.log(1.0 - struck), hit)
            alone = nothing_shared - total + own + evidence[n, side] - free[n]
            probability[n, side] = math.exp(with_others) + math.exp(alone)


@compiled
def log_sum_exp(one: float, other: float) -> float:
    """Logarithm of the sum of two numbers of which the logarithms are given."""
    return max(one, other) + math.log1p(math.exp(-abs(one - other)))
