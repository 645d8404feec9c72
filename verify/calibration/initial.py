"""Start values for the adjustment: rough lenses, boards' poses, the cameras' relation."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from verify.board import Board, BoardView
from verify.calibration.gauge import FIXED
from verify.calibration.parameters import State
from verify.calibration.relation import Relation
from verify.records import Array
from verify.rig import Camera

MOST_VIEWS = 15  # of a camera for its start value; the adjustment takes all
SANE_FOCAL = (0.25, 8.0)  # of the longer image side; beyond it the closed form has failed
FOREIGN_PX, FOREIGN = 5.0, 8.0  # and times the usual miss: this view shows something else
FEWEST_VIEWS = 5  # of a camera: with fewer none can be accused


@dataclass(frozen=True, slots=True)
class Lens:
    """A camera's rough lens and where it saw each board."""

    matrix: Array  # (3, 3), px
    distortion: Array  # (5,), k1 alone
    poses: dict[int, Array]  # by place in the list of pairs: camera_T_board (4, 4)


def rough_lens(views: dict[int, BoardView], board: Board, image_size: tuple[int, int]) -> Lens:
    """Find a camera's focal length and first distortion coefficient, and its boards' poses.

    The principal point stays at the image's centre: few tilted boards leave it open, and the
    adjustment finds it.

    Source: cv2.initCameraMatrix2D (Zhang's closed form) and cv2.calibrateCamera.
    """
    matrix = _closed_form(views, board, image_size)
    picked = list(views)[:: max(1, -(-len(views) // MOST_VIEWS))]
    flags = (
        cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_FIX_PRINCIPAL_POINT
        | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    )  # fmt: skip
    _, found, lens, _, _ = cv2.calibrateCamera(
        [_points(board, views[i]) for i in picked],
        [_seen(views[i]) for i in picked],
        image_size,
        matrix.copy(),
        np.zeros(5),
        flags=flags,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 1e-6),
    )
    distortion = np.asarray(lens, dtype=float).ravel()[:5]
    if _sane(found[0, 0], image_size) and abs(distortion[0]) < 1.0:
        matrix = np.asarray(found, dtype=float)
    else:
        distortion = np.zeros(5)
    poses = {i: pose_of(view, board, matrix, distortion) for i, view in views.items()}
    return Lens(matrix, distortion, poses)


def _closed_form(views: dict[int, BoardView], board: Board, image_size: tuple[int, int]) -> Array:
    width, height = image_size
    points = [_points(board, v) for v in views.values()]
    seen = [_seen(v) for v in views.values()]
    guess = np.asarray(cv2.initCameraMatrix2D(points, seen, image_size, 1.0), dtype=float)
    focal = guess[0, 0] if _sane(guess[0, 0], image_size) else float(max(image_size))
    return np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])


def _sane(focal: float, image_size: tuple[int, int]) -> bool:
    low, high = (f * max(image_size) for f in SANE_FOCAL)
    return bool(np.isfinite(focal) and low < focal < high)


def _points(board: Board, view: BoardView) -> NDArray[np.float32]:
    return board.points[view.corner].astype(np.float32)


def _seen(view: BoardView) -> NDArray[np.float32]:
    return view.centre.astype(np.float32).reshape(-1, 1, 2)


def pose_of(view: BoardView, board: Board, matrix: Array, distortion: Array) -> Array:
    """Place a board before a camera, camera_T_board (4, 4)."""
    _, turn, shift = cv2.solvePnP(
        board.points[view.corner], view.centre.reshape(-1, 1, 2), matrix, distortion
    )
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(turn)[0]
    pose[:3, 3] = shift.ravel()
    return pose


def foreign(views: dict[int, BoardView], board: Board) -> tuple[int, ...]:
    """Tell the views whose corners lie on no board, by a plane's picture that they should be.

    A lens bends all views alike, so one is foreign that misses by far more than the others do.
    Medians within a view, so that a bad corner or two accuse nobody.
    """
    if len(views) < FEWEST_VIEWS:
        return ()
    miss = {}
    for i, view in views.items():
        flat = board.points[view.corner, :2]
        plane, _ = cv2.findHomography(flat, view.centre, 0)
        if plane is None:
            miss[i] = float("inf")
            continue
        predicted = cv2.perspectiveTransform(flat[:, None], plane)[:, 0]
        miss[i] = float(np.median(np.linalg.norm(predicted - view.centre, axis=1)))
    usual = float(np.median(list(miss.values())))
    return tuple(i for i, m in miss.items() if m > max(FOREIGN_PX, FOREIGN * usual))


def start(
    lenses: Sequence[Lens],
    relation: Relation,
    pan: Array,
    pairs: Sequence[int],
    bases: Sequence[str],
) -> State:
    """Compose the start values: ideal bases, boards as the left camera saw them where it did."""
    cameras = []
    for side, (lens, axis) in enumerate(zip(lenses, relation.axes, strict=True)):
        mount = np.eye(4)
        place = relation.left_T_right if side else np.eye(4)
        angle = pan[0, side] if bases[side] == FIXED else 0.0  # a fixed base stands at its reading
        back = Rotation.from_rotvec(-axis * angle).as_matrix()
        mount[:3, :3] = back @ place[:3, :3]
        cameras.append(Camera(lens.matrix, lens.distortion, place[:3, 3].copy(), axis, 0.0, mount))
    boards = []
    for i in pairs:
        side = 0 if i in lenses[0].poses else 1
        boards.append(cameras[side].rig_T_camera(pan[i, side]) @ lenses[side].poses[i])
    return State(cameras[0], cameras[1], np.array(boards), np.zeros((len(boards), 2)))
