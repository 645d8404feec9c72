"""One camera alone: against pictures by OpenCV, and two real sets of pictures."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.stats import chi2

from tests.verify.calibration.calibrated import squared_distance
from tests.verify.calibration.made_views import BOARD, SIGMA, SIZE, poses
from tests.verify.recorded import require_shared
from verify.board import Board, BoardView
from verify.calibration.find import find_board
from verify.calibration.one_camera import OneCamera, calibrate_camera, judge_principal_point
from verify.calibration.parameters import KEYS
from verify.errors import InputError
from verify.records import Array

GROUPS = 8  # of views, one left out at a time
MATRIX = np.array([[1010.0, 0.0, 646.0], [0.0, 1012.0, 355.0], [0.0, 0.0, 1.0]])
CURVED = np.array([-0.085, 0.06, 0.0006, -0.0004, 0.0])
WAVY = np.array([0.19, -1.5, 0.003, 0.0006, 2.9])  # the LifeCam's
SEEDS = 6


def look(
    rng: np.random.Generator,
    boards: Array,
    matrix: Array = MATRIX,
    lens: Array = CURVED,
    sigma: float = SIGMA,
) -> dict[int, BoardView]:
    """Views of boards (b, 4, 4) by OpenCV's own camera; frames 10, 12, 14, ..."""
    views = {}
    for number, pose in enumerate(boards):
        turn = cv2.Rodrigues(pose[:3, :3])[0]
        pixels = cv2.projectPoints(BOARD.points, turn, pose[:3, 3], matrix, lens)[0][:, 0]
        pixels = pixels + rng.normal(0, sigma, pixels.shape)
        inside = np.flatnonzero(np.all((pixels > 2) & (pixels < np.array(SIZE) - 3), axis=1))
        covariance = np.tile(np.eye(2) * SIGMA**2, (len(inside), 1, 1))
        views[10 + 2 * number] = BoardView(inside, pixels[inside], covariance)
    return views


def distance(found: OneCamera, matrix: Array, lens: Array) -> tuple[float, int]:
    """d² of the stated parameters from the true ones, and its degrees of freedom."""
    error = np.concatenate(
        [(found.matrix - matrix)[[0, 1, 0, 1], [0, 1, 2, 2]], found.distortion - lens]
    )
    return squared_distance(error[[KEYS.index(name) for name in found.names]], found.covariance)


@pytest.mark.parametrize(
    ("lens", "full", "rank"), [(CURVED, False, 8), (CURVED, True, 9), (WAVY, False, 9)]
)
def test_true_lens_lies_within_the_stated_covariance(lens: Array, full: bool, rank: int) -> None:
    d2, degrees = 0.0, 0
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        views = look(rng, poses(rng, 14), lens=lens)
        found = calibrate_camera(views, BOARD, SIZE, lens="full" if full else "supported")
        one, own = distance(found, MATRIX, lens)
        d2, degrees = d2 + one, degrees + own
        assert not found.standing_out
        assert not found.left_out
    assert degrees == pytest.approx(rank * SEEDS, abs=1)  # chance may let a k3 of 0 stay in one
    low, high = chi2.ppf([0.005, 0.995], degrees)
    print(f"d² {d2:.1f} of {degrees}, {low:.1f} to {high:.1f}")
    assert low < d2 < high


def test_corners_noisier_than_stated_widen_the_covariance() -> None:
    rng = np.random.default_rng(3)
    boards = poses(rng, 12)
    quiet, loud = (
        calibrate_camera(look(np.random.default_rng(4), boards, sigma=s), BOARD, SIZE, lens="full")
        for s in (SIGMA, 3 * SIGMA)
    )
    assert loud.noise / quiet.noise == pytest.approx(3, rel=0.01)  # the same draws, times three
    growth = np.sqrt(np.diag(loud.covariance) / np.diag(quiet.covariance))
    assert growth == pytest.approx(np.full(9, 3.0), rel=0.1)
    assert loud.rms == pytest.approx(np.sqrt(2) * 3 * SIGMA, rel=0.1)


