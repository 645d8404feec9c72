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
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from verify.core.records import Array
from verify.measurement.detection.fit import SpotFit
from verify.measurement.detection.kernels import occlusion as kernel

N_DIRECTIONS = 24  # round the rim: steps of 15°, under a bite's own width
ANGLES = 2 * np.pi / N_DIRECTIONS * np.arange(N_DIRECTIONS)
PRIOR_DEPTH = 0.05  # half-widths, scale of what is expected; far deeper ones show without a prior
P_SHARED = 0.1  # prior probability that something hides one side of an image's LEDs
P_OCCLUDED = 0.8  # of an LED's being bitten then
P_SINGLE = 0.02  # of an LED's being bitten, where no side is shared
DIRECTION_VECTORS = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])


def unoccluded_centres(
    fits: Sequence[SpotFit], numbers: NDArray[np.int64], assessed: Array
) -> tuple[Array, Array]:
    """Average over all bites that n spots of an image may have; none without one LED's shape.

    `fits` are of spots numbered on from fit to fit, `numbers` (n,) those meant; columns of
    `assessed` (n, 16) as in kernels/quality.py. Where the reduced chi² is above 1, unmodelled
    errors make the pixels worth less.

    Gives what to add to the centres for those of the whole discs, (n, 2) px, and to their
    covariances, (n, 2, 2) px².
    """
    shape, begin = (len(numbers), N_DIRECTIONS), 0
    gradient, information, pull = np.zeros(shape), np.zeros(shape), np.zeros((*shape, 2))
    for fit in fits:
        kernel.score_all(
            numbers - begin, assessed, fit.parameters, fit.information, fit.gradient, fit.model,
            fit.whitened, DIRECTION_VECTORS, (gradient, information, pull),
        )  # fmt: skip
        begin += len(fit.parameters)
    evidence, depth, square = depth_posterior(gradient, information)
    probability = occlusion_probability(evidence)
    shift = ((probability * depth)[:, None] @ pull)[:, 0]
    covariance = np.swapaxes(pull, 1, 2) @ ((probability * square)[..., None] * pull)
    return shift, covariance - shift[:, :, None] * shift[:, None]


def depth_posterior(gradient: Array, information: Array) -> tuple[Array, Array, Array]:
    """Suppose a bite of unknown depth in each direction of each spot, (n, d) throughout.

    The half-normal prior and the Gaussian likelihood make a normal law cut off at 0. Gives the
    log-likelihood ratio of a bite to none; the depth's posterior mean and mean square.
    """
    sigma = 1.0 / np.sqrt(information + PRIOR_DEPTH**-2)
    z = gradient * sigma
    cut_off = log_ndtr(z) + z * z / 2.0
    excess = z + np.exp(-cut_off) / np.sqrt(2.0 * np.pi)
    evidence = np.log(2.0 / PRIOR_DEPTH * sigma) + cut_off
    return evidence, sigma * excess, sigma * sigma * (1.0 + z * excess)


def occlusion_probability(evidence: Array) -> Array:
    """Posterior probability of each spot's bite in each direction, (n, d).

    Shared out among no bite, one of each spot's own, and bites on one side of all spots. `evidence`
    (n, d): log-likelihood ratio of each spot's bite in each direction to none.
    """
    hit = np.log(P_OCCLUDED) + evidence
    either = np.logaddexp(np.log(1.0 - P_OCCLUDED), hit)
    sides = np.log(P_SHARED / N_DIRECTIONS) + either.sum(axis=0)
    own = np.log(P_SINGLE / N_DIRECTIONS) + evidence
    free = np.logaddexp(np.log(1.0 - P_SINGLE), np.logaddexp.reduce(own, axis=1))
    alone = np.log(1.0 - P_SHARED) + free.sum()
    total = np.logaddexp(alone, np.logaddexp.reduce(sides))
    probability: Array = np.exp(sides - total + hit - either)
    probability += np.exp(alone - total + own - free[:, None])
    return probability
