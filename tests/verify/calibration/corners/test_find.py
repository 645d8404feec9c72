"""Boards found in pictures, and their corners against cv2.projectPoints."""

import cv2
import numpy as np
import pytest

from tests.bench.corners import recorded
from tests.bench.halves import SETS
from tests.support.boards.board_images import (
    HALF_CAMERA,
    HALF_SIZE,
    Look,
    camera,
    corners,
    picture,
    placed,
    random_pose,
)
from tests.support.recorded import require_shared
from verify.calibration.corners.find import find_board, find_other_board, is_ambiguous
from verify.calibration.corners.search import find_by_growing, is_blank
from verify.core.fiducials import Board, BoardView
from verify.core.records import Array, Image

PLAIN = Board(9, 7, 0.040)
UNIQUE = Board(9, 6, 0.040)
CHARUCO = Board(9, 6, 0.040, markers="DICT_5X5_100", marker=0.030)
CAMERA = camera()


def squared(view: BoardView, error: Array) -> Array:
    """Squared errors in units of their covariance, (n,)."""
    return np.einsum("ni,nij,nj->n", error, np.linalg.inv(view.covariance), error)


def found(image: Image, board: Board) -> BoardView:
    view = find_board(image, board)
    assert view is not None
    return view


@pytest.mark.slow
@pytest.mark.parametrize(
    ("board", "look"),
    [
        (PLAIN, Look()),
        (PLAIN, Look(white=60.0, black=3.0, blur=2.0)),
        (PLAIN, Look(shading=(0.8, -0.5), gamma=1.8, white=150.0)),
        (CHARUCO, Look()),
    ],
    ids=["usual", "dark and blurred", "shaded, with gamma", "charuco"],
)
def test_errors_scatter_as_their_covariance_states(board: Board, look: Look) -> None:
    rng = np.random.default_rng(3)
    errors, d2 = [], []
    for _ in range(4):
        camera_T_board = random_pose(board, rng)
        view = found(picture(board, CAMERA, camera_T_board, rng, look), board)
        assert len(view) == len(board)
        error = view.centre - corners(board, CAMERA, camera_T_board)
        errors.append(error)
        d2.append(squared(view, error))
    ratio = np.sqrt(np.mean(d2) / 2)
    rms = np.sqrt(np.mean(np.square(errors)))
    assert 0.9 < ratio < 1.1  # 432 errors or more: 3.4 % is one sigma
    # 432 errors or more: their mean is within 4 sigma of nought
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 4 * rms / np.sqrt(216)


@pytest.mark.parametrize("distortion", [(0.0,) * 5, (-0.35, 0.15, 0.001, 0.001, 0.0)])
def test_without_noise_a_thousandth_of_a_pixel_is_left(distortion: tuple[float, ...]) -> None:
    rng, view = np.random.default_rng(4), camera(distortion)
    for _ in range(2):
        camera_T_board = random_pose(PLAIN, rng)
        seen = found(picture(PLAIN, view, camera_T_board, None), PLAIN)
        error = seen.centre - corners(PLAIN, view, camera_T_board)
        assert np.sqrt(np.mean(error**2)) < 0.001


@pytest.mark.slow
def test_corners_of_neighbours_share_no_error() -> None:
    rng = np.random.default_rng(7)
    camera_T_board = placed((0.1, 0.2, 0.1), (0, 0, 1.0), PLAIN)
    truth = corners(PLAIN, CAMERA, camera_T_board)
    errors = np.array(
        [found(picture(PLAIN, CAMERA, camera_T_board, rng), PLAIN).centre - truth for _ in range(4)]
    ).reshape(-1, 7, 9, 2)
    along = np.mean(errors[:, :, 1:] * errors[:, :, :-1]) / np.mean(errors**2)
    assert abs(along) < 4 / np.sqrt(2 * 4 * 7 * 8)


