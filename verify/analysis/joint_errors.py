"""Each joint's mean error, and its error resolved by angle and direction of travel.

A tolerance bounds the error at every pose. The largest single pair is noise, and the mean hides
what changes with the angle; so the errors of all joints j are fitted at once,

    e_j(q, s) = c0 + c1 (q - q_mid) / (span / 2) + c2 s + c3 sin(q - q_mid) + c4 cos(q - q_mid),

with the terms that the motion can tell apart: angle q beyond MIN_SPAN, direction of travel s where
both occur, sine and cosine beyond MIN_SPAN_CIRCULAR.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.analysis.comparison import Comparison
from verify.analysis.least_squares import RegressionFit, solve
from verify.analysis.model import JointErrorModel
from verify.core.records import Array
from verify.core.statistics import chi2_isf, t_ppf
from verify.measurement.systematics import Systematics, covariance_root

MIN_SPAN = np.deg2rad(2.0)  # a smaller turn shows no slope worth extrapolating within it
MIN_SPAN_CIRCULAR = np.deg2rad(60.0)  # docs/results.md: below that sine and cosine are a parabola
MIN_PAIRS_PER_DIRECTION = 3
MIN_PAIRS = 4  # fewer visits leave nothing to tell a slope from chance by
MIN_PAIRS_CIRCULAR = 8  # likewise with five terms a joint
MIN_SIGNIFICANCE = 4.0  # standard uncertainties: one false term in a thousand sessions
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
    mean_covariance: Array  # (j, j)
    swing: Array  # (j,), half the range of what is not constant; nan where that is not determined
    swing_uncertainty: Array  # (j,)
    terms: tuple[tuple[str, ...], ...]  # fitted terms a joint
    significant: Array  # (r, s), whitened columns of the terms, constants apart, that are there
    lack_of_fit: bool
    misfit: float  # chi-squared a degree of freedom where the fit lacks, else 1
    fit: RegressionFit


def error_terms(comparison: Comparison) -> tuple[list[tuple[str, ...]], list[Array]]:
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
        names.append(tuple(terms))
        columns.append(np.stack(parts, axis=1))
    return names, columns


def resolve_errors(model: JointErrorModel) -> ResolvedErrors:
    """Fit the resolved errors of all joints together, with what was registered."""
    names, columns = error_terms(model.comparison)
    design, carried = resolved_design(model)
    count = carried.shape[2]
    fit = solve(design, model.xi, model.prior)
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
        significant=_significant(design[:, :count], columns, fit, misfit),
        lack_of_fit=lacking,
        misfit=misfit,
        fit=fit,
    )


def predict_errors(model: JointErrorModel, resolved: ResolvedErrors) -> Array:
    """The whitened errors that the fit describes, held columns included, (r,)."""
    free = resolved_design(model)[0] @ resolved.fit.value
    described: Array = free + model.prior @ resolved.fit.held
    return described


def resolved_design(model: JointErrorModel) -> tuple[Array, Array]:
    """Lay out the regression of the resolved errors.

    Returns:
        The whitened columns of all joints' terms and of what was fitted beside them, (r, k + f);
        and what a unit of each term is to each joint's error at each pair, (n, j, k).
    """
    _, columns = error_terms(model.comparison)
    places = _column_offsets(columns)
    carried = np.zeros((len(columns[0]), len(columns), places[-1]))
    parts = []
    for j, terms in enumerate(columns):
        carried[:, j, places[j] : places[j + 1]] = terms
        varying = model.joints[:, [j]] * terms[model.white.pair]
        varying[:, 0] = model.offsets[:, j]  # the constant is what registration left of it
        parts.append(varying)
    return np.concatenate([*parts, model.fitted], axis=1), carried


def _column_offsets(columns: list[Array]) -> list[int]:
    return [0, *np.cumsum([c.shape[1] for c in columns]).tolist()]


def _errors_at(
    carried: Array, values: Array, spread: Array, known: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Errors and their covariance; nan where a term that counts there is not determined."""
    error = carried @ values
    covariance = carried @ spread @ np.swapaxes(carried, 1, 2)
    hidden = np.any(carried[:, :, ~known] != 0, axis=2)
    error[hidden] = np.nan
    covariance[hidden[:, :, None] | hidden[:, None, :]] = np.nan
    return error, covariance


