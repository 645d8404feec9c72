"""How well a board's corners are measured: this tool's fit beside OpenCV's two ways.

Root mean square error of a coordinate against cv2.projectPoints, its ratio to this tool's, and the
time a view. cornerSubPix starts at this tool's corners, the best start there is.

Then the time of a whole calibration beside OpenCV's.

    python -m tests.bench corners
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from time import perf_counter, thread_time
from typing import Any

import cv2
import numpy as np

from tests.bench.goals import Figure, Line
from tests.bench.tracking import one_core
from tests.support.beside import SHARED
from tests.support.boards.board_images import Look, camera, corners, picture, random_pose
from tests.support.boards.made_views import fixed_rig, poses
from verify.calibration.corners.find import find_board
from verify.calibration.stereo.calibrate import calibrate
from verify.core.fiducials import Board, BoardPair, BoardView
from verify.core.records import Array, Image
from verify.core.rig import Camera
from verify.io import rig as io_rig

BOARD = Board(9, 7, 0.040)
VIEWS = 12
PAIRS, SMALL = 30, (640, 480)  # of a whole calibration
HALF_WINDOWS = (11, 5)  # px, of cornerSubPix
MOST_CALIBRATION = 3.0  # of the time of OpenCV's chain
SUB_PIX_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-3)  # as its examples have
LOOKS = {
    "clean": None,
    "noisy": Look(),
    "dark": Look(white=45.0, black=3.0, background=2.0),
    "blurred": Look(blur=2.0),
    "shaded, gamma 2.2": Look(shading=(0.6, -0.4), gamma=2.2, white=150.0),
}
Scene = tuple[Image, Array]  # a picture and its true corners
Method = Callable[[Image, BoardView], Array]


def lines() -> Iterator[Line]:
    """One line a set of pictures and method, and the time of a calibration."""
    with one_core():
        yield from calibration()
    for name, look in LOOKS.items():
        yield from compared(f"synthetic, {name}", synthetic(look))
    session = SHARED / "sessions" / "calibration_boards"
    if session.is_dir():
        yield from compared("recorded session", recorded(session))


def calibration() -> Iterator[Line]:
    """Time from pictures to a calibrated rig over OpenCV's with the same pictures.

    OpenCV's needs the longer the worse its corners are: with the window of its examples, which
    holds neighbouring corners in pictures so small, and with one that fits the squares.
    """
    rig = fixed_rig()
    sides = _small(rig.left), _small(rig.right)
    scenes = list(_board_pairs(sides))
    find_board(scenes[0][0][0], BOARD)  # loads what is compiled
    began = thread_time()
    views = [[find_board(image, BOARD) for image, _ in pair] for pair in scenes]
    pans = sides[0].pan, sides[1].pan
    calibrate([BoardPair(i, *pans, *pair) for i, pair in enumerate(views)], BOARD, SMALL)
    ours = thread_time() - began
    errors = [
        view.centre - truth[view.corner]
        for pair, of_pair in zip(views, scenes, strict=True)
        for view, (_, truth) in zip(pair, of_pair, strict=True)
        if view is not None
    ]
    yield f"calibration: corners {rms(errors):.4f} px in {len(errors)} of {2 * PAIRS} views"
    for half in HALF_WINDOWS:
        theirs = _open_cv_seconds(scenes, half)
        name = f"calibration, {PAIRS} pairs of {SMALL[0]} x {SMALL[1]}, over OpenCV's, {half} px"
        note = f"{ours:.2f} s beside {theirs:.2f} s"
        yield Figure(name, ours / theirs, most=MOST_CALIBRATION, note=note)


def _open_cv_seconds(scenes: list[list[Scene]], half: int) -> float:
    """findChessboardCorners, cornerSubPix and stereoCalibrate: s of the processor."""
    began = thread_time()
    sides: list[list[Any]] = [[], []]
    for pair in scenes:
        for side, (image, _) in zip(sides, pair, strict=True):
            _, found = cv2.findChessboardCorners(image, (BOARD.columns, BOARD.rows))
            side.append(cv2.cornerSubPix(image, found, (half, half), (-1, -1), SUB_PIX_STOP))
    points = [BOARD.points.astype(np.float32)] * PAIRS
    start = np.eye(3), np.zeros(5), np.eye(3), np.zeros(5)
    cv2.stereoCalibrate(points, *sides, *start, SMALL, flags=0)
    return thread_time() - began


def _small(view: Camera) -> Camera:
    """The camera at SMALL: half the resolution, the same middle."""
    matrix = view.matrix / 2
    matrix[1:, 2] = (SMALL[1] - 1) / 2, 1.0
    return replace(view, matrix=matrix)


def _board_pairs(sides: tuple[Camera, Camera]) -> Iterator[list[Scene]]:
    """PAIRS boards that both cameras show whole."""
    rng, count = np.random.default_rng(5), 0
    while count < PAIRS:
        rig_T_board = poses(rng, 1)[0]
        placed = [np.linalg.inv(side.rig_T_camera(side.pan)) @ rig_T_board for side in sides]
        truth = [corners(BOARD, side, pose) for side, pose in zip(sides, placed, strict=True)]
        if all(((at > 12) & (at < np.array(SMALL) - 13)).all() for at in truth):
            count += 1
            images = [
                picture(BOARD, *view, rng, size=SMALL) for view in zip(sides, placed, strict=True)
            ]
            yield list(zip(images, truth, strict=True))


def synthetic(look: Look | None) -> Iterator[Scene]:
    """Boards at random poses; without a look there is no noise."""
    rng, view = np.random.default_rng(20261121), camera()
    for _ in range(VIEWS):
        pose = random_pose(BOARD, rng)
        noise = None if look is None else rng
        yield picture(BOARD, view, pose, noise, look), corners(BOARD, view, pose)


def recorded(session: Path) -> Iterator[Scene]:
    """All images of the shared session, by its true rig and board poses."""
    rig, _ = io_rig.read(session / "rig.toml")
    for row in np.loadtxt(session / "board_poses.csv", delimiter=",", skiprows=1):
        rig_T_board = np.eye(4)
        rig_T_board[:3, :3], rig_T_board[:3, 3] = cv2.Rodrigues(row[1:4])[0], row[4:] / 1000
        for side, view in (("left", rig.left), ("right", rig.right)):
            image = cv2.imread(str(session / side / f"{int(row[0]):06d}.png"), cv2.IMREAD_GRAYSCALE)
            pose = np.linalg.inv(view.rig_T_camera(view.pan)) @ rig_T_board
            yield np.asarray(image, dtype=np.uint8), corners(BOARD, view, pose)


def sub_pix(image: Image, view: BoardView, half: int) -> Array:
    """Corners by cv2.cornerSubPix with a window of 2 half + 1 pixels."""
    start = view.centre.astype(np.float32).reshape(-1, 1, 2)
    until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-4)
    return cv2.cornerSubPix(image, start, (half, half), (-1, -1), until).reshape(-1, 2)


def fitted_sub_pix(image: Image, view: BoardView) -> Array:
    """The same with 0.35 of the least distance between corners."""
    grid = view.centre.reshape(BOARD.rows, BOARD.columns, 2)
    apart = min(np.linalg.norm(np.diff(grid, axis=axis), axis=2).min() for axis in (0, 1))
    return sub_pix(image, view, max(round(0.35 * apart), 2))


def sector(image: Image, _: BoardView) -> Array:
    """Corners by cv2.findChessboardCornersSB; nan where it finds none."""
    counts = (BOARD.columns, BOARD.rows)
    done, found = cv2.findChessboardCornersSB(image, counts, flags=cv2.CALIB_CB_ACCURACY)
    return found.reshape(-1, 2) if done else np.full((len(BOARD), 2), np.nan)


METHODS: dict[str, Method] = {
    "cornerSubPix, half window 11 px": lambda image, view: sub_pix(image, view, 11),
    "cornerSubPix, 0.35 spacings": fitted_sub_pix,
    "findChessboardCornersSB": sector,
}


def compared(name: str, scenes: Iterator[Scene]) -> Iterator[str]:
    """Errors and times of each method on the same pictures."""
    own: list[Array] = []
    squared: list[Array] = []
    others: dict[str, list[Array]] = {method: [] for method in METHODS}
    seconds = dict.fromkeys(["own", *METHODS], 0.0)
    views = 0
    for image, truth in scenes:
        views += 1
        begin = perf_counter()
        view = find_board(image, BOARD)
        seconds["own"] += perf_counter() - begin
        if view is None or len(view) < len(BOARD):
            continue
        own.append(matched(view.centre, truth))
        squared.append(np.einsum("ni,nij,nj->n", own[-1], np.linalg.inv(view.covariance), own[-1]))
        for method, refine in METHODS.items():
            begin = perf_counter()
            centre = refine(image, view)
            seconds[method] += perf_counter() - begin
            others[method].append(matched(centre, truth))
    unit = rms(own)
    ratio = np.sqrt(np.mean(squared) / 2)
    yield (
        f"corners, {name}: {unit:.5f} px, {ratio:.3f} of what is stated, "
        f"{len(own)} of {views} views, {seconds['own'] / views:.3f} s a view with the search"
    )
    for method, errors in others.items():
        seen = [e for e in errors if not np.isnan(e).any()]
        yield (
            f"corners, {name}, {method}: {rms(seen):.5f} px, ratio {rms(seen) / unit:.1f}, "
            f"{len(seen)} views, {seconds[method] / max(len(errors), 1):.3f} s"
        )


def matched(centre: Array, truth: Array) -> Array:
    """Errors, in whichever of both orders is the board's."""
    straight, turned = centre - truth, centre[::-1] - truth
    return straight if np.sum(straight**2) < np.sum(turned**2) else turned


def rms(errors: list[Array]) -> float:
    """Root mean square of a coordinate, px."""
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else float("nan")
