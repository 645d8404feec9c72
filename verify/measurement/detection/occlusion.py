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

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.core.records import Array
from verify.measurement.detection.fit import SpotFit
from verify.measurement.detection.kernels import occlusion
from verify.measurement.detection.quality import SpotQuality

N_DIRECTIONS = 24  # round the rim: steps of 15°, under a bite's own width
ANGLES = 2 * np.pi / N_DIRECTIONS * np.arange(N_DIRECTIONS)
DIRECTION_VECTORS = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])
OCCLUSION_WIDTH = 0.3  # rad, standard deviation: a stalk of a third to a half of its LED's diameter
RIM_RADIUS = 1.8  # half-widths: no rim beyond
MIN_INFORMATION = 0.05  # share of a bite's information that the fit's own parameters must leave
PRIOR_DEPTH = 0.05  # half-widths, scale of what is expected; far deeper ones show without a prior
P_SHARED = 0.1  # prior probability that something hides one side of an image's LEDs
P_OCCLUDED = 0.8  # of an LED's being bitten then
P_SINGLE = 0.02  # of an LED's being bitten, when nothing is shared


@dataclass(frozen=True, slots=True)
class RimScore:
    """Log-likelihood of a bite in each direction, first order in its depth in half-widths."""

    gradient: Array  # (n, N_DIRECTIONS), of the log-likelihood, other parameters following
    information: Array  # (n, N_DIRECTIONS)
    pull: Array  # (n, N_DIRECTIONS, 2), px a depth, by which the centre moves when it is granted


def no_rim_scores(n: int) -> RimScore:
    """Rim scores of n spots without information."""
    shape = n, N_DIRECTIONS
    return RimScore(np.zeros(shape), np.zeros(shape), np.zeros((*shape, 2)))


def score_directions(
    state: SpotFit, numbers: NDArray[np.int64], kept: SpotQuality, score: RimScore
) -> None:
    """Compute the rim scores from residuals; 0 for spots without one LED's shape.

    Args:
        state: fits of some spots.
        numbers: (n,), of the spots among these fits; what is no number of theirs is elsewhere.
        kept: what is told of the n spots. Where the reduced chi² is above 1, unmodelled errors
            make the pixels worth less.
        score: of the n spots, filled where a rim is asked.
    """
    occlusion.score_all(
        numbers, kept.told, state.parameters, state.information, state.gradient, state.known,
        state.whitened, DIRECTION_VECTORS,
        (RIM_RADIUS, OCCLUSION_WIDTH, MIN_INFORMATION),
        (score.gradient, score.information, score.pull),
    )  # fmt: skip


def unoccluded_centres(score: RimScore) -> tuple[Array, Array]:
    """Average over all bites that an image's spots may have.

    Returns:
        What to add to the centres for those of the whole discs, (n, 2) px, and to their
        covariances, (n, 2, 2) px².
    """
    if not len(score.gradient):
        return np.zeros((0, 2)), np.zeros((0, 2, 2))
    evidence, depth, depth2 = depth_posterior(score)
    shift, doubt = np.empty((len(evidence), 2)), np.empty((len(evidence), 2, 2))
    occlusion.average_shifts(
        occlusion_probability(evidence),
        depth,
        depth2,
        np.ascontiguousarray(score.pull),
        shift,
        doubt,
    )
    return shift, doubt


def depth_posterior(score: RimScore) -> tuple[Array, Array, Array]:
    """Log evidence of a bite against none, and its depth's posterior mean and mean square.

    The half-normal prior and the Gaussian likelihood make a normal law cut off at 0.
    """
    shape = score.gradient.shape
    evidence, mean, square = np.empty(shape), np.empty(shape), np.empty(shape)
    occlusion.fill_depth_posterior(
        np.ascontiguousarray(score.gradient), np.ascontiguousarray(score.information), PRIOR_DEPTH,
        evidence, mean, square,
    )  # fmt: skip
    return evidence, mean, square


def occlusion_probability(evidence: Array) -> Array:
    """Posterior probability of each spot's bite in each direction, (n, N_DIRECTIONS)."""
    probability = np.empty_like(evidence)
    occlusion.share_probability(
        np.ascontiguousarray(evidence), (P_SHARED, P_OCCLUDED, P_SINGLE), probability
    )
    return probability
