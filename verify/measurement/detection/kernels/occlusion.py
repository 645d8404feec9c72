"""Correct spot centres for an object that hides a sliver of the LED's rim.

Model, to first order in the depth d of a bite in direction k (24 directions round the rim):

    log L(d) = g_k d - i_k d² / 2,   d ~ half-normal(PRIOR_DEPTH),   d >= 0
    centre   = fitted centre + E[d] pull_k, averaged over no bite, one of the spot's own, and bites
               on one side of all spots, by their posterior probabilities

    symbol  meaning                                                        unit
    d       depth of the bite                                              half-widths
    g, i    gradient and information of the log-likelihood                half-widths^-1, ^-2
    pull    shift of the centre a unit of depth, (2,)                      px

A bite adds harmonics to the rim's radius: the first shifts the centre, the second changes the
ellipse, the third and higher ones, which no whole disc has, reveal it. One spot seldom shows them
above its noise, but an object hides the same side of all LEDs of a marker. No threshold decides;
what remains uncertain enlarges the covariance.

Source: Hoeting et al., Bayesian model averaging: a tutorial, Statistical Science 14, 1999.

A bite of depth b in direction s lowers pixel k by b v_k(s). With D the derivatives by the spot's
parameters and r the residual, all over the pixels' sigmas, the parameters eliminated,

    i = v'v - v'D (D'D)⁻¹ D'v,  g = v'r - r'D (D'D)⁻¹ D'v
"""

import math

import numpy as np

from verify.core.jit import compiled, compiled_sums
from verify.core.kernels.linear_algebra import factor, solve_each
from verify.core.records import Array
from verify.measurement.detection.kernels.fit import multiply_rows
from verify.measurement.detection.kernels.patches import Fits, Index, rows_of
from verify.measurement.detection.kernels.pixels import (
    N_PARAMETERS,
    N_WHITENED,
    ONE,
    PAR_PEAK,
    PAR_STEEPNESS,
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
    ZERO,
    Pixels,
    Real,
)
from verify.measurement.detection.kernels.quality import COL_MERGED, COL_MISFIT, COL_SATURATED

N_DIRECTIONS = 24  # round the rim: steps of 15°, under a bite's own width
_ANGLES = 2 * np.pi / N_DIRECTIONS * np.arange(N_DIRECTIONS)
DIRECTIONS = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])
PRIOR_DEPTH = 0.05  # half-widths, scale of what is expected; far deeper ones show without a prior
P_SHARED = 0.1  # prior probability that something hides one side of an image's LEDs
P_OCCLUDED = 0.8  # of an LED's being bitten then
P_SINGLE = 0.02  # of an LED's being bitten, where no side is shared
MIN_Z = -5.0  # sigma: below, a continued fraction gives the normal law's tail
N_FRACTIONS = 24  # of it: good to rounding
MIN_RADIUS2 = Real(1e-18)  # half-widths²: nearer the very centre no bite changes anything
OCCLUSION_WIDTH = 0.3  # rad, standard deviation: a stalk of a third to a half of its LED's diameter
RIM_RADIUS2 = Real(1.8**2)  # half-widths²: no rim beyond
SERIES = tuple(Real(1.0 / math.factorial(n)) for n in range(2, 10))
# Logarithm; a Gaussian's is 0.33. Nearer to it, what an edge leaves of an LED is stretched alone,
# like one seen at an angle: a bite's chi² is 3 to 12, as it is by chance.
MIN_STEEPNESS = 0.39
MIN_INFORMATION = 0.05  # share of a bite's information that the fit's own parameters must leave


@compiled
def occlusion_change(peak: float, rows: Pixels, near: Index, sunk: Pixels) -> None:
    """Change of pixels by a bite in each direction, per depth and over each pixel's sigma.

    `peak`, DN; `rows` (25, p); `near` (m,), the pixels meant; `sunk` (24, m), filled: bites are as
    wide as von Mises' bump, a Gaussian round a circle.
    """
    some, twice = np.empty((6, len(near)), Real), Real(2.0 * peak)
    u, w, depth, weight = some[0], some[1], some[2], some[3]
    for at in range(len(near)):
        k = near[at]
        u[at], w[at], depth[at] = rows[ROW_U, k], rows[ROW_W, k], rows[ROW_SLOPE, k]
        weight[at], some[4, at] = rows[ROW_USED, k] / rows[ROW_VARIANCE, k], rows[ROW_VISIBLE, k]
        some[5, at] = rows[ROW_RADIUS2, k]
    for at in range(len(near)):
        # a smaller radius is a larger t: d(t²) = 2 t² times the relative depth
        depth[at] *= twice * some[5, at] * some[4, at] * math.sqrt(weight[at])
    for at in range(len(near)):
        weight[at] = ONE / math.sqrt(max(u[at] * u[at] + w[at] * w[at], MIN_RADIUS2))
    for at in range(len(near)):
        u[at] *= weight[at]
        w[at] *= weight[at]
    for side in range(N_DIRECTIONS):
        depth_profile(u, w, depth, DIRECTIONS[side], sunk[side])


