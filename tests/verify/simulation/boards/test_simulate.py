import tomllib
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from robots.transforms import carry
from tests.support.boards.drawn_corners import board_pairs, true_corners
from tests.support.leds.scene import moved
from tests.support.scene import project
from tests.support.simulated import AWKWARD, keys_of
from verify.cli.simulate import simulate as command
from verify.core import fiducials
from verify.core.fiducials import Board
from verify.core.records import Array, Image
from verify.errors import InputError
from verify.io import rig as io_rig
from verify.io.board.folder import open_board_folder
from verify.simulation import library
from verify.simulation.boards.render import PrintedBoard
from verify.simulation.boards.simulate import MIN_BORDER_PX, simulate_boards
from verify.simulation.scenario import (
    BoardImage,
    BoardRig,
    BoardScenario,
    BoardScenarioBases,
    ScenarioBoards,
)
from verify.simulation.world.bench import inside

# A lamp so far in front that the light is even, and next to no noise.
BUILT_IN = Path(library.__file__).parent / "scenarios"
CLEAN = BoardImage(lamp_mm=(0.0, 0.0, -1e7), read_noise_dn=0.01, electrons_per_dn=1e9)
STOP = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-5)


def built_in(name: str) -> BoardScenario:
    scenario = library.load(name)
    assert isinstance(scenario, BoardScenario)
    return scenario


def scene(pairs: int = 6, **changes: object) -> BoardScenario:
    plain = BoardScenario(
        format=1,
        seed=7,
        boards=ScenarioBoards(pairs=pairs),
        bases=BoardScenarioBases(range_deg=20.0),
        rig=BoardRig(left=AWKWARD),
        image=CLEAN,
    )
    return msgspec.structs.replace(plain, **changes)


def refined(image: Image, corners: Array) -> Array:
    start = corners.astype(np.float32).reshape(-1, 1, 2).copy()
    return cv2.cornerSubPix(image, start, (5, 5), (-1, -1), STOP).reshape(-1, 2)


def test_pictures_of_a_folder_agree_with_its_truth(tmp_path: Path) -> None:
    """Corners found in the PNGs agree with rig_true.toml, frames.csv and board_poses.csv."""
    path = tmp_path / "mine.toml"
    text = (BUILT_IN / "boards_turning.toml").read_text()
    path.write_text(text.replace("pairs = 40", "pairs = 4"))
    command(str(path), tmp_path / "out", seed=3)
    boards = open_board_folder(tmp_path / "out")
    assert boards.warnings == ()
    assert (len(boards), boards.image_size, np.ptp(boards.pan_left) > 0) == (4, (1280, 720), True)
    rig, _ = io_rig.read(tmp_path / "out" / "rig_true.toml", registered=False)
    assert not rig.registered
    poses = np.loadtxt(tmp_path / "out" / "board_poses.csv", delimiter=",", skiprows=1)
    errors = []
    for pair in boards.pairs():
        turn, shift = poses[pair.frame, 1:4], poses[pair.frame, 4:] / 1000
        rig_T_board = moved(np.eye(4), shift, turn)
        for camera, pan, image in (
            (rig.left, pair.pan_left, pair.left),
            (rig.right, pair.pan_right, pair.right),
        ):
            truth = project(camera, pan, carry(rig_T_board, boards.board.points))
            errors.append(refined(image, truth) - truth)
    assert np.abs(np.mean(np.concatenate(errors), axis=0)).max() < 0.01
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) < 0.05  # cornerSubPix's own, with noise


def test_the_board_is_whole_its_first_corner_at_the_top_left_and_bases_turn_in_steps() -> None:
    boards = simulate_boards(built_in("boards_turning"))
    pan = np.degrees(boards.pan)
    assert_allclose(pan / 5, np.rint(pan / 5), atol=1e-9)
    assert np.all(pan.max(axis=0) >= 15)
    assert np.all(pan.min(axis=0) <= -15)
    fixed = np.degrees(simulate_boards(built_in("boards_fixed")).pan)
    assert_allclose(fixed, np.tile([7.5, -7.5], (20, 1)))
    for side in range(2):
        seen = true_corners(boards, side)
        assert np.all(inside(seen, (1280, 720), MIN_BORDER_PX))
        grid = seen.reshape(len(boards), 7, 9, 2)
        assert np.all(np.diff(grid[..., 0], axis=2) > 0)
        assert np.all(np.diff(grid[..., 1], axis=1) > 0)


