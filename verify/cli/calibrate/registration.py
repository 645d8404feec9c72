"""Register a robot's base and LEDs by its own motion or a tracker's poses, or by a fixed board."""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path

from verify.calibration.axes.table import SweepResult, axes_from_sweeps
from verify.calibration.corners.folder import find_boards
from verify.calibration.kinematics.mistakes import refuse_mistaken_readings
from verify.calibration.kinematics.registration import register_poses
from verify.calibration.kinematics.sessions import gather_sessions, session_to_poses
from verify.calibration.origin import ResultsOrigin
from verify.calibration.registration import results
from verify.calibration.registration.fixture import register_fixture
from verify.calibration.registration.records import MotionRegistration
from verify.calibration.registration.register import register_motion
from verify.cli.calibrate.boards import error_in_folder, require_same_size
from verify.cli.terminal import report_files, terminal
from verify.core.fiducials import Board, Marker
from verify.core.records import Array
from verify.core.rig import Rig
from verify.errors import InputError
from verify.io import fiducials
from verify.io import rig as io_rig
from verify.io.board.folder import open_board_folder
from verify.io.files import (
    digest,
    require_apart,
    require_vacant,
    write_folder_whole,
    written_together,
)
from verify.io.results import write_report_folder
from verify.io.session.folder import SESSION_FILE
from verify.io.session.session import Recording, Session, open_recording
from verify.measurement.chain import Setup, measure


@dataclass(frozen=True, slots=True)
class RegistrationOptions:
    """What a registration by motion keeps or adds."""

    leds: int | None
    known_marker: Path | None
    keep_base: bool
    keep_leds: bool
    sweeps: bool


def register_by_fixture(
    folder: Path,
    fixture: Path,
    rig_path: Path | None,
    board: Board | None,
    out: Path,
    report: Path,
    *,
    force: bool,
) -> None:
    """Register the base by pictures of a board that sits on it; write rig `out` and report."""
    if rig_path is None:
        expected = "the calibrated cameras are needed"
        raise InputError("--rig", "is missing", expected, "Give the rig of `calibrate boards`.")
    rig, rig_warnings = io_rig.read(rig_path, registered=False)
    place, fixture_warnings = fiducials.read_fixture(fixture)
    others = {str(path): digest(path) for path in (fixture, rig_path)}
    opened = open_board_folder(folder, board)
    require_same_size(opened.folder, opened.image_size, rig)
    with terminal.progress("pairs searched for the board") as progress:
        pairs = find_boards(opened, progress)
    with error_in_folder(folder):
        found = register_fixture(rig, pairs, opened.board, place.base_T_board, place.covariance)
    warnings = (*rig_warnings, *opened.warnings, *fixture_warnings, *found.warnings)
    terminal.warn(*warnings)
    made = results.fixture_results(
        replace(found, warnings=warnings),
        ResultsOrigin(folder.resolve().name, inputs=opened.inputs | others),
    )
    with written_together(out):
        io_rig.write(out, found.rig)
        write_report_folder(made, report, force=force)
    _print_summary(found.decisions, [out], report)


def register_by_motion(
    folder: Path,
    rig: Path | None,
    options: RegistrationOptions,
    written: tuple[Path, Path],
    report: Path,
    *,
    force: bool,
) -> None:
    """Register base and LEDs by the robot's own motion; `written`: the rig and the marker file."""
    recording = open_recording(folder, rig=rig)
    given = None if options.known_marker is None else fiducials.read_marker(options.known_marker)
    with terminal.progress("pairs") as progress:
        found = register_motion(
            recording,
            leds=options.leds,
            marker=None if given is None else given[0],
            keep_base=options.keep_base,
            keep_leds=options.keep_leds,
            progress=progress,
        )
    warnings = (*recording.warnings, *(given[1] if given else ()), *found.warnings)
    terminal.warn(*warnings)
    swept = _fit_swept_axes(recording, found.rig, found.marker) if options.sweeps else None
    made = results.motion_results(
        replace(found, warnings=warnings),
        robot=recording.robot,
        origin=ResultsOrigin(recording.name, recording.description, recording.inputs),
        sweeps=swept,
        base_held=options.keep_base,
        leds_held=options.keep_leds,
    )
    with written_together(*written):
        io_rig.write(written[0], found.rig)
        fiducials.write_marker(written[1], found.marker)  # kept LEDs too: with the registration
        write_report_folder(made, report, force=force)
    words = (
        *found.decisions,
        *_hidden_fault_sentences(found.visible_fractions),
        *_hold_out_sentences(found),
        *(swept.decisions if swept else ()),
    )
    _print_summary(words, list(written), report)


