"""Sums of joint errors that are known where the single ones are not, or better than they."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

import robots
from verify.analysis.comparison import Comparison, JointComparison
from verify.analysis.joint_errors import JointErrors, ResolvedErrors
from verify.analysis.model import JointErrorModel, SessionComparison
from verify.core.records import Array, Index

MIN_WEIGHT = 0.005  # of a weight: less than what its two decimals in the label can show
POSE_DOF = 6  # degrees of freedom of a pose


@dataclass(frozen=True, slots=True)
class Combination:
    """A weighted sum of joint errors, rad."""

    weights: Array  # (j,), of the middle pair where they vary with the posture
    mean: float
    standard_uncertainty: float
    pairs: int
    why: str  # singularity, self_motion, well_known

    @property
    def label(self) -> str:
        """The sum as a formula: q2+q3+q4, q1-0.34·q3."""
        terms = [
            f"{'+' if w > 0 else '-'}{_format_weight(abs(w))}q{j + 1}"
            for j, w in enumerate(self.weights)
            if abs(w) > MIN_WEIGHT
        ]
        return "".join(terms).removeprefix("+")

    @property
    def joints(self) -> list[int]:
        """The joints in the sum, counted from 1."""
        return [j + 1 for j, w in enumerate(self.weights) if abs(w) > MIN_WEIGHT]


def _format_weight(weight: float) -> str:
    return "" if abs(weight - 1) < MIN_WEIGHT else f"{weight:.2f}·"


def combinations(
    compared: SessionComparison,
    model: JointErrorModel,
    errors: JointErrors,
    resolved: ResolvedErrors,
) -> list[Combination]:
    """Collect sums of joint errors that are known better than their parts.

    Errors of single pairs count only where base and LEDs were registered without the encoders: else
    they are residuals.
    """
    arm, joints, clock = compared.session.arm, compared.joints, compared.clock_uncertainty
    found: list[Combination] = []
    if not model.through_encoders:
        found += _singularity_sums(joints, errors, clock)
        if arm.dof > POSE_DOF:
            found += _pose_sums(model.comparison, joints, errors, clock)
    return found + _parallel(arm, resolved, len(model.comparison))


def _parallel(arm: robots.Arm, resolved: ResolvedErrors, pairs: int) -> list[Combination]:
    """Sums over joints with parallel axes: the angle of the last link, known better than each."""
    found = []
    for weights in _parallel_axes(arm):
        used = weights != 0
        if np.isfinite(resolved.mean[used]).all():
            part = weights[used]
            mean = float(part @ resolved.mean[used])
            variance = float(part @ resolved.mean_covariance[np.ix_(used, used)] @ part)
            found.append(Combination(weights, mean, float(np.sqrt(variance)), pairs, "well_known"))
    return found


def _parallel_axes(arm: robots.Arm) -> list[Array]:
    if not isinstance(arm, robots.DhArm):
        return []
    groups: list[list[int]] = [[0]]
    for j in range(1, arm.dof):
        if abs(float(np.sin(arm.alpha[j - 1]))) < 1e-9:  # of a table's right or zero angle
            groups[-1].append(j)
        else:
            groups.append([j])
    linkage = np.eye(arm.dof) if arm.linkage is None else arm.linkage
    sums = [arm.sign[group] @ linkage[group] for group in groups]
    return [weights for weights in sums if np.count_nonzero(weights) > 1]


def _singularity_sums(
    joints: JointComparison, errors: JointErrors, clock_uncertainty: float | None
) -> list[Combination]:
    """Means of the sums that a singularity leaves determined, over the pairs near it."""
    groups: dict[tuple[str, tuple[float, ...]], list[int]] = {}
    for i, coupling in enumerate(joints.coupling):
        if coupling is not None and coupling.combination is not None:
            key = (coupling.label, tuple(coupling.combination.tolist()))
            groups.setdefault(key, []).append(i)
    found = []
    for (_, combination), mine in groups.items():
        weights = np.array(combination)
        used = weights != 0
        each = joints.error[mine][:, used] @ weights[used]
        told = ~np.isnan(each)
        if told.any():
            places = np.array(mine)[told]
            every = np.tile(weights, (len(places), 1))
            u = _uncertainty(every, errors, places, clock_uncertainty)
            mean = float(each[told].mean())
            found.append(Combination(weights, mean, u, len(places), "singularity"))
    return found


def _pose_sums(
    comparison: Comparison,
    joints: JointComparison,
    errors: JointErrors,
    clock_uncertainty: float | None,
) -> list[Combination]:
    """The six sums that a pose determines on an arm with more than six joints.

    Each is one joint less the share by which the self-motion ties it to the joints that this moves
    most: the joint's error if those read true. The shares follow the posture from pair to pair.
    """
    places = np.flatnonzero(
        joints.reached & np.array([b.shape[1] == POSE_DOF for b in comparison.determined])
    )
    if not len(places):
        return []
    inverse, xi = joints.inverse[places], comparison.xi[places]
    dof = inverse.shape[1]
    still = [np.linalg.svd(comparison.jacobian[i])[2][POSE_DOF:].T for i in places]  # (j, j - 6)
    middle = len(places) // 2
    held = np.sort(qr(still[middle].T, pivoting=True)[2][: dof - POSE_DOF])
    rest = np.setdiff1d(np.arange(dof), held)
    weights = np.zeros((len(places), POSE_DOF, dof))
    weights[:, np.arange(POSE_DOF), rest] = 1.0
    for row, null in zip(weights, still, strict=True):
        row[:, held] = -null[rest] @ np.linalg.pinv(null[held])
    each = np.einsum("ncj,njk,nk->nc", weights, inverse, xi)
    return [
        Combination(
            weights[middle, c],
            float(each[:, c].mean()),
            _uncertainty(weights[:, c], errors, places, clock_uncertainty),
            len(places),
            "self_motion",
        )
        for c in range(POSE_DOF)
    ]


def _uncertainty(
    weights: Array, errors: JointErrors, places: Index, clock_uncertainty: float | None
) -> float:
    """Standard uncertainty of a sum's mean over some pairs; (n, j) weights, rad."""
    n = len(places)
    random = np.einsum("ni,nij,nj->", weights, errors.covariance[places], weights) / n**2
    moved = np.einsum("ni,nip->p", weights, errors.systematic[places]) / n
    drift = np.einsum("ni,ni->", weights, errors.clock[places]) / n * (clock_uncertainty or 0.0)
    return float(np.sqrt(random + moved @ moved + drift**2))
