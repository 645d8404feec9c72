import re
import shutil
import subprocess
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import pytest
import typer
from numpy.testing import assert_allclose
from typer.testing import CliRunner

from tests.support.recorded import refusal
from verify.calibration.board import drawing
from verify.calibration.board.drawing import PAPERS_MM, QUIET_ZONE_MM, PageLayout, lay_out
from verify.cli.board import board as command
from verify.core import fiducials as core_fiducials
from verify.core.fiducials import Board
from verify.core.records import Array, Image
from verify.errors import InputError
from verify.io import fiducials

PLAIN = Board(9, 7, 0.02)
CHARUCO = Board(6, 8, 0.02, markers="DICT_5X5_100", marker=0.015)
both = pytest.mark.parametrize("board", [PLAIN, CHARUCO], ids=["plain", "charuco"])
REDUCED = 3.0  # px/mm at which corners are searched; they are refined at full resolution


def picture(board: Board) -> tuple[Image, PageLayout, float]:
    """The PNG, its layout, and the px/mm that the file itself states."""
    layout = lay_out(board)
    data = drawing.png(board, layout)
    dpi = PIL.Image.open(BytesIO(data)).info["dpi"]
    assert dpi[0] == dpi[1]
    image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    return np.asarray(image, dtype=np.uint8), layout, dpi[0] / 25.4


def wanted_mm(board: Board, layout: PageLayout) -> Array:
    """Where the inner corners belong on the sheet."""
    return board.points[:, :2] * 1000 + np.array(layout.pattern[:2]) + board.square * 1000


def corners_mm(board: Board, image: Image, scale: float) -> Array:
    """Where OpenCV finds the inner corners on the sheet, in its own order of the board."""
    share = REDUCED / scale
    small = cv2.resize(image, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    if board.markers is not None:
        found = cv2.aruco.CharucoDetector(core_fiducials.charuco_board(board)).detectBoard(small)
        assert np.ravel(found[1]).tolist() == list(range(len(board)))
        rough = found[0]
    else:
        seen, rough = cv2.findChessboardCornersSB(small, (board.columns, board.rows))
        assert seen
        if np.sum(rough[0]) > np.sum(rough[-1]):  # half a turn makes the plain pattern the same
            rough = rough[::-1]
    start = ((np.reshape(rough, (-1, 1, 2)) + 0.5) / share - 0.5).astype(np.float32)
    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-4)
    fine = cv2.cornerSubPix(image, start, (20, 20), (-1, -1), stop)
    return (fine.reshape(-1, 2) + 0.5) / scale


@both
def test_the_corners_of_the_png_are_where_they_should_be(board: Board) -> None:
    image, layout, scale = picture(board)
    assert_allclose(corners_mm(board, image, scale), wanted_mm(board, layout), atol=0.02)


@both
def test_the_corners_of_the_pdf_are_where_they_should_be(board: Board, tmp_path: Path) -> None:
    tool = shutil.which("pdftoppm")
    if tool is None:
        pytest.skip("needs poppler's pdftoppm")
    layout = lay_out(board)
    (tmp_path / "board.pdf").write_bytes(drawing.pdf(board, layout))
    words = [tool, "-gray", "-r", "254", str(tmp_path / "board.pdf"), str(tmp_path / "page")]
    subprocess.run(words, check=True)
    image = np.asarray(cv2.imread(str(next(tmp_path.glob("*.pgm"))), cv2.IMREAD_GRAYSCALE))
    assert_allclose(np.array(image.shape[::-1]) / 10, layout.page, atol=0.1)
    assert_allclose(corners_mm(board, image, 10.0), wanted_mm(board, layout), atol=0.02)


def test_the_rulers_are_true_and_long_enough() -> None:
    image, layout, scale = picture(PLAIN)
    for (x, y, length), along in ((layout.across, True), (layout.up, False)):
        assert length >= 100
        column = image[round((y + 1) * scale), :] if along else image[:, round((x - 1) * scale)]
        dark = np.flatnonzero((column[1:] < 128) & (column[:-1] >= 128)) + 1.0
        ticks = dark / scale - (x if along else y)
        count = int(length) + 1
        wanted = np.arange(count) if along else -np.arange(count)[::-1]
        assert_allclose(ticks[-count:] if not along else ticks[:count], wanted, atol=0.1)


def test_the_default_is_the_papers_board_on_a2() -> None:
    layout = lay_out(Board(9, 7, 0.04))
    assert layout.paper == "A2"
    assert layout.white >= 40


@pytest.mark.parametrize("paper", PAPERS_MM)
@pytest.mark.parametrize("counts", [(9, 7), (5, 11), (3, 3)])
def test_the_largest_square_that_is_named_does_fit(paper: str, counts: tuple[int, int]) -> None:
    refused = refusal(lay_out, Board(*counts, square=0.5), paper)
    named = re.search(r"would are ([\d.]+) mm", str(refused))
    layout = lay_out(Board(*counts, square=float(named[1]) / 1000), paper)
    x, y, width, height = layout.pattern
    assert min(x, y, layout.page[0] - x - width, layout.page[1] - y - height) >= QUIET_ZONE_MM
    assert x - layout.across[0] >= QUIET_ZONE_MM
    assert layout.across[1] - y - height >= QUIET_ZONE_MM
    with pytest.raises(InputError):
        lay_out(Board(*counts, square=float(named[1]) / 1000 + 0.0002), paper)


def test_what_does_not_fit_is_refused_with_what_would() -> None:
    with pytest.raises(InputError, match=r"do not fit on A4.*--paper A2"):
        lay_out(Board(9, 7, 0.04), "a4")
    with pytest.raises(InputError, match='"A5" is not known'):
        lay_out(PLAIN, "A5")


def run(*words: str) -> int:
    app = typer.Typer()
    app.command()(command)
    result = CliRunner().invoke(app, list(words))
    if isinstance(result.exception, InputError):
        raise result.exception
    return result.exit_code


def test_the_command_writes_three_files_and_the_same_ones_again(tmp_path: Path) -> None:
    out = tmp_path / "board"
    words = ["-o", str(out), "--corners", "5x4", "--square-mm", "30", "--charuco", "DICT_4X4_50"]
    assert run(*words) == 0
    files = {file.name: file.read_bytes() for file in out.iterdir()}
    assert set(files) == {"board.pdf", "board.png", "board.toml"}
    board, warnings = fiducials.read_board(out / "board.toml")
    assert board == Board(5, 4, 0.03, markers="DICT_4X4_50", marker=0.0225)
    assert warnings == ()
    with pytest.raises(InputError, match="not empty"):
        run(*words)
    assert run(*words, "--force") == 0
    assert {file.name: file.read_bytes() for file in out.iterdir()} == files


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--corners", "9"], '--corners: is "9"; two counts are expected'),
        (["--corners", "9x2"], "at least 3 a side"),
        (["--square-mm", "nan"], "square_mm: is nan"),
        (["--marker-mm", "20"], "a plain board has no markers"),
        (["--paper", "A4"], "the largest squares that would are"),
    ],
)
def test_wrong_options_leave_nothing_behind(tmp_path: Path, words: list[str], message: str) -> None:
    assert message in str(refusal(run, "-o", str(tmp_path / "board"), *words))
    assert not list(tmp_path.iterdir())
