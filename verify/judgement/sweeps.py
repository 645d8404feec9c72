"""Single-joint sweeps: a joint's encoder against the turn about its own axis, without registration.

While one joint moves alone, the flange turns about that joint's axis, wherever the robot stands,
however the LEDs are mounted and whatever the arm's table says. How far it turned, against what the
encoder says, shows gear ratio, hysteresis, eccentricity and what is left of a straight line. A
constant offset of the joint does not show.
"""

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from verify.comparison import alignment_scale
from verify.distributions import chi2_isf, chi2_sf
from verify.judgement.budget_sources import many_pan_readings
from verify.judgement.model import Model
from verify.judgement.resolved import CIRCULAR_SPAN, LACK_OF_FIT
from verify.judgement.sweep_axis import Swept
from verify.judgement.sweep_stretches import Stretch, find_stretches, reading_noise
from verify.judgement.sweep_terms import NOTHING, Figure, figure, find_eccentricity, fit_terms
from verify.records import Array
from verify.session import Session
from verify.systematics import Systematics
from verify.track import Track, subset

MOST_PAIRS = 150  # of one sweep, evenly spread: more only cost time
OUTLYING = 1e-3  # chance of any in a sweep that has none
MOST_OUTLYING = 0.1  # of the pairs; more are no outliers
MOST_SWEEPS = 60  # of a session, the widest: a fiftieth of a second each


@dataclass(frozen=True, slots=True)
class Sweep:
    """One joint turned alone; n pairs. Angles in rad, errors are reading less true angle."""

    joint: int  # from 0
    rows: NDArray[np.int64]  # (n,), of the comparison
    outlying: NDArray[np.int64]  # rows that were left out: off the circle beyond chance
    q: Array  # (n,), reading
    direction: Array  # (n,), of travel, +1 or -1
    error: Array  # (n,), about their mean: a constant does not show
    uncertainty: Array  # (n,), standard, of the error, pixels and readings
    curve: Array  # (n,), the fitted error
    gain: Figure  # d reading / d true - 1
    hysteresis: Figure  # reading on the way up less on the way down, at one angle
    eccentricity: Figure  # amplitude once a turn
    phase: Figure  # the true angle at which the eccentricity's error is largest
    eccentric: bool  # beyond chance: then gain and hysteresis come from the fit with it
    nonlinearity: Figure  # rms of what a straight line and the hysteresis leave
    noise: float  # rms that pixels and readings alone give
    nonlinear_p: float  # that noise alone leaves as much beside the curve
    wobble: tuple[float, float]  # rms of what no turn about a fixed axis explains: m, rad
    wobble_p: float  # that noise alone gives as much

    @property
    def span(self) -> float:
        """From the least to the largest reading, rad."""
        return float(np.ptp(self.q))


def sweeps(
    model: Model, session: Session, track: Track, systematics: Systematics, *, clock_given: bool
) -> list[Sweep]:
    """Find the single-joint sweeps of a session and judge each.

    Args:
        model: the session.
        session: for what is stated of the encoders.
        track: the measured poses, for their pan readings.
        systematics: for the pan readings' uncertainty.
        clock_given: the clock's offset was stated; else each sweep fits what is left of it, as an
            error of the clock looks like hysteresis.
    """
    found = find_stretches(model.comparison, session.encoder_resolution)
    widest = sorted(found, key=lambda s: -np.ptp(model.comparison.q[s.rows, s.joint]))
    kept = {id(s) for s in widest[:MOST_SWEEPS]}
    return [
        _swept(model, session, track, systematics, stretch, clock_given=clock_given)
        for stretch in found
        if id(stretch) in kept
    ]


def _swept(
    model: Model,
    session: Session,
    track: Track,
    systematics: Systematics,
    stretch: Stretch,
    *,
    clock_given: bool,
) -> Sweep:
    comparison, joint = model.comparison, stretch.joint
    count = min(len(stretch.rows), MOST_PAIRS)
    chosen = np.linspace(0, len(stretch.rows) - 1, count).round().astype(int)
    rows = stretch.rows[chosen]
    q, rate = comparison.q[rows, joint], comparison.rate[rows, joint]
    covariance = _own_noise(track, comparison.index[stretch.rows], comparison.index[rows])
    for spread in many_pan_readings(comparison, track, systematics):
        covariance = covariance + spread[rows]
    variance = np.full(count, reading_noise(comparison)[joint] ** 2)
    variance += (session.encoder_resolution or 0.0) ** 2 / 12
    variance += (rate * (session.encoder_time_standard_uncertainty or 0.0)) ** 2
    swept = Swept(
        poses=comparison.base_T_measured[rows],
        covariance=covariance,
        held=model.prior_columns[rows],
        q=q,
        reading_variance=variance,
    )
    case = _Case(swept, rows, joint, stretch.direction[chosen], None if clock_given else rate)
    outlying = _outlying(case)
    return _judged(case.without(outlying), rows[outlying])


