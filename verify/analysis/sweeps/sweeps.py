"""Single-joint sweeps: a joint's encoder against the turn about its own axis, without registration.

While one joint moves alone, the flange turns about that joint's axis, wherever the robot stands,
however the LEDs are mounted and whatever the arm's table says. How far it turned, against what the
encoder says, shows gear ratio, hysteresis, eccentricity and what is left of a straight line. A
constant offset of the joint does not show.
"""

from dataclasses import dataclass

import numpy as np

from verify.analysis.comparison import alignment_scale
from verify.analysis.joint_errors import MIN_SPAN_CIRCULAR, P_LACK_OF_FIT
from verify.analysis.model import JointErrorModel, SessionComparison
from verify.analysis.sweeps.axis import (
    NO_FIGURE,
    AxisFit,
    SweepPairs,
    UncertainValue,
    find_eccentricity,
    fit_terms,
    term_figure,
)
from verify.analysis.sweeps.segments import SweepSegment, comparison_segments
from verify.analysis.uncertainty.sources import pan_reading_covariance
from verify.core.records import Array, Flags, Index
from verify.core.statistics import chi2_isf, chi2_sf
from verify.measurement.track import Track, subset

MAX_PAIRS = 150  # of one sweep, evenly spread: more only cost time
P_OUTLIER = 1e-3  # chance of any in a sweep that has none
MAX_OUTLIER_SHARE = 0.1  # of the pairs; more are no outliers
MIN_PLAY_SIGMA = 4.0  # standard uncertainties: a hysteresis beyond may be play
PLAY_MARGIN = 1.5  # of the hysteresis first found: the travel that takes up the play
MAX_SWEEPS = 60  # of a session, the widest: a fiftieth of a second each


@dataclass(frozen=True, slots=True)
class JointSweep:
    """One joint turned alone; n pairs. Angles in rad, errors are reading less true angle."""

    joint: int  # from 0
    rows: Index  # (n,), of the comparison
    outlying: Index  # rows that were left out: off the circle beyond chance
    q: Array  # (n,), reading
    direction: Array  # (n,), of travel, +1 or -1
    error: Array  # (n,), about their mean: a constant does not show
    uncertainty: Array  # (n,), standard, of the error, pixels and readings
    curve: Array  # (n,), the fitted error
    gain: UncertainValue  # d reading / d true - 1
    hysteresis: UncertainValue  # reading on the way up less on the way down, at one angle
    eccentricity: UncertainValue  # amplitude once a turn
    phase: UncertainValue  # the true angle at which the eccentricity's error is largest
    eccentric: bool  # beyond chance: then gain and hysteresis come from the fit with it
    nonlinearity: UncertainValue  # rms of what a straight line and the hysteresis leave
    noise: float  # rms that pixels and readings alone give
    nonlinear_p: float  # that noise alone leaves as much beside the curve
    wobble: tuple[float, float]  # rms of what no turn about a fixed axis explains: m, rad
    wobble_p: float  # that noise alone gives as much


def judge_sweeps(model: JointErrorModel, compared: SessionComparison) -> list[JointSweep]:
    """Find the single-joint sweeps of a session, the MAX_SWEEPS widest, and judge each.

    Unless the clock's offset was stated, each sweep fits what is left of it: an error of the clock
    resembles hysteresis.
    """
    found = comparison_segments(model.comparison, compared.session.encoder_resolution)
    least = sorted((segment.span for segment, _ in found), reverse=True)[:MAX_SWEEPS]
    judged = []
    for segment, direction in found:
        if segment.span >= least[-1]:
            pairs = _sweep_pairs(model, compared, segment, direction)
            outlying = _outliers(pairs)
            kept = pairs.without(outlying)
            settled = kept.without(_in_play(kept))
            judged.append(_judge_sweep(segment.joint, settled, pairs.rows[outlying]))
    return judged


def _sweep_pairs(
    model: JointErrorModel, compared: SessionComparison, segment: SweepSegment, direction: Array
) -> SweepPairs:
    """Take a segment's pairs, MAX_PAIRS at most, with what is known of each."""
    session, comparison, joint = compared.session, model.comparison, segment.joint
    count = min(len(segment.rows), MAX_PAIRS)
    chosen = np.linspace(0, len(segment.rows) - 1, count).round().astype(int)
    rows = segment.rows[chosen]
    rate = comparison.rate[rows, joint]
    covariance = _own_noise(compared.track, comparison.index[segment.rows], comparison.index[rows])
    for spread in pan_reading_covariance(comparison, compared):
        covariance = covariance + spread[rows]
    variance = np.full(count, comparison.reading_noise[joint] ** 2)
    variance += (session.encoder_resolution or 0.0) ** 2 / 12
    variance += (rate * (session.encoder_time_standard_uncertainty or 0.0)) ** 2
    return SweepPairs(
        poses=comparison.base_T_measured[rows],
        covariance=covariance,
        held=model.prior_columns[rows],
        q=comparison.q[rows, joint],
        reading_variance=variance,
        rows=rows,
        direction=direction[chosen],
        rate=None if compared.clock.source == "given" else rate,
    )


