"""A recorded session from pixels to results: measure, compare, estimate, present."""

from dataclasses import asdict, replace

import numpy as np
import pandas as pd

from reports.session.outliers import outlier_notes
from verify.analysis.clock.estimate import ClockEstimate, shown_offset, spread
from verify.analysis.combinations import combinations
from verify.analysis.comparison import (
    Comparison,
    ReadingUncertainty,
    compare,
    inflate_covariance,
    solve_joints,
    without_weight,
)
from verify.analysis.diagnosis.detectability import detectable
from verify.analysis.diagnosis.diagnose import Diagnosis, explained_by, find_causes
from verify.analysis.instrument import MeasuredSession
from verify.analysis.joint_errors import JointErrors, ResolvedErrors, predict_errors, resolve_errors
from verify.analysis.least_squares import autocorrelation
from verify.analysis.measured import (
    Chain,
    measure_instrument,
    measure_pictures,
    measurement_refusal,
    refuse_time_unit,
    session_clock,
    setup_of,
    with_gaps_named,
    with_measured_places,
    with_repeats_named,
    with_shown_noise,
    without_displaced_led,
    without_repeats,
)
from verify.analysis.mistakes import refuse_misread_pans
from verify.analysis.model import (
    JointErrorModel,
    ModelBuilder,
    SessionComparison,
    add_pan_noise,
    build_model,
    clock_effect,
    visibility,
)
from verify.analysis.other_motion import refuse_other_motion
from verify.analysis.performance.entries import session_performance
from verify.analysis.plausibility import refuse_misread
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
from verify.analysis.results.warnings import result_warnings
from verify.analysis.sweeps.sweeps import judge_sweeps
from verify.analysis.tangent import about_camera_errors, tangent_of
from verify.analysis.uncertainty.budget import budget
from verify.analysis.uncertainty.monte_carlo import monte_carlo
from verify.core.readings import Readings
from verify.core.records import Array, Index, Progress, no_progress
from verify.errors import InputError
from verify.io.files import digest
from verify.io.results import Results
from verify.io.series import ALARMS, read_alarms
from verify.io.session.keys import Tolerance
from verify.io.session.session import Session
from verify.measurement.chain import measure
from verify.measurement.track import Track

__all__ = ["analyse", "measure", "measure_session", "session_model", "setup_of"]

TOL_REPEATED = 0.05  # of the factors by which pairs count for fewer
MIN_VISIBLE_SHARE = 1e-9  # of a joint's column; a smaller share is rounding
MAX_ROUNDS = 4  # of causes and what pairs repeat of what they leave
MIN_MISFIT_TURNED = 10.0  # of the causes: a turned camera is tried though it is none of them
MAX_RIVALS_JUDGED = 3  # of the clock offsets that fit as well: each costs an analysis
NO_TOLERANCE = Tolerance(None, None, None)


def analyse(
    session: Session,
    *,
    tolerance: Tolerance | None = None,
    progress: Progress = no_progress,
    chain: Chain | None = None,
) -> Results:
    """Measure a recorded session and judge the robot by it: what `verify run` reports.

    `tolerance` replaces what session.toml says, entry by entry; `progress` is called with pairs
    done and pairs in all; `chain` measures the pairs, `measure` unless another gives the same.

    Raises:
        InputError: the session cannot be measured; nothing is returned in part.
    """
    alarms = read_alarms(session.folder / ALARMS, session.arm.dof)
    readings = Readings.of_log(session.encoders.t, session.encoders.q)
    session = with_shown_noise(session, readings)
    session, measured, clock = measure_session(session, readings, progress, chain or measure)
    compared, unreachable = compare_session(session, measured, readings, clock)
    tolerance = tolerance or NO_TOLERANCE
    found = _estimate(compared, measured, tolerance, unreachable)
    others = [
        _estimate(at_other, measured, tolerance, unreached)
        for at_other, unreached in (
            compare_session(session, measured, readings, replace(clock, offset=clock.rivals[i]))
            for i in spread(len(clock.rivals), MAX_RIVALS_JUDGED)
        )
    ]
    results = _results(replace(found, by_clock=tuple(others)))
    if alarms is not None:
        results.tables["alarms"] = alarms
        results.summary["inputs"][ALARMS] = digest(session.folder / ALARMS)
    return results