@compiled_sums
def depth_profile(u: Pixels, w: Pixels, depth: Pixels, side: Array, sunk: Pixels) -> None:
    """Let the depth of pixels in direction (u, w) fall off on both sides of a direction (2,).

    The exponential is a series' 32nd power, good to rounding down to -22, its least argument at a
    width of 0.3 rad: plain arithmetic, which the processor does on several pixels at once.
    """
    sharp = 1.0 / (32.0 * OCCLUSION_WIDTH * OCCLUSION_WIDTH)
    x, y, less = Real(side[0] * sharp), Real(side[1] * sharp), Real(sharp)
    for at in range(len(u)):
        z = x * u[at] + y * w[at] - less
        z4 = z * z * z * z
        low = ONE + z * (ONE + z * (SERIES[0] + z * SERIES[1]))
        middle = SERIES[2] + z * (SERIES[3] + z * (SERIES[4] + z * SERIES[5]))
        power = low + z4 * (middle + z4 * (SERIES[6] + z * SERIES[7]))
        power *= power
        power *= power
        power *= power
        power *= power
        sunk[at] = depth[at] * power * power


@compiled_sums
def cross_products(rows: Pixels, near: Index, sunk: Pixels, cross: Array, whole: Array) -> None:
    """Products of the whitened rows (11 of 25, p) with every bite (d, m), and of it with itself."""
    few = np.empty((N_WHITENED, len(near)), Real)
    for a in range(N_WHITENED):
        for at in range(len(near)):
            few[a, at] = rows[a, near[at]]
    multiply_rows(few, sunk, cross, Real)
    for side in range(len(sunk)):
        total = ZERO
        for at in range(len(near)):
            total += sunk[side, at] * sunk[side, at]
        whole[side] = total


@compiled
def score_bites(fits: Fits, n: int, worth: float, score: Array) -> None:
    """Score bites in each direction by the residuals of a fit.

    `worth`: by which unmodelled errors make the pixels worth less; `score` (4, 24), filled where
    enough is left: gradient, information, pull in x and in y.
    """
    rows, count = rows_of(fits, n), 0
    found = np.empty(rows.shape[1], np.int64)
    cross, whole = np.empty((N_WHITENED, N_DIRECTIONS)), np.empty(N_DIRECTIONS)
    root, follow = np.empty((N_PARAMETERS, N_PARAMETERS)), np.empty((N_PARAMETERS, N_DIRECTIONS))
    for k in range(rows.shape[1]):
        found[count] = k
        count += rows[ROW_RADIUS2, k] < RIM_RADIUS2
    near = found[:count]
    sunk = np.empty((N_DIRECTIONS, count), Real)
    occlusion_change(fits.parameters[n, PAR_PEAK], rows, near, sunk)
    cross_products(rows, near, sunk, cross, whole)
    factor(fits.information[n], 0.0, root)
    for a in range(N_PARAMETERS):
        for side in range(N_DIRECTIONS):
            follow[a, side] = cross[a, side]
    solve_each(root, follow)
    for side in range(N_DIRECTIONS):
        left, slope = whole[side], cross[ROW_RESIDUAL, side]
        for a in range(N_PARAMETERS):
            left -= cross[a, side] * follow[a, side]
            slope -= fits.gradient[n, a] * follow[a, side]
        if left > MIN_INFORMATION * whole[side]:
            score[0, side], score[1, side] = slope / worth, left / worth
            score[2, side], score[3, side] = -follow[PAR_X, side], -follow[PAR_Y, side]


@compiled
def depth_posterior(gradient: float, information: float) -> tuple[float, float, float]:
    """Suppose a bite of unknown depth.

    The half-normal prior and the Gaussian likelihood make a normal law cut off at 0. Gives the
    log-likelihood ratio of a bite to none; the depth's posterior mean and mean square.
    """
    sigma = 1.0 / math.sqrt(information + PRIOR_DEPTH**-2)
    z = gradient * sigma
    cut_off = log_scaled_law(z)
    excess = z + math.exp(-cut_off) / math.sqrt(2.0 * math.pi)
    evidence = math.log(2.0 / PRIOR_DEPTH * sigma) + cut_off
    return evidence, sigma * excess, sigma * sigma * (1.0 + z * excess)


@compiled
def log_scaled_law(z: float) -> float:
    """Logarithm of the share of a standard normal variable below z, over exp(-z²/2)."""
    if z > MIN_Z:
        return math.log(0.5 * math.erfc(-z * math.sqrt(0.5))) + z * z / 2.0
    below = -z
    for k in range(N_FRACTIONS, 0, -1):
        below = k / below - z
    return -math.log(below * math.sqrt(2.0 * math.pi))


