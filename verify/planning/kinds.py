"""What each kind of fault would do to every pair of a session: columns of the judgement's model.

The columns are the diagnosis's own. Its faults are not taken whole, as `joint_faults` leaves out
those that the motion at hand does not show: here a kind has a column for every joint, so that one
which a plan does not show yet is told to be missing, and single poses can be weighed for it.
"""

from dataclasses import dataclass

import numpy as np

from verify.arm_identification.chain import chain_of
from verify.arm_identification.model import predict_with_jacobian
from verify.arm_identification.parameters import (
    Parameter,
    State,
    geometry_parameters,
    offset_parameters,
)
from verify.judgement.faults_joints import shaped
from verify.judgement.model import Model
from verify.planning.wishes import Bench
from verify.records import Array

PERCENT = 0.01


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of fault of every joint; docs/results.md says what a unit of each does."""

    name: str
    unit: str  # of what is predicted: deg, or percent of the angle
    scale: float  # SI units in one of these
    columns: tuple[Array, ...]  # (r, j) each, whitened, a SI unit; two where a phase is open


def kind(name: str, model: Model) -> Kind:
    """Lay out a kind's columns."""
    q, degree = model.comparison.q, float(np.deg2rad(1.0))
    if name == "offsets":
        return Kind(name, "deg", degree, (model.offsets,))
    if name == "gains":
        return Kind(name, "percent", PERCENT, (_every_joint(model, q),))
    if name == "backlash":
        return Kind(name, "deg", degree, (_every_joint(model, model.comparison.direction / 2),))
    waves = _every_joint(model, np.cos(q)), _every_joint(model, np.sin(q))
    return Kind(name, "deg", degree, waves)


def _every_joint(model: Model, shapes: Array) -> Array:
    """Columns (r, j) of joint errors that vary as (n, j) does."""
    joints = range(shapes.shape[1])
    return np.concatenate([shaped(model, j, shapes[:, [j]]) for j in joints], axis=1)


def geometry(bench: Bench, model: Model) -> tuple[tuple[Parameter, ...], Array]:
    """The arm's parameters that may be identified, and their columns.

    Returns:
        L parameters, and (r, L), whitened, a unit of each parameter's tolerance (1 mm, 1°).
    """
    chain = chain_of(bench.arm)
    parameters = (*offset_parameters(chain), *geometry_parameters(chain))
    rows = np.zeros(len(model.comparison), dtype=np.int64)
    still = np.eye(4)[None]
    state = State(chain, still, still)
    _, columns = predict_with_jacobian(state, model.comparison.q, rows, rows, parameters)
    scale = np.array([parameter.tolerance for parameter in parameters])
    return parameters, model.white.rows(columns * scale)