@pytest.mark.parametrize("turn", [0.0, 100.0, 175.0, -120.0])
def test_colours_settle_the_order_at_any_turn(turn: float) -> None:
    rng = np.random.default_rng(8)
    camera_T_board = placed((0.0, 0.0, np.deg2rad(turn)), (0, 0, 1.0), UNIQUE)
    assert not is_ambiguous(UNIQUE)
    view = found(picture(UNIQUE, CAMERA, camera_T_board, rng), UNIQUE)
    truth = corners(UNIQUE, CAMERA, camera_T_board)
    assert np.abs(view.centre - truth[view.corner]).max() < 0.1


@pytest.mark.parametrize(
    ("counts", "turn", "label"), [((9, 7), 60.0, 0), ((9, 7), 130.0, 62), ((8, 8), -30.0, 0)]
)
def test_a_symmetric_pattern_starts_at_the_top_left(
    counts: tuple[int, int], turn: float, label: int
) -> None:
    board, rng = Board(*counts, 0.035), np.random.default_rng(9)
    assert is_ambiguous(board)
    camera_T_board = placed((0.0, 0.0, np.deg2rad(turn)), (0, 0, 1.0), board)
    view = found(picture(board, CAMERA, camera_T_board, rng), board)
    assert np.linalg.norm(view.centre[0] - corners(board, CAMERA, camera_T_board)[label]) < 0.1


def test_white_at_the_first_square_turns_an_unambiguous_board_round() -> None:
    camera_T_board = placed((0.0, 0.0, 0.1), (0, 0, 1.0), UNIQUE)
    view = found(picture(UNIQUE, CAMERA, camera_T_board, None, Look(inverted=True)), UNIQUE)
    truth = corners(UNIQUE, CAMERA, camera_T_board)[::-1]
    assert np.abs(view.centre - truth).max() < 0.01


def test_a_charuco_board_may_be_partly_out_of_view() -> None:
    rng = np.random.default_rng(10)
    camera_T_board = placed((0.2, -0.2, 2.4), (0.5, 0.1, 0.9), CHARUCO)
    view = found(picture(CHARUCO, CAMERA, camera_T_board, rng), CHARUCO)
    assert 8 <= len(view) < len(CHARUCO)
    assert np.all(np.diff(view.corner) > 0)
    error = view.centre - corners(CHARUCO, CAMERA, camera_T_board)[view.corner]
    assert np.sqrt(np.mean(squared(view, error)) / 2) < 1.5  # few corners


def test_a_plain_board_partly_out_of_view_is_not_found() -> None:
    camera_T_board = placed((0.0, 0.0, 0.0), (0.5, 0.0, 0.8), UNIQUE)
    assert find_board(picture(UNIQUE, CAMERA, camera_T_board, None), UNIQUE) is None


def test_a_covered_corner_is_left_out_and_colour_does_not_matter() -> None:
    rng = np.random.default_rng(11)
    camera_T_board = placed((0.0, 0.2, 0.1), (0, 0, 1.0), PLAIN)
    image = picture(PLAIN, CAMERA, camera_T_board, rng)
    truth = corners(PLAIN, CAMERA, camera_T_board)
    x, y = np.rint(truth[31]).astype(int)
    image[y - 3 : y + 12, x - 4 : x + 12] = 120
    view = found(np.repeat(image[..., None], 3, axis=2), PLAIN)
    error = view.centre - truth[view.corner]
    assert 31 not in view.corner or squared(view, error)[list(view.corner).index(31)] < 25
    assert np.abs(error[view.corner != 31]).max() < 0.05
    assert len(view) >= 62


