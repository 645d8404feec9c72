from pathlib import Path

import cv2
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tests.verify.recorded import replace, require_shared
from tests.verify.test_rig_file import assert_same, every_disk
from verify import board_file, board_markers
from verify.board import Board
from verify.errors import InputError

PLAIN = "format = 1\ninner_corners = [9, 7]\nsquare_mm = 40.0\n"
CHARUCO = PLAIN + 'markers = "DICT_5X5_100"\nmarker_mm = 30.0\n'

sizes = st.floats(1e-3, 1.0)


@st.composite
def boards(draw: st.DrawFn) -> Board:
    square = draw(sizes)
    markers = draw(st.none() | st.sampled_from(["DICT_5X5_1000", "DICT_ARUCO_ORIGINAL"]))
    return Board(
        columns=draw(st.integers(3, 20)),
        rows=draw(st.integers(3, 20)),
        square=square,
        square_standard_uncertainty=draw(st.none() | st.floats(0, 1e-4)),
        markers=markers,
        marker=None if markers is None else draw(st.floats(0.1, 0.9)) * square,
    )


@every_disk
@given(board=boards())
def test_a_board_written_and_read_is_the_same_board(
    board: Board, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "board.toml"
    board_file.write(path, board)
    again, warnings = board_file.read(path)
    assert warnings == ()
    assert_same(board, again)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "board.toml").write_text(CHARUCO)
    return tmp_path / "board.toml"


def test_millimetres_become_metres(path: Path) -> None:
    replace(path, "square_mm = 40.0", "square_mm = 40.0\nsquare_standard_uncertainty_mm = 0.02")
    board, warnings = board_file.read(path)
    assert warnings == ()
    assert board.square == pytest.approx(0.04)
    assert board.marker == pytest.approx(0.03)
    assert board.square_standard_uncertainty == pytest.approx(2e-5)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("inner_corners = [9, 7]", "squares = [10, 8]", "Write [9, 7] for 10 x 8 squares"),
        ("inner_corners = [9, 7]", "inner_corners = [10, 8]\nsquares = [10, 8]", "one fewer"),
        ("inner_corners = [9, 7]", "inner_corners = [9, 2]", "at least 3 a side"),
        ("inner_corners = [9, 7]", "inner_corners = [9, 7, 1]", "inner_corners: is a list of 3"),
        ("inner_corners = [9, 7]", "inner_corners = [9.5, 7]", "inner_corners[0]: is 9.5"),
        ("square_mm = 40.0", "square_mm = 0.0", "square_mm: is 0.0"),
        ("square_mm = 40.0", "square_mm = -40.0", "square_mm: is -40.0"),
        ("square_mm = 40.0", "", "square_mm: is missing"),
        ("format = 1", "format = 1\nsquare_standard_uncertainty_mm = -1", "is -1"),
        ("marker_mm = 30.0", "marker_mm = 40.0", "marker_mm: is 40.0; a marker fits into"),
        ("marker_mm = 30.0", "marker_mm = 0.0", "marker_mm: is 0.0"),
        ("marker_mm = 30.0", "", "marker_mm: is missing; markers is there"),
        ('markers = "DICT_5X5_100"', "", "markers: is missing; marker_mm is there"),
        ('"DICT_5X5_100"', '"DICT_5X5_10"', "Did you mean `DICT_5X5_100`?"),
        ('"DICT_5X5_100"', '"5x5"', "an ArUco dictionary of OpenCV's is expected"),
        ("[9, 7]", "[29, 7]", "which has 100 markers; the board needs 120"),
    ],
)
def test_a_wrong_board_is_refused_by_its_key(path: Path, old: str, new: str, said: str) -> None:
    replace(path, old, new)
    with pytest.raises(InputError) as caught:
        board_file.read(path)
    assert said in str(caught.value)
    assert str(path) in str(caught.value)


def test_squares_that_agree_with_the_corners_do_no_harm(path: Path) -> None:
    replace(path, "[9, 7]", "[9, 7]\nsquares = [10, 8]")
    assert board_file.read(path)[1] == ()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("format = 1", "format = 1\nsquare_um = 40000", "`square_mm`"),
        ("square_mm = 40.0\nmarkers", "square_mm = 0.04\nmarkers", "in metres?"),
    ],
)
def test_what_may_be_a_mistake_is_a_warning(path: Path, old: str, new: str, said: str) -> None:
    replace(path, old, new)
    replace(path, "marker_mm = 30.0", "marker_mm = 0.03")
    assert said in board_file.read(path)[1][0]


def test_the_corners_come_in_the_order_of_opencvs_charuco_board(path: Path) -> None:
    board, _ = board_file.read(path)
    drawn = board_markers.charuco(board)
    assert_allclose(drawn.getChessboardCorners() - [0.04, 0.04, 0.0], board.points, atol=1e-8)
    assert len(drawn.getIds()) == board_markers.needed(board)
    assert isinstance(drawn, cv2.aruco.CharucoBoard)


@pytest.mark.shared
def test_the_recorded_board_is_read() -> None:
    board, warnings = board_file.read(require_shared() / "calibration_boards" / "board.toml")
    assert warnings == ()
    assert (board.columns, board.rows, board.square) == (9, 7, 0.04)
