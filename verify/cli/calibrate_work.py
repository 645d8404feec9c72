"""What the `verify calibrate` commands share: options into boards, registrations, checks."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

from verify.calibration.axes.table import axes_from_sweeps
from verify.calibration.check import check as interim
from verify.calibration.check.results import check_results
from verify.calibration.corners.folder import find_boards
from verify.calibration.origin import ResultsOrigin
from verify.calibration.registration import fixture_file
from verify.calibration.registration.fixture import register_fixture
from verify.calibration.registration.register import register_motion
from verify.calibration.registration.results import fixture_results, motion_results
from verify.cli.board import parse_corners
from verify.cli.terminal import terminal
from verify.errors import InputError
from verify.io import fiducials
from verify.io import fiducials as io_fiducials
from verify.io import rig as io_rig
from verify.io.board_folder import open_board_folder
from verify.io.fiducials import BoardTable
from verify.io.files import digest, written_together
from verify.io.results import write_report_folder
from verify.io.session.session import Recording, Session, open_recording, open_session
from verify.io.toml import FORMAT
from verify.measurement.chain import Setup, measure

if TYPE_CHECKING:
    from verify.calibration.axes.table import SweepResult
    from verify.calibration.check.check import CheckResult
    from verify.calibration.registration.records import MotionRegistration
    from verify.core.fiducials import Board, Marker
    from verify.core.rig import Rig

BOARD_OPTION = "the board given by option"


@dataclass(frozen=True, slots=True)
class RegistrationOptions:
    """What a registration from motion shall keep or add."""

    leds: int | None
    known_marker: Path | None
    keep_base: bool
    keep_leds: bool
    sweeps: bool


def board_from_options(
    corners: str | None, square_mm: float | None, square_uncertainty_mm: float | None
) -> "Board | None":
    """Make a board of the options; None where board.toml is to say it."""
    if corners is None and square_mm is None and square_uncertainty_mm is None:
        return None
    if corners is None or square_mm is None:
        missing = "--corners" if corners is None else "--square-mm"
        remedy = "Give both, or neither and a board.toml in the folder."
        raise InputError(missing, "is missing", "corners and square make a board together", remedy)
    if 0 < square_mm < fiducials.MIN_SQUARE_MM:
        terminal.warn(f"--square-mm: is {square_mm} mm; is that in metres?")
    table = BoardTable(
        format=FORMAT,
        inner_corners=parse_corners(corners),
        square_mm=square_mm,
        square_standard_uncertainty_mm=square_uncertainty_mm,
    )
    return fiducials.build_board(BOARD_OPTION, table)


@contextmanager
def error_in_folder(folder: Path, doubt: str = "") -> Iterator[None]:
    """Put the folder in front of the place that a complaint names.

    Args:
        folder: of the pictures.
        doubt: what is suspicious of frames.csv; it comes before the complaint, as its likely cause.
    """
    try:
        yield
    except InputError as problem:
        if doubt:
            remedy = f"Convert them. As they stand: {problem.place} {problem.found}."
            where = folder / "frames.csv"
            raise InputError(where, doubt, "degrees are expected", remedy) from problem
        place = f"{folder}, {problem.place}"
        raise InputError(place, problem.found, problem.expected, problem.remedy) from problem


def refuse_contradictions(
    *, fixture: bool, motion_only: Mapping[str, bool], fixture_only: Mapping[str, bool]
) -> None:
    """Refuse options that the chosen way of registering has no use for."""
    useless = motion_only if fixture else fixture_only
    given = [option for option, there in useless.items() if there]
    if given:
        way = "a board on the base" if fixture else "a motion"
        raise InputError(given[0], f"has no meaning when {way} is used", "", "Leave it out.")


def refuse_one_file(out: Path, marker_out: Path) -> None:
    """Refuse to write the marker over the rig."""
    if out.resolve() == marker_out.resolve():
        expected = "rig and marker are two files"
        raise InputError(marker_out, "is named for both", expected, "Give --marker another name.")


def register_by_fixture(
    folder: Path,
    fixture: Path,
    rig_path: Path | None,
    board: "Board | None",
    out: Path,
    target: Path,
    *,
    force: bool,
) -> None:
    """Register the base by pictures of a board that sits on it; write rig and report."""
    if rig_path is None:
        expected = "the calibrated cameras are needed"
        raise InputError("--rig", "is missing", expected, "Give the rig of `calibrate boards`.")
    rig, rig_warnings = io_rig.read(rig_path, registered=False)
    place, fixture_warnings = fixture_file.read(fixture)
    opened = open_board_folder(folder, board)
    _require_same_size(opened.folder, opened.image_size, rig)
    with terminal.progress("pairs searched for the board") as progress:
        pairs = find_boards(opened, progress)
    with error_in_folder(folder):
        found = register_fixture(rig, pairs, opened.board, place.base_T_board, place.covariance)
    warnings = (*rig_warnings, *opened.warnings, *fixture_warnings, *found.warnings)
    for warning in warnings:
        terminal.warn(warning)
    made = fixture_results(
        replace(found, warnings=warnings),
        robot="a robot by a board on its base",
        origin=ResultsOrigin(folder.resolve().name, inputs=opened.inputs),
    )
    with written_together(out):
        io_rig.write(out, found.rig)
        write_report_folder(made, target, force=force)
    _print_summary(found.decisions, [out], target)


def register_by_motion(
    folder: Path,
    rig: Path | None,
    wishes: RegistrationOptions,
    places: tuple[Path, Path, Path],
    *,
    force: bool,
) -> None:
    """Register base and LEDs by the robot's own motion; write rig, marker and report."""
    out, marker_out, target = places
    recording = open_recording(folder, rig=rig)
    known = None if wishes.known_marker is None else io_fiducials.read_marker(wishes.known_marker)
    with terminal.progress("pairs") as progress:
        found = register_motion(
            recording,
            leds=wishes.leds,
            marker=None if known is None else known[0],
            keep_base=wishes.keep_base,
            keep_leds=wishes.keep_leds,
            progress=progress,
        )
    warnings = (*recording.warnings, *(known[1] if known else ()), *found.warnings)
    for warning in warnings:
        terminal.warn(warning)
    swept = _fit_swept_axes(recording, found.rig, found.marker) if wishes.sweeps else None
    made = motion_results(
        replace(found, warnings=warnings),
        robot=recording.robot,
        origin=ResultsOrigin(recording.name, recording.description, recording.inputs),
        sweeps=swept,
        base_held=wishes.keep_base,
        leds_held=wishes.keep_leds,
    )
    with written_together(out, marker_out):
        io_rig.write(out, found.rig)
        io_fiducials.write_marker(
            marker_out, found.marker
        )  # kept LEDs too: it carries the registration
        write_report_folder(made, target, force=force)
    written = [out, marker_out]
    words = (*found.decisions, *_hidden_fault_sentences(found), *(swept.decisions if swept else ()))
    _print_summary(words, written, target)


