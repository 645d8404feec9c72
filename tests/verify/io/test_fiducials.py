""""""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tests.support.recorded import MARKER, refusal, replace
from tests.support.strategies import assert_same, every_disk, finite, positive, texts
from verify.core import fiducials as core_fiducials
from verify.core.fiducials import COLOURS, Board, Marker
from verify.io import fiducials


@st.composite
def markers(draw: st.DrawFn) -> Marker:
    names = draw(st.lists(texts.filter(len), min_size=1, max_size=5, unique=True))
    count = len(names)
    away = np.arange(count)[:, None] * np.array([22.0, 0, 0])  # never inside one another
    scatter = st.lists(st.tuples(finite, finite, finite), min_size=count, max_size=count)
    colour = st.none() | st.sampled_from(COLOURS)
    return Marker(
        names=tuple(names),
        leds=away + np.array(draw(scatter)),
        colours=tuple(draw(st.lists(colour, min_size=count, max_size=count))),
        led_diameter=draw(positive),
        source=draw(st.none() | st.sampled_from(["jig", "measured", "motion"])),
        datum=draw(st.none() | texts),
        registration=draw(st.none() | texts),
        body_standard_uncertainty=draw(st.none() | st.tuples(*[positive] * 6).map(np.array)),
        led_standard_uncertainty=draw(st.none() | positive),
        centre_shift_standard_uncertainty=draw(st.none() | positive),
    )


@every_disk
@given(marker=markers())
def test_a_marker_written_and_read_is_the_same_marker(
    marker: Marker, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "marker.toml"
    fiducials.write_marker(path, marker)
    again, warnings = fiducials.read_marker(path)
    assert warnings == ()
    assert_same(marker, again)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "marker.toml").write_text(MARKER)
    return tmp_path / "marker.toml"


def test_millimetres_and_degrees_become_metres_and_radians(path: Path) -> None:
    replace(
        path,
        "led_diameter_mm = 5.0",
        "led_diameter_mm = 5.0\nled_standard_uncertainty_mm = 0.05\nsource = 'jig'\n"
        "centre_shift_standard_uncertainty_mm = 0.01\ndatum = 'dowel hole'\n"
        "body_standard_uncertainty = {x_mm=1, y_mm=2, z_mm=3, rx_deg=180, ry_deg=90, rz_deg=45}",
    )
    marker, warnings = fiducials.read_marker(path)
    assert warnings == ()
    assert (marker.names, marker.colours) == (("A", "B"), (None, "red"))
    assert (marker.source, marker.datum) == ("jig", "dowel hole")
    assert_allclose(marker.leds, [[0.06, 0, 0.01], [-0.045, 0.04, 0.015]])
    assert marker.led_diameter == pytest.approx(0.005)
    assert marker.led_standard_uncertainty == pytest.approx(5e-5)
    assert marker.centre_shift_standard_uncertainty == pytest.approx(1e-5)
    assert_allclose(
        marker.body_standard_uncertainty, [0.001, 0.002, 0.003, np.pi, np.pi / 2, np.pi / 4]
    )


def test_a_misspelt_key_of_an_led_is_named(path: Path) -> None:
    replace(path, 'colour = "red"', 'color = "red"')
    warnings = fiducials.read_marker(path)[1]
    assert len(warnings) == 1
    assert "led[1].color:" in warnings[0]
    assert "`colour`" in warnings[0]


NEGATIVE = "{x_mm=-1, y_mm=0, z_mm=0, rx_deg=0, ry_deg=0, rz_deg=0}"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (MARKER, "format = 1\nled_diameter_mm = 5.0\nled = []\n", "led: is empty"),
        ("led_diameter_mm = 5.0", "led_diameter_mm = 0", "led_diameter_mm: is 0.0"),
        ('"red"', '"pink"', 'led[1].colour: is "pink"'),
        ('"B"', '"A"', 'led[1].name: repeats "A"'),
        ('"B"', '""', "led[1].name: is empty"),
        ("[-45.0, 40.0, 15.0]", "[60.0, 0.0, 11.0]", "led[1].position_mm: is 1 mm from led[0]"),
        ("format = 1", "format = 1\nsource = 'jigg'", 'source: is "jigg"'),
        ("format = 1", "format = 1\nbody_standard_uncertainty = {x_mm=1}", "y_mm: is missing"),
        (
            "format = 1",
            f"format = 1\nbody_standard_uncertainty = {NEGATIVE}",
            "body_standard_uncertainty.x_mm: is -1.0",
        ),
    ],
)
def test_a_wrong_marker_is_refused_by_its_key(path: Path, old: str, new: str, message: str) -> None:
    replace(path, old, new)
    assert message in str(refusal(fiducials.read_marker, path))


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
    board_path = tmp_path_factory.getbasetemp() / "board.toml"
    fiducials.write_board(board_path, board)
    again, warnings = fiducials.read_board(board_path)
    assert warnings == ()
    assert_same(board, again)


