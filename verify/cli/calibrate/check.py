"""Check a rig's calibration by a session's LEDs, a bar, or pictures of a board."""

from dataclasses import replace
from pathlib import Path

from verify.calibration.check.check import CheckResult, check_board, check_session
from verify.calibration.corners.folder import find_boards
from verify.calibration.origin import ResultsOrigin
from verify.cli.calibrate.boards import require_same_size
from verify.cli.terminal import terminal
from verify.core.fiducials import Board
from verify.errors import InputError
from verify.io import rig as io_rig
from verify.io.board.folder import open_board_folder
from verify.io.files import digest, require_folder
from verify.io.session.session import open_session


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
