"""Refine hypotheses until their spots are those that their poses explain, and score them.

Two steps alternate: Gauss-Newton steps on pose and shift with the spots held, and the choice of
spots with the pose held. Hypotheses that come to the same spots are one; those beyond their chi²
bound are dropped.
"""

import numpy as np
from numpy.typing import NDArray

from verify.core.records import Array
from verify.core.statistics import chi2_bound
from verify.measurement.correspondence.hypotheses import Hypotheses, start_hypotheses
from verify.measurement.correspondence.kernels import spots as kernel
from verify.measurement.correspondence.kernels.fit import fit_all
from verify.measurement.correspondence.kernels.points import MAX_DEVIATION, Index
from verify.measurement.correspondence.views import SpotViews

MIN_SKEW = 1e-3  # px: in effect simultaneous; avoids a division by zero
MIN_DEPTH = 0.02  # m, depth below which a point cannot be imaged
MAX_GATE = 10.0  # px, an LED predicted worse than this could be any spot
# 2 ln of how much denser spots are at an LED (half a px) than clutter (20 an image)
SPOT_REWARD = 20.0
MERGED_COST = 9.0  # of the same kind: a clean spot is taken unless it lies 3 sigma farther off
P_REJECT = 1e-4  # chi² beyond this probability is not this marker
UNPAIRED_COST = 7.0  # 2 ln 30: an LED in one camera's view is hidden from the other once in 30
COARSE_SIGMA = 4e-3  # m, of an LED by a coarse pose: depth, with the images a few ms apart
DOF_BY_LEDS = np.array([0, 3, 5, 6])  # degrees of freedom, by LEDs seen: three determine all
SIDES = np.array([[0], [1]])


def refine(views: SpotViews, hypotheses: Hypotheses) -> Hypotheses:
    """Fit (in place), gather what each pose explains, fit again; drop what fails and doubles."""
    if len(hypotheses) == 0:
        return hypotheses
    _fit(views, hypotheses, 2)  # steps: from a few mm off they leave 0.01 px
    return _settle(views, hypotheses)


def follow_prediction(
    views: SpotViews, found: Hypotheses, rig_T_flange: Array, position: float, rotation: float
) -> Hypotheses:
    """Take the spots nearest to a predicted pose (4, 4), alone and from what the search found.

    LEDs that one camera alone sees are looked for anew. `position`, m, and `rotation`, rad: the
    pose's standard uncertainty.
    """
    place = np.repeat([position, rotation], 3)
    none = np.full((1, 2, len(views.leds)), -1, dtype=np.int64)
    pose = rig_T_flange[None].copy()
    predicted = start_hypotheses(views, pose[:, :3, :3].copy(), pose[:, :3, 3].copy(), none, place)
    joined = predicted.join(found)
    joined.hold[:] = place**-2
    first, others = joined.take(slice(0, 1)), joined.take(slice(1, None))  # views of `joined`
    first.spot[:] = _explained_spots(views, first, np.inf)
    if _is_complete(views, found) and np.array_equal(first.spot[0], found.spot[0]):
        _fit(views, joined, 2)
        best = unique(joined)
        _fit(views, best, 1)
        return best
    _fit(views, others, 0)
    others.spot[:] = _explained_spots(views, others, np.inf)
    _fit(views, joined, 2)
    return _settle(views, joined)


def _is_complete(views: SpotViews, found: Hypotheses) -> bool:
    """Whether there is one assignment, every LED with a spot and no spot left, that fits well.

    So well that no assignment with an LED less would have more evidence.
    """
    return (
        len(found) == 1
        and views.pixels.shape[1] == len(views.leds)
        and found.chi2.item() < SPOT_REWARD + UNPAIRED_COST
        and found.spot.min() >= 0
    )