@pytest.fixture
def board_path(tmp_path: Path) -> Path:
    (tmp_path / "board.toml").write_text(CHARUCO)
    return tmp_path / "board.toml"


def test_millimetres_become_metres(board_path: Path) -> None:
    replace(
        board_path, "square_mm = 40.0", "square_mm = 40.0\nsquare_standard_uncertainty_mm = 0.02"
    )
    board, warnings = fiducials.read_board(board_path)
    assert warnings == ()
    assert board.square == pytest.approx(0.04)
    assert board.marker == pytest.approx(0.03)
    assert board.square_standard_uncertainty == pytest.approx(2e-5)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("inner_corners = [9, 7]", "squares = [10, 8]", "Write [9, 7] for 10 x 8 squares"),
        ("inner_corners = [9, 7]", "inner_corners = [10, 8]\nsquares = [10, 8]", "one fewer"),
        ("inner_corners = [9, 7]", "inner_corners = [9, 2]", "at least 3 a side"),
        ("square_mm = 40.0", "square_mm = -40.0", "square_mm: is -40.0"),
        ("square_mm = 40.0", "square_mm = 4e-8", "square_mm: is 4e-08; a size is 0.001 mm or more"),
        ("marker_mm = 30.0", "marker_mm = 40.0", "marker_mm: is 40.0; a marker fits into"),
        ("marker_mm = 30.0", "marker_mm = 0.0", "marker_mm: is 0.0"),
        ("marker_mm = 30.0", "", "marker_mm: is missing; markers is there"),
        ('markers = "DICT_5X5_100"', "", "markers: is missing; marker_mm is there"),
        ('"DICT_5X5_100"', '"DICT_5X5_10"', "Did you mean `DICT_5X5_100`?"),
        ('"DICT_5X5_100"', '"5x5"', "an ArUco dictionary of OpenCV's is expected"),
        ("[9, 7]", "[29, 7]", "which has 100 markers; the board needs 120"),
    ],
)
def test_a_wrong_board_is_refused_by_its_key(
    board_path: Path, old: str, new: str, message: str
) -> None:
    replace(board_path, old, new)
    found = str(refusal(fiducials.read_board, board_path))
    assert message in found
    assert str(board_path) in found


def test_squares_that_agree_with_the_corners_do_no_harm(board_path: Path) -> None:
    replace(board_path, "[9, 7]", "[9, 7]\nsquares = [10, 8]")
    assert fiducials.read_board(board_path)[1] == ()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("format = 1", "format = 1\nsquare_um = 40000", "`square_mm`"),
        ("square_mm = 40.0\nmarkers", "square_mm = 0.04\nmarkers", "in metres?"),
    ],
)
def test_what_may_be_a_mistake_is_a_warning(
    board_path: Path, old: str, new: str, message: str
) -> None:
    replace(board_path, old, new)
    replace(board_path, "marker_mm = 30.0", "marker_mm = 0.03")
    assert message in fiducials.read_board(board_path)[1][0]


def test_the_corners_come_in_the_order_of_opencvs_charuco_board(board_path: Path) -> None:
    board, _ = fiducials.read_board(board_path)
    drawn = core_fiducials.charuco_board(board)
    assert_allclose(drawn.getChessboardCorners() - [0.04, 0.04, 0.0], board.points, atol=1e-8)
    assert len(drawn.getIds()) == 40  # white squares of 10 x 8
