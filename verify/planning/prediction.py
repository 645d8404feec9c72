"""What a session would show: uncertainty and detectable size of every fault that is asked for."""

from dataclasses import dataclass

import numpy as np

from verify.arm_identification.parameters import Parameter
from verify.arm_identification.support import Support, observability, support, triangle
from verify.judgement.model import Model, clock_effect
from verify.judgement.visibility import DETECTION
from verify.planning.foresight import Foreseen
from verify.planning.kinds import Kind, geometry, kind
from verify.planning.wishes import KINDS, Bench
from verify.records import Array
from verify.regression import left_over, solve

JOINT_KINDS = tuple(name for name in KINDS if name not in ("kinematics", "clock"))
NOTHING = 1e-6  # of a column's squared length: rounding


@dataclass(frozen=True, slots=True)
class Shown:
    """One kind of fault, a joint each; nan where this session would not show it. SI units."""

    name: str
    unit: str
    scale: float  # SI units in one of `unit`
    standard_uncertainty: Array  # (j,), all kinds that were asked for fitted together
    detectable: Array  # (j,), alone


@dataclass(frozen=True, slots=True)
class ClockShown:
    """How well the encoders' clock would be known; s, None where the motion does not show it."""

    standard_uncertainty: float | None
    detectable: float | None  # of an error of a clock that is given
    source: str


@dataclass(frozen=True, slots=True)
class Geometry:
    """Which of the arm's parameters could be identified, beside what rig and marker leave open."""

    parameters: tuple[Parameter, ...]  # those supported
    standard_uncertainty: Array  # m or rad
    support: Support
    indexes: dict[str, float]


def shown(model: Model, observe: tuple[str, ...]) -> list[Shown]:
    """Predict every kind of fault of single joints that is asked for."""
    kinds = [kind(name, model) for name in JOINT_KINDS if name in observe]
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
        found.append(Shown(one.name, one.unit, one.scale, uncertainty, _detectable(model, one)))
    return found


def _detectable(model: Model, one: Kind) -> Array:
    """The smallest that would be noticed of a joint's fault alone, worst phase, (j,)."""
    joints = model.joints.shape[1]
    smallest = np.full(joints, np.nan)
    for j in range(joints):
        columns = np.stack([part[:, j] for part in one.columns], axis=1)
        left = np.linalg.eigvalsh(left_over(model.fitted, columns, model.prior))[0]
        if left > NOTHING * np.sum(columns**2) > 0:
            smallest[j] = DETECTION / np.sqrt(left)
    return smallest


def clock_shown(foreseen: Foreseen) -> ClockShown:
    """Predict how well the motion tells the encoders' clock."""
    clock, model = foreseen.clock, foreseen.model
    if clock.source != "given":
        return ClockShown(clock.standard_uncertainty, None, clock.source)
    column = model.white.rows(clock_effect(foreseen.comparison))
    others = np.concatenate([model.offsets, model.fitted], axis=1)
    left = float(left_over(others, column, model.prior)[0, 0])
    known = left > NOTHING * float(np.sum(column**2)) > 0
    smallest = DETECTION / float(np.sqrt(left)) if known else None
    return ClockShown(clock.standard_uncertainty, smallest, clock.source)


def geometry_shown(bench: Bench, model: Model) -> Geometry:
    """Predict which of the arm's parameters `verify identify` could find, and how well."""
    parameters, columns = geometry(bench, model)
    loose = _unit(model.fitted) / NOTHING  # found with them, as good as free
    known = triangle(columns, np.concatenate([model.prior, loose], axis=1))
    supported = support(parameters, known)
    own = [parameters.index(p) for p in supported.supported]
    tolerance = np.array([p.tolerance for p in supported.supported])
    _, size, vt = np.linalg.svd(known[:, own], full_matrices=False)
    spread = np.linalg.norm(vt.T / size, axis=1) * tolerance
    indexes = observability(known[:, own], len(model.comparison))
    return Geometry(supported.supported, spread, supported, indexes)


def _unit(columns: Array) -> Array:
    size = np.linalg.norm(columns, axis=0)
    unit: Array = columns / np.where(size > 0, size, 1.0)
    return unit
