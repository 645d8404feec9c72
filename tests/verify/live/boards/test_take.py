"""Board pictures from live cameras: when a pair is taken, what reaches the disk, the page."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.support.boards.drawn_corners import board_pairs
from tests.support.boards.station import SMALL, STATION
from tests.support.command import verify
from tests.support.devices.chromium import Browser
from verify.calibration.corners.find import find_board
from verify.calibration.corners.folder import find_boards
from verify.cli.calibrate.live import board_of, take_pictures
from verify.core.fiducials import Board, BoardPair, BoardView
from verify.core.records import Array, StereoPair
from verify.errors import InputError
from verify.io.board.folder import open_board_folder
from verify.live.boards import pictures as boards_pictures
from verify.live.boards.goals import CameraCoverage, CapturedPairs, coverage, goals
from verify.live.boards.pictures import BoardPictures, complete_pairs
from verify.live.boards.show import BoardPageSource, BoardSnapshot, BoardState
from verify.live.boards.take import BoardCapture, BoardDevices
from verify.live.boards.view import (
    MAX_MOTION_PX,
    MIN_PICTURES,
    STILL_TIME,
    U_CORNER_PX,
    StillnessDetector,
    find_board_coarsely,
)
from verify.live.page.feed import Page
from verify.live.station.cameras import open_station_cameras
from verify.live.station.keys import SimSettings
from verify.simulation import library
from verify.simulation.boards.cameras import BoardCameras
from verify.simulation.boards.simulate import simulate_boards
from verify.simulation.scenario import BoardScenario
from verify.simulation.session.simulate import simulate_session
from verify.simulation.world.bench import rigid

BOARD = Board(9, 7, 0.04)
HOSTILE = "<img src=x onerror=document.title='taken'>"


@pytest.fixture
def station(tmp_path: Path) -> Path:
    (tmp_path / "small.toml").write_text(SMALL)
    (tmp_path / "station.toml").write_text(STATION)
    return tmp_path / "station.toml"


def turning() -> BoardScenario:
    scenario = library.load("boards_turning")
    assert isinstance(scenario, BoardScenario)
    return scenario


# when a pair is taken


def view(offset: Array) -> BoardView:
    corner = np.arange(12)
    centre = np.stack([50.0 * (corner % 4), 50.0 * (corner // 4)], axis=1) + offset
    return BoardView(corner, centre, np.tile(0.01 * np.eye(2), (12, 1, 1)))


def watched(positions: Array, rate: float = 10.0, noise: float = 0.1) -> StillnessDetector:
    """A board whose places (n, 2), px, both cameras see at a rate, Hz."""
    rng, still = np.random.default_rng(1), StillnessDetector()
    for number, place in enumerate(positions):
        both = [view(place + noise * rng.standard_normal((12, 2))) for _ in range(2)]
        still.add(number / rate, *both)
    return still


def test_a_board_is_still_once_it_was_for_long_enough() -> None:
    assert watched(np.zeros((20, 2))).still
    assert not watched(np.zeros((int(STILL_TIME * 10), 2))).still
    assert not watched(np.zeros((MIN_PICTURES - 1, 2)), rate=1.0).still


def test_a_drift_that_two_free_cameras_would_see_differently_is_not_still() -> None:
    seconds = np.arange(20)[:, None] / 10
    assert not watched(seconds * [2 * MAX_MOTION_PX / STILL_TIME, 0] * 1.2, noise=0.0).still
    assert watched(seconds * [MAX_MOTION_PX / STILL_TIME, 0], noise=0.0).still
    jumped = np.zeros((20, 2))
    jumped[-1] = 5.0
    assert not watched(jumped).still


def test_a_picture_without_the_board_begins_anew() -> None:
    still = watched(np.zeros((20, 2)))
    still.add(2.0, view(np.zeros(2)), None)
    assert still.motion is None
    still.add(2.1, view(np.zeros(2)), view(np.zeros(2)))
    assert not still.still


ONE_PLACE = msgspec.structs.replace(
    turning(), boards=msgspec.structs.replace(turning().boards, pairs=1)
)


def placed(rotation_deg: tuple[float, float, float], at: tuple[float, float, float]) -> BoardPair:
    """A board seen by two cameras whose focal length is not the guessed one."""
    boards = simulate_boards(ONE_PLACE)
    pose = rigid(np.deg2rad(rotation_deg), np.array(at)) @ rigid(
        np.zeros(3), -boards.board.points.mean(axis=0)
    )
    points = boards.board.points @ pose[:3, :3].T + pose[:3, 3]
    seen = [camera.project(points, 0.0) for camera in boards.cameras]
    views = [BoardView(np.arange(63), s, np.tile(0.01 * np.eye(2), (63, 1, 1))) for s in seen]
    return BoardPair(0, 0.0, 0.0, views[0], views[1])


@pytest.mark.parametrize(
    ("rotation", "at", "new"),
    [
        ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), False),
        ((4.0, 0.0, 0.0), (0.02, 0.0, 1.05), False),
        ((25.0, 0.0, 0.0), (0.0, 0.0, 1.0), True),
        ((0.0, -25.0, 0.0), (0.0, 0.0, 1.0), True),
        ((0.0, 0.0, 30.0), (0.0, 0.0, 1.0), True),
        ((0.0, 0.0, 0.0), (0.25, 0.0, 1.0), True),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 1.3), True),
    ],
)
def test_a_pair_is_taken_if_the_board_pose_is_new(
    rotation: tuple[float, float, float], at: tuple[float, float, float], new: bool
) -> None:
    taken = CapturedPairs(BOARD, (1280, 720))
    taken.add(placed((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    assert (taken.alike(placed(rotation, at)) is None) == new


def test_a_turned_base_makes_any_pair_worth_taking() -> None:
    pair = placed((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    taken = CapturedPairs(BOARD, (1280, 720))
    taken.add(pair)
    assert taken.alike(replace(pair, pan_left=np.deg2rad(5.0))) is None


def test_tilts_and_distances_are_those_of_the_simulation() -> None:
    pairs, rig = board_pairs(turning())
    taken = CapturedPairs(BOARD, (1280, 720))
    for pair in pairs[:12]:
        taken.add(pair)
    boards = simulate_boards(turning())
    for pair, placement in zip(pairs[:12], taken.of_camera(0), strict=True):
        rig_T_camera = rig.left.rig_T_camera(pair.pan_left)
        camera_T_board = np.linalg.inv(rig_T_camera) @ boards.rig_T_board[pair.frame]
        middle = camera_T_board @ np.append(boards.board.points.mean(axis=0), 1.0)
        assert placement.orientation.distance == pytest.approx(middle[2], rel=0.03)
        normal = placement.orientation.view_T_board[:3, 2]
        assert np.degrees(np.arccos(normal @ camera_T_board[:3, 2])) < 3.0


def test_a_part_of_the_image_has_the_name_that_the_report_gives_it() -> None:
    regions = np.full((3, 3), 99.0)
    regions[1, 0] = 0
    left, right = (
        CameraCoverage(np.ones((1, 1)), r, np.zeros(4), ()) for r in (regions, regions.T)
    )
    found = goals(CapturedPairs(BOARD, (1280, 720)), (left, right), turning=False)
    assert found[0].words == "8 of 9 parts; hold the board in the left edge"
    assert found[1].words == "8 of 9 parts; hold the board in the upper middle"


def test_the_goals_are_reached_by_what_the_report_finds_nothing_missing_in() -> None:
    taken = CapturedPairs(BOARD, (1280, 720))

    def open_goals() -> set[str]:
        covered = (coverage(taken, 0), coverage(taken, 1))
        return {goal.name for goal in goals(taken, covered, turning=True) if not goal.reached}

    assert len(open_goals()) == 8
    for pair in board_pairs(turning())[0]:
        taken.add(pair)
    assert open_goals() <= {"left image", "right image"}  # chance need not fill every edge
    assert coverage(taken, 0).cells.sum() == 40 * 63


def test_a_glimpse_is_good_to_what_it_states() -> None:
    boards = simulate_boards(turning())
    for board_index in range(3):
        image = boards.image(0, board_index)
        seen, exact = find_board_coarsely(image, boards.board), find_board(image, boards.board)
        np.testing.assert_array_equal(seen.corner, exact.corner)
        assert np.sqrt(np.mean((seen.centre - exact.centre) ** 2)) < U_CORNER_PX
    assert find_board_coarsely(np.full((720, 1280, 3), 40, np.uint8), boards.board) is None


# what reaches the disk


def shot(number: int) -> StereoPair:
    rng = np.random.default_rng(number)
    left, right = (rng.integers(0, 255, (48, 64, 3), dtype=np.uint8) for _ in range(2))
    return StereoPair(number, 4.0 * number, 4.0 * number, 0.1 * number, -0.1 * number, left, right)


def test_pictures_come_back_to_the_last_bit_and_angles_with_them(tmp_path: Path) -> None:
    pictures = BoardPictures(tmp_path / "kept", BOARD, turning=True)
    for number in range(3):
        pictures.keep(shot(number))
    opened = open_board_folder(tmp_path / "kept")
    assert opened.board == BOARD
    for pair in opened.pairs():
        assert np.array_equal(pair.left, shot(pair.frame).left)
        assert np.array_equal(pair.right, shot(pair.frame).right)
        assert pair.pan_left == pytest.approx(0.1 * pair.frame, abs=1e-11)


class StoppedError(BaseException):
    """The program ends here."""


def test_wherever_it_is_stopped_pairs_are_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every operation that changes names on the disk is the last one, in its turn."""
    given = {name: getattr(Path, name) for name in ("rename", "replace")}
    remaining = 0

    def limited(name: str) -> Callable[[Path, Path], Path]:
        def change(path: Path, target: Path) -> Path:
            nonlocal remaining
            remaining -= 1
            if remaining < 0:
                raise StoppedError
            result: Path = given[name](path, target)
            return result

        return change

    for name in given:
        monkeypatch.setattr(Path, name, limited(name))
    lengths = []
    for operations in range(5, 20):  # five until the first pair counts
        remaining = operations
        folder = tmp_path / str(operations)
        with suppress(StoppedError):
            pictures = BoardPictures(folder, BOARD, turning=True)
            pictures.keep(shot(0))
            pictures.keep(shot(1))
        exhausted, remaining = remaining < 0, 1000
        complete_pairs(folder)
        opened = open_board_folder(folder)
        assert [pair.frame for pair in opened.pairs()] == list(range(len(opened)))
        lengths.append(len(opened))
        if not exhausted:
            break
    assert lengths == sorted(lengths)
    assert set(lengths) == {1, 2}
    assert not exhausted


