"""summary.json: what docs/results.md promises, from what was judged."""

import math
import platform
from collections import Counter
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import scipy

from verify.analysis.combinations import Combination
from verify.analysis.comparison import flange_error
from verify.analysis.diagnosis.causes import Cause
from verify.analysis.diagnosis.diagnose import Diagnosis
from verify.analysis.instrument import MeasuredSession
from verify.analysis.joint_errors import JointErrors, ResolvedErrors
from verify.analysis.model import JointErrorModel, Observability, SessionComparison
from verify.analysis.relative_motion import RelativeMotion
from verify.analysis.results.entries import (
    budget_entry,
    cause_entry,
    correlation_entry,
    finite_number,
    monte_carlo_entry,
    sweep_entries,
)
from verify.analysis.rig_check.tilt import TiltedCamera
from verify.analysis.sweeps.sweeps import JointSweep
from verify.analysis.uncertainty.budget import Budget
from verify.analysis.uncertainty.monte_carlo import MonteCarlo
from verify.analysis.verdict import (
    GUARD_FACTOR,
    P_FALSE_ALARM,
    RULE,
    Verdict,
    agreed_verdict,
    borne_verdict,
    judge_joint,
    judge_norm,
    overall_verdict,
)
from verify.core.records import Array
from verify.core.version import __version__
from verify.io.session.keys import Tolerance

MILLIMETRE = 1e3
DEGREE = 180 / math.pi


@dataclass(frozen=True, slots=True)
class SessionAnalysis:
    """Everything that was found out about a session; n compared pairs, j joints."""

    measured: MeasuredSession
    compared: SessionComparison
    model: JointErrorModel
    tolerance: Tolerance
    status: list[str]  # a pair each
    errors: JointErrors
    resolved: ResolvedErrors
    combinations: list[Combination]
    sources: Budget
    monte_carlo: MonteCarlo | None
    sweeps: list[JointSweep]
    visibility: Observability
    relative: RelativeMotion | None
    diagnosis: Diagnosis
    flange: tuple[Array, Array]  # (6,) mean error twist and (6, 6) its covariance
    warnings: list[str]
    by_clock: "tuple[SessionAnalysis, ...]" = ()  # the same at other offsets that fit as well

    @property
    def frame(self) -> Array:
        """Number of each compared pair, (n,)."""
        return self.compared.track.frame[self.model.comparison.index]

    def resolved_flange(self) -> tuple[Array, Array]:
        """The resolved joint errors at the flange, (n, 6), m and rad, and its covariance."""
        comparison, resolved = self.model.comparison, self.resolved
        jacobian = comparison.jacobian
        twist = flange_error(comparison, self.compared.session.arm, resolved.error)
        return twist, jacobian @ resolved.covariance @ np.swapaxes(jacobian, 1, 2)

    @property
    def error_uncertainty(self) -> Array:
        """Standard uncertainty of each pair's joint errors from all sources, (n, j), rad."""
        covariance = self.compared.joints.covariance
        variance = np.diagonal(covariance, axis1=1, axis2=2)
        variance = variance + np.sum(self.errors.systematic**2, axis=2)
        if self.compared.clock_uncertainty is not None:
            drift = self.model.comparison.rate * self.compared.clock_uncertainty
            variance = variance + drift**2
        return np.asarray(np.sqrt(variance))


