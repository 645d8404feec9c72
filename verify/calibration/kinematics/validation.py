"""How a fit holds beyond its poses: on those held out, and from one recording to the next.

Held-out poses count whether outlying or not. Models are compared by their squared distances in
units of the noise that the richest model leaves, each pose's capped at MAX_CHI2: an outlying one
weighs the same in every model. A larger model is taken where it predicts better by more than the
scatter of that difference from block to block.

Of several recordings, what the parameters scatter by from one to the next:

    u_k² → max(R u_k², u_k² + b_k²)
    R    = Σ_k Q_k / Σ_k (m_k - 1),    Q_k = Σ_s (p_ks - p̄_k)² / u_ks²
    b_k² = Σ_s (p_ks - p_k)² / (m_k (m_k - 1))

p_k is parameter k of the arm by all recordings together, p_ks as recording s alone gives it, with
the uncertainty u_ks that its own residuals leave, p̄_k their weighted mean over the m_k recordings
that tell it. What an arm does beyond its model (load, warmth, bending) repeats itself within a
recording and differs between two: R is then far above 1 (Birge, Phys. Rev. 40, 1932), and b_k is a
parameter's own share of that.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from verify.calibration.kinematics.fit import (
    FitState,
    KinematicFit,
    minimise,
    pose_residuals,
    tolerances,
)
from verify.calibration.kinematics.noise import NoiseScale
from verify.calibration.kinematics.poses import IdentificationPoses
from verify.core.records import Array, Flags, Index, take_rows

MAX_CHI2 = 25.0  # that a row may bring: noise brings a full pose's beyond it in 3 of 10,000
MAX_PRIOR_SHARE = 0.5  # of a prior's standard deviation: a recording that leaves more says nothing
SHARED = 2.0  # parameters of one arm hang together: that many count as one degree of freedom
MIN_GAIN_CONFIDENCE = 0.84  # that a larger model predicts better: of many splits, one sigma


@dataclass(frozen=True, slots=True)
class HoldOut:
    """How poses are held out."""

    splits: int = 10  # 0: none
    share: float = 0.3  # of the rows
    seed: int = 1


@dataclass(frozen=True, slots=True)
class CrossValidation:
    """Residuals on rows held out, means over the splits, outlying rows included."""

    splits: int
    rows: int  # held out in each, about
    position: Array  # (3,), m: mean, rms, greatest
    orientation: Array  # (3,), rad; nan where only positions were measured
    chi2: Array  # (n,), capped, a measured number; nan: never held out


def split(poses: IdentificationPoses, share: float, generator: np.random.Generator) -> Flags:
    """Hold out a share of the blocks of every base; (n,), True where held out."""
    held = np.zeros(len(poses), dtype=bool)
    for base in np.unique(poses.base):
        own = poses.base == base
        blocks = np.unique(poses.block[own])
        some_blocks = generator.permutation(blocks)[: max(1, round(share * len(blocks)))]
        held |= own & np.isin(poses.block, some_blocks)
    return held


def statistics(left: Array) -> Array:
    """Mean, rms and greatest length of vectors (n, 3)."""
    length = np.linalg.norm(left, axis=1)
    return np.array([length.mean(), np.sqrt(np.mean(length**2)), length.max()])


def hold_out(
    fit: KinematicFit, poses: IdentificationPoses, noise: NoiseScale, options: HoldOut
) -> CrossValidation | None:
    """Fit on one part and evaluate on the other, several times; None: too few rows.

    Each fit starts at the one of all rows and leaves its outlying rows out; distances are measured
    by the noise.
    """
    generator = np.random.default_rng(options.seed)
    start = FitState(fit.state, fit.change / tolerances(fit.parameters))
    positions, turns, counts = [], [], []
    total, times = np.zeros(len(poses)), np.zeros(len(poses))
    for _ in range(options.splits):
        held = split(poses, options.share, generator)
        training = take_rows(poses, ~held & fit.used)
        if int(training.dimensions.sum()) < len(fit.parameters) or not held.any():
            return None
        judged = take_rows(poses, held)
        left = pose_residuals(minimise(start, training, fit.parameters, fit.scale)[0].state, judged)
        positions.append(statistics(left[:, :3]))
        turns.append(statistics(left[:, 3:]))
        counts.append(int(held.sum()))
        chi2 = np.minimum(np.sum(noise.whiten(judged, left) ** 2, axis=1), MAX_CHI2)
        total[held] += chi2 / np.maximum(judged.dimensions, 1)
        times[held] += 1
    if not positions:
        return None
    blind = np.full(3, np.nan)
    return CrossValidation(
        splits=options.splits,
        rows=round(float(np.mean(counts))),
        position=np.mean(positions, axis=0),
        orientation=blind if poses.position_only else np.mean(turns, axis=0),
        chi2=np.where(times > 0, total / np.maximum(times, 1), np.nan),
    )


def best_model(found: Sequence[CrossValidation | None], block: Index) -> int:
    """Choose the model that predicts best, the smaller where that makes no clear difference.

    The smallest model stands first; one without is not chosen. Rows of one block (n,) repeat each
    other, and those of one split share a fit: few blocks or splits show less (Student's t).
    """
    best = 0
    for k, larger in enumerate(found[1:], start=1):
        smaller = found[best]
        if larger is None or smaller is None:
            continue
        gain = smaller.chi2 - larger.chi2
        known = np.isfinite(gain)
        labels, place = np.unique(block[known], return_inverse=True)
        by_block = np.bincount(place, gain[known]) / np.bincount(place)
        freedom = max(min(len(labels), larger.splits) - 1, 1)
        scatter = by_block.std(ddof=1) / np.sqrt(len(labels)) if len(labels) > 1 else np.inf
        if by_block.mean() > stdtrit(freedom, MIN_GAIN_CONFIDENCE) * scatter:
            best = k
    return best


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
