"""A rig from pictures of a board, a robot in the rig, and whether both still hold."""

import time
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from verify.cli import options as option
from verify.cli.terminal import report_files, terminal
from verify.errors import InputError
from verify.live.page.access import DEFAULT_PORT, LOOPBACK

calibrate = typer.Typer(
    name="calibrate",
    help="Calibrate the rig, register the robot, check that both hold.",
    rich_markup_mode=None,
)

EXIT_CHECK_FAILED = 1
FOLDER_FORMAT = "boards-%Y-%m-%d-%H%M%S"  # the folder of the pictures, for strftime


@calibrate.command(cls=option.Command)
def boards(
    folder: Annotated[
        Path,
        Argument(
            help="Pictures of a board: left/ and right/, or two videos; with --live a station file."
        ),
    ],
    out: option.RigOut = Path("rig.toml"),
    report: option.ReportOut = None,
    corners: option.Corners = None,
    square_mm: option.SquareMm = None,
    square_uncertainty_mm: Annotated[
        float | None, Option(help="Standard uncertainty of that edge, mm.")
    ] = None,
    board: Annotated[
        Path | None, Option(help="Another board.toml than the one with the pictures.")
    ] = None,
    force: option.ReplaceFiles = False,
    live: Annotated[
        bool, Option("--live", help="Take the pictures now, by a station's cameras.")
    ] = False,
    pictures: Annotated[
        Path | None, Option(help="Live: their folder; default: boards-DATE-TIME, here.")
    ] = None,
    enough: Annotated[
        int | None, Option("--pairs", min=3, help="Live: finish after so many pairs.")
    ] = None,
    page: Annotated[bool, Option("--page", help="Live: serve a page.")] = False,
    page_port: option.PagePort = DEFAULT_PORT,
    page_address: option.PageAddress = LOOPBACK,
    page_token: option.PageToken = None,
) -> None:
    """Calibrate both cameras and their turning bases from pictures of a board.

    Writes the rig file and a report, by default in NAME-calibration, NAME the folder's. With --live
    the pictures are taken first: each when the board is still and stands otherwise than before.

    Example: verify calibrate boards tuesday_boards -o rig.toml
    """
    from verify.cli.calibrate.boards import board_from_options, calibrate_folder
    from verify.cli.calibrate.live import board_of, take_pictures
    from verify.io.files import real_path
    from verify.io.results import refuse_existing, refuse_file
    from verify.live.boards.pictures import complete_pairs

    station = folder
    if live:
        folder = pictures or Path(time.strftime(FOLDER_FORMAT))
    target = report if report is not None else Path(f"{real_path(folder).name}-calibration")
    refuse_file(out, force=force, read=(station, folder, board))
    refuse_existing(target, force=force)
    given = board_of(board_from_options(corners, square_mm, square_uncertainty_mm), board)
    if live:
        shown = option.PageOptions(page_port, page_address, page_token) if page else None
        take_pictures(station, folder, given, enough, shown)
    else:
        if folder.suffix == ".toml":
            expected = "without --live a folder of pictures is expected"
            raise InputError(folder, "is a station file", expected, "Add --live.")
        used = {"--pictures": pictures is not None, "--pairs": enough is not None, "--page": page}
        remedy = "Leave it out, or add --live."
        option.refuse_options(
            used, "was given with a folder of pictures", "it is for --live", remedy
        )
        complete_pairs(folder)
    calibrate_folder(folder, given, out, target, force=force)