def test_a_board_of_which_a_middle_part_is_covered_is_found_beside_it() -> None:
    squares = np.indices((6, 9)).sum(axis=0) % 2
    light = 40 + 160 * np.pad(np.kron(squares, np.ones((30, 30))), 40, constant_values=1.0)
    light[150:210, 200:260] = 90.0
    view = found(np.asarray(cv2.GaussianBlur(light, (0, 0), 1.0), np.uint8), Board(8, 5, 0.040))
    row, column = np.divmod([view.corner, 39 - view.corner], 8)  # it looks the same upside down
    places = 69.5 + 30.0 * np.stack([column, row], axis=2)
    assert len(view) >= 36
    off = min(np.abs(view.centre - places), key=np.max)
    assert np.count_nonzero((off < 0.02).all(axis=1)) >= 34  # what covers it shifts those beside


@pytest.mark.parametrize(
    ("stated", "there"), [((10, 8), (9, 7)), ((8, 7), (9, 7)), ((9, 8), (9, 7))]
)
def test_other_counts_are_not_found_but_named(
    stated: tuple[int, int], there: tuple[int, int]
) -> None:
    rng = np.random.default_rng(12)
    image = picture(PLAIN, HALF_CAMERA, random_pose(PLAIN, rng), rng, size=HALF_SIZE)
    board = Board(*stated, 0.040)
    assert find_board(image, board) is None
    assert find_other_board(image, board) == there


def test_where_no_board_is_none_is_found() -> None:
    noise = np.random.default_rng(13).integers(0, 255, (240, 320), dtype=np.uint8)
    for image in (noise, np.zeros_like(noise)):
        assert find_board(image, PLAIN) is None
        assert find_board(image, CHARUCO) is None
        assert find_other_board(image, PLAIN) is None


def test_noise_on_one_grey_is_blank_and_a_board_in_hardly_any_light_is_found() -> None:
    rng = np.random.default_rng(15)
    assert is_blank(np.rint(rng.normal(90, 2, (720, 1280))).astype(np.uint8))
    dim = Look(white=14, black=8, background=9, read=0.5)
    image = picture(PLAIN, camera(), random_pose(PLAIN, rng), rng, dim)
    view = find_board(image, PLAIN)
    assert view is not None
    assert len(view) == len(PLAIN)


@pytest.mark.shared
@pytest.mark.slow
def test_recorded_boards_are_measured_to_a_hundredth_of_a_pixel() -> None:
    errors, d2 = [], []
    scenes = enumerate(recorded(require_shared() / "calibration_boards"))
    for image, truth in (scene for i, scene in scenes if i // 2 % 2 == 0):  # every other pair
        view = found(image, PLAIN)
        assert len(view) == len(PLAIN)
        errors.append(view.centre - truth)
        d2.append(squared(view, errors[-1]))
    rms, ratio = np.sqrt(np.mean(np.square(errors))), np.sqrt(np.mean(d2) / 2)
    assert rms < 0.0266 / 3  # a coordinate; 0.0266 px: cornerSubPix on the same images
    assert 0.9 < ratio < 1.1


@pytest.mark.shared
@pytest.mark.slow
@pytest.mark.parametrize(("name", "count"), [("stereo", 26), ("lifecam", 14), ("gloworm", 25)])
def test_every_real_board_is_found_whole(name: str, count: int) -> None:
    kit = SETS[name]
    views = [v for pair in kit.pairs() for v in (pair.left, pair.right) if v is not None]
    assert [len(view) for view in views] == count * [len(kit.board)]


def test_a_hardly_readable_picture_gives_the_same_answer_whatever_opencv_drew_before() -> None:
    board = Board(columns=7, rows=5, square=0.24 / 7)
    look = Look(white=102.0, black=1.0, background=68.0, blur=2.2, read=2.3)
    camera_T_board = placed((-0.74, 0.16, -0.21), (0.15, -0.01, 1.78), board)
    rng = np.random.default_rng(14)
    image = picture(board, HALF_CAMERA, camera_T_board, rng, look, HALF_SIZE)
    for seed in range(4):
        cv2.setRNGSeed(seed)
        grid = find_by_growing(image)
        assert grid is not None
        assert grid.shape == (7, 5, 2)
