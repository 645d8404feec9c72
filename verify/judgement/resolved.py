"""The resolved error: what of each joint's error is a function of its angle and direction.

A tolerance bounds the error at every pose. The largest single pair is noise, the mean hides what
changes with the angle; so the errors of all joints are fitted at once, each by a constant, its
angle, its direction of travel, and sine and cosine where it turns far enough to tell them apart.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.comparison import Comparison
from verify.distributions import chi2_isf
from verify.judgement.model import Model
from verify.records import Array
from verify.regression import Fit, solve

LEAST_SPAN = np.deg2rad(2.0)  # a smaller turn shows no slope worth extrapolating within it
CIRCULAR_SPAN = np.deg2rad(60.0)  # docs/results.md: below that sine and cosine are a parabola
LEAST_PAIRS_A_DIRECTION = 3
LEAST_PAIRS = 4  # fewer visits leave nothing to tell a slope from chance by
LEAST_PAIRS_CIRCULAR = 8  # likewise with five terms a joint
SIGNIFICANT = 4.0  # standard uncertainties: one false term in a thousand sessions
LACK_OF_FIT = 1e-3  # chance of calling a sound fit bad


@dataclass(frozen=True, slots=True)
class Resolved:
    """The fitted errors at each pair; nan where the data do not determine them. Radians."""

    error: Array  # (n, j)
    uncertainty: Array  # (n, j), standard, systematic part included
    covariance: Array  # (n, j, j), of the errors at one pair
    mean: Array  # (j,), over the pairs
    mean_covariance: Array  # (j, j)
    swing: Array  # (j,), half the range of what is not constant; nan where that is not determined
    swing_uncertainty: Array  # (j,)
    terms: tuple[tuple[str, ...], ...]  # fitted terms a joint
    significant: Array  # (r, s), whitened columns of the terms, constants apart, that are there
    lack_of_fit: bool
    misfit: float  # chi-squared a degree of freedom where the fit lacks, else 1
    fit: Fit


def basis(comparison: Comparison) -> tuple[list[tuple[str, ...]], list[Array]]:
    """The terms that a joint's motion can tell apart, and their columns (n, terms) a joint."""
    names, columns = [], []
    for j in range(comparison.q.shape[1]):
        q, direction = comparison.q[:, j], comparison.direction[:, j]
        terms, parts = ["constant"], [np.ones(len(q))]
        middle, span = (q.max() + q.min()) / 2, float(np.ptp(q))
        if span > LEAST_SPAN and len(q) >= LEAST_PAIRS:
            terms.append("angle")
            parts.append((q - middle) / (span / 2))
        counts = min(int(np.sum(direction > 0)), int(np.sum(direction < 0)))
        if counts >= LEAST_PAIRS_A_DIRECTION and len(q) >= LEAST_PAIRS:
            terms.append("direction")
            parts.append(direction)
        if span > CIRCULAR_SPAN and len(q) >= LEAST_PAIRS_CIRCULAR:
            terms += ["sine", "cosine"]
            parts += [np.sin(q - middle), np.cos(q - middle) - np.mean(np.cos(q - middle))]
        names.append(tuple(terms))
        columns.append(np.stack(parts, axis=1))
    return names, columns


def resolve(model: Model) -> Resolved:
    """Fit the resolved errors of all joints together, with what was registered."""
    names, columns = basis(model.comparison)
    parts = [_column(model, j, columns[j]) for j in range(len(columns))]
    count = sum(p.shape[1] for p in parts)
    fit = solve(np.concatenate([*parts, model.fitted], axis=1), model.xi, model.prior)
    limit = chi2_isf(LACK_OF_FIT, max(fit.degrees_of_freedom, 1))
    lacking = bool(fit.chi2 > limit and fit.degrees_of_freedom > 0)
    # a fit that lacks knows its figures no better than it describes the pairs (Birge)
    misfit = fit.chi2 / fit.degrees_of_freedom if lacking else 1.0
    values, spread = fit.value[:count], fit.covariance[:count, :count] * misfit
    known = fit.estimable[:count]
    carried = _carried(columns, count)
    error, covariance = _at(carried, values, spread, known)
    mean, mean_covariance = _at(carried.mean(axis=0)[None], values, spread, known)
    swing, doubt = _swing(columns, values, spread, known)
    return Resolved(
        error=error,
        uncertainty=np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)),
        covariance=covariance,
        mean=mean[0],
        mean_covariance=mean_covariance[0],
        swing=swing,
        swing_uncertainty=doubt,
        terms=tuple(names),
        significant=_significant(parts, values, spread, known),
        lack_of_fit=lacking,
        misfit=misfit,
        fit=fit,
    )


def predicted(model: Model, resolved: Resolved) -> Array:
    """The whitened errors that the fit describes, held columns included, (r,)."""
    _, columns = basis(model.comparison)
    parts = [_column(model, j, columns[j]) for j in range(len(columns))]
    free = np.concatenate([*parts, model.fitted], axis=1) @ resolved.fit.value
    described: Array = free + model.prior @ resolved.fit.held
    return described


def _column(model: Model, j: int, terms: Array) -> Array:
    """Whitened columns of one joint's terms; the constant is what registration left of it."""
    varying = model.joints[:, [j]] * terms[model.white.pair]
    varying[:, 0] = model.offsets[:, j]
    return varying


def _places(columns: list[Array]) -> list[int]:
    return [0, *np.cumsum([c.shape[1] for c in columns]).tolist()]


def _carried(columns: list[Array], count: int) -> Array:
    """What a unit of each term is to each joint's error at each pair, (n, j, terms)."""
    places = _places(columns)
    carried = np.zeros((len(columns[0]), len(columns), count))
    for j, terms in enumerate(columns):
        carried[:, j, places[j] : places[j + 1]] = terms
    return carried


def _at(
    carried: Array, values: Array, spread: Array, known: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Errors and their covariance; nan where a term that counts there is not determined."""
    error = carried @ values
    covariance = carried @ spread @ np.swapaxes(carried, 1, 2)
    hidden = np.any(carried[:, :, ~known] != 0, axis=2)
    error[hidden] = np.nan
    covariance[hidden[:, :, None] | hidden[:, None, :]] = np.nan
    return error, covariance


def _swing(
    columns: list[Array], values: Array, spread: Array, known: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Half the range of each joint's error less its constant, with its uncertainty."""
    places = _places(columns)
    swing, doubt = np.full(len(columns), np.nan), np.full(len(columns), np.nan)
    for j, terms in enumerate(columns):
        rest = slice(places[j] + 1, places[j + 1])
        if terms.shape[1] > 1 and known[rest].all():
            varying = terms[:, 1:] @ values[rest]
            contrast = (terms[np.argmax(varying), 1:] - terms[np.argmin(varying), 1:]) / 2
            swing[j] = contrast @ values[rest]
            doubt[j] = np.sqrt(contrast @ spread[rest, rest] @ contrast)
    return swing, doubt


def _significant(
    parts: list[Array], values: Array, spread: Array, known: NDArray[np.bool_]
) -> Array:
    """Columns of the terms, constants apart, that differ from 0 beyond doubt."""
    columns = np.concatenate(parts, axis=1)
    constant = np.concatenate([np.arange(p.shape[1]) == 0 for p in parts])
    size = np.abs(values) / np.sqrt(np.maximum(np.diag(spread), 1e-300))
    there = known & ~constant & (size > SIGNIFICANT)
    return columns[:, there]