@compiled
def log_add(a: float, b: float) -> float:
    """Logarithm of exp(a) + exp(b)."""
    return max(a, b) + math.log1p(math.exp(-abs(a - b)))


@compiled
def log_sum(values: Array) -> float:
    """Logarithm of the sum of exp(v), of (n,)."""
    most, total = -math.inf, 0.0
    for value in values:
        most = max(most, value)
    for value in values:
        total += math.exp(value - most)
    return most + math.log(total)


@compiled
def occlusion_probability(evidence: Array) -> Array:
    """Posterior probability of each spot's bite in each direction, (n, d).

    Shared out among no bite, one of each spot's own, and bites on one side of all spots. `evidence`
    (n, d): log-likelihood ratio of each spot's bite in each direction to none.
    """
    sides, alone = np.empty(N_DIRECTIONS), math.log(1.0 - P_SHARED)
    own, hit = math.log(P_SINGLE / N_DIRECTIONS), math.log(P_OCCLUDED)
    free, missed = np.empty(len(evidence)), math.log(1.0 - P_OCCLUDED)
    either, probability = np.empty(evidence.shape), np.empty(evidence.shape)
    for side in range(N_DIRECTIONS):
        sides[side] = math.log(P_SHARED / N_DIRECTIONS)
    for n in range(len(evidence)):
        free[n] = log_add(math.log(1.0 - P_SINGLE), own + log_sum(evidence[n]))
        alone += free[n]
        for side in range(N_DIRECTIONS):
            either[n, side] = log_add(missed, hit + evidence[n, side])
            sides[side] += either[n, side]
    total = log_add(alone, log_sum(sides))
    for n in range(len(evidence)):
        for side in range(N_DIRECTIONS):
            here = evidence[n, side]
            probability[n, side] = math.exp(sides[side] - total + hit + here - either[n, side])
            probability[n, side] += math.exp(alone - total + own + here - free[n])
    return probability


@compiled
def score_spots(fits: Fits, kept: Index, assessed: Array, score: Array) -> Array:
    """Score the bites of m spots of an image that have one LED's shape; others have none.

    `kept` (m,), of the fits; `assessed` (m, 16), theirs; `score` (m, 4, 24), filled as by
    `score_bites`. Gives the chi² of each spot's likeliest bite, (m,), for noise as stated; inf of
    spots so far out of focus that none shows.
    """
    chi2 = np.zeros(len(kept))
    score[:] = 0.0
    for m in range(len(kept)):
        if assessed[m, COL_SATURATED] + assessed[m, COL_MERGED] > 0.0:
            continue
        # where the reduced chi² is above 1, unmodelled errors make the pixels worth less
        worth = max(assessed[m, COL_MISFIT], 1.0)
        score_bites(fits, kept[m], worth, score[m])
        for side in range(N_DIRECTIONS):
            if score[m, 0, side] > 0.0:
                chi2[m] = max(chi2[m], worth * score[m, 0, side] ** 2 / score[m, 1, side])
        if fits.parameters[kept[m], PAR_STEEPNESS] < MIN_STEEPNESS:
            chi2[m] = math.inf
    return chi2


@compiled
def correct_for_bites(score: Array, assessed: Array, moments: Array) -> None:
    """Average over all bites that m spots of an image may have; none without one LED's shape.

    `score` (m, 4, 24), as by `score_spots`; `assessed` (m, 16); `moments` (m, 2, 3): what makes the
    centres those of the whole discs, px, and its covariance, px², are added.
    """
    shape = len(score), N_DIRECTIONS
    evidence, depth, square = np.empty(shape), np.empty(shape), np.empty(shape)
    for m in range(len(score)):
        if assessed[m, COL_MERGED] > 0.0:
            score[m] = 0.0
        for side in range(N_DIRECTIONS):
            found = depth_posterior(score[m, 0, side], score[m, 1, side])
            evidence[m, side], depth[m, side], square[m, side] = found
    probability = occlusion_probability(evidence)
    for m in range(len(score)):
        shift, spread = np.zeros(2), np.zeros((2, 2))
        for side in range(N_DIRECTIONS):
            for i in range(2):
                pull = score[m, 2 + i, side]
                shift[i] += probability[m, side] * depth[m, side] * pull
                for j in range(2):
                    spread[i, j] += (
                        probability[m, side] * square[m, side] * pull * score[m, 2 + j, side]
                    )
        for i in range(2):
            moments[m, i, 0] += shift[i]
            for j in range(2):
                moments[m, i, 1 + j] += spread[i, j] - shift[i] * shift[j]