def test_a_blurred_view_stands_out_and_a_foreign_one_is_left_out() -> None:
    rng = np.random.default_rng(5)
    boards = poses(rng, 12)
    views = look(rng, boards)
    views[16] = look(rng, boards, sigma=10 * SIGMA)[16]
    shuffled = rng.permutation(len(views[20]))
    views[20] = BoardView(views[20].corner, views[20].centre[shuffled], views[20].covariance)
    found = calibrate_camera(views, BOARD, SIZE)
    assert found.standing_out == (16,)
    assert found.left_out == (20,)
    assert any("20" in sentence for sentence in found.decisions)
    assert sorted(found.view_rms) == [f for f in views if f != 20]


def test_bad_corners_are_refused_and_move_nothing() -> None:
    rng = np.random.default_rng(6)
    views = look(rng, poses(rng, 12))
    clean = calibrate_camera(views, BOARD, SIZE)
    for frame in (10, 18, 26):
        views[frame].centre[4] += [3.0, -2.0]
    found = calibrate_camera(views, BOARD, SIZE)
    assert found.refused == 3
    shift = np.abs(found.matrix - clean.matrix)[[0, 1, 0, 1], [0, 1, 2, 2]]
    assert np.all(shift < np.sqrt(np.diag(clean.covariance))[:4] / 2)


def test_an_odd_principal_point_that_is_real_is_believed() -> None:
    matrix = MATRIX.copy()
    matrix[1, 2] = 194.0
    rng = np.random.default_rng(7)
    found = calibrate_camera(look(rng, poses(rng, 12), matrix), BOARD, SIZE)
    point = found.principal_point
    assert point.odd
    assert point.believed
    assert point.uncertainty is not None
    assert point.distance == pytest.approx(np.hypot(6.5, 165.5), abs=4 * point.uncertainty)
    assert any("believe it" in sentence for sentence in found.decisions)


def test_an_odd_principal_point_inside_its_uncertainty_is_not_believed() -> None:
    matrix = MATRIX.copy()
    matrix[:2, 2] = 639.5, 194.5
    point = judge_principal_point(matrix, np.diag([1.0, 50.0]) ** 2, SIZE)
    assert point.odd
    assert not point.believed
    assert point.distance == pytest.approx(165.0)
    assert point.uncertainty == pytest.approx(50.0)  # along the offset, so cy's alone


def test_boards_alike_are_said_to_leave_the_focal_length_weak() -> None:
    rng = np.random.default_rng(8)
    boards = poses(rng, 12)
    two_tilts = [cv2.Rodrigues(np.array(turn))[0] for turn in ([0.2, 0.1, 0.0], [0.2, -0.1, 0.0])]
    boards[:, :3, :3] = two_tilts * 6
    boards[:, :3, 3] = [-0.16, -0.12, 1.0]
    boards[:, :3, 3] += rng.uniform(-0.1, 0.1, (12, 3))
    found = calibrate_camera(look(rng, boards), BOARD, SIZE)
    share = np.sqrt(found.covariance[0, 0]) / found.matrix[0, 0]
    assert share > 0.01
    assert any(f"known to ± {share:.1%} only" in sentence for sentence in found.decisions)


def test_parallel_boards_are_refused() -> None:
    rng = np.random.default_rng(9)
    boards = poses(rng, 8)
    boards[:, :3, :3] = np.eye(3)
    with pytest.raises(InputError, match=r"camera: shows its focal length or principal point"):
        calibrate_camera(look(rng, boards), BOARD, SIZE)


