"""Single-joint sweeps: a joint's encoder against the turn about its own axis, without registration.

While one joint moves alone, the flange turns about that joint's axis, wherever the robot stands,
however the LEDs are mounted and whatever the arm's table says. How far it turned, against what the
encoder says, shows gear ratio, hysteresis, eccentricity and what is left of a straight line. A
constant offset of the joint does not show.
"""

from dataclasses import dataclass, fields, replace

import numpy as np

from verify.analysis.comparison import alignment_scale
from verify.analysis.joint_errors import MIN_SPAN_CIRCULAR, P_LACK_OF_FIT
from verify.analysis.model import JointErrorModel, SessionComparison
from verify.analysis.sweeps.axis import (
    NO_FIGURE,
    SweepData,
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
            judged.append(_judge_sweep(pairs.without(outlying), pairs.rows[outlying]))
    return judged


def _sweep_pairs(
    model: JointErrorModel, compared: SessionComparison, segment: SweepSegment, direction: Array
) -> "_SweepPairs":
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
    swept = SweepData(
        poses=comparison.base_T_measured[rows],
        covariance=covariance,
        held=model.prior_columns[rows],
        q=comparison.q[rows, joint],
        reading_variance=variance,
    )
    given = compared.clock.source == "given"
    return _SweepPairs(swept, rows, joint, direction[chosen], None if given else rate)


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


@dataclass(frozen=True, slots=True)
class _SweepPairs:
    """A sweep's pairs, n of them."""

    swept: SweepData
    rows: Index
    joint: int
    direction: Array
    rate: Array | None  # of a clock that is fitted along

    def without(self, left_out: Flags) -> "_SweepPairs":
        """The other pairs."""
        parts = {f.name: getattr(self.swept, f.name)[~left_out] for f in fields(SweepData)}
        rate = None if self.rate is None else self.rate[~left_out]
        return _SweepPairs(
            SweepData(**parts), self.rows[~left_out], self.joint, self.direction[~left_out], rate
        )


def _outliers(case: _SweepPairs) -> Flags:
    """Pairs that lie off the circle by more than all others, (n,): a spot that was bitten, say.

    A flange that leaves its circle again and again is no outlier: then none is left out.
    """
    _, fit = fit_terms(case.swept, case.direction, case.rate, circular=False)
    count = len(case.rows)
    off = np.linalg.solve(case.swept.covariance, fit.rest[:, :, None])[:, :, 0]
    far = np.sum(fit.rest * off, axis=1) > chi2_isf(P_OUTLIER / count, 5)
    few = np.sum(far) <= max(1, int(MAX_OUTLIER_SHARE * count))
    return far if few else np.zeros(count, dtype=bool)


def _judge_sweep(case: _SweepPairs, outlying: Index) -> JointSweep:
    swept, rows, direction, rate = case.swept, case.rows, case.direction, case.rate
    terms, fit = fit_terms(swept, direction, rate, circular=False)
    eccentricity, phase, eccentric = NO_FIGURE, NO_FIGURE, False
    if np.ptp(swept.q) > MIN_SPAN_CIRCULAR:
        wide = fit_terms(swept, direction, rate, circular=True)
        eccentricity, phase, eccentric = find_eccentricity(*wide)
        if eccentric:
            terms, fit = wide
    angle_degrees = len(rows) - terms.columns.shape[1] - 1
    rest_degrees = 5 * len(rows) - 9  # of line and start pose, a shift along the angle taken out
    nonlinear_p = float(chi2_sf(fit.chi2_angle, max(angle_degrees, 1)))
    # a fit that lacks knows its figures no better than it describes the pairs (Birge)
    misfit = (
        max(1.0, fit.chi2_angle / max(angle_degrees, 1)) if nonlinear_p < P_LACK_OF_FIT else 1.0
    )
    by_clock = terms.columns[:, terms.clock] * fit.value[terms.clock] if terms.clock >= 0 else 0.0
    curve = terms.columns @ fit.value - by_clock
    error = curve - fit.angle_left
    line = terms.columns[:, 0] * fit.value[0]
    if terms.hysteresis >= 0:
        line = line + terms.columns[:, terms.hysteresis] * fit.value[terms.hysteresis]
    left = error - line - np.mean(error - line)
    rms = float(np.sqrt(np.mean(left**2)))
    return JointSweep(
        joint=case.joint,
        rows=rows,
        outlying=outlying,
        q=swept.q,
        direction=direction,
        error=error,
        uncertainty=np.sqrt(fit.angle_variance),
        curve=curve,
        gain=term_figure(fit, 0, misfit),
        hysteresis=term_figure(fit, terms.hysteresis, misfit),
        eccentricity=replace(
            eccentricity, uncertainty=eccentricity.uncertainty * float(np.sqrt(misfit))
        ),
        phase=phase,
        eccentric=eccentric,
        nonlinearity=UncertainValue(rms, rms / float(np.sqrt(2 * max(angle_degrees, 1)))),
        noise=float(np.sqrt(np.mean(fit.angle_variance))),
        nonlinear_p=nonlinear_p,
        wobble=(
            float(np.sqrt(np.mean(np.sum(fit.rest[:, :3] ** 2, axis=1)))),
            float(np.sqrt(np.mean(np.sum(fit.rest[:, 3:] ** 2, axis=1)))),
        ),
        wobble_p=float(chi2_sf(fit.chi2_rest, max(rest_degrees, 1))),
    )
