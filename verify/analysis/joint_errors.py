"""Each joint's mean error, and its error resolved by angle and direction of travel.

A tolerance bounds the error at every pose. The largest single pair is noise, and the mean hides
what changes with the angle; so the errors of all joints j are fitted at once,

    e_j(q, s) = c0 + c1 (q - q_mid) / (span / 2) + c2 s + c3 sin(q - q_mid) + c4 cos(q - q_mid),

with the terms that the motion can tell apart: angle q beyond MIN_SPAN, direction of travel s where
both occur, sine and cosine beyond MIN_SPAN_CIRCULAR.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from verify.analysis.comparison import Comparison
from verify.analysis.diagnosis.faults import Fault
from verify.analysis.least_squares import RegressionFit, solve
from verify.analysis.model import JointErrorModel
from verify.core.records import Array, Flags
from verify.core.statistics import chi2_isf, t_ppf

MIN_SPAN = np.deg2rad(2.0)  # a smaller turn shows no slope worth extrapolating within it
MIN_SPAN_CIRCULAR = np.deg2rad(60.0)  # docs/results.md: below that sine and cosine are a parabola
MIN_PAIRS_PER_DIRECTION = 3
MIN_PAIRS = 4  # fewer visits leave nothing to tell a slope from chance by
MIN_PAIRS_CIRCULAR = 8  # likewise with five terms a joint
TOL_SHAPE = 1e-6  # of a shape: what other terms leave of it by rounding
DISPLACEMENTS = ("base_moved", "base_drift", "led_body_slipped")  # three shifts, three turns
P_LACK_OF_FIT = 1e-3  # chance of calling a sound fit bad
P_TWO_SIGMA = 0.97725  # coverage of k = 2, one-sided
MIN_LARGE_DOF = 50  # effective degrees of freedom above which k = 2 stands for 95 %


@dataclass(frozen=True, slots=True)
class ResolvedErrors:
    """The fitted errors at each pair; nan where the data do not determine them. Radians."""

    error: Array  # (n, j)
    uncertainty: Array  # (n, j), standard, systematic part included
    covariance: Array  # (n, j, j), of the errors at one pair
    mean: Array  # (j,), over the pairs
    mean_covariance: Array  # (j, j), nan rows where the mean is nan
    swing: Array  # (j,), half the range of what is not constant; nan where that is not determined
    swing_uncertainty: Array  # (j,)
    terms: tuple[tuple[str, ...], ...]  # fitted terms a joint
    causes: tuple[Fault, ...]  # fitted with them
    common: Array  # (r, h), of unit variance: causes that were there before, of about their size
    lack_of_fit: bool
    misfit: float  # chi-squared a degree of freedom where the fit lacks, else 1
    fit: RegressionFit


def error_terms(
    comparison: Comparison, causes: Sequence[Fault] = ()
) -> tuple[list[tuple[str, ...]], list[Array]]:
    """The terms that a joint's motion can tell apart, and their columns (n, terms) a joint."""
    names, columns = [], []
    for j in range(comparison.q.shape[1]):
        q, direction = comparison.q[:, j], comparison.direction[:, j]
        terms, parts = ["constant"], [np.ones(len(q))]
        middle, span = (q.max() + q.min()) / 2, float(np.ptp(q))
        if span > MIN_SPAN and len(q) >= MIN_PAIRS:
            terms.append("angle")
            parts.append((q - middle) / (span / 2))
        counts = min(int(np.sum(direction > 0)), int(np.sum(direction < 0)))
        if counts >= MIN_PAIRS_PER_DIRECTION and len(q) >= MIN_PAIRS:
            terms.append("direction")
            parts.append(direction)
        if span > MIN_SPAN_CIRCULAR and len(q) >= MIN_PAIRS_CIRCULAR:
            terms += ["sine", "cosine"]
            parts += [np.sin(q - middle), np.cos(q - middle) - np.mean(np.cos(q - middle))]
        for cause in causes:
            if cause.joint != j + 1 or cause.shape is None:
                continue
            for shape in cause.shape.T:
                told = np.stack(parts, axis=1)
                left = shape - told @ np.linalg.lstsq(told, shape)[0]
                if np.linalg.norm(left) > TOL_SHAPE * np.linalg.norm(shape):
                    terms.append(cause.kind)
                    parts.append(shape / np.abs(shape).max())
        names.append(tuple(terms))
        columns.append(np.stack(parts, axis=1))
    return names, columns