def summarise(judged: SessionAnalysis) -> dict[str, Any]:
    """Word the judgement as summary.json."""
    session, clock = judged.compared.session, judged.compared.clock
    counts = Counter(judged.status)
    repeated = len(judged.measured.repeated)
    told = counts - Counter(unaligned=repeated)  # a camera's repeats contradict nothing
    agreed = map(agreed_verdict, zip(*map(_verdicts, (judged, *judged.by_clock)), strict=True))
    *per_joint, position, orientation = (borne_verdict(verdict, told) for verdict in agreed)
    measured = counts.pop("measured", 0)
    choices = Counter(m.choice for m in judged.measured.measurements if m.choice)
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
            **({"certificate": session.certificate} if session.certificate else {}),
            **({} if session.instrument is None else {"instrument": session.instrument.name}),
        },
        "pairs": {
            "recorded": len(judged.status),
            "measured": measured,
            "rejected": dict(sorted(counts.items())),
            **({"repeated": repeated} if repeated else {}),
        },
        "pictures": _pictures(judged.measured),
        "clock": {
            "encoder_offset_s": finite_number(clock.offset),
            "standard_uncertainty_s": finite_number(clock.standard_uncertainty),
            "source": clock.source,
            "observable": clock.source != "none",
            "alternatives_s": list(clock.rivals),
        },
        "verdict": overall_verdict(verdicts),
        "decision_rule": RULE,
        "joints": [_joint(judged, j, per_joint[j]) for j in range(session.arm.dof)],
        "joint_error_correlation": correlation_entry(judged.resolved.mean_covariance),
        "position": _flange(judged, position, slice(0, 3), MILLIMETRE, "mm"),
        "orientation": _flange(judged, orientation, slice(3, 6), DEGREE, "deg"),
        "relative_motions": _relative(judged.relative),
        "diagnosis": _diagnosis(judged),
        "outlying_pairs": [int(f) for f in judged.frame[judged.diagnosis.outlying]],
        "budget": {
            **budget_entry(judged.sources),
            "monte_carlo": monte_carlo_entry(judged.monte_carlo, judged.frame),
        },
        "sweeps": sweep_entries(judged.sweeps, judged.frame),
        "decision": _decision(judged),
        "software": {  # versions of what the figures depend on beside this program
            "python": platform.python_version(),
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "opencv": cv2.__version__,
        },
        "inputs": dict(sorted(session.inputs.items())),
        "warnings": judged.warnings,
        "combinations": [_combination(c) for c in judged.combinations],
        "choices": dict(sorted(choices.items())),
        "known_dof": max((b.shape[1] for b in judged.model.comparison.determined), default=0),
    }


def _pictures(measured: MeasuredSession) -> dict[str, Any] | None:
    found, left_out, shifts = measured.pictures, measured.displaced, measured.shifts
    if found is None:
        return None
    led = left_out or found.led
    return {
        "contradict": found.contradicts,
        "misfit": finite_number(found.whole),
        "first_misfit": finite_number(found.first),
        "last_misfit": finite_number(found.last),
        "displaced_led": None
        if led is None
        else {
            "name": led.name,
            "displacement_mm": [finite_number(x * MILLIMETRE) for x in led.displacement.tolist()],
            "expanded_uncertainty_mm": finite_number(2 * led.standard_uncertainty * MILLIMETRE),
            "last_pairs_only": math.isfinite(led.begin) and math.isinf(led.end),
            "begin_s": finite_number(led.begin),
            "end_s": finite_number(led.end),
            "left_out": left_out is not None,
        },
        "led_shifts": None
        if shifts is None
        else {
            "shift_mm": (shifts.shift * MILLIMETRE).tolist(),
            "expanded_uncertainty_mm": finite_number(2 * shifts.standard_uncertainty * MILLIMETRE),
        },
    }


def _diagnosis(judged: SessionAnalysis) -> list[dict[str, Any]]:
    """The causes; an offset that is all that ails its joint is the mean of the resolved error."""
    causes, resolved, pictures = judged.diagnosis.causes, judged.resolved, judged.measured.pictures
    count = Counter(c.joint for c in causes)
    tilts = [] if pictures is None or pictures.tilted is None else [_tilt(pictures.tilted)]
    entries = list(tilts)
    for cause in causes:
        entry = cause_entry(cause)
        if (same := _same_as(cause, len(resolved.mean))) is not None:
            entry["same_as"] = same
        # a base or whole rig that creeps leaves the pictures as they should be
        elif cause.kind == "base_drift" and not tilts and pictures and pictures.contradicts:
            entry["same_as"] = "camera_tilted"
        j = (cause.joint or 0) - 1
        if cause.kind == "offset" and count[cause.joint] == 1 and np.isfinite(resolved.mean[j]):
            u = float(np.sqrt(resolved.mean_covariance[j, j]) * DEGREE)
            entry |= {
                "value": float(resolved.mean[j] * DEGREE),
                "standard_uncertainty": u,
                "expanded_uncertainty": float(judged.sources.coverage_factor[j]) * u,
            }
        entries.append(entry)
    return entries


