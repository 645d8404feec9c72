"""The resolved error: what of each joint's error is a function of its angle and direction.

A tolerance bounds the error at every pose. The largest single pair is noise, the mean hides what
changes with the angle; so the errors of all joints are fitted at once, each by a constant, its
angle, its direction of travel, and sine and cosine where it turns far enough to tell them apart.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2 as chi2_distribution

from verify.comparison import Comparison
from verify.judgement.model import Model
from verify.records import Array
from verify.regression import Fit, solve

LEAST_SPAN = np.deg2rad(2.0)  # a smaller turn shows no slope worth extrapolating within it
CIRCULAR_SPAN = np.deg2rad(60.0)  # docs/results.md: below that sine and cosine are a parabola
LEAST_PAIRS_A_DIRECTION = 3
LACK_OF_FIT = 1e-3  # chance of calling a sound fit bad


@dataclass(frozen=True, slots=True)
class Resolved:
    """The fitted errors at each pair; nan where the data do not determine them. Radians."""

    error: Array  # (n, j)
    uncertainty: Array  # (n, j), standard, systematic part included
    covariance: Array  # (n, j, j), of the errors at one pair
    terms: tuple[tuple[str, ...], ...]  # fitted terms a joint
    lack_of_fit: bool
    chi2: float
    degrees_of_freedom: int
    fit: Fit


def basis(comparison: Comparison) -> tuple[list[tuple[str, ...]], list[Array]]:
    """The terms that a joint's motion can tell apart, and their columns (n, terms) a joint."""
    names, columns = [], []
    for j in range(comparison.q.shape[1]):
        q, direction = comparison.q[:, j], comparison.direction[:, j]
        terms, parts = ["constant"], [np.ones(len(q))]
        middle, span = (q.max() + q.min()) / 2, float(np.ptp(q))
        if span > LEAST_SPAN:
            terms.append("angle")
            parts.append((q - middle) / (span / 2))
        counts = min(int(np.sum(direction > 0)), int(np.sum(direction < 0)))
        if counts >= LEAST_PAIRS_A_DIRECTION:
            terms.append("direction")
            parts.append(direction)
        if span > CIRCULAR_SPAN:
            terms += ["sine", "cosine"]
            parts += [np.sin(q - middle), np.cos(q - middle) - np.mean(np.cos(q - middle))]
        names.append(tuple(terms))
        columns.append(np.stack(parts, axis=1))
    return names, columns


def resolve(model: Model, factor: float) -> Resolved:
    """Fit the resolved errors of all joints together, with what was registered.

    Args:
        model: the session's linear model.
        factor: inflation of the random variance by correlation from pair to pair.
    """
    comparison = model.comparison
    names, columns = basis(comparison)
    design = np.concatenate([_column(model, j, columns[j]) for j in range(len(columns))], axis=1)
    count = design.shape[1]
    design = np.concatenate([design, model.fitted], axis=1)
    fit = solve(design, model.xi, model.prior)
    scale = 1 / np.sqrt(factor)
    wide = solve(design * scale, model.xi * scale, model.prior * scale)
    error, uncertainty, covariance = _at_pairs(wide, columns, count)
    limit = chi2_distribution.isf(LACK_OF_FIT, max(fit.degrees_of_freedom, 1))
    return Resolved(
        error=error,
        uncertainty=uncertainty,
        covariance=covariance,
        terms=tuple(names),
        lack_of_fit=bool(fit.chi2 > limit and fit.degrees_of_freedom > 0),
        chi2=fit.chi2,
        degrees_of_freedom=fit.degrees_of_freedom,
        fit=fit,
    )


def _column(model: Model, j: int, terms: Array) -> Array:
    """Whitened columns of one joint's terms; the constant is what registration left of it."""
    pair = model.white.pair
    varying = model.joints[:, [j]] * terms[pair]
    varying[:, 0] = model.offsets[:, j]
    return varying


def _at_pairs(fit: Fit, columns: list[Array], count: int) -> tuple[Array, Array, Array]:
    """Fitted errors at every pair with their covariance."""
    n, joints = len(columns[0]), len(columns)
    places = np.cumsum([0] + [c.shape[1] for c in columns])
    spread = np.zeros((n, joints, count))
    for j, terms in enumerate(columns):
        spread[:, j, places[j] : places[j + 1]] = terms
    error = spread @ fit.value[:count]
    covariance = spread @ fit.covariance[:count, :count] @ np.swapaxes(spread, 1, 2)
    for j in range(joints):
        if not fit.estimable[places[j] : places[j + 1]].all():
            error[:, j] = np.nan
            covariance[:, j] = covariance[:, :, j] = np.nan
    uncertainty = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    return error, uncertainty, covariance