def measure_session(
    session: Session,
    readings: Readings,
    progress: Progress,
    chain: Chain,
    *,
    registered: bool = True,
) -> tuple[Session, MeasuredSession, ClockEstimate]:
    """Measure a session's pairs, or take its instrument's poses, and find the readings' clock.

    Returns the session as it was measured, with its warnings: without an LED that is not in its
    place, or with pairs that show an earlier instant left out.

    `progress` is called with pairs done and pairs in all. `registered`: base and body are where the
    session has them; else nothing can be laid side by side, and readings are not compared with the
    poses.

    Raises:
        InputError: nothing was measured, or in units or axes that are not those of the readings.
    """
    instrument = session.instrument
    if instrument is None:
        refuse_time_unit(session.folder, session.frames.t_left, readings.t)
        measured = measure_pictures(session, progress, chain)
        session, measured = without_displaced_led(session, measured, chain)
        session, measured = with_measured_places(session, measured, chain)
        refuse_misread_pans(session, measured.measurements)
        if not len(measured.track):
            raise measurement_refusal(session, measured)
        clock = session_clock(session, measured.track, readings)
        measured = without_repeats(session, measured, readings, clock.offset, chain)
        if measured.repeated:
            clock = session_clock(session, measured.track, readings)
    else:
        measured, clock = measure_instrument(session, instrument, readings)
        progress(len(session), len(session))
        refuse_misread(session, instrument, measured.track, readings, clock)
    if measured.repeated:
        session = with_repeats_named(session, measured.repeated)
    if registered:
        refuse_other_motion(session, measured.track, readings, clock)
    return session, measured, clock


def compare_session(
    session: Session, measured: MeasuredSession, readings: Readings, clock: ClockEstimate
) -> tuple[SessionComparison, set[int]]:
    """Compare every pair that has a reading and that the arm can stand in.

    Also gives the rows of the track that the arm cannot stand in.

    Raises:
        InputError: no pair is left.
    """
    track, systematics = measured.track, measured.systematics
    known = readings.available(track.t - clock.offset)
    session = with_gaps_named(session, readings, (track.t - clock.offset)[~known], len(track))
    stated = ReadingUncertainty(
        session.encoder_resolution, session.encoder_time_standard_uncertainty
    )
    shown = shown_offset(track, session.arm, readings, clock)
    if shown is not None:
        known &= readings.available(track.t - shown)
    unreachable: set[int] = set()
    for _ in range(2):  # a second time without the pairs that the arm cannot reach
        comparison = compare(track, session.arm, readings, clock.offset, stated=stated, known=known)
        comparison = replace(comparison, timed=session.frames.timed)
        comparison = add_pan_noise(comparison, track, systematics)
        joints = solve_joints(comparison, session.arm)
        if joints.reached.all():
            break
        unreachable = set(comparison.index[~joints.reached].tolist())
        known = known.copy()
        known[list(unreachable)] = False
    if not len(comparison):
        raise _comparison_refusal(session, track, reached=not unreachable)
    posed = tuple(m for m in measured.measurements if m.status == "measured" and m.pose is not None)
    tangent = None
    if shown is not None:
        there = compare(track, session.arm, readings, shown, stated=stated, known=known)
        there = add_pan_noise(replace(there, timed=comparison.timed), track, systematics)
        tangent = there, clock.offset - shown
    parts = session, track, systematics, clock, comparison, joints, posed, tangent
    return SessionComparison(*parts), unreachable


