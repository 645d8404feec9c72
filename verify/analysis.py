"""A recorded session from pixels to results: chain, clock, comparison, judgement."""

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

import robots
from reports import Results
from verify.caveats import caveats, rig_moved, uncounted
from verify.clock import ClockEstimate, estimate_clock
from verify.combinations import combinations
from verify.comparison import Comparison, about, compare, correlated
from verify.description import describe
from verify.errors import InputError
from verify.joints import Joints, solve_joints
from verify.judgement.budget import budget
from verify.judgement.diagnosis import diagnose
from verify.judgement.means import JointErrors, mean_errors
from verify.judgement.model import Model, build, clock_effect, with_pan_noise
from verify.judgement.resolved import predicted, resolve
from verify.judgement.visibility import visibility
from verify.measurement import Setup, measure
from verify.plausibility import refuse_radians
from verify.preview import draw_pair
from verify.readings import Readings
from verify.records import Array, Measurement, StereoPair
from verify.regression import autocorrelation
from verify.session import Session, Tolerance
from verify.summary import Judged, summarise
from verify.systematics import Systematics, sensitivities, stated
from verify.tables import frames_table, resolved_table, spots_table
from verify.track import Track, collect

SEARCH_SPAN = 2.0  # s about a pair, for readings whose clock is not known yet
SEARCH_STEP = 0.05  # s: arms turn a degree or two in it, branches and LEDs lie further apart
MOST_CANDIDATES = 200

Progress = Callable[[int, int], None]
Chain = Callable[[Iterable[StereoPair], Setup], Iterator[Measurement]]


def _quiet(_done: int, _total: int) -> None:
    """Report no progress."""


@dataclass(frozen=True, slots=True)
class _Seen:
    """What the pictures gave."""

    measurements: list[Measurement]
    track: Track
    systematics: Systematics
    preview: bytes | None


def analyse(
    session: Session,
    *,
    tolerance: Tolerance | None = None,
    progress: Progress = _quiet,
    chain: Chain | None = None,
) -> Results:
    """Measure a recorded session and judge the robot by it.

    Args:
        session: an opened session.
        tolerance: replaces what session.toml says, entry by entry.
        progress: called with pairs done and pairs in all.
        chain: what measures the pairs, `measure` unless another gives the same.

    Returns:
        Results, ready for `reports.render_html`, `render_pdf` and `write`.

    Raises:
        InputError: the session cannot be measured; nothing is returned in part.
    """
    readings = Readings(session.encoders.t, session.encoders.q)
    seen = _see(session, progress, chain or measure)
    track = seen.track
    if not len(track):
        raise _nothing_measured(session, seen)
    clock = _clock(session, track, readings)
    refuse_radians(session, track, readings, clock)
    comparison, joints, unreachable = _compare(session, track, readings, clock, seen.systematics)
    if not len(comparison) and unreachable:
        raise InputError(
            session.folder / "rig.toml",
            f"{session.arm.name} can stand in none of the {len(track)} measured poses",
            "robot, [robot_base] and marker.toml must belong to this recording",
            "Check robot_base.position_mm and the robot's name.",
        )
    if not len(comparison):
        raise InputError(
            session.folder / "encoders.csv",
            f"no reading for any of the {len(track)} measured pairs",
            "readings must cover the pictures once [clock] encoder_offset_s is added",
            "Check that clock and recording belong together.",
        )
    model = _model(session, track, clock, seen.systematics, comparison, joints)
    return _judge(session, tolerance, seen, clock, model, joints, unreachable)


def _model(
    session: Session,
    track: Track,
    clock: ClockEstimate,
    systematics: Systematics,
    comparison: Comparison,
    joints: Joints,
) -> Model:
    """The linear model about the errors that are there, with pairs that repeat each other."""

    def built(compared: Comparison) -> Model:
        return build(compared, track, session.rig, session.marker, clock, systematics)

    error, told = np.nan_to_num(joints.error), ~np.isnan(joints.error)
    typical = error.sum(axis=0) / np.maximum(told.sum(axis=0), 1)
    if not told.any(axis=0).all():  # joints that no pair tells: from a first fit
        typical = np.where(
            told.any(axis=0), typical, np.nan_to_num(resolve(built(comparison)).mean)
        )
    middle = about(comparison, session.arm, typical)
    model = built(middle)
    residual = model.xi - predicted(model, resolve(model))
    factors = autocorrelation(model.white.by_pair(residual))
    return built(correlated(middle, factors)) if np.any(factors > 1) else model


