"""Draw a checkerboard to print, true to scale."""

from pathlib import Path
from typing import Annotated

from typer import Option

from verify.cli.options import CornerCounts, ReplaceInFolder, parse_corners
from verify.cli.terminal import terminal

DEFAULT_CORNERS = CornerCounts(9, 7)
DEFAULT_SQUARE_MM = 40.0
MARKER_SHARE = 0.75  # of a square's edge: white of an eighth on each side
OPTIONS_PLACE = "the board asked for"  # names the options in a refusal


def board(
    out: Annotated[Path, Option("-o", "--out", help="Folder of the files.")] = Path("board"),
    corners: Annotated[
        CornerCounts,
        Option(
            parser=parse_corners,
            metavar="<str>",
            help="Inner corners along and across, one fewer than squares.",
        ),
    ] = DEFAULT_CORNERS,
    square_mm: Annotated[float, Option(help="Edge of a square, mm.")] = DEFAULT_SQUARE_MM,
    paper: Annotated[
        str | None, Option(help="A4, A3, A2, A1 or A0; the smallest that holds it.")
    ] = None,
    charuco: Annotated[
        str | None, Option(help="Markers in the white squares, of this dictionary: DICT_5X5_100.")
    ] = None,
    marker_mm: Annotated[
        float | None, Option(help="Edge of a marker, mm; three quarters of a square's.")
    ] = None,
    force: ReplaceInFolder = False,
) -> None:
    """Draw a checkerboard to print, true to scale; .pdf, .png, .toml.

    Without options it is the grasping paper's: 9 x 7 inner corners of 40 mm, on A2.

    Example: verify board --corners 9x7 --square-mm 25 --paper A3
    """
    from verify.calibration.board import drawing
    from verify.errors import InputError
    from verify.io import fiducials
    from verify.io.files import write_folder_whole
    from verify.io.toml import FORMAT

    if marker_mm is not None and charuco is None:
        raise InputError("--marker-mm", "a plain board has no markers", "", "Give --charuco too.")
    if charuco is not None and marker_mm is None:
        marker_mm = MARKER_SHARE * square_mm
    table = fiducials.BoardTable(
        format=FORMAT,
        inner_corners=(corners.columns, corners.rows),
        square_mm=square_mm,
        markers=charuco,
        marker_mm=marker_mm,
    )
    drawn = fiducials.build_board(OPTIONS_PLACE, table)
    if drawn.four_fold:
        terminal.warn(
            f"--corners: {corners}: this board looks the same after a quarter turn, so nothing "
            "tells which corner is the first; hold it with the arrow up in every picture. "
            f"{drawn.columns + 1}x{drawn.rows} cannot be mistaken."
        )
    layout = drawing.lay_out(drawn, paper)
    with write_folder_whole(out, force) as folder:
        (folder / "board.pdf").write_bytes(drawing.pdf(drawn, layout))
        (folder / "board.png").write_bytes(drawing.png(drawn, layout))
        fiducials.write_board(folder / "board.toml", drawn)
    text = f"{drawn.columns} x {drawn.rows} inner corners of {square_mm:g} mm on {layout.paper}"
    terminal.say(f"{text}, in {out}. Print board.pdf at 100 %, then check the rulers.")
    terminal.record("result", out=str(out), paper=layout.paper)
