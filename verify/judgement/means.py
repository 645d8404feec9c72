"""Each joint's mean error and how well it is known."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.distributions import t_ppf
from verify.judgement.model import Model
from verify.judgement.resolved import Resolved
from verify.records import Array
from verify.regression import solve
from verify.systematics import Systematics, root

TWO_SIGMA = 0.97725  # coverage of k = 2, one-sided
LARGE_SAMPLE = 50  # effective degrees of freedom above which k = 2 stands for 95 %


@dataclass(frozen=True, slots=True)
class JointErrors:
    """Per-pair joint errors (readings less measured), rad; nan where a pair does not tell."""

    error: Array  # (n, j)
    covariance: Array  # (n, j, j), random, of the error
    systematic: Array  # (n, j, p), d error / d prior column
    clock: Array  # (n, j), d error / d clock offset, rad/s


@dataclass(frozen=True, slots=True)
class Means:
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
    """Coverage factor for 95.45 %: 2 above LARGE_SAMPLE degrees of freedom, else Student's."""
    exact = t_ppf(TWO_SIGMA, np.maximum(np.nan_to_num(degrees, nan=np.inf), 1.0))
    factor: Array = np.where(degrees > LARGE_SAMPLE, 2.0, exact)
    return factor


def mean_errors(
    model: Model,
    errors: JointErrors,
    resolved: Resolved,
    clock_uncertainty: float | None,
    systematics: Systematics,
) -> Means:
    """Plain means over the pairs that tell a joint's error, else from a fit over the session.

    Args:
        model: the session's linear model.
        errors: joint errors a pair.
        resolved: the fit of all joints' errors, for joints that no pair tells.
        clock_uncertainty: s, of a clock offset that was estimated; None where it is given.
        systematics: for the degrees of freedom that the calibration states.
    """
    if is_fitted(model, errors):
        return _fitted(model, resolved)
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
        _calibrated(moved, systematics),
        systematics.degrees_of_freedom,
    )
    return Means(mean, covariance, spread, coverage_factor(degrees), pairs.astype(np.int64))


def is_fitted(model: Model, errors: JointErrors) -> bool:
    """Whether the means come from a fit over the session, as no pair tells some joint's error."""
    told = bool((~np.isnan(errors.error)).any(axis=0).all())
    return model.through_encoders or model.clock_open or not told


def _fitted(model: Model, resolved: Resolved) -> Means:
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
    return Means(mean, covariance, np.where(known, random, np.nan), factor, pairs)


def _calibrated(moved: Array, systematics: Systematics) -> Array:
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
    unit = root(systematics.covariance)
    sensitivity = moved[:, : unit.shape[1]] @ np.linalg.pinv(unit)
    variance: Array = np.einsum(
        "jp,pq,jq->j", sensitivity * found, systematics.covariance, sensitivity * found
    )
    return variance