def _own_noise(track: Track, segment: Index, rows: Index) -> Array:
    """Covariance of some of a segment's poses, (n, 6, 6), by its own accelerations.

    A shoulder swept alone accelerates the flange ten times as much as a wrist: the session's mean
    would be too little for one and too much for the other. And where a joint turns back it
    accelerates most: what the neighbours show there of alignment is counted pair by pair.
    """
    scale = float(alignment_scale(subset(track, segment)).mean())
    left = track.alignment_error[rows]
    total: Array = track.covariance_pixels[rows] + scale * track.covariance_alignment[rows]
    return total + left[:, :, None] * left[:, None, :]


def _outliers(case: SweepPairs) -> Flags:
    """Pairs that lie off the circle by more than all others, (n,): a spot that was bitten, say.

    The farthest draw the circle after them, so they go first. A flange that leaves its circle again
    and again is no outlier: then none is left out.
    """
    count = len(case.rows)
    far = np.zeros(count, dtype=bool)
    while np.sum(far) <= max(1, int(MAX_OUTLIER_SHARE * count)):
        kept = case.without(far)
        _, fit = fit_terms(kept, circular=False)
        off = np.linalg.solve(kept.covariance, fit.rest[:, :, None])[:, :, 0]
        square = np.sum(fit.rest * off, axis=1)
        beyond = square > max(chi2_isf(P_OUTLIER / count, 5), square.max() / 2)
        if not beyond.any():
            return far
        far[~far] = beyond
    return np.zeros(count, dtype=bool)


def _in_play(case: SweepPairs) -> Flags:
    """Pairs after a turning back, or the start, at which a joint with backlash may rest, (n,)."""
    terms, fit = fit_terms(case, circular=False)
    found = term_figure(fit, terms.hysteresis, _lack_of_fit(fit)[2])
    turned = np.flatnonzero(np.diff(case.direction))  # the last pairs before
    last = np.concatenate([[0], turned])[np.searchsorted(turned, np.arange(len(case.rows)))]
    travel = np.abs(case.q - case.q[last])
    # such pairs themselves make the hysteresis look smaller
    there = abs(found.value) > MIN_PLAY_SIGMA * found.uncertainty
    return np.asarray(there & (travel < PLAY_MARGIN * abs(found.value)))


def _lack_of_fit(fit: AxisFit) -> tuple[int, float, float]:
    """Degrees of freedom of the angles left, chance that noise alone leaves such, and the misfit.

    A fit that lacks knows its figures no better than it describes the pairs (Birge).
    """
    degrees = max(len(fit.angle_left) - len(fit.value) - 1, 1)
    chance = float(chi2_sf(fit.chi2_angle, degrees))
    return degrees, chance, max(1.0, fit.chi2_angle / degrees) if chance < P_LACK_OF_FIT else 1.0


def _judge_sweep(joint: int, case: SweepPairs, outlying: Index) -> JointSweep:
    terms, fit = fit_terms(case, circular=False)
    eccentricity, phase, eccentric = NO_FIGURE, NO_FIGURE, False
    if np.ptp(case.q) > MIN_SPAN_CIRCULAR:
        wide = fit_terms(case, circular=True)
        eccentricity, phase, eccentric = find_eccentricity(*wide, _lack_of_fit(wide[1])[2])
        if eccentric:
            terms, fit = wide
    # of line and start pose, a shift along the angle taken out
    rest_degrees = 5 * len(case.rows) - 9
    degrees, nonlinear_p, misfit = _lack_of_fit(fit)
    by_clock = terms.columns[:, terms.clock] * fit.value[terms.clock] if terms.clock >= 0 else 0.0
    curve = terms.columns @ fit.value - by_clock
    error = curve - fit.angle_left
    straight = [0] if terms.hysteresis < 0 else [0, terms.hysteresis]
    line = terms.columns[:, straight] @ fit.value[straight]
    left = error - line - np.mean(error - line)
    rms = float(np.sqrt(np.mean(left**2)))
    return JointSweep(
        joint=joint,
        rows=case.rows,
        outlying=outlying,
        q=case.q,
        direction=case.direction,
        error=error,
        uncertainty=np.sqrt(fit.angle_variance),
        curve=curve,
        gain=term_figure(fit, 0, misfit),
        hysteresis=term_figure(fit, terms.hysteresis, misfit),
        eccentricity=eccentricity,
        phase=phase,
        eccentric=eccentric,
        nonlinearity=UncertainValue(rms, rms / float(np.sqrt(2 * degrees))),
        noise=float(np.sqrt(np.mean(fit.angle_variance))),
        nonlinear_p=nonlinear_p,
        wobble=(
            float(np.sqrt(np.mean(np.sum(fit.rest[:, :3] ** 2, axis=1)))),
            float(np.sqrt(np.mean(np.sum(fit.rest[:, 3:] ** 2, axis=1)))),
        ),
        wobble_p=float(chi2_sf(fit.chi2_rest, max(rest_degrees, 1))),
    )
