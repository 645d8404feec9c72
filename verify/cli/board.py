"""Draw a checkerboard to print, true to scale.

Example: verify board --corners 9x7 --square-mm 25 --paper A3
"""

import re
from pathlib import Path
from typing import Annotated

import typer

from verify.cli.terminal import terminal

DEFAULT_CORNERS = "9x7"
DEFAULT_SQUARE_MM = 40.0
MARKER_SHARE = 0.75  # of a square's edge: white of an eighth on each side
OPTIONS_PLACE = "the board asked for"  # how complaints call what the options say


def board(
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder of the files.")] = Path("board"),
    corners: Annotated[
        str, typer.Option(help="Inner corners along and across, one fewer than squares.")
    ] = DEFAULT_CORNERS,
    square_mm: Annotated[float, typer.Option(help="Edge of a square, mm.")] = DEFAULT_SQUARE_MM,
    paper: Annotated[
        str | None, typer.Option(help="A4, A3, A2, A1 or A0; the smallest that holds it.")
    ] = None,
    charuco: Annotated[
        str | None,
        typer.Option(help="Markers in the white squares, of this dictionary: DICT_5X5_100."),
    ] = None,
    marker_mm: Annotated[
        float | None, typer.Option(help="Edge of a marker, mm; three quarters of a square's.")
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace files in a folder that is not empty.")
    ] = False,
) -> None:
    """Draw a checkerboard to print, true to scale: board.pdf, board.png and board.toml.

    Without options it is the grasping paper's: 9 x 7 inner corners of 40 mm, on A2.

    Example: verify board --corners 9x7 --square-mm 25 --paper A3
    """
    from verify.calibration import board_print
    from verify.calibration.board_print import lay_out
    from verify.errors import InputError
    from verify.io import fiducials
    from verify.io.fiducials import BoardTable, build_board
    from verify.io.files import write_folder_whole
    from verify.io.toml import FORMAT

    if marker_mm is not None and charuco is None:
        raise InputError("--marker-mm", "a plain board has no markers", "", "Give --charuco too.")
    if charuco is not None and marker_mm is None:
        marker_mm = MARKER_SHARE * square_mm
    table = BoardTable(
        format=FORMAT,
        inner_corners=parse_corners(corners),
        square_mm=square_mm,
        markers=charuco,
        marker_mm=marker_mm,
    )
    asked = build_board(OPTIONS_PLACE, table)
    if asked.four_fold:
        terminal.warn(
            f"--corners: {corners}: this board looks the same after a quarter turn, so nothing "
            "tells which corner is the first; hold it with the arrow up in every picture. "
            f"{asked.columns + 1}x{asked.rows} cannot be mistaken."
        )
    layout = lay_out(asked, paper)
    with write_folder_whole(out, force) as folder:
        (folder / "board.pdf").write_bytes(board_print.pdf(asked, layout))
        (folder / "board.png").write_bytes(board_print.png(asked, layout))
        fiducials.write_board(folder / "board.toml", asked)
    said = f"{asked.columns} x {asked.rows} inner corners of {square_mm:g} mm on {layout.paper}"
    terminal.say(f"{said}, in {out}. Print board.pdf at 100 %, then check the rulers.")
    terminal.record({"type": "result", "out": str(out), "paper": layout.paper})


def parse_corners(text: str) -> tuple[int, int]:
    """Read two counts, like 9x7.

    Raises:
        InputError: it is something else.
    """
    from verify.errors import InputError

    counts = re.fullmatch(r"(\d{1,3})\s*[xX×,]\s*(\d{1,3})", text.strip())
    if counts is None:
        expected = "two counts are expected, like 9x7"
        raise InputError("--corners", f'is "{text}"', expected, "Count where four squares meet.")
    return int(counts[1]), int(counts[2])