def register_by_poses(
    session: Session, out: Path, report: Path, options: RegistrationOptions, *, force: bool
) -> None:
    """Register base and target by an instrument's poses; write the session with both, and a report.

    `out` is the folder of that session: what `verify run` takes, alone or with --rig.
    """
    instrument = session.instrument
    if instrument is not None and instrument.poses.target is not None:
        remedy = "Leave the rows of one target, or find all with `verify identify`."
        expected = "one target is registered"
        raise InputError(session.left.path, "has the column target", expected, remedy)
    require_apart(out, session.folder)
    require_vacant(out, force=force)
    with terminal.progress("poses") as progress:
        measured = session_to_poses(session, progress, registered=False)
    gathered = gather_sessions([measured])
    if not options.keep_base and not options.keep_leds:
        refuse_mistaken_readings(session.folder / "encoders.csv", gathered)
    found = register_poses(gathered, keep_base=options.keep_base, keep_target=options.keep_leds)
    warnings = (*session.warnings, *found.warnings)
    terminal.warn(*warnings)
    made = results.poses_results(
        replace(found, warnings=warnings),
        session,
        ResultsOrigin(session.name, session.description, session.inputs),
        base_held=options.keep_base,
        target_held=options.keep_leds,
    )
    with write_folder_whole(out, force) as folder:
        (folder / SESSION_FILE).write_bytes(found.text)
        for name in session.inputs:
            if name != SESSION_FILE and not name.endswith("rig.toml"):
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_bytes((session.folder / name).read_bytes())
        write_report_folder(made, report, force=force)
    sentences = _hidden_fault_sentences(found.visible_fractions)
    _print_summary((*found.decisions, *sentences), [out / SESSION_FILE], report)


def _hidden_fault_sentences(shares: Array) -> Iterator[str]:
    """Say how much of each joint's offset the registration hides, by its visible shares (j,)."""
    gone = [f"{j + 1}" for j, share in enumerate(shares) if share == 0]
    if gone:
        joints = f"joint{'s' if len(gone) > 1 else ''} {' and '.join(gone)}"
        yield f"A constant offset of {joints} that was there already cannot show."
    left = [f"joint {j + 1} {share:.0%}" for j, share in enumerate(shares) if share > 0]
    if left:
        yield f"Of such an offset there stays visible: {', '.join(left)}. A later one shows fully."


def _hold_out_sentences(found: MotionRegistration) -> Iterator[str]:
    if found.held_out_rms_px is not None and found.fit_rms_px is not None:
        yield (
            f"Registered on half of the pairs: {found.fit_rms_px:.3f} px rms; "
            f"on the other half, not used: {found.held_out_rms_px:.3f} px."
        )


def _fit_swept_axes(recording: Recording, rig: Rig, marker: Marker) -> SweepResult:
    """Measure once more, with what was registered, and fit each swept joint's axis."""
    parts = {f.name: getattr(recording, f.name) for f in fields(Recording)} | {"rig": rig}
    session = Session(**parts, marker=marker, tolerance=None)
    with terminal.progress("pairs measured") as progress:
        measured = []
        for measurement in measure(session.pairs(), Setup(rig, marker)):
            measured.append(measurement)
            progress(len(measured), len(session))
    return axes_from_sweeps(session, measured)


def _print_summary(decisions: tuple[str, ...], written: list[Path], target: Path) -> None:
    terminal.say(*(f"  {sentence}" for sentence in decisions))
    terminal.say(f"Written: {', '.join(map(str, written))}; report: {report_files(target)}")
    terminal.record(
        "result", out=[str(path) for path in written], report=str(target), decisions=list(decisions)
    )
