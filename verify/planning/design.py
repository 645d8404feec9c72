"""Choose the poses that together tell most of the requested faults, everything else held open.

Model: rows of a pose are (A_i, B_i), whitened, A of the parameters requested, B of everything else
that is fitted or held; Pi is the prior information. The D_s-optimal choice C maximises

    ln det(Pi + sum_{i in C} (A_i B_i)'(A_i B_i)) - ln det(Pi_B + sum_{i in C} B_i'B_i)

greedily, then exchanging pose by pose. Source: Fedorov, Theory of Optimal Experiments, 1972; for
calibration Borm and Menq, 1991 (their O1 is this determinant).

Parameters requested, by kind, one column a joint:
    offsets       constant error                  1°
    gains         error in proportion to q        1 %
    backlash      error by direction of travel    1°
    eccentricity  error as cos q and sin q        1°
    kinematics    DH parameters and offsets       1 mm, 1°

The columns are those of the diagnosis, but of every joint: one that a plan does not show yet is
predicted as missing, and single poses can be weighed for it.
"""

from dataclasses import dataclass

import numpy as np

from verify.analysis.diagnosis.faults import shape_columns
from verify.analysis.model import JointErrorModel
from verify.calibration.kinematics.chain import (
    ArmState,
    Parameter,
    chain_of,
    geometry_parameters,
    offset_parameters,
)
from verify.calibration.kinematics.model import predict_with_jacobian
from verify.core.records import Array
from verify.planning.request import PlanningSetup

PERCENT = 0.01
POSE_KINDS = ("offsets", "gains", "eccentricity", "kinematics")  # kinds that the poses decide
PRIOR_SIGMA = 10.0  # units (1°, 1 %, 1 mm): prior of the requested, so that a gauge does no harm
PRIOR_SHARE = 1e-6  # of the largest: prior of what is fitted with it
MAX_ROUNDS = 3  # of exchanges


@dataclass(frozen=True, slots=True)
class FaultKind:
    """One kind of fault of every joint; docs/results.md says what a unit of each does."""

    name: str
    unit: str  # of what is predicted: deg, or percent of the angle
    columns: tuple[Array, ...]  # (r, j) each, whitened, one such unit; two where a phase is open


def fault_kind(name: str, model: JointErrorModel) -> FaultKind:
    """Build the columns of one kind."""
    q, degree = model.comparison.q, float(np.deg2rad(1.0))
    if name == "offsets":
        return FaultKind(name, "deg", (degree * model.offsets,))
    if name == "gains":
        return FaultKind(name, "percent", (_joint_columns(model, PERCENT * q),))
    if name == "backlash":
        direction = model.comparison.direction / 2
        return FaultKind(name, "deg", (_joint_columns(model, degree * direction),))
    waves = (_joint_columns(model, degree * wave) for wave in (np.cos(q), np.sin(q)))
    return FaultKind(name, "deg", tuple(waves))


def _joint_columns(model: JointErrorModel, shapes: Array) -> Array:
    """Columns (r, j) of joint errors that vary as (n, j) does."""
    joints = range(shapes.shape[1])
    return np.concatenate([shape_columns(model, j, shapes[:, [j]]) for j in joints], axis=1)


def geometry_columns(
    setup: PlanningSetup, model: JointErrorModel
) -> tuple[tuple[Parameter, ...], Array]:
    """The arm's L parameters that may be identified, and their columns (r, L).

    These are whitened, a unit of each parameter's tolerance (1 mm, 1°).
    """
    chain = chain_of(setup.arm)
    parameters = (*offset_parameters(chain), *geometry_parameters(chain))
    rows = np.zeros(len(model.comparison), dtype=np.int64)
    still = np.eye(4)[None]
    state = ArmState(chain, still, still)
    _, columns = predict_with_jacobian(state, model.comparison.q, rows, rows, parameters)
    scale = np.array([parameter.tolerance for parameter in parameters])
    return parameters, model.white.rows(columns * scale)