def _own_noise(track: Track, stretch: NDArray[np.int64], rows: NDArray[np.int64]) -> Array:
    """Covariance of some of a stretch's poses, (n, 6, 6), by its own accelerations.

    A shoulder swept alone accelerates the flange ten times as much as a wrist: the session's mean
    would be too little for one and too much for the other. And where a joint turns back it
    accelerates most: what the neighbours show there of alignment is counted pair by pair.
    """
    scale = float(alignment_scale(subset(track, stretch)).mean())
    left = track.alignment_error[rows]
    total: Array = track.covariance_pixels[rows] + scale * track.covariance_alignment[rows]
    return total + left[:, :, None] * left[:, None, :]


@dataclass(frozen=True, slots=True)
class _Case:
    """A sweep's pairs, n of them."""

    swept: Swept
    rows: NDArray[np.int64]
    joint: int
    direction: Array
    rate: Array | None  # of a clock that is fitted along

    def without(self, left_out: NDArray[np.bool_]) -> "_Case":
        """The other pairs."""
        parts = {f.name: getattr(self.swept, f.name)[~left_out] for f in fields(Swept)}
        rate = None if self.rate is None else self.rate[~left_out]
        return _Case(
            Swept(**parts), self.rows[~left_out], self.joint, self.direction[~left_out], rate
        )


def _outlying(case: _Case) -> NDArray[np.bool_]:
    """Pairs that lie off the circle by more than all others, (n,): a spot that was bitten, say.

    A flange that leaves its circle again and again is no outlier: then none is left out.
    """
    _, fit = fit_terms(case.swept, case.direction, case.rate, circular=False)
    count = len(case.rows)
    off = np.linalg.solve(case.swept.covariance, fit.rest[:, :, None])[:, :, 0]
    far = np.sum(fit.rest * off, axis=1) > chi2_isf(OUTLYING / count, 5)
    few = np.sum(far) <= max(1, int(MOST_OUTLYING * count))
    return far if few else np.zeros(count, dtype=bool)


def _judged(case: _Case, outlying: NDArray[np.int64]) -> Sweep:
    swept, rows, direction, rate = case.swept, case.rows, case.direction, case.rate
    terms, fit = fit_terms(swept, direction, rate, circular=False)
    eccentricity, phase, eccentric = NOTHING, NOTHING, False
    if np.ptp(swept.q) > CIRCULAR_SPAN:
        wide = fit_terms(swept, direction, rate, circular=True)
        eccentricity, phase, eccentric = find_eccentricity(*wide)
        if eccentric:
            terms, fit = wide
    angle_degrees = len(rows) - terms.columns.shape[1] - 1
    rest_degrees = 5 * len(rows) - 9  # of line and start pose, a shift along the angle taken out
    nonlinear_p = float(chi2_sf(fit.chi2_angle, max(angle_degrees, 1)))
    # a fit that lacks knows its figures no better than it describes the pairs (Birge)
    misfit = max(1.0, fit.chi2_angle / max(angle_degrees, 1)) if nonlinear_p < LACK_OF_FIT else 1.0
    by_clock = terms.columns[:, terms.clock] * fit.value[terms.clock] if terms.clock >= 0 else 0.0
    curve = terms.columns @ fit.value - by_clock
    error = curve - fit.angle_left
    line = terms.columns[:, 0] * fit.value[0]
    if terms.hysteresis >= 0:
        line = line + terms.columns[:, terms.hysteresis] * fit.value[terms.hysteresis]
    left = error - line - np.mean(error - line)
    rms = float(np.sqrt(np.mean(left**2)))
    return Sweep(
        joint=case.joint,
        rows=rows,
        outlying=outlying,
        q=swept.q,
        direction=direction,
        error=error,
        uncertainty=np.sqrt(fit.angle_variance),
        curve=curve,
        gain=figure(fit, 0, misfit),
        hysteresis=figure(fit, terms.hysteresis, misfit),
        eccentricity=replace(
            eccentricity, uncertainty=eccentricity.uncertainty * float(np.sqrt(misfit))
        ),
        phase=phase,
        eccentric=eccentric,
        nonlinearity=Figure(rms, rms / float(np.sqrt(2 * max(angle_degrees, 1)))),
        noise=float(np.sqrt(np.mean(fit.angle_variance))),
        nonlinear_p=nonlinear_p,
        wobble=(
            float(np.sqrt(np.mean(np.sum(fit.rest[:, :3] ** 2, axis=1)))),
            float(np.sqrt(np.mean(np.sum(fit.rest[:, 3:] ** 2, axis=1)))),
        ),
        wobble_p=float(chi2_sf(fit.chi2_rest, max(rest_degrees, 1))),
    )
