"""Refine hypotheses until their spots are those that their poses explain.

A hypothesis is a pose (rotation, position), a shift of the right image, the spot of each LED in
each image (-1 for none) and chi². Two steps alternate: Gauss-Newton steps on pose and shift with
the spots held (`fit_all`), and the choice of spots with the pose held (`gather_all`). Hypotheses
that come to the same spots are one; those beyond their chi² bound are dropped.
"""

import numpy as np
from numpy.typing import NDArray

from verify.core.records import Array
from verify.measurement.correspondence.kernels.fit import HypothesisArrays, fit_all, predict_all
from verify.measurement.correspondence.kernels.spots import count_all, gather_all

Index = NDArray[np.int64]
Flags = NDArray[np.bool_]
Cameras = tuple[Array, Array, Array]
Limits = tuple[tuple[float, float, float], tuple[float, float, float, float, float]]
# cameras as `fit_all` takes them; spots (2, s, 2) px, their covariance (2, s, 2, 2) px², and which
# are merged (2, s); which may be which LED (2, n, s); limits of `fit_all` and of `gather_all`;
# LEDs (n, 3), m, flange frame
SearchInputs = tuple[Cameras, tuple[Array, Array, Flags], Flags, Limits, Array]


def settle_all(
    inputs: SearchInputs, arrays: HypothesisArrays, steps: int, bounds: tuple[Array, Index]
) -> int:
    """Gather and fit until the spots are those of the poses; keep each good assignment once.

    Args:
        inputs: the images and the marker.
        arrays: h hypotheses, changed.
        steps: of a fit to begin with; below 0 there is none.
        bounds: as for `select_likely`.

    Returns:
        How many are kept: the first of `arrays`.
    """
    largest = inputs[3][1][3]
    if steps >= 0:
        _fit(inputs, arrays, steps)
    arrays[3][:] = _explained_spots(inputs, arrays, largest)
    arrays = _keep(arrays, best_of_each(arrays[6], arrays[3]))
    _fit(inputs, arrays, 1)
    spots = _explained_spots(inputs, arrays, largest)
    if spots.tobytes() != arrays[3].tobytes():
        arrays[3][:] = spots
        _fit(inputs, arrays, 2)
    arrays = _keep(arrays, select_likely(arrays[3], arrays[6], bounds[0], bounds[1]))
    return len(_keep(arrays, best_of_each(arrays[6], arrays[3]))[6])


def follow_all(
    inputs: SearchInputs, arrays: HypothesisArrays, bounds: tuple[Array, Index], settled: bool
) -> int:
    """Take the spots nearest to a predicted pose, alone and from what a search found.

    Args:
        inputs: the images and the marker.
        arrays: the prediction, then what the search found; changed.
        bounds: as for `select_likely`.
        settled: nothing is left to find, if the prediction's spots are those of the first found.

    Returns:
        How many are kept: the first of `arrays`.
    """
    first, found = _part(arrays, 0, 1), _part(arrays, 1, len(arrays[6]))
    first[3][:] = _explained_spots(inputs, first, np.inf)
    if settled and (first[3][0] == found[3][0]).all():
        _fit(inputs, arrays, 2)
        arrays = _keep(arrays, best_of_each(arrays[6], arrays[3]))
        _fit(inputs, arrays, 1)
        return len(arrays[6])
    _fit(inputs, found, 0)
    found[3][:] = _explained_spots(inputs, found, np.inf)
    _fit(inputs, arrays, 2)
    return settle_all(inputs, arrays, -1, bounds)


def best_of_each(chi2: Array, spot: Index) -> Index:
    """Number the best hypothesis of each assignment (h, 2, n), by rising chi² (h,)."""
    if len(chi2) < 2:
        return np.arange(len(chi2))
    first: dict[bytes, int] = {}
    for index in np.argsort(chi2, kind="stable").tolist():
        first.setdefault(spot[index].tobytes(), index)
    return np.array(list(first.values()))


def select_likely(spot: Index, chi2: Array, greatest: Array, determined: Index) -> Index:
    """Number the hypotheses that see an LED in both images and fit within their noise.

    Args:
        spot: (h, 2, n).
        chi2: (h,).
        greatest: chi² that is not improbable, by degrees of freedom.
        determined: (4,), degrees of freedom that none, one, two or more LEDs determine.
    """
    counts = np.empty((3, len(chi2)), np.int64)
    count_all(spot, counts)
    kept = []
    for h, (used, leds, both) in enumerate(counts.T.tolist()):
        freedom = max(2 * used - int(determined[min(leds, 3)]), 1)
        if both > 0 and chi2[h] <= greatest[freedom]:
            kept.append(h)
    return np.array(kept, dtype=np.int64)


def _part(arrays: HypothesisArrays, begin: int, end: int) -> HypothesisArrays:
    """Take the hypotheses from `begin` to `end`, as views."""
    rotation, position, shift, spot, hold, covariance, chi2 = arrays
    return (
        rotation[begin:end], position[begin:end], shift[begin:end], spot[begin:end],
        hold[begin:end], covariance[begin:end], chi2[begin:end],
    )  # fmt: skip


def _keep(arrays: HypothesisArrays, kept: Index) -> HypothesisArrays:
    """Move the hypotheses of these numbers to the front, and take those."""
    if kept.tolist() == list(range(len(arrays[6]))):
        return arrays
    for array in arrays:
        array[: len(kept)] = array[kept]
    return _part(arrays, 0, len(kept))


def _fit(inputs: SearchInputs, arrays: HypothesisArrays, steps: int) -> None:
    """Fit hypotheses in place by `fit_all`."""
    cameras, spots, _, limits, leds = inputs
    fit_all(cameras, (spots[0], spots[1]), limits[0], leds, arrays, steps)


def _explained_spots(inputs: SearchInputs, arrays: HypothesisArrays, largest: float) -> Index:
    """Find the spots (h, 2, n) that poses explain, by `gather_all`.

    An LED whose place is known worse than `largest` (px) gets none.
    """
    cameras, spots, allowed, limits, leds = inputs
    nearest, play, gate, _, cost = limits[1]
    bounds = nearest, play, gate, largest, cost
    rotation, position, shift, covariance = arrays[0], arrays[1], arrays[2], arrays[5]
    count, each = len(position), len(leds)
    image, depth = np.empty((count, 2, each, 2)), np.empty((count, 2, each))
    derivative = np.empty((count, 2, each, 2, covariance.shape[1]))
    predict_all(cameras, nearest, leds, rotation, position, shift, image, derivative, depth)
    spot = np.empty((count, 2, each), np.int64)
    gather_all(spots, allowed, bounds, (image, derivative, depth), covariance, spot)
    return spot
