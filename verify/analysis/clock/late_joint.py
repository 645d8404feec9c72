"""One joint whose readings are late against those of the others, though they stand in one row.

Beside a clock offset o and the errors of all joints, resolved by angle and direction of travel,
a joint k whose readings are d late is tried:

    xi = J e(q, s) - J q' o - J_k q'_k d + noise

Newton's steps on o and d move the readings themselves: a tenth of a second is no small step. The
joint is named where that leaves a small share of the misfit, and any other joint far more.
"""

import numpy as np

import robots
from verify.analysis.clock.estimate import MAX_PAIRS_COMPARED, MAX_STEP, spread
from verify.analysis.clock.search import are_visits
from verify.analysis.comparison import compare
from verify.analysis.joint_errors import error_terms
from verify.analysis.least_squares import RegressionFit, solve, whiten
from verify.analysis.model import clock_effect
from verify.core.readings import Readings
from verify.measurement.track import Track, subset

MIN_LATE = 0.005  # s; less may be an elastic gear, and moves little
MAX_LEFT_SHARE = 0.25  # of the misfit, with the joint's delay; and of what another joint's leaves
MAX_FIRST_SHARE = 0.6  # likewise, after one step: others are not worth more
MIN_MISFIT = 4.0  # of the session without: below that nothing is wrong that matters
MAX_STEPS = 8
TOL_LATE = 1e-5  # s


def late_joint(
    track: Track, arm: robots.Arm, readings: Readings, offset: float
) -> tuple[int, float] | None:
    """The joint, from 1, whose readings are late, and by how much, s; negative: early.

    None where no joint's are, or where the session does not say whose.
    """
    if are_visits(track.t) or are_visits(readings.t):
        return None
    sample = subset(track, spread(len(track), MAX_PAIRS_COMPARED))
    plain = _misfit(_fit(sample, arm, readings, offset, None))
    if plain < MIN_MISFIT:
        return None
    first = sorted(_refined(sample, arm, readings, offset, j, 1) for j in range(arm.dof))
    if first[0][0] > MAX_FIRST_SHARE * plain:
        return None
    tried = [_refined(sample, arm, readings, offset, j, MAX_STEPS) for *_, j in first[:2]]
    (left, late, joint), (other, *_) = sorted(tried)
    if left > MAX_LEFT_SHARE * min(plain, other) or abs(late) < MIN_LATE:
        return None
    return joint + 1, late


def _refined(
    track: Track, arm: robots.Arm, readings: Readings, offset: float, joint: int, steps: int
) -> tuple[float, float, int]:
    """The misfit with the best delay of the joint, from 0; that delay, s; the joint."""
    late, least = 0.0, (np.inf, 0.0, joint)
    for _ in range(steps):
        q = readings.q.copy()
        q[:, joint] = readings.at(readings.t + late)[:, joint]
        fit = _fit(track, arm, Readings(readings.t, q), offset, joint)
        step = np.clip(fit.value[:2], -MAX_STEP, MAX_STEP)
        offset, late = offset - float(step[0]), late + float(step[1])
        least = min(least, (_misfit(fit), late, joint))
        if np.abs(step).max() < TOL_LATE:
            break
    return least


def _fit(
    track: Track, arm: robots.Arm, readings: Readings, offset: float, joint: int | None
) -> RegressionFit:
    """Fit the clock, the delay of a joint (from 0) if one is given, and all joints' errors."""
    comparison = compare(track, arm, readings, offset)
    jacobian = comparison.jacobian
    columns = [clock_effect(comparison)]
    if joint is not None:
        columns.append(-jacobian[:, :, [joint]] * comparison.rate[:, None, [joint]])
    for j, terms in enumerate(error_terms(comparison)[1] if len(comparison) else ()):
        columns.append(jacobian[:, :, [j]] * terms[:, None])
    white = whiten(comparison)
    return solve(
        white.rows(np.concatenate(columns, axis=2)), white.rows(comparison.xi[:, :, None])[:, 0]
    )


def _misfit(fit: RegressionFit) -> float:
    return fit.chi2 / max(fit.degrees_of_freedom, 1)