def test_two_views_are_refused_and_a_row_of_corners_is_no_view() -> None:
    rng = np.random.default_rng(10)
    with pytest.raises(InputError, match=r"views: show the board 2 times; three are the fewest"):
        calibrate_camera(look(rng, poses(rng, 2)), BOARD, SIZE)
    views = look(rng, poses(rng, 4))
    row = views[14].corner < BOARD.columns
    views[14] = BoardView(*(getattr(views[14], k)[row] for k in ("corner", "centre", "covariance")))
    assert calibrate_camera(views, BOARD, SIZE, lens="full").left_out == (14,)


def found_in(folder: str, pattern: str, board: Board) -> dict[int, BoardView]:
    """The board in every picture of a real set, whole in each, by the picture's number."""
    base: Path = require_shared().parent / "data" / "camera_1280x720_photonvision" / folder
    views = {}
    for path in base.glob(pattern):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        view = find_board(np.asarray(image, dtype=np.uint8), board)
        assert view is not None, path.name
        assert len(view.corner) == len(board), path.name
        views[int(path.stem.removeprefix("img"))] = view
    return views


@pytest.mark.shared
@pytest.mark.slow
def test_the_real_lifecam() -> None:
    views = found_in("lifecam_1280x720", "*.png", Board(10, 10, 1.0))
    assert len(views) == 14
    found = calibrate_camera(views, Board(10, 10, 1.0), SIZE)
    assert reprojection(found, views, Board(10, 10, 1.0)) < 0.6
    assert found.rms < 0.6
    assert found.refused < 0.02 * 1400
    assert found.standing_out == (6, 7)
    assert min(found.view_rms[f] for f in (6, 7)) > 2 * max(
        rms for f, rms in found.view_rms.items() if f not in (6, 7)
    )
    u = np.sqrt(np.diag(found.covariance))[:4]
    published = np.array([1128.8, 1127.1, 604.3, 350.2])  # SOURCE.md, OpenCV, plain weights
    assert np.all(np.abs(found.matrix[[0, 1, 0, 1], [0, 1, 2, 2]] - published) < 2 * u)
    assert not found.principal_point.odd


@pytest.mark.shared
@pytest.mark.slow
def test_the_real_gloworm_and_its_odd_principal_point() -> None:
    board = Board(8, 6, 0.0254)
    views = found_in("gloworm_1280x720", "*.jpg", board)
    assert len(views) == 25
    found = calibrate_camera(views, board, SIZE)
    assert reprojection(found, views, board) < 0.6
    assert found.rms < 0.6
    assert not found.standing_out
    point = found.principal_point
    assert point.odd
    assert point.believed
    assert point.uncertainty is not None
    assert found.matrix[1, 2] == pytest.approx(193.8, abs=2 * point.uncertainty)
    assert any("focal length is known to ±" in sentence for sentence in found.decisions)
    apart = jackknife(views, board)
    print(f"{point.distance:.1f} px, u {point.uncertainty:.2f}, jackknife {apart:.2f}")
    assert 0.5 < point.uncertainty / apart < 2  # eight groups: itself known to some 27 %


def reprojection(found: OneCamera, views: dict[int, BoardView], board: Board) -> float:
    """Root mean square distance of all corners, refused ones too, by OpenCV's poses and camera."""
    squares = []
    for view in views.values():
        points = board.points[view.corner]
        camera = (found.matrix, found.distortion)
        _, turn, shift = cv2.solvePnP(points, view.centre[:, None], *camera)
        pixels = cv2.projectPoints(points, turn, shift, *camera)[0][:, 0]
        squares.append(np.sum((pixels - view.centre) ** 2, axis=1))
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def jackknife(views: dict[int, BoardView], board: Board) -> float:
    """Standard uncertainty of the principal point's distance: a group of views left out each."""
    numbers = sorted(views)
    distances = []
    for group in range(GROUPS):
        rest = {f: views[f] for i, f in enumerate(numbers) if i % GROUPS != group}
        distances.append(calibrate_camera(rest, board, SIZE).principal_point.distance)
    return float(np.sqrt((GROUPS - 1) * np.var(distances)))