def setup_of(session: Session) -> Setup:
    """What the chain needs to know to measure a session."""
    readings = Readings(session.encoders.t, session.encoders.q)
    return Setup(session.rig, session.marker, _expectation(session, readings))


def _see(session: Session, progress: Progress, chain: Chain) -> _Seen:
    """Stream the pictures through the chain; only numbers are kept."""
    setup = setup_of(session)
    turning = bool(np.ptp(session.frames.pan_left) or np.ptp(session.frames.pan_right))
    systematics = stated(session.rig, session.marker, turning)
    measurements: list[Measurement] = []
    effects: list[Array] = []
    recent: deque[StereoPair] = deque(maxlen=2)
    preview: bytes | None = None
    for m in chain(_watched(session.pairs(), recent), setup):
        measurements.append(m)
        if m.status == "measured":
            effects.append(sensitivities(systematics, m, session.rig, session.marker))
            if preview is None and m.frame >= len(session) // 2:
                pair = next((p for p in recent if p.frame == m.frame), None)
                preview = draw_pair(pair, m, session.marker) if pair is not None else None
        progress(len(measurements), len(session))
    return _Seen(measurements, collect(measurements, session.rig, effects), systematics, preview)


def _watched(pairs: Iterator[StereoPair], recent: deque[StereoPair]) -> Iterator[StereoPair]:
    for pair in pairs:
        recent.append(pair)
        yield pair


def _expectation(session: Session, readings: Readings) -> Callable[[float], Sequence[Array]]:
    """Where the readings put the flange in the rig at a time; many places with an open clock."""
    offset = 0.0 if session.clock is None else session.clock.encoder_offset
    around = np.arange(-SEARCH_SPAN, SEARCH_SPAN + SEARCH_STEP, SEARCH_STEP)
    every = np.linspace(readings.t[0], readings.t[-1], MOST_CANDIDATES)

    def expected(t: float) -> Sequence[Array]:
        if session.clock is not None:
            times = np.array([t - offset])
        else:
            times = t + around
            times = times[(times >= readings.t[0]) & (times <= readings.t[-1])]
            times = times if len(times) else every
        poses = session.rig.rig_T_base @ robots.forward(session.arm, readings.at(times))
        return list(poses)

    return expected


def _nothing_measured(session: Session, seen: _Seen) -> InputError:
    measurements = seen.measurements
    counts = Counter(m.status for m in measurements)
    most = max((m.leds_seen for m in measurements), default=0)
    said = ", ".join(f"{n} {status}" for status, n in sorted(counts.items())) or "no pairs"
    return InputError(
        session.folder,
        f"no pair could be measured ({said}; at most {most} LEDs recognised in one pair)",
        f"{len(session.marker)} LEDs are asked for by marker.toml",
        rig_moved(session, measurements, seen.systematics)
        or "Check that the LEDs are lit and in view, and that rig.toml and marker.toml belong to "
        "this recording.",
    )


def _clock(session: Session, track: Track, readings: Readings) -> ClockEstimate:
    if session.clock is None:
        return estimate_clock(track, session.arm, readings)
    given = session.clock
    return ClockEstimate(
        given.encoder_offset, given.standard_uncertainty, "given", np.zeros((0, 2))
    )


def _compare(
    session: Session,
    track: Track,
    readings: Readings,
    clock: ClockEstimate,
    systematics: Systematics,
) -> tuple[Comparison, Joints, set[int]]:
    """Compare every pair that has a reading and that the arm can stand in; name the others."""
    known = readings.known(track.t - clock.offset)
    unreachable: set[int] = set()
    for _ in range(2):  # a second time without the pairs that the arm cannot reach
        comparison = compare(
            track,
            session.arm,
            readings,
            clock.offset,
            resolution=session.encoder_resolution,
            time_uncertainty=session.encoder_time_standard_uncertainty,
            known=known,
        )
        comparison = with_pan_noise(comparison, track, systematics)
        joints = solve_joints(comparison, session.arm)
        if joints.reached.all():
            break
        unreachable = set(comparison.index[~joints.reached].tolist())
        known = known.copy()
        known[list(unreachable)] = False
    return comparison, joints, unreachable