def test_the_markers_are_those_of_opencvs_charuco_board() -> None:
    table = ScenarioBoards(
        pairs=1, markers="DICT_5X5_100", marker_mm=30.0, in_view=0.5, distance_mm=(450.0, 700.0)
    )
    boards = simulate_boards(scene(boards=table))
    detector = cv2.aruco.CharucoDetector(fiducials.charuco_board(boards.board))
    for side in range(2):
        for i in range(len(boards)):
            corners, numbers, _, _ = detector.detectBoard(boards.image(side, i))
            assert len(numbers) > 20
            truth = true_corners(boards, side)[i, np.ravel(numbers)]
            assert_allclose(np.reshape(corners, (-1, 2)), truth, atol=0.5)
    pairs, _ = board_pairs(boards.scenario)
    assert any(view is not None and len(view) < 63 for p in pairs for view in (p.left, p.right))


def test_pan_readings_scatter_about_the_truth_by_what_is_stated() -> None:
    boards = simulate_boards(
        scene(300, bases=BoardScenarioBases(range_deg=10.0, standard_uncertainty_deg=0.05))
    )
    off = np.degrees(boards.true_pan - boards.pan)
    assert off.std() == pytest.approx(0.05, rel=0.1)
    assert boards.rig.left.pan_standard_uncertainty == pytest.approx(np.radians(0.05))


def test_a_fixture_is_fixed_to_the_robot_base_and_its_folder_holds_the_pose(tmp_path: Path) -> None:
    scenario = built_in("boards_fixture")
    boards = simulate_boards(scenario)
    shift = np.array(scenario.fixture.board_position_mm) / 1000
    base_T_board = moved(np.eye(4), shift, np.radians(scenario.fixture.board_rotation_deg))
    for rig_T_board in boards.rig_T_board:
        assert_allclose(rig_T_board, boards.rig.rig_T_base @ base_T_board, atol=1e-12)
    assert (boards.rig.registered, boards.rig.base_source) == (True, "fixture")
    assert np.all(np.ptp(boards.pan, axis=0) > 0)
    path = tmp_path / "mine.toml"
    text = (BUILT_IN / "boards_fixture.toml").read_text()
    path.write_text(text.replace("pairs = 12", "pairs = 1"))
    command(str(path), tmp_path / "out")
    written = tomllib.loads((tmp_path / "out" / "board_in_base.toml").read_text())
    assert written["position_mm"] == [150.0, -105.0, 320.0]
    assert written["rotation_vector_deg"] == [-63.9, -45.5, 70.8]
    rig, _ = io_rig.read(tmp_path / "out" / "rig_true.toml")
    assert_allclose(rig.rig_T_base[:3, 3], [0.0, 0.25, 1.15])


def test_corners_without_pictures_carry_the_noise_that_they_state() -> None:
    scenario = scene(40)
    pairs, rig = board_pairs(scenario)
    boards = simulate_boards(scenario)
    whitened = []
    for i, pair in enumerate(pairs):
        assert (pair.frame, pair.pan_left) == (i, boards.pan[i, 0])
        for camera, pan, view in (
            (rig.left, pair.pan_left, pair.left),
            (rig.right, pair.pan_right, pair.right),
        ):
            assert_array_equal(view.corner, np.arange(63))
            truth = project(camera, pan, carry(boards.rig_T_board[i], boards.board.points))
            whitened.append((view.centre - truth) / np.sqrt(view.covariance[:, [0, 1], [0, 1]]))
    scatter = np.concatenate(whitened).ravel()  # 10,080 numbers
    assert scatter.mean() == pytest.approx(0, abs=0.04)
    assert scatter.std() == pytest.approx(1, abs=0.03)


