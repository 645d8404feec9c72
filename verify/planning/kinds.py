"""What each kind of fault would do to every pair of a session: columns of the judgement's model."""

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
        return Kind(name, "percent", PERCENT, (_shaped(model, q),))
    if name == "backlash":
        return Kind(name, "deg", degree, (_shaped(model, model.comparison.direction / 2),))
    return Kind(name, "deg", degree, (_shaped(model, np.cos(q)), _shaped(model, np.sin(q))))


def _shaped(model: Model, shape: Array) -> Array:
    """Columns of errors that vary as (n, j) does; of their mean, what registration left of it."""
    mean = shape.mean(axis=0)
    columns: Array = model.joints * (shape - mean)[model.white.pair] + model.offsets * mean
    return columns


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
