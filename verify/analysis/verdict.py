"""Conform, nonconform or undecided: docs/measuring.md's rule with guard bands."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from verify.analysis.joint_errors import MIN_PAIRS, ResolvedErrors
from verify.analysis.model import vector_length
from verify.core.records import Array
from verify.core.statistics import chi2_isf, norm_cdf, norm_isf

GUARD_FACTOR = 1.645  # of the standard uncertainty: one-sided 95 %
P_FALSE_ALARM = 0.05  # of calling a conforming joint nonconform, shared out over its fitted terms

RULE = (
    "Conform: |resolved error| + 1.645 u within the tolerance at every measured pair, no lack of "
    "fit (chi-squared, 0.1 %), and the detectable error within the tolerance. Nonconform: "
    "|resolved error| − z u beyond the tolerance at some pair, z two-sided 5 % with Bonferroni "
    "over the fitted terms. Else undecided. The verdict covers the poses, directions and speeds "
    "seen, no others. Undecided as well: all, where more pairs contradict rig.toml and marker.toml "
    f"than were measured; what would conform, where most pairs were lost and under {MIN_PAIRS} are "
    "left."
)
CONTRADICTING = ("outlier", "ambiguous_leds", "unaligned", "unreachable")  # of a pair's statuses


@dataclass(frozen=True, slots=True)
class Verdict:
    """One judged quantity; `worst` and `uncertainty` in the unit of its tolerance."""

    verdict: str | None  # conform, nonconform, undecided; None without a tolerance
    reason: str
    worst: float  # the resolved error of largest magnitude
    uncertainty: float  # its standard uncertainty
    probability: float | None  # that the error is within the tolerance at the worst pair


def judge_joint(
    resolved: ResolvedErrors, joint: int, tolerance: float | None, detectable: float
) -> Verdict:
    """Judge one joint by its resolved error at every pair."""
    error, u = resolved.error[:, joint], resolved.uncertainty[:, joint]
    terms = len(resolved.terms[joint])
    z = float(norm_isf(P_FALSE_ALARM / 2 / terms))
    swing, doubt = float(resolved.swing[joint]), float(resolved.swing_uncertainty[joint])
    if np.isnan(error).any() and tolerance is not None and swing - z * doubt > tolerance:
        # whatever its constant may be, at one end or the other it is beyond the tolerance
        return Verdict("nonconform", "exceeds_tolerance", float("nan"), float("nan"), None)
    return _judge(error, u, z, tolerance, detectable, resolved.lack_of_fit)


def judge_norm(
    vectors: Array, covariance: Array, terms: int, tolerance: float | None, resolved: ResolvedErrors
) -> Verdict:
    """Judge the length of an error vector at every pair, (n, 3) with (n, 3, 3)."""
    size, u = vector_length(vectors, covariance)
    # the length of three components is larger by chance than any one of them
    z = float(max(norm_isf(P_FALSE_ALARM / 2 / terms), np.sqrt(chi2_isf(P_FALSE_ALARM / terms, 3))))
    return _judge(size, u, z, tolerance, 0.0, resolved.lack_of_fit)


def _judge(
    error: Array, u: Array, z: float, tolerance: float | None, detectable: float, lack_of_fit: bool
) -> Verdict:
    nan = float("nan")
    if not len(error) or np.isnan(error).any() or np.isnan(u).any():
        open_verdict = None if tolerance is None else "undecided"
        return Verdict(open_verdict, "not_observable", nan, nan, None)
    worst = int(np.argmax(np.abs(error)))
    value, doubt = float(error[worst]), float(u[worst])
    if tolerance is None:
        return Verdict(None, "no_tolerance", value, doubt, None)
    safe = np.where(u > 0, u, 1e-300)
    within = norm_cdf((tolerance - error) / safe) - norm_cdf((-tolerance - error) / safe)
    probability = float(np.min(within))
    if bool(np.any(np.abs(error) - z * u > tolerance)):
        return Verdict("nonconform", "exceeds_tolerance", value, doubt, probability)
    reason = ""
    if lack_of_fit:
        reason = "lack_of_fit"
    elif not detectable <= tolerance:  # nan: nothing would be noticed
        reason = "not_detectable"
    elif bool(np.any(np.abs(error) + GUARD_FACTOR * u > tolerance)):
        reason = "uncertainty_too_large"
    if reason:
        return Verdict("undecided", reason, value, doubt, probability)
    return Verdict("conform", "within_tolerance", value, doubt, probability)


def borne_verdict(verdict: Verdict, status: Counter[str]) -> Verdict:
    """The verdict as far as the pairs that are left bear it; `status` counts all pairs.

    Where more contradict rig and marker than were measured, those left may be the wrong ones. Where
    most are lost and under MIN_PAIRS left, no scatter beside slope and direction says whether
    these are sound.
    """
    measured = status["measured"]
    against = sum(status[word] for word in CONTRADICTING) > measured
    few = verdict.verdict == "conform" and measured < MIN_PAIRS and 2 * measured < status.total()
    if verdict.verdict is None or not (against or few):
        return verdict
    return replace(verdict, verdict="undecided", reason="pairs_lost")


def agreed_verdict(verdicts: Sequence[Verdict]) -> Verdict:
    """The first of several verdicts on one quantity; undecided where another one differs."""
    first = verdicts[0]
    if all(v.verdict == first.verdict for v in verdicts):
        return first
    return replace(first, verdict="undecided", reason="clock_ambiguous")


def overall_verdict(verdicts: list[str | None]) -> str | None:
    """Nonconform if any is; else undecided if any is; else conform; None if nothing was judged."""
    asked = [v for v in verdicts if v is not None]
    for answer in ("nonconform", "undecided", "conform"):
        if answer in asked:
            return answer
    return None