def _hidden_fault_sentences(found: "MotionRegistration") -> Iterator[str]:
    """What the registration took in of each joint's faults, in words."""
    shares = found.visible_fractions
    gone = [f"{j + 1}" for j, share in enumerate(shares) if share == 0]
    if gone:
        joints = f"joint{'s' if len(gone) > 1 else ''} {' and '.join(gone)}"
        yield f"A constant offset of {joints} that was there already is hidden altogether."
    left = [f"joint {j + 1} {share:.0%}" for j, share in enumerate(shares) if share > 0]
    if left:
        yield f"Of such an offset there stays visible: {', '.join(left)}. A later one shows fully."
    if found.held_out_rms_px is not None and found.fit_rms_px is not None:
        yield (
            f"Registered on half of the pairs: {found.fit_rms_px:.3f} px rms; "
            f"on the other half, not used: {found.held_out_rms_px:.3f} px."
        )


def _fit_swept_axes(recording: Recording, rig: "Rig", marker: "Marker") -> "SweepResult":
    """Measure once more, with what was registered, and fit each swept joint's axis."""
    parts = {f.name: getattr(recording, f.name) for f in fields(Recording)} | {"rig": rig}
    session = Session(**parts, marker=marker, tolerance=None)
    with terminal.progress("pairs measured") as progress:
        measured = []
        for measurement in measure(session.pairs(), Setup(rig, marker)):
            measured.append(measurement)
            progress(len(measured), len(session))
    return axes_from_sweeps(session, measured)


