"""A recorded session from pixels to results: chain, clock, comparison, judgement."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pandas as pd

from reports import Results
from verify.analysis.clock import ClockEstimate
from verify.analysis.combinations import combinations
from verify.analysis.comparison import (
    Comparison,
    JointComparison,
    compare,
    inflate_covariance,
    relinearise,
    solve_joints,
)
from verify.analysis.diagnosis.detectability import detectable
from verify.analysis.diagnosis.diagnose import find_causes
from verify.analysis.joint_errors import JointErrors, mean_errors, predict_errors, resolve_errors
from verify.analysis.least_squares import autocorrelation
from verify.analysis.measured import (
    Chain,
    MeasuredSession,
    Progress,
    measure_instrument,
    measure_pictures,
    measurement_refusal,
    session_clock,
    setup_of,
)
from verify.analysis.model import (
    JointErrorModel,
    add_pan_noise,
    build_model,
    clock_effect,
    visibility,
)
from verify.analysis.performance.conditions import session_performance
from verify.analysis.plausibility import refuse_misread, refuse_radians
from verify.analysis.relative_motion import compare_relative_motions
from verify.analysis.results.entries import monte_carlo_table, sweeps_table
from verify.analysis.results.summary import SessionAnalysis, summarise
from verify.analysis.results.tables import (
    describe,
    frames_table,
    relative_table,
    resolved_table,
    spots_table,
)
from verify.analysis.results.warnings import result_warnings, unstated_sources
from verify.analysis.sweeps.sweeps import judge_sweeps
from verify.analysis.uncertainty.budget import budget
from verify.analysis.uncertainty.monte_carlo import monte_carlo
from verify.core.readings import Readings
from verify.core.records import Array
from verify.errors import InputError
from verify.io.session.keys import Tolerance
from verify.io.session.session import Session
from verify.measurement.chain import measure
from verify.measurement.systematics import Systematics
from verify.measurement.track import Track

__all__ = ["analyse", "measure", "measure_session", "session_model", "setup_of"]

MIN_VISIBLE_SHARE = (
    1e-9  # of a joint's column: a share below this is what rounding leaves of nothing
)


def _no_progress(_done: int, _total: int) -> None:
    """Report no progress."""


def analyse(
    session: Session,
    *,
    tolerance: Tolerance | None = None,
    progress: Progress = _no_progress,
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
    seen, clock = measure_session(session, readings, progress, chain or measure)
    track = seen.track
    comparison, joints, unreachable = _compare(session, track, readings, clock, seen.systematics)
    if not len(comparison):
        raise _comparison_refusal(session, track, reached=not unreachable)
    model = session_model(session, track, clock, seen.systematics, comparison, joints)
    return _judge(session, tolerance, seen, clock, model, comparison, joints, unreachable)


def measure_session(
    session: Session, readings: Readings, progress: Progress, chain: Chain
) -> tuple[MeasuredSession, ClockEstimate]:
    """Measure a session's pairs, or take its instrument's poses, and find the readings' clock.

    Args:
        session: an opened session.
        readings: its readings.
        progress: called with pairs done and pairs in all.
        chain: what measures the pairs.

    Raises:
        InputError: nothing was measured, or in units or axes that are not those of the readings.
    """
    instrument = session.instrument
    if instrument is None:
        seen = measure_pictures(session, progress, chain)
        if not len(seen.track):
            raise measurement_refusal(session, seen)
        clock = session_clock(session, seen.track, readings)
    else:
        seen, clock = measure_instrument(session, instrument, readings)
        progress(len(session), len(session))
        refuse_misread(session, instrument, seen.track, readings, clock)
    refuse_radians(session, seen.track, readings, clock)
    return seen, clock


def session_model(
    session: Session,
    track: Track,
    clock: ClockEstimate,
    systematics: Systematics,
    comparison: Comparison,
    joints: JointComparison,
) -> JointErrorModel:
    """Lay a session out about the errors that are there; pairs repeat each other.

    Args:
        session: the session.
        track: its measured poses.
        clock: of its readings.
        systematics: what is stated of rig and marker.
        comparison: poses against readings.
        joints: measured angles of the compared pairs.
    """

    def built(compared: Comparison) -> JointErrorModel:
        shown = zero_undetermined_columns(compared)
        return build_model(shown, track, session.rig, session.marker, clock, systematics)

    error, told = np.nan_to_num(joints.error), ~np.isnan(joints.error)
    typical = error.sum(axis=0) / np.maximum(told.sum(axis=0), 1)
    if not told.any(axis=0).all():  # joints that no pair tells: from a first fit
        typical = np.where(
            told.any(axis=0), typical, np.nan_to_num(resolve_errors(built(comparison)).mean)
        )
    middle = relinearise(comparison, session.arm, typical)
    model = built(middle)
    residual = model.xi - predict_errors(model, resolve_errors(model))
    factors = autocorrelation(model.white.by_pair(residual))
    return built(inflate_covariance(middle, factors)) if np.any(factors > 1) else model


def zero_undetermined_columns(comparison: Comparison) -> Comparison:
    """Empty the Jacobian's columns of joints that no pair determines anything of.

    A single LED, or a tracker's target, on the last joint's axis stands still when that turns: what
    rounding leaves of the column would pass for a joint with an error of any size.
    """
    columns = comparison.jacobian
    seen = [known.T @ one for known, one in zip(comparison.determined, columns, strict=True)]
    shown = np.max([np.linalg.norm(one, axis=0) for one in seen], axis=0)
    whole = np.linalg.norm(columns, axis=1).max(axis=0)
    return replace(comparison, jacobian=np.where(shown > MIN_VISIBLE_SHARE * whole, columns, 0.0))


def _comparison_refusal(session: Session, track: Track, *, reached: bool) -> InputError:
    """Say why no measured pose has a reading that it could be set against."""
    posed = session.instrument is not None
    if reached:
        return InputError(
            session.folder / "encoders.csv",
            f"no reading for any of the {len(track)} measured {'poses' if posed else 'pairs'}",
            f"readings must cover the {'poses' if posed else 'pictures'} once [clock] "
            "encoder_offset_s is added",
            "Check that clock and recording belong together.",
        )
    registration = "[poses] and [robot_base]" if posed else "[robot_base] and marker.toml"
    return InputError(
        session.folder / ("session.toml" if posed else "rig.toml"),
        f"{session.arm.name} can stand in none of the {len(track)} measured poses",
        f"robot, {registration} must belong to this recording",
        "Check robot_base.position_mm and the robot's name.",
    )


def _compare(
    session: Session,
    track: Track,
    readings: Readings,
    clock: ClockEstimate,
    systematics: Systematics,
) -> tuple[Comparison, JointComparison, set[int]]:
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
        comparison = add_pan_noise(comparison, track, systematics)
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
    seen: MeasuredSession,
    clock: ClockEstimate,
    model: JointErrorModel,
    plain: Comparison,
    joints: JointComparison,
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
    resolved, relative = resolve_errors(model), compare_relative_motions(model)
    estimated = clock.standard_uncertainty if clock.source == "estimated" else None
    means = mean_errors(model, errors, resolved, estimated, systematics)
    sources = budget(
        model, plain, joints, errors, means, resolved, session, systematics, seen.track, clock
    )
    means = replace(means, coverage_factor=sources.coverage_factor)
    measured = [m for m in seen.measurements if m.status == "measured"]
    drawn = monte_carlo(session, measured, seen.track, plain, joints, systematics, clock)
    given = clock.source == "given"
    swept = judge_sweeps(model, session, seen.track, systematics, clock_given=given)
    frame = seen.track.frame[comparison.index]
    diagnosis = find_causes(model, resolved, session.arm, session.rig)
    status, rows = _statuses(seen, comparison, unreachable)
    judged = SessionAnalysis(
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
        sources=sources,
        drawn=drawn,
        sweeps=swept,
        frame=frame,
        visibility=visibility(model),
        resolved=resolved,
        relative=relative,
        diagnosis=diagnosis,
        flange=_flange(model, estimated),
        through_encoders=model.through_encoders,
        uncounted=unstated_sources(systematics, clock),
        warnings=result_warnings(session, seen.measurements, systematics, clock, model),
    )
    tables = {
        "frames": frames_table(
            seen.measurements, status, comparison, rows, joints,
            _combined_uncertainty(joints, errors, comparison, clock),
        ),
        "spots": spots_table(seen.measurements, session.marker),
        "resolved": resolved_table(comparison, resolved, seen.track.frame[comparison.index]),
        "relative": relative_table(relative, seen.track.frame[comparison.index]),
        "clock_curve": pd.DataFrame(clock.curve, columns=["offset_s", "cost"]),
        "budget": sources.lines,
        "budget_parameters": sources.parameters,
        "monte_carlo": monte_carlo_table(drawn, frame),
        "sweeps": sweeps_table(swept, frame),
        "detectable": detectable(diagnosis.products),
    }  # fmt: skip
    images = {"pair": seen.preview} if seen.preview is not None else {}
    repeated, repeated_tables = session_performance(session, model, clock.offset)
    return Results(
        summarise(judged) | repeated, describe(session), tables | repeated_tables, images
    )


def _tolerance(session: Session, override: Tolerance | None) -> Tolerance:
    given = session.tolerance or Tolerance(None, None, None)
    if override is None:
        return given
    return Tolerance(
        given.joints if override.joints is None else override.joints,
        given.position if override.position is None else override.position,
        given.orientation if override.orientation is None else override.orientation,
    )


def _combined_uncertainty(
    joints: JointComparison, errors: JointErrors, comparison: Comparison, clock: ClockEstimate
) -> Array:
    """Standard uncertainty of each pair's error from all sources, (n, j), rad."""
    variance = np.diagonal(joints.covariance, axis1=1, axis2=2) + np.sum(errors.systematic**2, 2)
    if clock.source == "estimated" and clock.standard_uncertainty is not None:
        variance = variance + (comparison.rate * clock.standard_uncertainty) ** 2
    uncertainty: Array = np.sqrt(variance)
    return uncertainty


def _flange(model: JointErrorModel, clock_uncertainty: float | None) -> tuple[Array, Array]:
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
    seen: MeasuredSession, comparison: Comparison, unreachable: set[int]
) -> tuple[list[str], list[int]]:
    """What is finally said of each pair, and which rows were compared."""
    status = [m.status for m in seen.measurements]
    measured = [i for i, s in enumerate(status) if s == "measured"]
    compared = set(comparison.index.tolist())
    for place, row in enumerate(measured):
        if place not in compared:
            status[row] = "unreachable" if place in unreachable else "no_encoder"
    return status, [measured[i] for i in comparison.index]
