"""summary.json: what docs/results.md promises, from what was judged."""

import math
import platform
from collections import Counter
from dataclasses import dataclass
from typing import Any

import cv2
import numba
import numpy as np
import scipy

from verify import __version__
from verify.clock import ClockEstimate
from verify.combinations import Combination
from verify.comparison import Comparison
from verify.joints import Joints
from verify.judgement.budget import Budget
from verify.judgement.budget_words import budget_entry, drawn_entry
from verify.judgement.causes_words import entry_of
from verify.judgement.congruence import Congruence
from verify.judgement.diagnosis import Diagnosis
from verify.judgement.means import Means
from verify.judgement.monte_carlo import MonteCarlo
from verify.judgement.resolved import Resolved
from verify.judgement.sweep_words import sweep_entries
from verify.judgement.sweeps import Sweep
from verify.judgement.verdict import (
    FALSE_ALARM,
    GUARD,
    RULE,
    Verdict,
    judge_joint,
    judge_norm,
    overall,
)
from verify.judgement.visibility import Visibility
from verify.records import Array
from verify.session import Session, Tolerance

MILLIMETRE = 1e3
DEGREE = 180 / math.pi


@dataclass(frozen=True, slots=True)
class Judged:
    """Everything that was found out about a session."""

    session: Session
    tolerance: Tolerance
    status: list[str]  # a pair each
    choices: dict[str, int]
    clock: ClockEstimate
    comparison: Comparison
    joints: Joints
    combinations: list[Combination]
    means: Means
    sources: Budget
    drawn: MonteCarlo | None
    sweeps: list[Sweep]
    frame: Array  # (n,), number of each compared pair
    visibility: Visibility
    resolved: Resolved
    relative: Congruence | None
    diagnosis: Diagnosis
    flange: tuple[Array, Array]  # (6,) mean error twist and (6, 6) its covariance
    through_encoders: bool  # base or LEDs were fitted through the encoders: errors are residuals
    uncounted: tuple[str, ...]
    warnings: list[str]


def summarise(judged: Judged) -> dict[str, Any]:
    """Word the judgement as summary.json."""
    session = judged.session
    counts = Counter(judged.status)
    measured = counts.pop("measured", 0)
    per_joint = [_verdict(judged, j) for j in range(session.arm.dof)]
    position, orientation = _flange_verdicts(judged)
    verdicts = [*(v.verdict for v in per_joint), position.verdict, orientation.verdict]
    return {
        "format": 1,
        "tool": {"name": "verify", "version": __version__},
        "session": {
            "path": str(session.folder),
            "robot": session.robot,
            "robot_fingerprint": f"sha256:{session.arm.fingerprint}",
            "description": session.description,
            "started": session.started,
            **({} if session.instrument is None else {"instrument": session.instrument.name}),
        },
        "pairs": {
            "recorded": len(judged.status),
            "measured": measured,
            "rejected": dict(sorted(counts.items())),
        },
        "clock": _clock(judged.clock),
        "verdict": overall(verdicts),
        "decision_rule": RULE,
        "joints": [_joint(judged, j, per_joint[j]) for j in range(session.arm.dof)],
        "joint_error_correlation": _correlation(judged.means.covariance),
        "position": _flange(judged, position, slice(0, 3), MILLIMETRE, "mm"),
        "orientation": _flange(judged, orientation, slice(3, 6), DEGREE, "deg"),
        "relative_motions": _relative(judged.relative),
        "diagnosis": [entry_of(c) for c in judged.diagnosis.causes],
        "outlying_pairs": [int(f) for f in judged.frame[judged.diagnosis.outlying]],
        "budget": {
            **budget_entry(judged.sources, judged.uncounted),
            "monte_carlo": drawn_entry(judged.drawn, judged.frame),
        },
        "sweeps": sweep_entries(judged.sweeps, judged.frame),
        "decision": _decision(judged),
        "software": _software(),
        "inputs": dict(sorted(session.inputs.items())),
        "warnings": judged.warnings,
        "combinations": [_combination(c) for c in judged.combinations],
        "choices": dict(sorted(judged.choices.items())),
        "known_dof": max((b.shape[1] for b in judged.comparison.determined), default=0),
    }


def _decision(judged: Judged) -> dict[str, Any]:
    """The decision rule's figures, for a program that checks the verdicts."""
    fit = judged.resolved.fit
    return {
        "guard": GUARD,
        "false_alarm": FALSE_ALARM,
        "fitted_terms": [list(terms) for terms in judged.resolved.terms],
        "half_range_deg": [number(s * DEGREE) for s in judged.resolved.swing],
        "half_range_standard_uncertainty_deg": [
            number(u * DEGREE) for u in judged.resolved.swing_uncertainty
        ],
        "lack_of_fit": judged.resolved.lack_of_fit,
        "chi2": number(fit.chi2),
        "degrees_of_freedom": fit.degrees_of_freedom,
        "tolerance_from": _tolerance_from(judged),
    }


def _tolerance_from(judged: Judged) -> str | None:
    """Who asked for the tolerances: the session's file, or whoever had it judged."""
    used, own = judged.tolerance, judged.session.tolerance
    parts = used.joints, used.position, used.orientation
    if all(part is None for part in parts):
        return None
    given = (None, None, None) if own is None else (own.joints, own.position, own.orientation)
    alike = (np.array_equal(np.array(a), np.array(b)) for a, b in zip(parts, given, strict=True))
    return "session.toml" if all(alike) else "command line"


def _software() -> dict[str, str]:
    """Versions of what the figures depend on beside this program."""
    return {
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "numba": numba.__version__,
        "opencv": cv2.__version__,
    }