def test_without_a_pair_there_is_no_folder(tmp_path: Path) -> None:
    BoardPictures(tmp_path / "kept", BOARD, turning=True)
    assert not (tmp_path / "kept").exists()


def test_nothing_is_added_to_pictures_that_are_there(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="not empty"):
        BoardPictures(tmp_path, BOARD, turning=False)


def test_a_refusing_disk_is_reported_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pictures = BoardPictures(tmp_path / "kept", BOARD, turning=False)
    pictures.keep(shot(0))

    def full(path: Path, _data: bytes) -> None:
        raise InputError(path, "no space left on device")

    monkeypatch.setattr(boards_pictures, "write_whole", full)
    with pytest.raises(InputError, match="no space"):
        pictures.keep(shot(1))
    assert len(open_board_folder(tmp_path / "kept")) == 1


# from cameras


def test_a_station_file_of_cameras_alone_is_enough(station: Path, tmp_path: Path) -> None:
    opened = open_station_cameras(station, BoardCameras)
    assert opened.board == BOARD
    assert opened.open_pan() is None
    (tmp_path / "one.toml").write_text(STATION.replace('source = "sim"', "source = 0", 1))
    with pytest.raises(InputError, match=r"left\.source"):
        open_station_cameras(tmp_path / "one.toml", BoardCameras)
    (tmp_path / "none.toml").write_text(STATION.replace("small.toml", "nowhere"))
    with pytest.raises(InputError, match=r"sim\.scenario"):
        open_station_cameras(tmp_path / "none.toml", BoardCameras)