def _settle(views: SpotViews, hypotheses: Hypotheses) -> Hypotheses:
    """Gather and fit until the spots are those of the poses; keep each good assignment once."""
    hypotheses.spot[:] = _explained_spots(views, hypotheses, MAX_GATE)
    hypotheses = unique(hypotheses)
    _fit(views, hypotheses, 1)
    spots = _explained_spots(views, hypotheses, MAX_GATE)
    if not np.array_equal(spots, hypotheses.spot):
        hypotheses.spot[:] = spots
        _fit(views, hypotheses, 2)
    likely = select_likely(hypotheses.spot, hypotheses.chi2)
    return unique(hypotheses if len(likely) == len(hypotheses) else hypotheses.take(likely))


def unique(hypotheses: Hypotheses) -> Hypotheses:
    """Keep the best fit of each assignment: two poses of a flat marker may share one."""
    if len(hypotheses) < 2:
        return hypotheses
    first: dict[bytes, int] = {}
    for index in np.argsort(hypotheses.chi2, kind="stable").tolist():
        first.setdefault(hypotheses.spot[index].tobytes(), index)
    kept = list(first.values())
    return hypotheses.take(slice(kept[0], kept[0] + 1) if len(kept) == 1 else np.array(kept))


def merge(some: Hypotheses, others: Hypotheses) -> Hypotheses:
    """Keep the best fit of each assignment of both."""
    if len(some) == len(others) == 1 and np.array_equal(some.spot, others.spot):
        return others if others.chi2.item() < some.chi2.item() else some
    return unique(some.join(others))


def select_likely(spot: Index, chi2: Array) -> Index:
    """Number the hypotheses that see an LED in both images and fit within their noise.

    `spot` (h, 2, n); `chi2` (h,).
    """
    used, leds, both = kernel.count_all(spot)
    freedom = np.maximum(2 * used - DOF_BY_LEDS[np.minimum(leds, 3)], 1)
    bound = np.array([chi2_bound(P_REJECT, degrees) for degrees in freedom.tolist()])
    return np.flatnonzero((both > 0) & (chi2 <= bound))


def _fit(views: SpotViews, hypotheses: Hypotheses, steps: int) -> None:
    """Fit hypotheses in place by `fit_all`."""
    play = views.led_play * views.mean_focal
    limits = MIN_DEPTH, play, 1 / max(views.skew, MIN_SKEW) ** 2
    spots = views.pixels, views.covariance
    fit_all(views.cameras, spots, limits, views.leds, hypotheses.arrays, steps)


def _explained_spots(views: SpotViews, hypotheses: Hypotheses, largest: float) -> Index:
    """Find the spots (h, 2, n) that poses explain, by `gather_all`.

    An LED whose place is known worse than `largest` (px) gets none.
    """
    spots = views.pixels, views.covariance, views.merged
    limits = MIN_DEPTH, views.led_play * views.mean_focal, MAX_DEVIATION, largest, MERGED_COST
    return kernel.gather_all(
        views.cameras, spots, views.allowed, limits, views.leds, hypotheses.arrays
    )


def score(views: SpotViews, hypotheses: Hypotheses) -> Array:
    """Twice the negative log evidence of each, against clutter alone: the less the better."""
    used, leds, both = kernel.count_all(hypotheses.spot)
    merged = (hypotheses.spot >= 0) & views.merged[SIDES, hypotheses.spot]
    explained = SPOT_REWARD * used - MERGED_COST * merged.sum(axis=(1, 2))
    total: Array = hypotheses.chi2 + UNPAIRED_COST * (leds - both) - explained
    return total


def is_single_led(hypotheses: Hypotheses) -> NDArray[np.bool_]:
    """Say where one LED of several is all that both cameras see: any lamp would do as well."""
    several = hypotheses.spot.shape[2] > 1
    alone: NDArray[np.bool_] = several & (kernel.count_all(hypotheses.spot)[2] == 1)
    return alone


def conflicts(hypotheses: Hypotheses, best: int) -> NDArray[np.bool_]:
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
        (hypotheses.rotation, hypotheses.position),
        np.array(rig_T_flange, order="C"),
        (position, rotation, COARSE_SIGMA),
    )