def _half_range(
    columns: list[Array], values: Array, spread: Array, known: NDArray[np.bool_]
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


def _significant(design: Array, columns: list[Array], fit: RegressionFit, misfit: float) -> Array:
    """Columns of the terms, constants apart, that differ from 0 beyond doubt."""
    count = design.shape[1]
    varying = np.ones(count, dtype=bool)
    varying[_column_offsets(columns)[:-1]] = False
    variance = np.diag(fit.covariance)[:count] * misfit
    size = np.abs(fit.value[:count]) / np.sqrt(np.maximum(variance, 1e-300))
    return design[:, fit.estimable[:count] & varying & (size > MIN_SIGNIFICANCE)]


@dataclass(frozen=True, slots=True)
class JointErrors:
    """Per-pair joint errors (readings less measured), rad; nan where a pair does not tell."""

    error: Array  # (n, j)
    covariance: Array  # (n, j, j), random, of the error
    systematic: Array  # (n, j, p), d error / d prior column
    clock: Array  # (n, j), d error / d clock offset, rad/s


@dataclass(frozen=True, slots=True)
class MeanErrors:
    """Mean errors, rad; nan where no data determine them."""

    mean: Array  # (j,)
    covariance: Array  # (j, j), nan rows where the mean is nan
    random: Array  # (j,), standard uncertainty from what averages out
    coverage_factor: Array  # (j,)
    pairs: NDArray[np.int64]  # (j,), in each joint's statistics


def effective_degrees(
    total: Array, noise: Array, own: Array | float, calibrated: Array, stated: float
) -> Array:
    """Welch-Satterthwaite degrees of freedom of each mean, (j,); inf: without bound. GUM G.4.1.

    The session's own noise is one estimate, and so is what one calibration found together; what
    is stated without degrees of freedom has no bound.

    Args:
        total: (j,), variance.
        noise: (j,), the part of it that the session itself shows.
        own: (j,), its degrees of freedom.
        calibrated: (j,), the part that one calibration found.
        stated: its degrees of freedom; may be inf.
    """
    below = np.asarray(noise**2 / own + calibrated**2 / stated)
    degrees: Array = np.divide(total**2, below, out=np.full(len(total), np.inf), where=below > 0)
    return degrees


def coverage_factor(degrees: Array) -> Array:
    """Coverage factor for 95.45 %: 2 above MIN_LARGE_DOF degrees of freedom, else Student's."""
    exact = t_ppf(P_TWO_SIGMA, np.maximum(np.nan_to_num(degrees, nan=np.inf), 1.0))
    factor: Array = np.where(degrees > MIN_LARGE_DOF, 2.0, exact)
    return factor


def mean_errors(
    model: JointErrorModel,
    errors: JointErrors,
    resolved: ResolvedErrors,
    clock_uncertainty: float | None,
    systematics: Systematics,
) -> MeanErrors:
    """Plain means over the pairs that tell a joint's error, else from a fit over the session.

    Args:
        model: the session's linear model.
        errors: joint errors a pair.
        resolved: the fit of all joints' errors, for joints that no pair tells.
        clock_uncertainty: s, of a clock offset that was estimated; None where it is given.
        systematics: for the degrees of freedom that the calibration states.
    """
    if is_fitted(model, errors):
        return _fitted_means(model, resolved)
    known = ~np.isnan(errors.error)
    pairs = known.sum(axis=0)
    weight = known / np.maximum(pairs, 1)
    mean = np.where(pairs > 0, np.sum(np.nan_to_num(errors.error) * weight, axis=0), np.nan)
    random = np.einsum("ni,nij,nj->ij", weight, np.nan_to_num(errors.covariance), weight)
    moved = np.einsum("ni,nip->ip", weight, np.nan_to_num(errors.systematic))
    covariance = random + moved @ moved.T
    if clock_uncertainty is not None:
        drift = (np.nan_to_num(errors.clock) * weight).sum(axis=0) * clock_uncertainty
        covariance = covariance + np.outer(drift, drift)
    covariance[pairs == 0] = covariance[:, pairs == 0] = np.nan
    spread = np.sqrt(np.diag(random))
    # six coordinates a pair share the noise estimate; the spots' own is known far better
    degrees = effective_degrees(
        np.diag(covariance),
        np.diag(random),
        np.maximum(6.0 * pairs - 6, 1.0),
        _calibration_variance(moved, systematics),
        systematics.degrees_of_freedom,
    )
    return MeanErrors(mean, covariance, spread, coverage_factor(degrees), pairs.astype(np.int64))


def is_fitted(model: JointErrorModel, errors: JointErrors) -> bool:
    """Whether the means come from a fit over the session, as no pair tells some joint's error."""
    told = bool((~np.isnan(errors.error)).any(axis=0).all())
    return model.through_encoders or model.clock_open or not told


def _fitted_means(model: JointErrorModel, resolved: ResolvedErrors) -> MeanErrors:
    """Means by weighted least squares over the session.

    With a registration through the encoders, constant offsets of all joints together with what was
    registered; else the mean of the resolved errors, which gain and backlash do not mislead.
    """
    joints = model.joints.shape[1]
    design = np.concatenate([model.offsets, model.fitted], axis=1)
    fit = solve(design, model.xi, model.prior)
    random = np.sqrt(np.maximum(np.diag(solve(design, model.xi).covariance)[:joints], 0.0))
    if model.through_encoders:
        known = fit.estimable[:joints]
        mean, covariance = fit.value[:joints], fit.covariance[:joints, :joints].copy()
    else:
        known = ~np.isnan(resolved.mean)
        mean, covariance = resolved.mean, resolved.mean_covariance.copy()
    mean = np.where(known, mean, np.nan)
    covariance[~known] = covariance[:, ~known] = np.nan
    pairs = np.full(joints, len(model.comparison))
    # the fit weighs sources against each other; `budget` takes the calibration's part of it out
    degrees = np.full(joints, float(fit.degrees_of_freedom))
    factor = coverage_factor(degrees)
    return MeanErrors(mean, covariance, np.where(known, random, np.nan), factor, pairs)


def _calibration_variance(moved: Array, systematics: Systematics) -> Array:
    """Variance (j,) of the plain means from all that one calibration found.

    A session's budget knows the rig file and counts its parameters; here, where a plan has no
    budget yet, their names tell: LED positions are the calibration's where no LED body is stated
    beside them.

    Args:
        moved: (j, p), of columns of unit variance, those of the stated parameters first.
        systematics: stated parameters.
    """
    body = "LED body" in systematics.sources
    own = {"rig", "robot base"} if body else {"rig", "robot base", "LED positions"}
    found = np.array([source in own for source in systematics.sources], dtype=float)
    unit = covariance_root(systematics.covariance)
    sensitivity = moved[:, : unit.shape[1]] @ np.linalg.pinv(unit)
    variance: Array = np.einsum(
        "jp,pq,jq->j", sensitivity * found, systematics.covariance, sensitivity * found
    )
    return variance