def test_the_written_station_file_shows_boards_to_its_own_cameras() -> None:
    cameras = BoardCameras(SimSettings("multi_joint_rv_3sd"), turning=False)
    session = library.load("multi_joint_rv_3sd")
    assert not isinstance(session, BoardScenario)
    assert cameras.scene.boards.scenario.rig.left == session.rig.left
    true = simulate_session(session).world.bench.cameras  # not those that the scenario states
    for found, camera in zip(cameras.scene.boards.cameras, true, strict=True):
        np.testing.assert_array_equal(found.matrix, camera.matrix)
        np.testing.assert_array_equal(found.turntable_T_camera, camera.turntable_T_camera)
    assert not np.ptp(cameras.scene.boards.pan, axis=0).any()
    cameras.scene.close()


def test_pairs_are_taken_unattended_and_are_what_a_calibration_reads(
    station: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "taken"
    take_pictures(station, folder, None, 2, None)
    opened = open_board_folder(folder)
    assert len(opened) == 2
    assert opened.image_size == (640, 360)
    for pair in find_boards(opened, lambda *_: None):
        assert len(pair.left) == len(pair.right) == 63


def test_a_station_file_needs_live_and_what_is_for_live_needs_it_too(tmp_path: Path) -> None:
    out = ("-o", tmp_path / "rig.toml")
    station = verify("calibrate", "boards", tmp_path / "station.toml", *out)
    assert "Add --live" in station.refusal
    assert "--pairs" in verify("calibrate", "boards", tmp_path, "--pairs", "5", *out).refusal


def test_a_board_must_be_named_once(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--corners"):
        board_of(BOARD, tmp_path / "board.toml")
    assert board_of(None, None) is None


# in the browser


@contextmanager
def taking(station: Path, folder: Path) -> Iterator[tuple[Page, BoardState, threading.Thread]]:
    opened = open_station_cameras(station, BoardCameras)
    assert opened.board is not None
    left, right = opened.open_cameras()
    state = BoardState(BoardSnapshot())
    pictures = BoardPictures(folder, opened.board, turning=False)
    devices = BoardDevices(left, right, opened.open_pan())
    run = BoardCapture(devices, opened.board, pictures, None, state)
    page = Page(
        BoardPageSource(state, opened.board, HOSTILE), 0,
        commands={"take": run.ask, "finish": run.finish},
    )  # fmt: skip
    thread = threading.Thread(target=run.run, daemon=True)
    thread.start()
    try:
        yield page, state, thread
    finally:
        run.finish()
        thread.join(10)
        page.close()
        left.close()
        right.close()


GREEN = """() => { const c = document.querySelector('#left');
  const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
  let n = 0; for (let i = 0; i < d.length; i += 4) n += d[i + 1] > d[i] + 12;
  return n / (d.length / 4); }"""
POINTS = """() => { const c = document.querySelector('.tilts canvas');
  const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
  let n = 0; for (let i = 0; i < d.length; i += 4) n += d[i + 3] === 255 && d[i + 2] > d[i] + 100;
  return n; }"""


@pytest.mark.browser
def test_the_page_fills_takes_and_finishes(browser: Browser, station: Path, tmp_path: Path) -> None:
    with (
        taking(station, tmp_path / "taken") as (page, state, thread),
        browser.open(page.url) as tab,
    ):
        tab.until("document.querySelector('#connection')?.textContent === 'live'")
        assert HOSTILE in tab.text("#description")
        tab.until("document.querySelector('#left').ariaLabel.includes('63 corners')")
        tab.until("/^[1-9]/.test(document.querySelector('#pairs').innerText)")  # by itself
        tab.until(f"({GREEN})() > 0.01")
        tab.until(f"({POINTS})() > 10")
        assert tab.evaluate("document.querySelectorAll('#goals li.open').length") > 0
        before = state.snapshot().pairs
        tab.press("f")
        assert "Again" in tab.text("#finish")
        assert thread.is_alive()
        while state.snapshot().pairs == before:  # by hand, as soon as the board is seen
            tab.press(" ")
            time.sleep(0.05)
        tab.evaluate("document.querySelector('#finish').click()")
        tab.evaluate("document.querySelector('#finish').click()")
        tab.until("document.querySelector('#words').innerText.startsWith('finished')")
        thread.join(10)
        assert not thread.is_alive()
        assert tab.evaluate("document.title") == "Calibration · verify"
        assert tab.complaints == []
    assert len(open_board_folder(tmp_path / "taken")) == state.snapshot().pairs


@pytest.mark.browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_shows_it_too(browser: Browser, station: Path, tmp_path: Path, scheme: str) -> None:
    with (
        taking(station, tmp_path / "taken") as (page, _, _),
        browser.open(page.url, 360, 740, scheme) as tab,
    ):
        tab.until("document.querySelectorAll('#goals li').length > 5")
        assert tab.evaluate("document.documentElement.scrollWidth") <= 360
        assert tab.evaluate("document.documentElement.dataset.theme") == scheme
        hidden = "[...document.querySelectorAll('#joints, #scene-section, #pause')]"
        assert tab.evaluate(f"{hidden}.every(part => part.offsetParent === null)")
        assert tab.complaints == []
