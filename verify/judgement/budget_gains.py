"""How each joint's mean error follows from the pairs: sensitivities that a budget starts from."""

import numpy as np
from numpy.typing import NDArray

from verify.judgement.means import JointErrors, is_fitted
from verify.judgement.model import Model
from verify.judgement.resolved import Resolved, basis
from verify.records import Array
from verify.regression import solve


def gains(model: Model, errors: JointErrors, resolved: Resolved, inverse: Array) -> Array:
    """Derivative of the mean errors by each pair's twist xi, (n, j, 6); nan where not determined.

    Whatever moves the twists moves the means by these, so every source's share of a mean's variance
    is its own variance carried through them, and the shares add up.

    Args:
        model: the session's linear model.
        errors: joint errors a pair.
        resolved: the fit that means come from where no pair tells some joint's error.
        inverse: (n, j, 6), d joints / d pose.

    Source: GUM 5.1.3, sensitivity coefficients; means by generalised least squares.
    """
    if not is_fitted(model, errors):
        known: NDArray[np.bool_] = ~np.isnan(errors.error)
        weight = known / known.sum(axis=0)  # every joint is told by some pair
        plain: Array = weight[:, :, None] * inverse
        return plain
    return _a_pair(model, _fitted(model, resolved))


def _fitted(model: Model, resolved: Resolved) -> Array:
    """Derivative of the fitted means by the whitened rows, (j, r)."""
    joints = model.joints.shape[1]
    if model.through_encoders:
        design, chosen = np.concatenate([model.offsets, model.fitted], axis=1), np.eye(joints)
    else:
        design, chosen = _resolved_design(model)
    free = np.zeros((joints, design.shape[1]))
    free[:, : chosen.shape[1]] = chosen
    fit = solve(design, model.xi, model.prior)
    held = model.prior
    # W = (1 + H H')⁻¹ weighs rows by noise and held columns together
    inner = np.linalg.solve(np.eye(held.shape[1]) + held.T @ held, held.T)
    weighted = design.T - (design.T @ held) @ inner
    found: Array = free @ fit.covariance @ weighted
    known = fit.estimable if model.through_encoders else fit.estimable | (free == 0).all(axis=0)
    hidden = np.any(free[:, ~known] != 0, axis=1)
    if not model.through_encoders:
        hidden |= np.isnan(resolved.mean)
    return np.where(hidden[:, None], np.nan, found)


def _resolved_design(model: Model) -> tuple[Array, Array]:
    """Columns of the resolved errors' terms with what was fitted, and their means, (j, terms)."""
    _, columns = basis(model.comparison)
    count = sum(c.shape[1] for c in columns)
    parts, chosen, start = [], np.zeros((len(columns), count)), 0
    for j, terms in enumerate(columns):
        varying = model.joints[:, [j]] * terms[model.white.pair]
        varying[:, 0] = model.offsets[:, j]
        parts.append(varying)
        chosen[j, start : start + terms.shape[1]] = terms.mean(axis=0)
        start += terms.shape[1]
    return np.concatenate([*parts, model.fitted], axis=1), chosen


def _a_pair(model: Model, by_row: Array) -> Array:
    """Take derivatives by whitened rows (j, r) to those by the pairs' twists, (n, j, 6)."""
    factors = model.white.factors
    ends = np.cumsum([len(f) for f in factors])
    parts = np.split(by_row, ends[:-1], axis=1)
    return np.array([part @ factor for part, factor in zip(parts, factors, strict=True)])