def session_model(compared: SessionComparison) -> tuple[JointErrorModel, Diagnosis, ResolvedErrors]:
    """Linearise a session about the errors that are there, find their causes, resolve them.

    Where cameras are known roughly that is done about their errors too, and the explanation that
    costs less is told. A turned camera is found first, and the session linearised anew about its
    angle. Pairs that repeat each other's errors count for fewer. What a cause leaves in every pair
    from its beginning on repeats itself as well: so causes are found first with all that counted as
    noise, then again with what they themselves leave. A pair whose reading lies between one from
    before a change and one from after it weighs nothing.
    """
    session = compared.session

    def built(comparison: Comparison) -> JointErrorModel:
        return build_model(
            zero_undetermined_columns(comparison), compared.track, session.rig, session.marker,
            compared.clock, compared.systematics,
        )  # fmt: skip

    plain = tangent_of(compared, built)
    there = about_camera_errors(compared, plain, (), built)
    places = [plain] if there is plain else [plain, there]
    model, found, resolved = min(
        (_explain(compared, place, built) for place in places), key=lambda one: one[0]
    )[1:]
    # what is told of pairs is their whole error, no tangent's
    whole = compared.comparison.xi
    return replace(model, comparison=replace(model.comparison, xi=whole)), found, resolved


def _explain(
    compared: SessionComparison, plain: Comparison, built: ModelBuilder
) -> tuple[float, JointErrorModel, Diagnosis, ResolvedErrors]:
    """Find the causes of a session's errors, linearised at one place, and what they cost.

    That is the chi-squared they leave of all pairs, and what Schwarz's criterion asks for them.
    """
    session = compared.session

    def explained(model: JointErrorModel, found: Diagnosis | None) -> tuple[ResolvedErrors, Array]:
        causes = [] if found is None else explained_by(found, model, session.arm, session.rig)
        resolved = resolve_errors(model, causes)
        left = model.xi - predict_errors(model, resolved)
        return resolved, autocorrelation(model.white.by_pair(left))

    middle, factors = plain, explained(built(plain), None)[1]
    rounds, changes, across = 0, 0, np.zeros(0, dtype=np.int64)
    cameras = bool(plain.systematic[:, :, -1].any())
    while rounds < MAX_ROUNDS:
        model = built(inflate_covariance(without_weight(middle, across), factors))
        found = find_causes(model, resolve_errors(model), session.arm, session.rig)
        turns = found.camera_turns
        if not turns and cameras and middle is plain and found.misfit > MIN_MISFIT_TURNED:
            turns = [("camera_turned", 0)]
        if not rounds and changes < 2 and bool(turns) == (middle is plain):
            middle = about_camera_errors(compared, plain, turns, built) if turns else plain
            factors, changes = explained(built(middle), None)[1], changes + 1
            continue
        resolved, rounds = explained(model, found)[0], rounds + 1
        more = np.union1d(across, found.straddling(middle.t))
        found = replace(found, outlying=np.union1d(found.outlying, across))
        if not resolved.causes:
            break
        left = explained(built(without_weight(middle, more)), found)[1]
        if len(more) == len(across) and np.all(left > (1 - TOL_REPEATED) * factors):
            break
        factors, across = np.minimum(left, factors), more
    named = (cause.candidates[0] if cause.candidates else cause for cause in found.causes)
    cost = explained(built(middle), found)[0].fit.chi2
    cost += sum(one.fault.schwarz(len(model.xi)) for one in named)
    return cost, model, found, resolved


def zero_undetermined_columns(comparison: Comparison) -> Comparison:
    """Empty the Jacobian's columns of joints that no pair determines anything of.

    A single LED, or a tracker's target, on the last joint's axis stands still when that turns: what
    rounding leaves of the column would pass for a joint with an error of any size.
    """
    columns = comparison.jacobian
    determined = [known.T @ one for known, one in zip(comparison.determined, columns, strict=True)]
    shown = np.max([np.linalg.norm(one, axis=0) for one in determined], axis=0)
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
        session.rig_file or session.folder / "session.toml",
        f"{session.arm.name} can reach none of the {len(track)} measured poses",
        f"robot, {registration} must belong to this recording",
        "Check robot_base.position_mm and the robot's name.",
    )