@dataclass(frozen=True, slots=True)
class CheckReport:
    """An interim check, and what it was made from."""

    found: "CheckResult"
    origin: ResultsOrigin


def write_check(done: CheckReport, out: Path, *, force: bool) -> None:
    """Write the report of a check, and say where."""
    write_report_folder(check_results(done.found, done.origin), out, force=force)
    terminal.say(f"Report: {out / 'report.html'} and {out / 'report.pdf'}")


def run_check(
    source: Path,
    rig_path: Path | None,
    length_mm: float | None,
    length_uncertainty_mm: float | None,
    board: "Board | None",
) -> CheckReport:
    """Check a rig by a session's LEDs, a bar, or pictures of a board."""
    rig = None if rig_path is None else io_rig.read(rig_path, registered=False)[0]
    other_rig = {} if rig_path is None else {str(rig_path): digest(rig_path)}
    if length_uncertainty_mm is not None and length_mm is None:
        raise InputError(
            "--length-uncertainty-mm", "has no length to belong to", "", "Give --length-mm too."
        )
    if (source / "session.toml").exists():
        if board is not None:
            raise InputError(
                "--corners",
                "has no meaning for a session",
                "its LEDs are measured",
                "Leave it out.",
            )
        session = open_session(source)
        if session.instrument is not None:
            expected = "cameras are checked by pictures of LEDs or of a board"
            raise InputError(source, "holds poses and no pictures", expected, "Give one of those.")
        session = session if rig is None else replace(session, rig=rig)
        with terminal.progress("pairs") as progress:
            found = interim.check_session(
                session,
                length=None if length_mm is None else length_mm * 1e-3,
                length_standard_uncertainty=None
                if length_uncertainty_mm is None
                else length_uncertainty_mm * 1e-3,
                progress=progress,
            )
        origin = ResultsOrigin(session.name, session.description, session.inputs | other_rig)
        return CheckReport(found, origin)
    if rig is None:
        expected = "pictures of a board do not say which rig is to be checked"
        raise InputError("--rig", "is missing", expected, "Give the rig file, or a session.")
    if length_mm is not None:
        raise InputError("--length-mm", "has no meaning for a board", "", "Leave it out.")
    opened = open_board_folder(source, board)
    _require_same_size(opened.folder, opened.image_size, rig)
    with terminal.progress("pairs searched for the board") as progress:
        found = interim.check_board(rig, find_boards(opened, progress), opened.board)
    origin = ResultsOrigin(source.resolve().name, inputs=opened.inputs | other_rig)
    return CheckReport(found, origin)


def _require_same_size(folder: Path, size: tuple[int, int], rig: "Rig") -> None:
    if size != rig.image_size:
        found = "shows pictures of {} x {} px".format(*size)
        expected = "the rig is calibrated for {} x {}".format(*rig.image_size)
        raise InputError(folder, found, expected, "Use the rig.toml of these cameras.")


def _print_summary(decisions: tuple[str, ...], written: list[Path], target: Path) -> None:
    for sentence in decisions:
        terminal.say(f"  {sentence}")
    terminal.say(
        f"Written: {', '.join(map(str, written))}; report: {target / 'report.html'} and "
        f"{target / 'report.pdf'}"
    )
    terminal.record(
        {
            "type": "result",
            "out": [str(path) for path in written],
            "report": str(target),
            "decisions": list(decisions),
        }
    )
