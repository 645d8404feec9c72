"""Refine hypotheses until their spots are those that their poses explain, and score them.

Those beyond their chi² bound are dropped.
"""

from functools import lru_cache

import numpy as np

from verify.core.records import Array, Flags
from verify.core.statistics import chi2_bound
from verify.measurement.correspondence.hypotheses import Hypotheses
from verify.measurement.correspondence.kernels import entries as kernel
from verify.measurement.correspondence.kernels.entries import (
    ALIKE_CHI2,
    MERGED_COST,
    SPOT_REWARD,
    UNPAIRED_COST,
)
from verify.measurement.correspondence.views import SpotViews

P_REJECT = 1e-4  # chi² beyond this probability is not this marker
COARSE_SIGMA = 4e-3  # m, of an LED by a coarse pose: depth, with the images a few ms apart
SIDES = np.array([[0], [1]])


def refine(views: SpotViews, hypotheses: Hypotheses) -> Hypotheses:
    """Fit (in place), gather what each pose explains, fit again; drop what fails and doubles."""
    if len(hypotheses) == 0:
        return hypotheses
    bounds, arrays = chi2_bounds(len(views.leds)), (hypotheses.state, hypotheses.spot)
    return hypotheses.take(slice(kernel.refine(views.scene, views.limits, *arrays, bounds)))


def follow_prediction(
    views: SpotViews, found: Hypotheses, rig_T_flange: Array, position: float, rotation: float
) -> Hypotheses:
    """Take the spots nearest to a predicted pose (4, 4), alone and from what the search found.

    LEDs that one camera alone sees are looked for anew. `position`, m, and `rotation`, rad: the
    pose's standard uncertainty.
    """
    bounds, sigmas = chi2_bounds(len(views.leds)), (position, rotation, views.skew)
    arrays, pose = (found.state, found.spot), np.array(rig_T_flange, order="C")
    return Hypotheses(*kernel.follow(views.scene, views.limits, arrays, pose, sigmas, bounds))


@lru_cache(maxsize=8)
def chi2_bounds(leds: int) -> Array:
    """Greatest chi² of an assignment of so many LEDs, by its degrees of freedom from 0."""
    return np.array([0.0, *(chi2_bound(P_REJECT, dof) for dof in range(1, 4 * leds + 1))])


def merge(some: Hypotheses, followed: Hypotheses) -> Hypotheses:
    """Keep the best fit of each assignment of both; of poses that fit alike, the followed one."""
    if len(some) == len(followed) == 1 and some.spot.tobytes() == followed.spot.tobytes():
        return some if some.chi2.item() < followed.chi2.item() - ALIKE_CHI2 else followed
    same = (some.spot[:, None] == followed.spot).all(axis=(2, 3))
    better = some.chi2[:, None] < followed.chi2 - ALIKE_CHI2
    kept = followed.take(~(same & better).any(axis=0))
    beaten = (same & ~better).any(axis=1)
    return kept if beaten.all() else kept.join(some.take(~beaten))


def score(views: SpotViews, hypotheses: Hypotheses) -> Array:
    """Twice the negative log evidence of each, against clutter alone: the less the better."""
    used, leds, both = kernel.count_all(hypotheses.spot)
    merged = (hypotheses.spot >= 0) & views.merged[SIDES, hypotheses.spot]
    explained = SPOT_REWARD * used - MERGED_COST * merged.sum(axis=(1, 2))
    total: Array = hypotheses.chi2 + UNPAIRED_COST * (leds - both) - explained
    return total


def is_single_led(hypotheses: Hypotheses) -> Flags:
    """Say where one LED of several is all that both cameras see: any lamp would do as well."""
    several = hypotheses.spot.shape[2] > 1
    alone: Flags = several & (kernel.count_all(hypotheses.spot)[2] == 1)
    return alone


def conflicts(hypotheses: Hypotheses, best: int) -> Flags:
    """Say which hypotheses contradict one: another spot for an LED, or another LED for a spot."""
    theirs, mine = hypotheses.spot[:, :, :, None], hypotheses.spot[best][:, None]
    same_led = np.eye(mine.shape[-1], dtype=np.bool_)
    contrary = (theirs >= 0) & (mine >= 0) & ((theirs == mine) != same_led)
    return np.asarray(contrary.any(axis=(1, 2, 3)))


def departure(
    views: SpotViews, hypotheses: Hypotheses, rig_T_flange: Array, position: float, rotation: float
) -> Array:
    """Measure how far the LEDs of each hypothesis (h,) are from where a reference pose has them.

    Their mean is compared on the scale of `position` (m), their arrangement about it on that of
    `rotation` (rad): a symmetric marker's turn stands out however far the whole has moved. What
    the LEDs seen do not determine is left out.
    """
    return kernel.departures_of_all(
        views.leds,
        hypotheses.spot,
        hypotheses.state,
        np.array(rig_T_flange, order="C"),
        (position, rotation, COARSE_SIGMA),
    )
