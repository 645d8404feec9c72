"""Scatter of an arm's parameters from one recording to the next.

    u_k² → max(R u_k², u_k² + b_k²)
    R    = Σ_k Q_k / Σ_k (m_k - 1),    Q_k = Σ_s (p_ks - p̄_k)² / u_ks²
    b_k² = Σ_s (p_ks - p_k)² / (m_k (m_k - 1))

p_k is parameter k of the arm by all recordings together, p_ks as recording s alone gives it, with
the uncertainty u_ks that its own residuals leave, p̄_k their weighted mean over the m_k recordings
that tell it. What an arm does beyond its model (load, warmth, bending) repeats itself within a
recording and differs between two: R is then far above 1 (Birge, Phys. Rev. 40, 1932), and b_k is a
parameter's own share of that.
"""

from dataclasses import replace

import numpy as np

from verify.calibration.kinematics.fit import FitState, KinematicFit, minimise, tolerances
from verify.calibration.kinematics.poses import IdentificationPoses
from verify.core.records import Array, take_rows

MAX_PRIOR_SHARE = 0.5  # of a prior's standard deviation: a recording that leaves more says nothing
SHARED = 2.0  # parameters of one arm hang together: that many count as one degree of freedom


def with_scatter(fit: KinematicFit, poses: IdentificationPoses) -> KinematicFit:
    """Enlarge a fit's covariance by what its recordings differ; unchanged where there is one."""
    recordings = np.unique(poses.recording)
    arm = [k for k, p in enumerate(fit.parameters) if not p.axis]
    if len(recordings) < 2 or not arm:
        return fit
    alone = [_alone(fit, poses, int(s)) for s in recordings]
    value, u = (np.array([one[i][arm] for one in alone]) for i in (0, 1))
    # beyond which a recording does not tell a parameter
    limits = [MAX_PRIOR_SHARE * fit.parameters[k].prior / fit.parameters[k].tolerance for k in arm]
    weight = np.where(u < np.array(limits), u, np.inf) ** -2.0
    told = np.count_nonzero(weight, axis=0)
    mean = np.sum(weight * value, axis=0) / np.maximum(weight.sum(axis=0), 1e-300)
    squares = np.sum(weight * (value - mean) ** 2, axis=0)
    freedom = int(np.maximum(told - 1, 0).sum())
    if not freedom:
        return fit
    ratio = max(1.0, float(squares[told > 1].sum()) / freedom)
    together = (fit.change / tolerances(fit.parameters))[arm]
    away = np.sum(np.where(weight > 0, (value - together) ** 2, 0.0), axis=0)
    own = away / np.maximum(told * (told - 1), 1) * (told > 1)
    factor = np.full(len(fit.parameters), ratio)
    within = (fit.standard_uncertainty / tolerances(fit.parameters))[arm] ** 2
    factor[arm] = np.maximum(ratio, 1 + own / within) if ratio > 1 else 1.0
    known = min(fit.scale.degrees_of_freedom, max(freedom / SHARED, 1.0))
    grown = np.sqrt(np.outer(factor, factor))
    return replace(
        fit,
        covariance=grown * fit.covariance,
        scale=replace(fit.scale, degrees_of_freedom=known) if ratio > 1 else fit.scale,
        scatter=float(ratio**0.5),
    )


def _alone(fit: KinematicFit, poses: IdentificationPoses, recording: int) -> tuple[Array, Array]:
    """Parameters (L,) as one recording alone gives them, and their uncertainties, in tolerances."""
    rows = take_rows(poses, fit.used & (poses.recording == recording))
    start = FitState(fit.state, fit.change / tolerances(fit.parameters))
    at, covariance = minimise(start, rows, fit.parameters, fit.scale)
    return at.change, np.sqrt(np.diag(covariance))[: len(at.change)]