def number(value: float | None) -> float | None:
    """A figure for JSON: null where it is not known, never 0 or NaN."""
    if value is None or not math.isfinite(value):
        return None
    return float(value)


def _clock(clock: ClockEstimate) -> dict[str, Any]:
    seen = clock.source != "not_observable"
    return {
        "encoder_offset_s": number(clock.offset) if seen else None,
        "standard_uncertainty_s": number(clock.standard_uncertainty),
        "source": clock.source,
        "observable": seen,
    }


def _verdict(judged: Judged, j: int) -> Verdict:
    given = judged.tolerance.joints
    tolerance = None if given is None else float(given[j])
    return judge_joint(judged.resolved, j, tolerance, float(judged.visibility.detectable[j]))


def _joint(judged: Judged, j: int, verdict: Verdict) -> dict[str, Any]:
    means, seen = judged.means, judged.visibility
    error = judged.joints.single[:, j]
    # residuals of a registration accuse the wrong joint: they are not summed up
    plain = error[~np.isnan(error)] if not judged.through_encoders else np.zeros(0)
    u = float(np.sqrt(means.covariance[j, j]))
    k = float(means.coverage_factor[j])
    given = judged.tolerance.joints
    return {
        "joint": j + 1,
        "mean_error_deg": number(means.mean[j] * DEGREE),
        "rms_error_deg": number(float(np.sqrt(np.mean(plain**2))) * DEGREE) if len(plain) else None,
        "max_abs_error_deg": number(float(np.max(np.abs(plain))) * DEGREE) if len(plain) else None,
        "standard_uncertainty_deg": number(u * DEGREE),
        "expanded_uncertainty_deg": number(k * u * DEGREE),
        "coverage_factor": number(k) if math.isfinite(u) else None,
        "worst_error_deg": number(verdict.worst * DEGREE),
        "worst_error_standard_uncertainty_deg": number(verdict.uncertainty * DEGREE),
        "tolerance_deg": None if given is None else number(given[j] * DEGREE),
        "conformance_probability": number(verdict.probability),
        "verdict": verdict.verdict,
        "reason": verdict.reason,
        "pairs": int(means.pairs[j]),
        "visible_fraction": number(seen.fraction[j]),
        "visible_fraction_since_registration": number(seen.fraction_since[j]),
        "minimum_detectable_error_deg": number(seen.detectable[j] * DEGREE),
        "minimum_separable_error_deg": number(seen.separable[j] * DEGREE),
    }


def _correlation(covariance: Array) -> list[list[float | None]]:
    sigma = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = covariance / np.outer(sigma, sigma)
    return [[number(float(c)) for c in row] for row in correlation]


def _flange_verdicts(judged: Judged) -> tuple[Verdict, Verdict]:
    """The resolved joint errors carried through the arm, judged by the same rule."""
    jacobian, resolved = judged.comparison.jacobian, judged.resolved
    twist = np.einsum("nij,nj->ni", jacobian, resolved.error)
    spread = jacobian @ resolved.covariance @ np.swapaxes(jacobian, 1, 2)
    terms = sum(len(t) for t in resolved.terms)
    tolerance = judged.tolerance
    return (
        judge_norm(twist[:, :3], spread[:, :3, :3], terms, tolerance.position, resolved),
        judge_norm(twist[:, 3:], spread[:, 3:, 3:], terms, tolerance.orientation, resolved),
    )


def _flange(
    judged: Judged, verdict: Verdict, part: slice, scale: float, unit: str
) -> dict[str, Any]:
    whole = np.array([b.shape[1] == 6 for b in judged.comparison.determined], dtype=bool)
    size = np.linalg.norm(judged.comparison.xi[:, part], axis=1)[whole]
    # where LEDs leave directions open, nothing is known of the error along them
    largest = float(np.linalg.eigvalsh(judged.flange[1][part, part])[-1]) if whole.all() else np.nan
    given = judged.tolerance.position if unit == "mm" else judged.tolerance.orientation
    return {
        f"rms_error_{unit}": number(float(np.sqrt(np.mean(size**2))) * scale)
        if len(size)
        else None,
        f"max_error_{unit}": number(float(size.max()) * scale) if len(size) else None,
        f"expanded_uncertainty_{unit}": number(2 * math.sqrt(largest) * scale),
        f"worst_error_{unit}": number(verdict.worst * scale),
        f"worst_error_standard_uncertainty_{unit}": number(verdict.uncertainty * scale),
        f"tolerance_{unit}": None if given is None else number(given * scale),
        "conformance_probability": number(verdict.probability),
        "verdict": verdict.verdict,
        "reason": verdict.reason,
    }


def _relative(found: Congruence | None) -> dict[str, Any] | None:
    if found is None:
        return None
    turn, advance = np.sqrt(np.mean(found.error**2, axis=0))
    return {
        "motions": len(found.early),
        "turn_rms_error_deg": number(float(turn) * DEGREE),
        "advance_rms_error_mm": number(float(advance) * MILLIMETRE),
        "chi2": number(found.chi2),
        "degrees_of_freedom": found.degrees,
        "p_value": number(found.p_value),
        "detectable_offset_deg": [number(float(d) * DEGREE) for d in found.detectable],
    }


def _combination(found: Combination) -> dict[str, Any]:
    return {
        "label": found.label,
        "joints": found.joints,
        "weights": [round(float(w), 6) for w in found.weights],
        "mean_error_deg": number(found.mean * DEGREE),
        "standard_uncertainty_deg": number(found.standard_uncertainty * DEGREE),
        "pairs": found.pairs,
        "why": found.why,
    }
