"""Joints whose readings are late against those of the others, though they stand in one row.

Beside the errors of all joints, resolved by angle and direction of travel, each joint's own delay
d_k is fitted; a common one is the clock's offset:

    xi = J e(q, s) - sum over k of J_k q'_k d_k + noise

Newton's steps move the readings themselves: a tenth of a second is no small step. Joints are named
where that leaves a small share of the misfit, and most joints agree.
"""

import numpy as np

import robots
from verify.analysis.clock.estimate import MAX_PAIRS_COMPARED, MAX_STEP, spread
from verify.analysis.clock.search import are_visits
from verify.analysis.comparison import compare
from verify.analysis.joint_errors import error_terms
from verify.analysis.least_squares import RegressionFit, solve, whiten
from verify.core.readings import Readings
from verify.measurement.track import Track, subset

MIN_LATE = 0.005  # s; less may be an elastic gear, and moves little
MIN_RATIO = 5.0  # of it, and of a delay, to their standard uncertainties
MAX_LEFT_SHARE = 0.25  # of the misfit, with the joints' delays
MIN_MISFIT = 4.0  # of the session without: below that nothing is wrong that matters
MIN_JOINTS = 3  # whose delays are known
MAX_STEPS = 8
TOL_LATE = 1e-5  # s


def late_joints(
    track: Track, arm: robots.Arm, readings: Readings, offset: float
) -> dict[int, float]:
    """Joints, from 1, whose readings are late, and by how much, s; negative: early.

    Empty where no joint's are, or where the session does not say whose.
    """
    if are_visits(track.t) or are_visits(readings.t):
        return {}
    sample = subset(track, spread(len(track), MAX_PAIRS_COMPARED))
    late, plain = np.zeros(arm.dof), np.inf
    for step in range(MAX_STEPS):
        moved = [readings.at(readings.t + d)[:, k] for k, d in enumerate(late.tolist())]
        log = Readings(readings.t, np.stack(moved, axis=1))
        fit, without = _fit(sample, arm, log, offset)
        plain = without if step == 0 else plain
        left = fit.chi2 / max(fit.degrees_of_freedom, 1)
        if plain < MIN_MISFIT or left > 2 * MAX_LEFT_SHARE * plain:
            return {}
        own = slice(0, arm.dof)
        change = np.where(fit.estimable[own], np.clip(fit.value[own], -MAX_STEP, MAX_STEP), 0.0)
        late = late + change
        if np.abs(change).max() < TOL_LATE:
            break
    doubt = MIN_RATIO * np.sqrt(left * np.diag(fit.covariance)[own])
    known = fit.estimable[own] & (doubt < MIN_LATE)
    if left > MAX_LEFT_SHARE * plain or known.sum() < MIN_JOINTS:
        return {}
    apart = late - np.median(late[known])
    found = np.flatnonzero(known & (np.abs(apart) > MIN_LATE))
    return {k + 1: float(apart[k]) for k in found.tolist()} if 2 * len(found) < known.sum() else {}


def _fit(
    track: Track, arm: robots.Arm, readings: Readings, offset: float
) -> tuple[RegressionFit, float]:
    """Fit the joints' delays and errors, delays first; the misfit with one delay for all."""
    comparison = compare(track, arm, readings, offset)
    jacobian, white = comparison.jacobian, whiten(comparison)
    delays = white.rows(-jacobian * comparison.rate[:, None])
    errors = [
        white.rows(jacobian[:, :, [j]] * terms[:, None])
        for j, terms in enumerate(error_terms(comparison)[1] if len(comparison) else ())
    ]
    xi = white.rows(comparison.xi[:, :, None])[:, 0]
    common = solve(np.concatenate([delays.sum(axis=1)[:, None], *errors], axis=1), xi)
    fit = solve(np.concatenate([delays, *errors], axis=1), xi)
    return fit, common.chi2 / max(common.degrees_of_freedom, 1)