def resolve_errors(model: JointErrorModel, causes: Sequence[Fault] = ()) -> ResolvedErrors:
    """Fit the resolved errors of all joints together, with what was registered.

    Of the causes, a joint's is a term of its error; a common one, or a link's, is no error of a
    joint, and takes off them what it explains. One that was there before the session is hardly
    determined beside the joints' constants: see `common_columns`.
    """
    names, columns = error_terms(model.comparison, causes)
    design, carried = resolved_design(model, causes)
    count = carried.shape[2]
    common = common_columns(model, causes)
    fit = solve(design, model.xi, np.concatenate([model.prior, common], axis=1))
    limit = chi2_isf(P_LACK_OF_FIT, max(fit.degrees_of_freedom, 1))
    lacking = bool(fit.chi2 > limit and fit.degrees_of_freedom > 0)
    # a fit that lacks knows its figures no better than it describes the pairs (Birge)
    misfit = fit.chi2 / fit.degrees_of_freedom if lacking else 1.0
    values, spread = fit.value[:count], fit.covariance[:count, :count] * misfit
    known = fit.estimable[:count]
    error, covariance = _errors_at(carried, values, spread, known)
    mean, mean_covariance = _errors_at(carried.mean(axis=0)[None], values, spread, known)
    swing, doubt = _half_range(columns, values, spread, known)
    return ResolvedErrors(
        error=error,
        uncertainty=np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)),
        covariance=covariance,
        mean=mean[0],
        mean_covariance=mean_covariance[0],
        swing=swing,
        swing_uncertainty=doubt,
        terms=tuple(names),
        causes=tuple(causes),
        common=common,
        lack_of_fit=lacking,
        misfit=misfit,
        fit=fit,
    )


def predict_errors(model: JointErrorModel, resolved: ResolvedErrors) -> Array:
    """The whitened errors that the fit describes, held columns included, (r,)."""
    free = resolved_design(model, resolved.causes)[0] @ resolved.fit.value
    held = np.concatenate([model.prior, resolved.common], axis=1)
    return free + held @ resolved.fit.held