def _estimate(
    compared: SessionComparison,
    measured: MeasuredSession,
    tolerance: Tolerance,
    unreachable: set[int],
) -> SessionAnalysis:
    """Estimate errors, their uncertainties and their causes."""
    session, joints = compared.session, compared.joints
    model, diagnosis, resolved = session_model(compared)
    comparison, clock_uncertainty = model.comparison, compared.clock_uncertainty
    errors = JointErrors(
        covariance=joints.inverse @ comparison.covariance @ np.swapaxes(joints.inverse, 1, 2),
        systematic=joints.inverse @ model.prior_columns,
        clock=(joints.inverse @ clock_effect(comparison))[:, :, 0],
    )
    sources = budget(model, compared, resolved)
    stated = {name: limit for name, limit in asdict(tolerance).items() if limit is not None}
    return SessionAnalysis(
        measured=measured,
        compared=compared,
        model=model,
        tolerance=replace(session.tolerance or NO_TOLERANCE, **stated),
        status=_statuses(measured, compared.comparison, unreachable),
        errors=errors,
        resolved=resolved,
        combinations=combinations(compared, model, errors, resolved),
        sources=sources,
        monte_carlo=monte_carlo(compared),
        sweeps=judge_sweeps(model, compared),
        visibility=visibility(model),
        relative=compare_relative_motions(model),
        diagnosis=diagnosis,
        flange=_flange(model, clock_uncertainty, diagnosis.outlying),
        warnings=result_warnings(compared, measured, model),
    )


def _results(found: SessionAnalysis) -> Results:
    """Word an analysis as summary, set-up, tables and images."""
    session, clock, measured = found.compared.session, found.compared.clock, found.measured
    tables = {
        "frames": frames_table(measured.measurements, found),
        "spots": spots_table(measured.measurements, session.marker),
        "resolved": resolved_table(
            found,
        ),
        "relative": relative_table(found.relative, found.frame),
        "clock_curve": pd.DataFrame(clock.curve, columns=["offset_s", "cost"]),
        "budget": found.sources.lines,
        "budget_parameters": found.sources.parameters,
        "monte_carlo": monte_carlo_table(found.monte_carlo, found.frame),
        "sweeps": sweeps_table(found.sweeps, found.frame),
        "detectable": detectable(found.diagnosis.products),
    }
    images = {"pair": measured.preview} if measured.preview is not None else {}
    entry, more = session_performance(found)
    found.warnings.extend(outlier_notes(entry["performance"]))
    return Results(summarise(found) | entry, describe(session), tables | more, images)


def _flange(
    model: JointErrorModel, clock_uncertainty: float | None, left_out: Index
) -> tuple[Array, Array]:
    """Mean twist of the flange over the pairs but those left out, and its covariance."""
    comparison = model.comparison
    kept = np.delete(np.arange(len(comparison)), left_out)
    covariance = comparison.covariance[kept].sum(axis=0) / len(kept) ** 2
    moved = model.prior_columns[kept].mean(axis=0)
    covariance = covariance + moved @ moved.T
    if clock_uncertainty is not None:
        speed = np.einsum("nij,nj->ni", comparison.jacobian, comparison.rate)[kept].mean(axis=0)
        covariance = covariance + clock_uncertainty**2 * np.outer(speed, speed)
    return comparison.xi[kept].mean(axis=0), covariance


def _statuses(
    measured: MeasuredSession, comparison: Comparison, unreachable: set[int]
) -> list[str]:
    """What is finally stated of each pair."""
    status = [m.status for m in measured.measurements]
    rows = [i for i, s in enumerate(status) if s == "measured"]
    for place in set(range(len(rows))) - set(comparison.index.tolist()):
        status[rows[place]] = "unreachable" if place in unreachable else "no_encoder"
    return status