def _judge(
    session: Session,
    tolerance: Tolerance | None,
    seen: _Seen,
    clock: ClockEstimate,
    model: Model,
    joints: Joints,
    unreachable: set[int],
) -> Results:
    comparison, systematics = model.comparison, seen.systematics
    random = joints.inverse @ comparison.covariance @ np.swapaxes(joints.inverse, 1, 2)
    errors = JointErrors(
        error=joints.single,
        covariance=random,
        systematic=joints.inverse @ model.prior_columns,
        clock=(joints.inverse @ clock_effect(comparison))[:, :, 0],
    )
    resolved = resolve(model)
    estimated = clock.standard_uncertainty if clock.source == "estimated" else None
    means = mean_errors(model, errors, resolved, estimated, systematics)
    status, rows = _statuses(seen, comparison, unreachable)
    judged = Judged(
        session=session,
        tolerance=_tolerance(session, tolerance),
        status=status,
        choices=dict(Counter(m.choice for m in seen.measurements if m.choice)),
        clock=clock,
        comparison=comparison,
        joints=joints,
        combinations=combinations(
            session.arm,
            comparison,
            joints,
            errors,
            means,
            estimated,
            through_encoders=model.through_encoders,
        ),
        means=means,
        visibility=visibility(model),
        resolved=resolved,
        causes=diagnose(model, resolved),
        flange=_flange(model, estimated),
        through_encoders=model.through_encoders,
        uncounted=uncounted(systematics, clock),
        warnings=caveats(session, seen.measurements, systematics, clock, model),
    )
    tables = {
        "frames": frames_table(
            seen.measurements, status, comparison, rows, joints,
            _error_uncertainty(joints, errors, comparison, clock),
        ),
        "spots": spots_table(seen.measurements, session.marker),
        "resolved": resolved_table(comparison, resolved, seen.track.frame[comparison.index]),
        "clock_curve": pd.DataFrame(clock.curve, columns=["offset_s", "cost"]),
        "budget": budget(
            model, errors, means, joints.inverse, systematics, seen.track,
            clock,
        ),
    }  # fmt: skip
    images = {"pair": seen.preview} if seen.preview is not None else {}
    return Results(summarise(judged), describe(session), tables, images)


def _tolerance(session: Session, override: Tolerance | None) -> Tolerance:
    given = session.tolerance or Tolerance(None, None, None)
    if override is None:
        return given
    return Tolerance(
        given.joints if override.joints is None else override.joints,
        given.position if override.position is None else override.position,
        given.orientation if override.orientation is None else override.orientation,
    )


def _error_uncertainty(
    joints: Joints, errors: JointErrors, comparison: Comparison, clock: ClockEstimate
) -> Array:
    """Standard uncertainty of each pair's error from all sources, (n, j), rad."""
    variance = np.diagonal(joints.covariance, axis1=1, axis2=2) + np.sum(errors.systematic**2, 2)
    if clock.source == "estimated" and clock.standard_uncertainty is not None:
        variance = variance + (comparison.rate * clock.standard_uncertainty) ** 2
    uncertainty: Array = np.sqrt(variance)
    return uncertainty


def _flange(model: Model, clock_uncertainty: float | None) -> tuple[Array, Array]:
    """Mean twist of the flange over the pairs and its covariance."""
    comparison = model.comparison
    n = len(comparison)
    covariance = comparison.covariance.sum(axis=0) / n**2
    moved = model.prior_columns.mean(axis=0)
    covariance = covariance + moved @ moved.T
    if clock_uncertainty is not None:
        speed = np.einsum("nij,nj->ni", comparison.jacobian, comparison.rate).mean(axis=0)
        covariance = covariance + clock_uncertainty**2 * np.outer(speed, speed)
    return comparison.xi.mean(axis=0), covariance


def _statuses(
    seen: _Seen, comparison: Comparison, unreachable: set[int]
) -> tuple[list[str], list[int]]:
    """What is finally said of each pair, and which rows were compared."""
    status = [m.status for m in seen.measurements]
    measured = [i for i, s in enumerate(status) if s == "measured"]
    compared = set(comparison.index.tolist())
    for place, row in enumerate(measured):
        if place not in compared:
            status[row] = "unreachable" if place in unreachable else "no_encoder"
    return status, [measured[i] for i in comparison.index]
