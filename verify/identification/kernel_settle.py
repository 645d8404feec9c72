"""Hypotheses settled on their spots, compiled: what `polish` and `follow` of hypotheses.py do."""

import numpy as np
from numpy.typing import NDArray

from verify.compiled import compiled
from verify.identification.kernel import fit_all, predict_all
from verify.identification.kernel_spots import count_all, gather_all
from verify.records import Array

Index = NDArray[np.int64]
Flags = NDArray[np.bool_]
Cameras = tuple[Array, Array, Array]
# rotation, position, shift, spot, hold, covariance and chi² of hypotheses, as there
Laid = tuple[Array, Array, Array, Index, Array, Array, Array]
Limits = tuple[tuple[float, float, float], tuple[float, float, float, float, float]]
# cameras as `fit_all` takes them; spots (2, s, 2) px, their covariance (2, s, 2, 2) px², and which
# are merged (2, s); which may be which LED (2, n, s); the limits of `fit_all` and of `gather_all`;
# LEDs (n, 3), m, flange frame
Asked = tuple[Cameras, tuple[Array, Array, Flags], Flags, Limits, Array]


@compiled
def part_of(laid: Laid, begin: int, end: int) -> Laid:
    """Some of the hypotheses, not copied."""
    rotation, position, shift, spot, hold, covariance, chi2 = laid
    return (
        rotation[begin:end], position[begin:end], shift[begin:end], spot[begin:end],
        hold[begin:end], covariance[begin:end], chi2[begin:end],
    )  # fmt: skip


@compiled
def fit_laid(asked: Asked, laid: Laid, steps: int) -> None:
    """Fit hypotheses in place, see `fit_all`."""
    cameras, seen, _, limits, leds = asked
    rotation, position, shift, spot, hold, covariance, chi2 = laid
    fit_all(
        cameras, (seen[0], seen[1]), limits[0], leds, rotation, position, shift, spot, hold,
        steps, covariance, chi2,
    )  # fmt: skip


@compiled
def spots_of(asked: Asked, laid: Laid, largest: float) -> Index:
    """Spots (h, 2, n) that the poses of hypotheses explain, see `gather_all`.

    An LED whose place is known worse than `largest` (px) gets none.
    """
    cameras, seen, allowed, limits, leds = asked
    nearest, play, gate, _, cost = limits[1]
    bounds = nearest, play, gate, largest, cost
    rotation, position, shift, covariance = laid[0], laid[1], laid[2], laid[5]
    count, each = len(position), len(leds)
    image, depth = np.empty((count, 2, each, 2)), np.empty((count, 2, each))
    derivative = np.empty((count, 2, each, 2, covariance.shape[1]))
    predict_all(cameras, nearest, leds, rotation, position, shift, image, derivative, depth)
    spot = np.empty((count, 2, each), np.int64)
    gather_all(seen, allowed, bounds, (image, derivative, depth), covariance, spot)
    return spot


@compiled
def first_of_each(chi2: Array, spot: Index) -> Index:
    """Number the best hypothesis of each assignment, by rising chi²."""
    kept, count = np.arange(len(chi2)), 0
    if len(chi2) < 2:
        return kept
    for index in np.argsort(chi2, kind="mergesort"):
        known = False
        for k in range(count):
            known = known or bool(np.all(spot[index] == spot[kept[k]]))
        if not known:
            kept[count] = index
            count += 1
    return kept[:count]


@compiled
def likely(spot: Index, chi2: Array, greatest: Array, determined: Index) -> Index:
    """Number the hypotheses that see an LED in both images and fit within their noise.

    Args:
        spot: (h, 2, n).
        chi2: (h,).
        greatest: chi² that is not improbable, by degrees of freedom.
        determined: (4,), degrees of freedom that none, one, two or more LEDs determine.
    """
    counts, kept, count = np.empty((3, len(chi2)), np.int64), np.arange(len(chi2)), 0
    count_all(spot, counts)
    for h in range(len(chi2)):
        freedom = max(2 * counts[0, h] - determined[min(counts[1, h], 3)], 1)
        if counts[2, h] > 0 and chi2[h] <= greatest[freedom]:
            kept[count] = h
            count += 1
    return kept[:count]


@compiled
def kept_of(laid: Laid, kept: Index) -> Laid:
    """Bring the hypotheses of these numbers to the begin; gives them."""
    rotation, position, shift, spot, hold, covariance, chi2 = laid
    count = len(kept)
    rotation[:count], position[:count], shift[:count] = rotation[kept], position[kept], shift[kept]
    spot[:count], hold[:count] = spot[kept], hold[kept]
    covariance[:count], chi2[:count] = covariance[kept], chi2[kept]
    return part_of(laid, 0, count)


@compiled
def settle_all(asked: Asked, laid: Laid, steps: int, bounds: tuple[Array, Index]) -> int:
    """Gather and fit until the spots are those of the poses; keep each good assignment once.

    Args:
        asked: the images and the marker.
        laid: h hypotheses, changed.
        steps: of a fit to begin with; below 0 there is none.
        bounds: as for `likely`.

    Returns:
        How many are kept: the first of `laid`.
    """
    largest = asked[3][1][3]
    if steps >= 0:
        fit_laid(asked, laid, steps)
    laid[3][:] = spots_of(asked, laid, largest)
    laid = kept_of(laid, first_of_each(laid[6], laid[3]))
    fit_laid(asked, laid, 1)
    again = spots_of(asked, laid, largest)
    if np.any(again != laid[3]):
        laid[3][:] = again
        fit_laid(asked, laid, 2)
    laid = kept_of(laid, likely(laid[3], laid[6], bounds[0], bounds[1]))
    return len(kept_of(laid, first_of_each(laid[6], laid[3]))[6])


@compiled
def follow_all(asked: Asked, laid: Laid, bounds: tuple[Array, Index], settled: bool) -> int:
    """Take the spots nearest to a predicted pose, alone and from what a search found.

    Args:
        asked: the images and the marker.
        laid: the prediction, then what the search found; changed.
        bounds: as for `likely`.
        settled: nothing is left to find, if the prediction's spots are those of the first found.

    Returns:
        How many are kept: the first of `laid`.
    """
    first, found = part_of(laid, 0, 1), part_of(laid, 1, len(laid[6]))
    first[3][:] = spots_of(asked, first, np.inf)
    if settled and np.all(first[3][0] == found[3][0]):
        fit_laid(asked, laid, 2)
        laid = kept_of(laid, first_of_each(laid[6], laid[3]))
        fit_laid(asked, laid, 1)
        return len(laid[6])
    fit_laid(asked, found, 0)
    found[3][:] = spots_of(asked, found, np.inf)
    fit_laid(asked, laid, 2)
    return settle_all(asked, laid, -1, bounds)
