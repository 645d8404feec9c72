"""Correct spot centres for an object that hides a sliver of the LED's rim.

Model, to first order in the depth d of a bite in direction k (24 directions round the rim):

    log L(d) = g_k d - i_k d² / 2,   d ~ half-normal(PRIOR_DEPTH),   d >= 0
    centre   = fitted centre + E[d] pull_k, averaged over no bite, one of the spot's own, and bites
               on one side of all spots, by their posterior probabilities

    symbol  meaning                                                        unit
    d       depth of the bite                                              half-widths
    g, i    gradient and information of the log-likelihood, `RimScore`     half-widths^-1, ^-2
    pull    shift of the centre a unit of depth, (2,)                      px

A bite adds harmonics to the rim's radius: the first shifts the centre, the second changes the
ellipse, the third and higher ones, which no whole disc has, reveal it. One spot seldom shows them
above its noise, but an object hides the same side of all LEDs of a marker. No threshold decides;
what remains uncertain enlarges the covariance.

Source: Hoeting et al., Bayesian model averaging: a tutorial, Statistical Science 14, 1999.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.core.records import Array
from verify.measurement.detection.fit import SpotFit
from verify.measurement.detection.kernels import occlusion as kernel

N_DIRECTIONS = 24  # round the rim: steps of 15°, under a bite's own width
ANGLES = 2 * np.pi / N_DIRECTIONS * np.arange(N_DIRECTIONS)
DIRECTION_VECTORS = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])


@dataclass(frozen=True, slots=True)
class RimScore:
    """Log-likelihood of a bite in each direction, first order in its depth in half-widths."""

    gradient: Array  # (n, N_DIRECTIONS), of the log-likelihood, other parameters following
    information: Array  # (n, N_DIRECTIONS)
    pull: Array  # (n, N_DIRECTIONS, 2), px a depth, by which the centre moves when it is granted


def score_rims(fits: Sequence[SpotFit], numbers: NDArray[np.int64], assessed: Array) -> RimScore:
    """Compute the rim scores of n spots from residuals; 0 for spots without one LED's shape.

    `fits` are of spots numbered on from fit to fit, `numbers` (n,) those to score; columns of
    `assessed` (n, 16) as in kernels/quality.py. Where the reduced chi² is above 1, unmodelled
    errors make the pixels worth less.
    """
    shape = len(numbers), N_DIRECTIONS
    score, begin = (np.zeros(shape), np.zeros(shape), np.zeros((*shape, 2))), 0
    for fit in fits:
        kernel.score_all(
            numbers - begin, assessed, fit.parameters, fit.information, fit.gradient, fit.model,
            fit.whitened, DIRECTION_VECTORS, score,
        )  # fmt: skip
        begin += len(fit.parameters)
    return RimScore(*score)


def unoccluded_centres(score: RimScore) -> tuple[Array, Array]:
    """Average over all bites that an image's spots may have.

    Gives what to add to the centres for those of the whole discs, (n, 2) px, and to their
    covariances, (n, 2, 2) px².
    """
    evidence, depth, depth2 = kernel.depth_posterior(score.gradient, score.information)
    probability = kernel.occlusion_probability(evidence)
    return kernel.average_shifts(probability, depth, depth2, score.pull)