@dataclass(frozen=True, slots=True)
class DesignInformation:
    """Rows of n candidate poses, six each: of the requested parameters, then of everything else."""

    rows: Array  # (n, 6, a + o), in units; the others are fitted or held
    prior: Array  # (a + o,), information that there is beforehand
    requested: int  # a


def design_information(
    setup: PlanningSetup, model: JointErrorModel, observe: tuple[str, ...], weight: float
) -> DesignInformation:
    """Split the analysis' model of one pair at each candidate pose by pose.

    Offsets stand for those of the kinds to observe that only the motion decides; the weight is the
    pairs that will be taken about each pose.
    """
    names = [name for name in observe if name in POSE_KINDS] or ["offsets"]
    columns = []
    for name in names:
        if name == "kinematics":
            columns.append(geometry_columns(setup, model)[1])
        elif name != "offsets" or "kinematics" not in names:  # those hold the offsets
            columns += fault_kind(name, model).columns
    requested = np.concatenate(columns, axis=1)
    size = np.linalg.norm(model.fitted, axis=0)
    fitted = model.fitted / np.where(size > 0, size, 1.0)
    # systematic errors are no better known for many pairs about a pose
    rows = np.concatenate([requested, fitted, model.prior], axis=1) * np.sqrt(weight)
    laid = np.zeros((len(model.comparison), 6, rows.shape[1]))
    place = np.concatenate([np.arange(len(f)) for f in model.white.factors])
    laid[model.white.pair, place] = rows
    counts = [part.shape[1] for part in (requested, fitted, model.prior)]
    prior = np.repeat([PRIOR_SIGMA**-2, PRIOR_SHARE, 1.0], counts)
    return DesignInformation(laid, prior, counts[0])


def log_information(information: DesignInformation, chosen: list[int], times: float = 1.0) -> float:
    """Ln det of the information on the requested parameters, everything else held open.

    `times` is the pairs of each chosen pose, over those that the rows were weighted for.
    """
    a = information.requested
    flat = information.rows[chosen].reshape(-1, len(information.prior))
    whole = np.diag(information.prior) + times * flat.T @ flat
    return float(np.linalg.slogdet(whole)[1] - np.linalg.slogdet(whole[a:, a:])[1])


def choose_poses(information: DesignInformation, count: int) -> list[int]:
    """Choose so many poses; which ones, (count,)."""
    chosen: list[int] = []
    for _ in range(min(count, len(information.rows))):
        chosen.append(_best(information, chosen))
    for _ in range(MAX_ROUNDS):
        before = list(chosen)
        for place in range(len(chosen)):
            chosen[place] = _best(information, chosen[:place] + chosen[place + 1 :], chosen[place])
        if chosen == before:
            break
    return chosen


def _best(information: DesignInformation, chosen: list[int], standing: int | None = None) -> int:
    """The pose that adds most to the determinant; on a tie the one that stands there now."""
    gain = _gain(information, chosen)
    gain[chosen] = -np.inf
    best = int(np.argmax(gain))
    return standing if standing is not None and gain[best] <= gain[standing] + 1e-9 else best


def _gain(information: DesignInformation, chosen: list[int]) -> Array:
    """What each pose adds to ln det of the requested, given everything else, (n,)."""
    others, prior = information.rows[:, :, information.requested :], information.prior
    whole = _added_information(information.rows, chosen, prior)
    return whole - _added_information(others, chosen, prior[information.requested :])


def _added_information(rows: Array, chosen: list[int], prior: Array) -> Array:
    """Increase of ln det by six more rows, by the matrix determinant lemma, (n,)."""
    flat = rows[chosen].reshape(6 * len(chosen), len(prior))
    inverse = np.linalg.inv(np.diag(prior) + flat.T @ flat)
    added = rows @ inverse @ np.swapaxes(rows, 1, 2)
    return np.asarray(np.linalg.slogdet(np.eye(6) + added)[1])
