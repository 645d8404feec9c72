"""Generalised least squares for sessions that share calibrations.

V = diag(scatter²) + one block a calibration, shared² in every place: an error of the rig moves all
its sessions alike. Each block is a diagonal plus a rank of one, so V⁻¹ is applied in one pass.

Source: Sherman and Morrison, Annals of Mathematical Statistics 21(1), 1950.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.fleet.series import Series
from verify.records import Array

SMALLEST_SHARE = 1e-9  # of a column that is left beside the others: less is rounding


def weighted(series: Series, columns: Array) -> Array:
    """Apply V⁻¹ to columns (n, m)."""
    weight = 1 / series.scatter**2
    result: Array = columns * weight[:, None]
    for inside, square in _blocks(series):
        share = square / (1 + square * weight[inside].sum())
        total = result[inside].sum(axis=0)
        result[inside] -= share * weight[inside][:, None] * total
    return result


def _blocks(series: Series) -> Iterator[tuple[NDArray[np.bool_], float]]:
    """Each calibration's sessions, and the variance that they share."""
    for group in np.unique(series.group):
        inside = series.group == group
        yield inside, float(np.mean(series.shared[inside] ** 2))


@dataclass(frozen=True, slots=True)
class Fit:
    """A linear model of one series."""

    coefficients: Array  # (p,)
    covariance: Array  # (p, p)
    chi2: float
    fitted: Array  # (n,)
    residual_weighted: Array  # (n,), V⁻¹ (y - fitted)
    shift: Array  # (n,), what each session's calibration is seen to add to the fit


def fit(series: Series, design: Array) -> Fit:
    """Fit columns (n, p) of full rank."""
    by_weight = weighted(series, design)
    covariance = np.asarray(np.linalg.inv(design.T @ by_weight), dtype=np.float64)
    coefficients = covariance @ (by_weight.T @ series.error)
    fitted = design @ coefficients
    residual = series.error - fitted
    residual_weighted = weighted(series, residual[:, None])[:, 0]
    shift = np.zeros(len(series))
    for inside, square in _blocks(series):
        shift[inside] = square * residual_weighted[inside].sum()  # its best linear prediction
    chi2 = float(residual @ residual_weighted)
    return Fit(coefficients, covariance, chi2, fitted, residual_weighted, shift)


@dataclass(frozen=True, slots=True)
class Scan:
    """What a step, or a drift, at each session alone would take off χ² beside a fit; (n,) each."""

    step: Array
    drift: Array


def scan(series: Series, months: Array, design: Array, found: Fit) -> Scan:
    """Try a step and a drift at every session, in one pass of sums from the end.

    A step at k is 1 from session k on; a drift at k is the time since session k, from there on. All
    products of such columns with V⁻¹ are sums over the sessions from k on.

    Args:
        series: n sessions in order of time.
        months: (n,), their time.
        design: (n, p), the columns of the fit.
        found: the fit.
    """
    by_weight = weighted(series, design)
    step_signal, drift_signal = _from(months, found.residual_weighted)
    step_common, drift_common = _from(months, by_weight)
    step_own, drift_own = _squares(series, months)
    return Scan(
        step=_gain(step_signal, step_common, step_own, found),
        drift=_gain(drift_signal, drift_common, drift_own, found),
    )


def _from(months: Array, values: Array) -> tuple[Array, Array]:
    """Σ v and Σ (t - t_k) v over the sessions from each k on."""
    t = months if values.ndim == 1 else months[:, None]
    plain = _suffix(values)
    return plain, _suffix(t * values) - t * plain


def _squares(series: Series, months: Array) -> tuple[Array, Array]:
    """Σ c V⁻¹ c for the step and the drift at each k."""
    weight = 1 / series.scatter**2
    plain, first = _suffix(weight), _suffix(weight * months)
    second = _suffix(weight * months**2) - months * (2 * first - months * plain)
    for inside, square in _blocks(series):
        part = np.where(inside, weight, 0.0)
        share = square / (1 + square * part.sum())
        steps, drifts = _from(months, part)
        plain, second = plain - share * steps**2, second - share * drifts**2
    return plain, second


def _gain(signal: Array, common: Array, own: Array, found: Fit) -> Array:
    left = own - np.einsum("np,pq,nq->n", common, found.covariance, common)
    there = left > SMALLEST_SHARE * own
    gain: Array = np.where(there, signal**2 / np.where(there, left, 1.0), 0.0)
    return gain


def _suffix(values: Array) -> Array:
    """Sums from each place to the end."""
    sums: Array = np.cumsum(values[::-1], axis=0)[::-1]
    return sums