def common_columns(model: JointErrorModel, causes: Sequence[Fault]) -> Array:
    """Columns (r, h) of the common causes that were there before the session, one size each.

    Held about zero by the size that a cause would have by itself (shifts and turns apart): what the
    pairs tell of it they tell, and the rest is doubt of the joints, not thousands of degrees.
    """
    held = [np.zeros((len(model.xi), 0))]
    for cause in causes:
        if cause.shape is not None or cause.begin is not None:
            continue
        alone = solve(np.concatenate([cause.columns, model.fitted], axis=1), model.xi, model.prior)
        square = (alone.value**2 + np.diag(alone.covariance))[: cause.freedom]
        groups = 2 if cause.kind in DISPLACEMENTS else 1
        sizes = np.sqrt([np.mean(part) for part in np.split(square, groups)])
        held.append(cause.columns * np.repeat(sizes, cause.freedom // groups))
    return np.concatenate(held, axis=1)


def resolved_design(model: JointErrorModel, causes: Sequence[Fault] = ()) -> tuple[Array, Array]:
    """Lay out the regression of the resolved errors.

    The whitened columns of all joints' terms and of what is fitted beside them, (r, k + f); and
    what a unit of each term is to each joint's error at each pair, (n, j, k).
    """
    _, columns = error_terms(model.comparison, causes)
    places = _column_offsets(columns)
    carried = np.zeros((len(columns[0]), len(columns), places[-1]))
    parts = []
    for j, terms in enumerate(columns):
        carried[:, j, places[j] : places[j + 1]] = terms
        varying = model.joints[:, [j]] * terms[model.white.pair]
        varying[:, 0] = model.offsets[:, j]  # the constant is what registration left of it
        parts.append(varying)
    beside = [c.columns for c in causes if c.shape is None and c.begin is not None]
    return np.concatenate([*parts, model.fitted, *beside], axis=1), carried


def _column_offsets(columns: list[Array]) -> list[int]:
    return [0, *np.cumsum([c.shape[1] for c in columns]).tolist()]


def _errors_at(carried: Array, values: Array, spread: Array, known: Flags) -> tuple[Array, Array]:
    """Errors and their covariance; nan where a term that counts there is not determined."""
    error = carried @ values
    covariance = carried @ spread @ np.swapaxes(carried, 1, 2)
    hidden = np.any(carried[:, :, ~known] != 0, axis=2)
    error[hidden] = np.nan
    covariance[hidden[:, :, None] | hidden[:, None, :]] = np.nan
    return error, covariance


def _half_range(
    columns: list[Array], values: Array, spread: Array, known: Flags
) -> tuple[Array, Array]:
    """Half the range of each joint's error less its constant, with its uncertainty."""
    places = _column_offsets(columns)
    swing, doubt = np.full(len(columns), np.nan), np.full(len(columns), np.nan)
    for j, terms in enumerate(columns):
        rest = slice(places[j] + 1, places[j + 1])
        if terms.shape[1] > 1 and known[rest].all():
            varying = terms[:, 1:] @ values[rest]
            contrast = (terms[np.argmax(varying), 1:] - terms[np.argmin(varying), 1:]) / 2
            swing[j] = contrast @ values[rest]
            doubt[j] = np.sqrt(contrast @ spread[rest, rest] @ contrast)
    return swing, doubt


@dataclass(frozen=True, slots=True)
class JointErrors:
    """How sure each pair's joint errors (readings less measured) are, rad."""

    covariance: Array  # (n, j, j), random
    systematic: Array  # (n, j, p), d error / d prior column
    clock: Array  # (n, j), d error / d clock offset, rad/s


def effective_degrees(
    total: Array, noise: Array, own: Array | float, calibrated: Array, stated: float
) -> Array:
    """Welch-Satterthwaite degrees of freedom of each mean, (j,); inf: without bound. GUM G.4.1.

    Of the variance `total` (j,), the part `noise` (j,) that the session itself shows is one
    estimate, of `own` (j,) degrees of freedom, and so is the part `calibrated` (j,) that one
    calibration found together, of `stated` ones (may be inf). What is stated without degrees of
    freedom has no bound.
    """
    below = np.asarray(noise**2 / own + calibrated**2 / stated)
    return np.asarray(np.divide(total**2, below, out=np.full(len(total), np.inf), where=below > 0))


def coverage_factor(degrees: Array) -> Array:
    """Coverage factor for 95.45 %: 2 above MIN_LARGE_DOF degrees of freedom, else Student's."""
    exact = t_ppf(P_TWO_SIGMA, np.maximum(np.nan_to_num(degrees, nan=np.inf), 1.0))
    return np.where(degrees > MIN_LARGE_DOF, 2.0, exact)


def mean_sensitivities(model: JointErrorModel, resolved: ResolvedErrors) -> Array:
    """Derivative of the mean errors by the whitened rows, (j, r); nan where not determined.

    Whatever moves the rows moves the means by these, so every source's share of a mean's variance
    is its own variance carried through them, and the shares add up.

    Source: GUM 5.1.3, sensitivity coefficients; means by generalised least squares.
    """
    design, carried = resolved_design(model, resolved.causes)
    free = np.zeros((carried.shape[1], design.shape[1]))
    free[:, : carried.shape[2]] = carried.mean(axis=0)
    held = np.concatenate([model.prior, resolved.common], axis=1)
    # W = (1 + H H')⁻¹ weighs rows by noise and held columns together
    inner = np.linalg.solve(np.eye(held.shape[1]) + held.T @ held, held.T)
    weighted = design.T - (design.T @ held) @ inner
    found: Array = free @ resolved.fit.covariance @ weighted
    return np.where(np.isnan(resolved.mean)[:, None], np.nan, found)
