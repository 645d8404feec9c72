"""Which causes explain the errors, and which the data cannot tell apart.

A dictionary of faults is fitted to the whitened errors beside everything that was fitted or stated;
the set of least cost is taken, and each of its members is named only if no rival can stand in its
place. Pairs that follow no cause are listed and left out of the fit.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import robots
from verify.distributions import chi2_isf, chi2_ppf
from verify.judgement.causes import Cause, cause, one_ambiguous
from verify.judgement.diagnosis_search import Chosen, Products, search
from verify.judgement.diagnosis_thinned import thinned
from verify.judgement.faults import Fault
from verify.judgement.faults_dictionary import dictionary
from verify.judgement.model import Model
from verify.judgement.resolved import Resolved, predicted
from verify.records import Array
from verify.regression import solve
from verify.rig import Rig

__all__ = ["Cause", "Diagnosis", "examine"]

OUTLYING = 1e-3  # chance of listing any pair of a session without outliers
MOST_OUTLYING = 0.1  # of the pairs: more of them are no outliers, the fit lacks something
LACK_OF_FIT = 1e-3  # chance of doubting sound figures
ROUNDS = 6
MOST_PAIRS = 2000  # of a session; of longer ones so many, evenly spread
SETTLED = 0.01  # of the misfit


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What a session says of the causes of its errors."""

    causes: list[Cause]
    outlying: NDArray[np.int64]  # rows of the comparison that follow no cause
    misfit: float  # chi-squared a degree of freedom that the causes leave, where they lack; else 1
    products: Products


def examine(
    model: Model, resolved: Resolved, arm: robots.Arm | None = None, rig: Rig | None = None
) -> Diagnosis:
    """Find the set of causes that the data ask for, and say where they cannot tell which.

    Args:
        model: the session's linear model; everything stated counts through its prior.
        resolved: its smooth fit, from which pairs that lie outside are first told.
        arm: gives the link parameters that are tried.
        rig: says where the cameras stand, for the skew of their instants.

    Returns:
        Causes, pairs that lie outside, and the products that `detectable` takes.
    """
    residual = model.xi - predicted(model, resolved)
    chosen = np.arange(len(model.comparison))
    if len(chosen) > MOST_PAIRS:
        chosen = np.linspace(0, len(chosen) - 1, MOST_PAIRS).round().astype(np.int64)
        residual = residual[np.isin(model.white.pair, chosen)]
        model = thinned(model, chosen)
    faults = dictionary(model, arm, rig)
    outlying = _outlying(model, residual)
    for _ in range(ROUNDS):
        kept = ~np.isin(model.white.pair, outlying)
        products, best, misfit = _settled(model, faults, kept)
        again = _outlying(model, _residual(model, products, best, kept))
        if np.array_equal(again, outlying):
            break
        outlying = again
    causes = sorted((cause(products, best, i) for i in best), key=lambda c: -c.explains)
    return Diagnosis(one_ambiguous(causes), chosen[outlying], misfit, products)


def _settled(
    model: Model, faults: list[Fault], kept: NDArray[np.bool_]
) -> tuple[Products, Chosen, float]:
    """The best set at the misfit that it leaves: a fit that lacks accuses nobody by its noise."""
    plain = Products.of(model, faults, kept)
    misfit = 1.0
    for _ in range(ROUNDS):
        products = plain.doubted(misfit)
        best = search(products)
        degrees = products.rows - model.fitted.shape[1] - len(products.columns(best))
        left = plain.chi2(best)
        lacking = degrees > 0 and left > chi2_isf(LACK_OF_FIT, degrees)
        before, misfit = misfit, left / degrees if lacking else 1.0
        if misfit <= before * (1 + SETTLED):
            break
    return products, best, before


def _residual(model: Model, products: Products, best: Chosen, kept: NDArray[np.bool_]) -> Array:
    """Whitened errors (r,) of all pairs less what the causes and all fitted and stated make."""
    named = [products.faults[i].columns for i in best]
    free = np.concatenate([model.fitted, *named], axis=1)
    fit = solve(free[kept], model.xi[kept], model.prior[kept])
    residual: Array = model.xi - free @ fit.value - model.prior @ fit.held
    return residual


def _outlying(model: Model, residual: Array) -> NDArray[np.int64]:
    """Pairs (of the comparison) whose residual is too large for the others' scatter."""
    pair, count = model.white.pair, len(model.comparison)
    distance = np.bincount(pair, residual**2, minlength=count)
    known = np.bincount(pair, minlength=count)
    typical = chi2_ppf(0.5, np.maximum(known, 1))
    scatter = max(float(np.median(distance / typical)), 1.0)
    limit = scatter * chi2_isf(OUTLYING / count, np.maximum(known, 1))
    found = np.flatnonzero(distance > limit)
    return found if len(found) <= MOST_OUTLYING * count else found[:0]
