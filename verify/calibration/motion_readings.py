"""Which readings an interpolated one is made of: what two instants share of the readings' noise."""

import numpy as np
from numpy.typing import NDArray

from verify.readings import LONGEST_GAP, Readings
from verify.records import Array


def reading_variance(readings: Readings, resolution: float | None) -> Array:
    """Variance of one reading of each joint, (j,), rad²: its roughness, or its last digit."""
    variance: Array = np.maximum(readings.noise**2, (resolution or 0.0) ** 2 / 12)
    return variance


def weights(readings: Readings, t: Array) -> tuple[NDArray[np.int64], Array]:
    """Write interpolated readings as sums of readings.

    Args:
        readings: on the controller's clock.
        t: (n,), s.

    Returns:
        Indices (n, 4) and weights (n, 4) with readings.at(t) = sum of weight · q[index]. Where
        there are no four about an instant, the nearest alone.
    """
    last = len(readings.t) - 1
    after = np.clip(np.searchsorted(readings.t, t), min(1, last), last)
    before = np.maximum(after - 1, 0)
    early = t - readings.t[before] < readings.t[after] - t
    index = np.repeat(np.where(early, before, after)[:, None], 4, axis=1)
    weight = np.tile([1.0, 0.0, 0.0, 0.0], (len(t), 1))
    start = np.searchsorted(readings.t, t, side="right") - 1
    inner = (start >= 1) & (start + 2 <= last)
    rows = np.flatnonzero(inner)
    around = start[rows][:, None] + np.arange(-1, 3)
    times = readings.t[around]
    whole = (np.diff(times, axis=1) <= LONGEST_GAP).all(axis=1)
    rows, around, times = rows[whole], around[whole], times[whole]
    index[rows] = around
    weight[rows] = _hermite(times, t[rows])
    return index, weight


def _hermite(times: Array, t: Array) -> Array:
    """Weights of four readings (n, 4) in a cubic whose slopes are second-order differences."""
    before, span, after = np.diff(times, axis=1).T
    u = (t - times[:, 1]) / span
    early, late = _slope(before, span), _slope(span, after)
    weight = np.zeros((len(t), 4))
    weight[:, 1] = 2 * u**3 - 3 * u**2 + 1
    weight[:, 2] = 3 * u**2 - 2 * u**3
    weight[:, :3] += ((u**3 - 2 * u**2 + u) * span)[:, None] * early
    weight[:, 1:] += ((u**3 - u**2) * span)[:, None] * late
    return weight


def _slope(before: Array, after: Array) -> Array:
    """Weights of three readings in the slope at the middle one, (n, 3), as numpy.gradient's."""
    scale = before * after * (before + after)
    slope: Array = np.stack([-(after**2), after**2 - before**2, before**2], axis=1) / scale[:, None]
    return slope


def overlap(index: NDArray[np.int64], weight: Array) -> Array:
    """What instants (m) share of white reading noise of unit variance, (m, m)."""
    same = index[:, None, :, None] == index[None, :, None, :]
    shared: Array = np.einsum("abkl,ak,bl->ab", same, weight, weight)
    return shared