def _tilt(found: TiltedCamera) -> dict[str, Any]:
    """The cause that the pictures tell by themselves."""
    u = found.standard_uncertainty * DEGREE
    return {
        "joint": None,
        "kind": "camera_tilted",
        "value": found.angle * DEGREE,
        "unit": "deg",
        "standard_uncertainty": u,
        "expanded_uncertainty": 2 * u,
        "explains": found.explains,
        **({} if found.begin is None else {"t_s": found.begin}),
    }


def _same_as(cause: Cause, dof: int) -> str | None:
    """What shows the same as a cause whatever the motion; None: nothing does.

    The base turned about the first axis, or shifted along it; the LED body, with all that stands
    behind the last axis.
    """
    same: dict[tuple[str, int | None, str | None], str] = {
        ("offset", 1, None): "base_turned",
        ("drift", 1, None): "base_turned",
        ("dh", 1, "d1"): "base_shifted",
        ("offset", dof, None): "led_body_turned",
        ("drift", dof, None): "led_body_turned",
        ("dh", dof, f"d{dof}"): "led_body_shifted",
        ("dh", dof, f"a{dof}"): "led_body_shifted",
        ("dh", dof, f"alpha{dof}"): "led_body_tilted",
    }
    return same.get((cause.kind, cause.joint, cause.fault.parameter))


def _decision(judged: SessionAnalysis) -> dict[str, Any]:
    """The decision rule's figures, for a program that checks the verdicts."""
    fit = judged.resolved.fit
    return {
        "guard": GUARD_FACTOR,
        "false_alarm": P_FALSE_ALARM,
        "fitted_terms": [list(terms) for terms in judged.resolved.terms],
        "half_range_deg": [finite_number(s * DEGREE) for s in judged.resolved.swing],
        "half_range_standard_uncertainty_deg": [
            finite_number(u * DEGREE) for u in judged.resolved.swing_uncertainty
        ],
        "lack_of_fit": judged.resolved.lack_of_fit,
        "chi2": finite_number(fit.chi2),
        "degrees_of_freedom": fit.degrees_of_freedom,
        "tolerance_from": _tolerance_source(judged),
    }


def _tolerance_source(judged: SessionAnalysis) -> str | None:
    """Who asked for the tolerances: the session's file, or whoever had it judged."""
    used, own = judged.tolerance, judged.compared.session.tolerance
    parts = used.joints, used.position, used.orientation
    if all(part is None for part in parts):
        return None
    given = (None, None, None) if own is None else (own.joints, own.position, own.orientation)
    alike = (np.array_equal(np.array(a), np.array(b)) for a, b in zip(parts, given, strict=True))
    return "session.toml" if all(alike) else "command line"


def _verdicts(judged: SessionAnalysis) -> list[Verdict]:
    """The verdict of each joint, of the position and of the orientation."""
    detectable = judged.visibility.detectable
    given = judged.tolerance.joints
    tolerance = [None] * len(detectable) if given is None else given.tolist()
    joints = [
        judge_joint(judged.resolved, j, tolerance[j], float(detectable[j]))
        for j in range(len(detectable))
    ]
    return [*joints, *_flange_verdicts(judged)]


