"""Predict what a session will show: every requested fault, flange and joints, and the sources.

A joint's angle of uncertainty U moves the flange by U times its lever, the distance between the
joint's axis and the flange.
"""

from dataclasses import dataclass, replace

import numpy as np

from verify.analysis.least_squares import residual_products, solve
from verify.analysis.model import DETECTION_SIGMA, JointErrorModel, clock_effect, prior_columns
from verify.analysis.results.entries import finite_number
from verify.analysis.uncertainty.sources import CLOCK
from verify.analysis.verdict import GUARD_FACTOR
from verify.calibration.kinematics.identifiability import (
    Identifiability,
    identifiability,
    information_root,
    observability_indices,
)
from verify.core.records import Array
from verify.measurement.systematics import PAN_ANGLE
from verify.planning.design import fault_kind, geometry_columns
from verify.planning.foresight import PredictedAnalysis, PredictedSession
from verify.planning.request import FAULT_KINDS, PlanningSetup

JOINT_KINDS = tuple(name for name in FAULT_KINDS if name not in ("kinematics", "clock"))
RANDOM_SOURCE = "pixels, alignment, readings"
TOL_COLUMN = 1e-6  # of a column's squared length: rounding
TOL_LEVER = 1e-6  # m: rounding of a flange that lies on the axis
GROUPS = {
    RANDOM_SOURCE: "pixels",
    CLOCK: "clock",
    **dict.fromkeys(("rig", PAN_ANGLE), "calibration"),
    **dict.fromkeys(("robot base", "LED body"), "registration"),
    **dict.fromkeys(("LED positions", "apparent LED centre"), "leds"),
}


@dataclass(frozen=True, slots=True)
class FaultPrediction:
    """One kind of fault of each joint, in `unit`; nan where this session would not show it."""

    name: str
    unit: str  # deg, or percent of the angle
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
        uncertainty = np.full(joints, np.nan)
        for j in range(joints):
            own = start + j + joints * np.arange(len(one.columns))
            if fit.estimable[own].all():
                uncertainty[j] = np.sqrt(np.linalg.eigvalsh(fit.covariance[np.ix_(own, own)])[-1])
        start += joints * len(one.columns)
        detectable = [
            _detectable(np.stack(alike, axis=1), model.fitted, model.prior)
            for alike in zip(*(part.T for part in one.columns), strict=True)
        ]
        found.append(FaultPrediction(one.name, one.unit, uncertainty, np.array(detectable)))
    return found


def _detectable(columns: Array, free: Array, held: Array) -> float:
    """Smallest detectable fault of columns (r, c), at its worst phase; nan where it is hidden."""
    left = np.linalg.eigvalsh(residual_products(free, held, [columns]))[0]
    visible = left > TOL_COLUMN * np.sum(columns**2) > 0
    return DETECTION_SIGMA / float(np.sqrt(left)) if visible else np.nan


def predict_clock(session: PredictedSession) -> ClockPrediction:
    """Predict how well the motion tells the encoders' clock."""
    clock, model = session.clock, session.model
    if clock.source != "given":
        return ClockPrediction(clock.standard_uncertainty, None, clock.source)
    column = model.white.rows(clock_effect(session.comparison))
    others = np.concatenate([model.offsets, model.fitted], axis=1)
    smallest = finite_number(_detectable(column, others, model.prior))
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


def uncertainty_sources(analysis: PredictedAnalysis) -> dict[str, Array]:
    """Split the mean errors' uncertainties by source: the squares add up where all are stated.

    Standard uncertainty (j,), rad, each; nan where the mean is not known.
    """
    found = {RANDOM_SOURCE: analysis.random}
    for line in analysis.systematic:
        if line.source in GROUPS and np.any(line.variance > 0):
            found[line.source] = np.sqrt(np.maximum(line.variance, 0.0))
    return found


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
        variance[GROUPS[name]] = variance.get(GROUPS[name], np.zeros(len(share))) + share**2
    return {name: np.sqrt(of) for name, of in variance.items()}


def conform_limits(analysis: PredictedAnalysis, tolerance: Array) -> Array:
    """The largest error of each joint that would be judged to conform, (j,), rad.

    `tolerance` (j,), rad. nan: undecided whatever the error, or the joint's offset cannot show.
    """
    largest = analysis.resolved.uncertainty.max(axis=0)
    limit = tolerance - GUARD_FACTOR * largest
    decided = (limit > 0) & (analysis.visibility.detectable <= tolerance)
    return np.where(decided, limit, np.nan)
