"""Predict what a session will show: every requested fault, flange and joints, and the sources.

A joint's angle of uncertainty U moves the flange by U times its lever, the distance between the
joint's axis and the flange.
"""

from dataclasses import dataclass, replace

import numpy as np

from verify.analysis.joint_errors import mean_sensitivities
from verify.analysis.least_squares import residual_products, solve
from verify.analysis.model import DETECTION_SIGMA, JointErrorModel, clock_effect, prior_columns
from verify.analysis.verdict import GUARD_FACTOR
from verify.calibration.kinematics.identifiability import (
    Identifiability,
    identifiability,
    information_root,
    observability_indices,
)
from verify.core.records import Array
from verify.planning.design import FaultKind, fault_kind, geometry_columns
from verify.planning.foresight import PredictedAnalysis, PredictedSession
from verify.planning.request import FAULT_KINDS, PlanningSetup

JOINT_KINDS = tuple(name for name in FAULT_KINDS if name not in ("kinematics", "clock"))
RANDOM_SOURCE, CLOCK_SOURCE, PAN_SOURCE = "pixels, alignment, readings", "clock", "pan angle"
TOL_COLUMN = 1e-6  # of a column's squared length: rounding
TOL_LEVER = 1e-6  # m: rounding of a flange that lies on the axis
GROUPS = {
    RANDOM_SOURCE: "pixels",
    "rig": "calibration",
    PAN_SOURCE: "calibration",
    "robot base": "registration",
    "LED body": "registration",
    "LED positions": "leds",
    "apparent LED centre": "leds",
    CLOCK_SOURCE: "clock",
}


@dataclass(frozen=True, slots=True)
class FaultPrediction:
    """One kind of fault of each joint; nan where this session would not show it. SI units."""

    name: str
    unit: str
    scale: float  # SI units in one of `unit`
    standard_uncertainty: Array  # (j,), all requested kinds fitted together
    detectable: Array  # (j,), alone


@dataclass(frozen=True, slots=True)
class ClockPrediction:
    """How well the encoders' clock would be known; s, None where the motion does not show it."""

    standard_uncertainty: float | None
    detectable: float | None  # of an error of a clock that is given
    source: str


@dataclass(frozen=True, slots=True)
class PredictedIdentifiability:
    """The arm's parameters that could be identified, beside what rig and marker leave open."""

    standard_uncertainty: Array  # m or rad, of the supported ones
    support: Identifiability
    indexes: dict[str, float]


def predict_faults(model: JointErrorModel, observe: tuple[str, ...]) -> list[FaultPrediction]:
    """Predict every requested kind of fault of single joints."""
    kinds = [fault_kind(name, model) for name in JOINT_KINDS if name in observe]
    if not kinds:
        return []
    columns = [part for one in kinds for part in one.columns]
    fit = solve(np.concatenate([*columns, model.fitted], axis=1), model.xi, model.prior)
    joints = model.joints.shape[1]
    found, start = [], 0
    for one in kinds:
        places = [
            slice(start + joints * k, start + joints * (k + 1)) for k in range(len(one.columns))
        ]
        start += joints * len(one.columns)
        uncertainty = np.full(joints, np.nan)
        for j in range(joints):
            own = [place.start + j for place in places]
            if fit.estimable[own].all():
                uncertainty[j] = np.sqrt(np.linalg.eigvalsh(fit.covariance[np.ix_(own, own)])[-1])
        found.append(
            FaultPrediction(one.name, one.unit, one.scale, uncertainty, _detectable(model, one))
        )
    return found


def _detectable(model: JointErrorModel, one: FaultKind) -> Array:
    """Smallest detectable fault of each joint alone, at its worst phase, (j,)."""
    joints = model.joints.shape[1]
    smallest = np.full(joints, np.nan)
    for j in range(joints):
        columns = np.stack([part[:, j] for part in one.columns], axis=1)
        left = np.linalg.eigvalsh(residual_products(model.fitted, model.prior, [columns]))[0]
        if left > TOL_COLUMN * np.sum(columns**2) > 0:
            smallest[j] = DETECTION_SIGMA / np.sqrt(left)
    return smallest


def predict_clock(session: PredictedSession) -> ClockPrediction:
    """Predict how well the motion tells the encoders' clock."""
    clock, model = session.clock, session.model
    if clock.source != "given":
        return ClockPrediction(clock.standard_uncertainty, None, clock.source)
    column = model.white.rows(clock_effect(session.comparison))
    others = np.concatenate([model.offsets, model.fitted], axis=1)
    left = float(residual_products(others, model.prior, [column])[0, 0])
    visible = left > TOL_COLUMN * float(np.sum(column**2)) > 0
    smallest = DETECTION_SIGMA / float(np.sqrt(left)) if visible else None
    return ClockPrediction(clock.standard_uncertainty, smallest, clock.source)