def _joint(judged: SessionAnalysis, j: int, verdict: Verdict) -> dict[str, Any]:
    resolved, seen = judged.resolved, judged.visibility
    error = judged.compared.joints.single[:, j]
    # residuals of a registration accuse the wrong joint: they are not summed up
    plain = error[~np.isnan(error)] if not judged.model.through_encoders else np.zeros(0)
    u = float(np.sqrt(resolved.mean_covariance[j, j]))
    k = float(judged.sources.coverage_factor[j])
    given = judged.tolerance.joints
    return {
        "joint": j + 1,
        "mean_error_deg": finite_number(resolved.mean[j] * DEGREE),
        "plain_mean_error_deg": finite_number(float(plain.mean()) * DEGREE) if len(plain) else None,
        "rms_error_deg": finite_number(float(np.sqrt(np.mean(plain**2))) * DEGREE)
        if len(plain)
        else None,
        "max_abs_error_deg": finite_number(float(np.max(np.abs(plain))) * DEGREE)
        if len(plain)
        else None,
        "standard_uncertainty_deg": finite_number(u * DEGREE),
        "expanded_uncertainty_deg": finite_number(k * u * DEGREE),
        "coverage_factor": finite_number(k) if math.isfinite(u) else None,
        "worst_error_deg": finite_number(verdict.worst * DEGREE),
        "worst_error_standard_uncertainty_deg": finite_number(verdict.uncertainty * DEGREE),
        "tolerance_deg": None if given is None else finite_number(given[j] * DEGREE),
        "conformance_probability": finite_number(verdict.probability),
        "verdict": verdict.verdict,
        "reason": verdict.reason,
        "pairs": int(np.sum(~np.isnan(error))) or len(error),
        "visible_fraction": finite_number(seen.fraction[j]),
        "visible_fraction_since_registration": finite_number(seen.fraction_since[j]),
        "minimum_detectable_error_deg": finite_number(seen.detectable[j] * DEGREE),
        "minimum_separable_error_deg": finite_number(seen.separable[j] * DEGREE),
    }


def _flange_verdicts(judged: SessionAnalysis) -> tuple[Verdict, Verdict]:
    """The resolved joint errors carried through the arm, judged by the same rule."""
    (twist, spread), resolved = judged.resolved_flange(), judged.resolved
    terms = sum(len(t) for t in resolved.terms)
    tolerance = judged.tolerance
    return (
        judge_norm(twist[:, :3], spread[:, :3, :3], terms, tolerance.position, resolved),
        judge_norm(twist[:, 3:], spread[:, 3:, 3:], terms, tolerance.orientation, resolved),
    )


def _flange(
    judged: SessionAnalysis, verdict: Verdict, part: slice, scale: float, unit: str
) -> dict[str, Any]:
    whole = np.array([b.shape[1] == 6 for b in judged.model.comparison.determined], dtype=bool)
    size = np.linalg.norm(judged.model.comparison.xi[:, part], axis=1)[whole]
    # where LEDs leave directions open, nothing is known of the error along them
    largest = float(np.linalg.eigvalsh(judged.flange[1][part, part])[-1]) if whole.all() else np.nan
    given = judged.tolerance.position if unit == "mm" else judged.tolerance.orientation
    return {
        f"rms_error_{unit}": finite_number(float(np.sqrt(np.mean(size**2))) * scale)
        if len(size)
        else None,
        f"max_error_{unit}": finite_number(float(size.max()) * scale) if len(size) else None,
        f"expanded_uncertainty_{unit}": finite_number(2 * math.sqrt(largest) * scale),
        f"worst_error_{unit}": finite_number(verdict.worst * scale),
        f"worst_error_standard_uncertainty_{unit}": finite_number(verdict.uncertainty * scale),
        f"tolerance_{unit}": None if given is None else finite_number(given * scale),
        "conformance_probability": finite_number(verdict.probability),
        "verdict": verdict.verdict,
        "reason": verdict.reason,
    }


def _relative(found: RelativeMotion | None) -> dict[str, Any] | None:
    if found is None:
        return None
    turn, advance = np.sqrt(np.mean(found.error**2, axis=0))
    return {
        "motions": len(found.early),
        "turn_rms_error_deg": finite_number(float(turn) * DEGREE),
        "advance_rms_error_mm": finite_number(float(advance) * MILLIMETRE),
        "chi2": finite_number(found.chi2),
        "degrees_of_freedom": found.degrees,
        "p_value": finite_number(found.p_value),
        "detectable_offset_deg": [finite_number(float(d) * DEGREE) for d in found.detectable],
    }


def _combination(found: Combination) -> dict[str, Any]:
    return {
        "label": found.label,
        "joints": found.joints,
        "weights": [round(float(w), 6) for w in found.weights],
        "mean_error_deg": finite_number(found.mean * DEGREE),
        "standard_uncertainty_deg": finite_number(found.standard_uncertainty * DEGREE),
        "pairs": found.pairs,
        "why": found.why,
    }