@calibrate.command(cls=option.Command)
def register(
    session: Annotated[
        Path,
        Argument(help="A recorded motion, or poses; with --board-in-base, pictures of that board."),
    ],
    out: Annotated[
        Path | None,
        Option(
            "-o",
            "--out",
            help="The rig file to write: rig.toml; of poses a session folder: NAME-registered.",
        ),
    ] = None,
    marker: Annotated[
        Path | None, Option(help="The marker file to write; default: marker.toml.")
    ] = None,
    rig: Annotated[
        Path | None, Option(help="The calibrated rig, instead of the session's own.")
    ] = None,
    board_in_base: Annotated[
        Path | None, Option(help="A file that says where the board sits on the robot's base.")
    ] = None,
    leds: Annotated[
        int | None, Option(min=3, help="Number of LEDs; default: determined from the pictures.")
    ] = None,
    known_marker: Annotated[
        Path | None, Option(help="A marker.toml whose LED names or positions are kept.")
    ] = None,
    keep_base: Annotated[
        bool, Option("--keep-base", help="Keep the rig's robot base, fit the LEDs alone.")
    ] = False,
    keep_leds: Annotated[
        bool, Option("--keep-leds", help="Keep the known marker, fit the base alone.")
    ] = False,
    sweeps: Annotated[
        bool, Option("--sweeps", help="Also compare each swept joint's axis with the DH table.")
    ] = False,
    corners: option.Corners = None,
    square_mm: option.SquareMm = None,
    report: option.ReportOut = None,
    force: option.ReplaceFiles = False,
) -> None:
    """Find where the robot stands in the rig and where the LEDs sit on its flange.

    From a motion it goes through the robot's own encoders, which hides part of their faults: how
    much, joint by joint, is printed. A board at a known place on the base hides nothing. Of a
    session with poses.csv, base and target are found likewise, and --keep-leds keeps the target.

    Example: verify calibrate register my_session --rig rig.toml -o registered.toml
    """
    from verify.cli.calibrate import registration
    from verify.cli.calibrate.boards import board_from_options
    from verify.io.files import real_path
    from verify.io.results import refuse_existing, refuse_file
    from verify.io.session.session import open_poses

    target = report if report is not None else Path(f"{real_path(session).name}-registration")
    options = registration.RegistrationOptions(leds, known_marker, keep_base, keep_leds, sweeps)
    marker_options = {
        "--marker": marker is not None, "--leds": leds is not None,
        "--known-marker": known_marker is not None, "--sweeps": sweeps,
    }  # fmt: skip

    def refuse_useless(given: dict[str, bool], way: str) -> None:
        option.refuse_options(given, f"does not apply when {way}", "", "Leave it out.")

    if board_in_base is not None:
        kept = {"--keep-base": keep_base, "--keep-leds": keep_leds}
        refuse_useless(marker_options | kept, "a board on the base is used")
    else:
        board_options = {"--corners": corners is not None, "--square-mm": square_mm is not None}
        refuse_useless(board_options, "the robot's own motion is used")
        if (posed := open_poses(session)) is not None:
            refuse_useless(marker_options | {"--rig": rig is not None}, "poses are used")
            refuse_existing(target, force=force)
            folder = out if out is not None else Path(f"{posed.name}-registered")
            registration.register_by_poses(posed, folder, target, options, force=force)
            return
    marker_out = marker if marker is not None else Path("marker.toml")
    out = out if out is not None else Path("rig.toml")
    refuse_file(out, force=force, read=(session, known_marker, board_in_base))
    if board_in_base is None:
        refuse_file(marker_out, force=force, read=(session, rig))
        if out.resolve() == marker_out.resolve():
            expected, remedy = "rig and marker are two files", "Give --marker another name."
            raise InputError(marker_out, "is named for both", expected, remedy)
    refuse_existing(target, force=force)
    if board_in_base is None:
        written = (out, marker_out)
        registration.register_by_motion(session, rig, options, written, target, force=force)
        return
    board = board_from_options(corners, square_mm, None)
    registration.register_by_fixture(session, board_in_base, rig, board, out, target, force=force)


@calibrate.command(cls=option.Command)
def check(
    source: Annotated[
        Path, Argument(help="A recorded session, or pictures of a board (one pair will do).")
    ],
    rig: Annotated[
        Path | None, Option(help="The rig to check, instead of the session's own.")
    ] = None,
    length_mm: Annotated[
        float | None, Option(help="Known distance of two LEDs on a bar, mm.")
    ] = None,
    length_uncertainty_mm: Annotated[
        float | None, Option(help="Standard uncertainty of that distance, mm.")
    ] = None,
    corners: option.Corners = None,
    square_mm: option.SquareMm = None,
    out: Annotated[
        Path | None, Option("-o", "--out", help="Folder of the report; none unless given.")
    ] = None,
    force: option.ReplaceFiles = False,
) -> int:
    """Say whether a calibration still holds, by known lengths measured anywhere in the volume.

    Exit status 0: it holds; 1: it does not; 2: it could not be checked.

    Example: verify calibrate check sample_sessions/quarter_circle_6r
    """
    from verify.calibration.check.results import check_results
    from verify.cli.calibrate.boards import board_from_options, run_check
    from verify.io.results import refuse_existing, write_report_folder

    board = board_from_options(corners, square_mm, None)
    if out is not None:
        refuse_existing(out, force=force)
    found, origin = run_check(source, rig, length_mm, length_uncertainty_mm, board)
    terminal.warn(*found.warnings)
    terminal.say("The calibration holds." if found.holds else "The calibration does not hold.")
    terminal.say(*(f"  {sentence}" for sentence in found.decisions))
    report = {}
    if out is not None:
        write_report_folder(check_results(found, origin), out, force=force)
        terminal.say(f"Report: {report_files(out)}")
        report["report"] = str(out)
    terminal.record("result", verdict=found.verdict, decisions=list(found.decisions), **report)
    return 0 if found.holds else EXIT_CHECK_FAILED