def predict_geometry(setup: PlanningSetup, model: JointErrorModel) -> PredictedIdentifiability:
    """Predict which of the arm's parameters `verify identify` could find, and how well."""
    parameters, columns = geometry_columns(setup, model)
    size = np.linalg.norm(model.fitted, axis=0)
    # found with them, as good as free
    loose = model.fitted / np.where(size > 0, size, 1.0) / TOL_COLUMN
    information = information_root(columns, np.concatenate([model.prior, loose], axis=1))
    supported = identifiability(parameters, information)
    own = [parameters.index(p) for p in supported.supported]
    tolerance = np.array([p.tolerance for p in supported.supported])
    _, size, vt = np.linalg.svd(information[:, own], full_matrices=False)
    spread = np.linalg.norm(vt.T / size, axis=1) * tolerance
    indexes = observability_indices(information[:, own], len(model.comparison))
    return PredictedIdentifiability(spread, supported, indexes)


def uncertainty_sources(session: PredictedSession, analysis: PredictedAnalysis) -> dict[str, Array]:
    """Split the mean errors' uncertainties by source: the squares add up where all are stated.

    Standard uncertainty (j,), rad, each; nan where the mean is not known.
    """
    found = {RANDOM_SOURCE: analysis.means.random}
    by_row = mean_sensitivities(session.model, analysis.resolved)
    for name, columns in _columns(session).items():
        share: Array = np.linalg.norm(by_row @ session.model.white.rows(columns), axis=1)
        if np.any(share > 0):
            found[name] = share
    return found


def _columns(session: PredictedSession) -> dict[str, Array]:
    """Each source's columns of unit variance (n, 6, p)."""
    comparison, clock = session.comparison, session.clock
    parts: dict[str, Array] = {}
    stated, exact = session.systematics, replace(clock, standard_uncertainty=None)
    still = replace(comparison, alignment_error=np.zeros_like(comparison.alignment_error))
    still_pan = np.full(2, np.nan)
    for source in dict.fromkeys(stated.sources):
        keep = np.array([one == source for one in stated.sources])
        own = replace(stated, covariance=stated.covariance * np.outer(keep, keep), pan=still_pan)
        parts[source] = prior_columns(still, session.track, exact, own)
    none = replace(stated, covariance=np.zeros_like(stated.covariance))
    parts[PAN_SOURCE] = prior_columns(still, session.track, exact, none)
    if clock.source == "given" and clock.standard_uncertainty:  # else the means' fit frees it
        parts[CLOCK_SOURCE] = clock_effect(comparison) * clock.standard_uncertainty
    return parts


def flange_uncertainty(session: PredictedSession) -> tuple[float, float]:
    """Predict what one pair tells of the flange: pixels, and all that is stated.

    Returns standard uncertainties of position, m, and orientation, rad: worst direction, median of
    the pairs.
    """
    exact = replace(session.clock, standard_uncertainty=None)
    columns = prior_columns(session.comparison, session.track, exact, session.systematics)
    covariance = session.track.covariance_pixels[session.comparison.index]
    covariance = covariance + columns @ np.swapaxes(columns, 1, 2)
    position, orientation = (
        float(np.median(np.sqrt(np.linalg.eigvalsh(covariance[:, part, part])[:, -1])))
        for part in (slice(0, 3), slice(3, 6))
    )
    return position, orientation


def joint_levers(session: PredictedSession) -> Array:
    """Largest distance between each joint's axis and the flange in the session, (j,), m."""
    levers: Array = np.linalg.norm(session.comparison.jacobian[:, :3], axis=1).max(axis=0)
    return np.where(levers > TOL_LEVER, levers, 0.0)


def group_sources(sources: dict[str, Array]) -> dict[str, Array]:
    """Add up the sources by what is to be done about them: standard uncertainty (j,), rad, each."""
    variance: dict[str, Array] = {}
    for name, share in sources.items():
        group = GROUPS.get(name, "calibration")
        variance[group] = variance.get(group, np.zeros(len(share))) + share**2
    return {name: np.sqrt(of) for name, of in variance.items()}


def conform_limits(analysis: PredictedAnalysis, tolerance: Array) -> Array:
    """The largest error of each joint that would be judged to conform, (j,), rad.

    `tolerance` (j,), rad. nan: undecided whatever the error, or the joint's offset cannot show.
    """
    largest = analysis.resolved.uncertainty.max(axis=0)
    limit = tolerance - GUARD_FACTOR * largest
    decided = (limit > 0) & (analysis.visibility.detectable <= tolerance)
    return np.where(decided, limit, np.nan)