def test_pixel_noise_is_that_of_the_scenario() -> None:
    table = BoardImage(lamp_mm=(0.0, 0.0, -1e7), read_noise_dn=2.0, electrons_per_dn=20.0)
    still = BoardScenarioBases(middle_deg=(7.0, -7.0))
    boards = simulate_boards(scene(2, image=table, bases=still))
    paper = PrintedBoard(boards.board, 0.02, table)
    light = paper.light(boards.cameras[1], float(boards.true_pan[0, 1]), boards.rig_T_board[0])
    off = boards.image(1, 0) - light
    for level, expected in ((table.white_dn, 2.0**2 + 190 / 20), (table.room_dn, 2.0**2 + 30 / 20)):
        there = np.abs(light - level) < 0.1
        assert there.sum() > 5000
        assert off[there].mean() == pytest.approx(0, abs=0.2)
        assert off[there].var() == pytest.approx(expected + 1 / 12, rel=0.06)


def test_the_same_seed_gives_the_same_pictures_and_another_does_not() -> None:
    first, again = simulate_boards(scene(2)), simulate_boards(scene(2))
    assert_array_equal(first.image(0, 1), again.image(0, 1))
    other = simulate_boards(scene(2, seed=8))
    assert np.any(first.image(0, 1) != other.image(0, 1))
    longer = simulate_boards(scene(4))
    assert_array_equal(longer.rig_T_board[:2], first.rig_T_board)


def test_the_scenario_boards_turning_shows_every_key() -> None:
    text = (BUILT_IN / "boards_turning.toml").read_text()
    still = {"ScenarioCamera.line_time_s", "ScenarioCamera.exposure_s"}  # no board shows them
    hidden = [key for key in keys_of(BoardScenario) - still if key.partition(".")[2] not in text]
    assert not hidden


@pytest.mark.parametrize("name", [f.stem for f in sorted(BUILT_IN.glob("boards_*.toml"))])
def test_defaults_in_scenario_comments_are_the_defaults(name: str, tmp_path: Path) -> None:
    lines = (BUILT_IN / f"{name}.toml").read_text().splitlines()
    path = tmp_path / "mine.toml"
    path.write_text("\n".join(line for line in lines if "(default)" not in line))
    assert library.load(str(path)) == built_in(name)


MINIMAL = "format = 1\nseed = 1\n[boards]\npairs = 2\n"


@pytest.mark.parametrize(
    ("extra", "words"),
    [
        ("square = 30.0\n", "square_mm.*boards_turning.toml shows every key"),
        ("[bases]\nrange = 20.0\n", "range_deg"),
        ("distance_mm = [900.0, 600.0]\n", "distance_mm.*the nearest comes first"),
        ("distance_mm = [150.0, 160.0]\n", "no place shows the whole board"),
        ('markers = "DICT_5X5_10"\nmarker_mm = 30.0\n', "DICT_5X5_100"),
        ('markers = "DICT_5X5_100"\n', "marker_mm"),
        ("[bases]\nmiddle_deg = [60.0, -60.0]\n", "no place shows the whole board"),
    ],
)
def test_a_wrong_scenario_is_refused_and_leaves_nothing_behind(
    tmp_path: Path, extra: str, words: str
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(MINIMAL + extra)
    with pytest.raises(InputError, match=words) as refused:
        command(str(path), tmp_path / "out")
    assert "mine.toml" in str(refused.value)
    assert [file.name for file in tmp_path.iterdir()] == ["mine.toml"]


def test_a_board_that_is_partly_out_of_sight_is_drawn_to_the_edge() -> None:
    """Rays that miss the lens's sane field or the plane leave room, not garbage."""
    camera = simulate_boards(scene(1)).cameras[0]
    paper = PrintedBoard(Board(40, 30, 0.04), 0.02, CLEAN)
    tilted = moved(np.eye(4), np.array([-0.3, -0.6, 0.4]), np.array([0.0, 1.45, 0.0]))
    light = paper.light(camera, 0.0, tilted)
    assert np.all((light >= CLEAN.black_dn - 0.5) & (light <= CLEAN.white_dn + 0.5))
    assert len(np.unique(light.round())) > 10
