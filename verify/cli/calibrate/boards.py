"""Calibrate both cameras from pictures of a board, and check them; options that give the board."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from verify.calibration.check.check import CheckResult, check_board, check_session
from verify.calibration.corners.folder import find_boards, middle_pair
from verify.calibration.origin import ResultsOrigin
from verify.calibration.quality.results import calibration_results
from verify.calibration.stereo.calibrate import calibrate
from verify.calibration.stereo.records import Calibration, rms
from verify.cli.options import CornerCounts
from verify.cli.terminal import report_files, terminal
from verify.core.fiducials import Board
from verify.core.rig import Rig
from verify.errors import InputError
from verify.io import fiducials
from verify.io import rig as io_rig
from verify.io.board.folder import open_board_folder
from verify.io.fiducials import BoardTable
from verify.io.files import digest, require_folder, written_together
from verify.io.results import write_report_folder
from verify.io.session.session import open_session
from verify.io.toml import FORMAT

BOARD_OPTION = "the board given by option"


def calibrate_folder(
    folder: Path, board: Board | None, out: Path, report: Path, *, force: bool
) -> None:
    """Calibrate from a folder of pictures; write the rig file `out` and the folder `report`.

    `board` replaces the folder's board.toml; `force`: write into a report folder that exists.

    Raises:
        InputError: the pictures cannot be used or do not determine the rig.
    """
    opened = open_board_folder(folder, board)
    terminal.warn(*opened.warnings)
    with terminal.progress("pairs searched for the board") as progress:
        pairs = find_boards(opened, progress)
    with (
        terminal.progress("stages of the adjustment") as progress,
        error_in_folder(folder, opened.doubtful_pan),
    ):
        found = calibrate(pairs, opened.board, opened.image_size, progress=progress)
    frames = found.frames.tolist()
    shown = middle_pair(opened, frames)
    pan = np.stack([opened.pan_left, opened.pan_right], axis=1)
    made = calibration_results(
        found,
        pan=pan[found.frames],
        picture=(shown.left, shown.right),
        picture_pan=pan[shown.frame],
        names={frame: opened.name(frame) for frame in frames},
        origin=ResultsOrigin(
            folder.resolve().name, inputs=opened.inputs, warnings=tuple(opened.warnings)
        ),
    )
    with written_together(out):
        io_rig.write(out, found.rig)
        write_report_folder(made, report, force=force)
    _print_calibration(found, out, report)


def board_from_options(
    corners: CornerCounts | None, square_mm: float | None, square_uncertainty_mm: float | None
) -> Board | None:
    """Make a board of the options, None without any; InputError: one missing, or no such board."""
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
        inner_corners=(corners.columns, corners.rows),
        square_mm=square_mm,
        square_standard_uncertainty_mm=square_uncertainty_mm,
    )
    return fiducials.build_board(BOARD_OPTION, table)


@contextmanager
def error_in_folder(folder: Path, doubt: str = "") -> Iterator[None]:
    """Put the folder before a complaint's place, and `doubt` of frames.csv as its likely cause."""
    try:
        yield
    except InputError as problem:
        if doubt:
            remedy = f"Convert them. As they stand: {problem.place} {problem.found}."
            where = folder / "frames.csv"
            raise InputError(where, doubt, "degrees are expected", remedy) from problem
        place = f"{folder}, {problem.place}"
        raise InputError(place, problem.found, problem.expected, problem.remedy) from problem


def require_same_size(folder: Path, size: tuple[int, int], rig: Rig) -> None:
    """Refuse pictures of another size than the rig is calibrated for."""
    if size != rig.image_size:
        found = "shows pictures of {} x {} px".format(*size)
        expected = "the rig is calibrated for {} x {}".format(*rig.image_size)
        raise InputError(folder, found, expected, "Use the rig.toml of these cameras.")


def _print_calibration(found: Calibration, out: Path, target: Path) -> None:
    used = found.residuals.used
    left = rms(found.residuals.residual[used])
    terminal.say(f"{len(found.frames)} pairs, {int(used.sum())} corners, {left:.3f} px rms.")
    terminal.say(*(f"  {sentence}" for sentence in found.decisions))
    terminal.say(f"Rig: {out}; report: {report_files(target)}")
    terminal.record(
        "result",
        out=str(out),
        report=str(target),
        pairs=len(found.frames),
        rms_px=left,
        decisions=list(found.decisions),
    )


def run_check(
    source: Path,
    rig_path: Path | None,
    length_mm: float | None,
    length_uncertainty_mm: float | None,
    board: Board | None,
) -> tuple[CheckResult, ResultsOrigin]:
    """Check a rig by a session or by board pictures; give what was found, and from what.

    `rig_path` None is the session's own; `length_mm` is the known distance of two of its LEDs, with
    its standard uncertainty; `board` replaces the pictures' board.toml.

    Raises:
        InputError: a file cannot be used, or an option has no meaning for the source.
    """
    rig = None if rig_path is None else io_rig.read(rig_path, registered=False)[0]
    other_rig = {} if rig_path is None else {str(rig_path): digest(rig_path)}
    if length_uncertainty_mm is not None and length_mm is None:
        found = "is given without --length-mm"
        raise InputError("--length-uncertainty-mm", found, "", "Give --length-mm too.")
    expected = "a session or a folder of board pictures is expected"
    require_folder(source, expected, "Give one of those.")
    if (source / "session.toml").exists():
        if board is not None:
            found, expected = "does not apply to a session", "its LEDs are measured"
            raise InputError("--corners", found, expected, "Leave it out.")
        session = open_session(source)
        if session.instrument is not None:
            expected = "cameras are checked by pictures of LEDs or of a board"
            raise InputError(source, "holds poses and no pictures", expected, "Give one of those.")
        session = session if rig is None else replace(session, rig=rig)
        length, u = (None if mm is None else mm * 1e-3 for mm in (length_mm, length_uncertainty_mm))
        with terminal.progress("pairs") as progress:
            result = check_session(
                session, length=length, length_standard_uncertainty=u, progress=progress
            )
        return result, ResultsOrigin(session.name, session.description, session.inputs | other_rig)
    if rig is None:
        expected = "pictures of a board do not say which rig is to be checked"
        raise InputError("--rig", "is missing", expected, "Give the rig file, or a session.")
    if length_mm is not None:
        raise InputError("--length-mm", "does not apply to a board", "", "Leave it out.")
    opened = open_board_folder(source, board)
    require_same_size(opened.folder, opened.image_size, rig)
    with terminal.progress("pairs searched for the board") as progress:
        result = check_board(rig, find_boards(opened, progress), opened.board)
    return result, ResultsOrigin(source.resolve().name, inputs=opened.inputs | other_rig)
