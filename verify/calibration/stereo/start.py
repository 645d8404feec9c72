"""Start values of the adjustment in closed form: lenses, camera relation, board poses.

    lens       f and k1 of a camera (px, 1) by Zhang's closed form and a rough calibration; the
               principal point is the image's centre, all other coefficients are 0
    relation   left_T_right (4, 4), both bases at pan 0, on which most pairs i agree:
               L(p_i) left_T_board_i H_i inv(R(q_i) right_T_board_i),  L, R: pan rotations
    boards     rig_T_board (4, 4) by the left camera, else by the right one

H_i is the identity, or half a turn of the board where one camera numbers it from its other end:
a pattern that half a turn leaves as it is does not decide it. Of relations that agree within the
tolerance the one with the fewest half turns is taken.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from robots.transforms import rotation_exp
from verify.calibration.stereo.gauge import BASE_FIXED
from verify.calibration.stereo.parameters import N_ERRORS, BundleState
from verify.core.fiducials import Board, BoardView
from verify.core.records import Array, rigid_transform
from verify.core.rig import Camera

MAX_UNCLEAR_TURN = np.deg2rad(5.0)  # range of readings that may not show which way they grow
MAX_RELATION_ANGLE = np.deg2rad(10.0)  # of two that agree, bases fixed: poses of a view err by 1°
MAX_RELATION_ANGLE_TURNED = np.deg2rad(20.0)  # bases turned: mounts and axes are still ideal
MAX_VIEWS = 15  # of a camera for its start value; the adjustment takes all
FOCAL_RANGE = (0.25, 8.0)  # of the longer image side; beyond it the closed form has failed
FOREIGN_MISFIT_PX = 5.0  # a view that misses a plane's image by more shows something else,
FOREIGN_MISFIT_RATIO = 8.0  # and by more than so many times the usual miss
MIN_VIEWS = 5  # of a camera: with fewer none can be called foreign


def foreign_views(views: dict[int, BoardView], board: Board) -> tuple[int, ...]:
    """Find the views whose corners are not the image of a plane, hence not of the board.

    A lens distorts all views alike, so one is foreign that misses by far more than the others do.
    Medians within a view, so that single bad corners do not count.
    """
    if len(views) < MIN_VIEWS:
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
    return tuple(
        i for i, m in miss.items() if m > max(FOREIGN_MISFIT_PX, FOREIGN_MISFIT_RATIO * usual)
    )


@dataclass(frozen=True, slots=True)
class InitialLens:
    """A camera's rough lens, and the boards' poses by it."""

    matrix: Array  # (3, 3), px
    distortion: Array  # (5,), k1 alone
    poses: dict[int, Array]  # by index of the pair: camera_T_board (4, 4)


def start_lens(
    views: dict[int, BoardView], board: Board, image_size: tuple[int, int]
) -> InitialLens:
    """Find a camera's focal length and first distortion coefficient, and its boards' poses.

    The principal point stays at the image's centre: few tilted boards leave it open, and the
    adjustment finds it.

    Source: cv2.initCameraMatrix2D (Zhang's closed form) and cv2.calibrateCamera.
    """
    matrix = _closed_form(views, board, image_size)
    picked = list(views)[:: max(1, -(-len(views) // MAX_VIEWS))]
    flags = (
        cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_FIX_PRINCIPAL_POINT
        | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    )  # fmt: skip
    _, found, lens, _, _ = cv2.calibrateCamera(
        [_points(board, views[i]) for i in picked],
        [_image_points(views[i]) for i in picked],
        image_size,
        matrix.copy(),
        np.zeros(5),
        flags=flags,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 1e-6),
    )
    distortion = np.asarray(lens, dtype=float).ravel()[:5]
    if _is_plausible_focal(found[0, 0], image_size) and abs(distortion[0]) < 1.0:
        matrix = np.asarray(found, dtype=float)
    else:
        distortion = np.zeros(5)
    poses = {i: board_pose(view, board, matrix, distortion) for i, view in views.items()}
    return InitialLens(matrix, distortion, poses)


def _closed_form(views: dict[int, BoardView], board: Board, image_size: tuple[int, int]) -> Array:
    width, height = image_size
    points = [_points(board, v) for v in views.values()]
    pixels = [_image_points(v) for v in views.values()]
    guess = np.asarray(cv2.initCameraMatrix2D(points, pixels, image_size, 1.0), dtype=float)
    focal = guess[0, 0] if _is_plausible_focal(guess[0, 0], image_size) else float(max(image_size))
    return np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])


def _is_plausible_focal(focal: float, image_size: tuple[int, int]) -> bool:
    low, high = (f * max(image_size) for f in FOCAL_RANGE)
    return bool(np.isfinite(focal) and low < focal < high)


def _points(board: Board, view: BoardView) -> NDArray[np.float32]:
    return board.points[view.corner].astype(np.float32)


def _image_points(view: BoardView) -> NDArray[np.float32]:
    return view.centre.astype(np.float32).reshape(-1, 1, 2)


def board_pose(view: BoardView, board: Board, matrix: Array, distortion: Array) -> Array:
    """Find a board's pose before a camera, camera_T_board (4, 4), by one view."""
    _, turn, shift = cv2.solvePnP(
        board.points[view.corner], view.centre.reshape(-1, 1, 2), matrix, distortion
    )
    return rigid_transform(cv2.Rodrigues(turn)[0], shift.ravel())


@dataclass(frozen=True, slots=True)
class CameraRelation:
    """How the right camera stands to the left one, both bases turned back to zero."""

    left_T_right: Array  # (4, 4)
    axes: Array  # (2, 3), left and right: ±y, the sense in which the readings grow
    half_turned: tuple[int, ...]  # pairs that agree once one view is numbered from the far end
    outliers: tuple[int, ...]  # pairs that agree neither way
    quarter_turned: tuple[int, ...]  # of these, those that agree once one view is turned by 90°


def relate_cameras(
    left: dict[int, Array], right: dict[int, Array], board: Board, pan: Array, bases: Sequence[str]
) -> CameraRelation:
    """Find the relation of the cameras on which most pairs agree.

    `left` and `right` hold left_T_board and right_T_board (4, 4) by pair, `pan` (b, 2), rad, the
    readings; a base that never turned counts as standing at zero.
    """
    both = sorted(set(left) & set(right))
    lefts = np.array([left[i] for i in both])
    rights = np.asarray(np.linalg.inv([right[i] for i in both]), dtype=np.float64)
    senses = [(1.0,) if base == BASE_FIXED else (1.0, -1.0) for base in bases]
    fixed = all(base == BASE_FIXED for base in bases)
    tolerance = MAX_RELATION_ANGLE if fixed else MAX_RELATION_ANGLE_TURNED
    # numbers the corners from the far end: index i becomes n - 1 - i
    half_turn = rigid_transform(np.diag([-1.0, -1.0, 1.0]), board.points[-1])
    found = []
    for sense in itertools.product(*senses):
        axes = np.array([0.0, 1.0, 0.0]) * np.array(sense)[:, None]
        back = [
            rigid_transform(rotation_exp(angle[:, None] * axis * (base != BASE_FIXED)), np.zeros(3))
            for axis, base, angle in zip(axes, bases, pan[both].T, strict=True)
        ]
        straight, halved, *quarters = (
            back[0] @ lefts @ renumbered @ rights @ back[1].transpose(0, 2, 1)
            for renumbered in (np.eye(4), half_turn, *_quarter_turns(board))
        )
        relation, price = _consensus(straight, halved, both, axes, tolerance)
        if board.four_fold:  # outliers that agree once one view is numbered a quarter turn on
            gaps = np.min([_angles(relation.left_T_right[None], q)[0] for q in quarters], axis=0)
            agree = {i for i, gap in zip(both, gaps, strict=True) if gap < tolerance}
            turned = tuple(i for i in relation.outliers if i in agree)
            relation = replace(relation, quarter_turned=turned)
        found.append((relation, price))
    return min(found, key=lambda f: f[1])[0]


def _quarter_turns(board: Board) -> tuple[Array, Array]:
    """Number the corners of a square board from the next corner, either way round."""
    edge = board.points[-1, 0]
    one = np.eye(4)
    one[:3] = [[0.0, -1.0, 0.0, edge], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
    return one, np.asarray(np.linalg.inv(one), dtype=np.float64)


def _consensus(
    straight: Array, halved: Array, both: list[int], axes: Array, tolerance: float
) -> tuple[CameraRelation, float]:
    """Choose the relation with the least sum of angles, each pair either way; and that sum."""
    candidates = np.concatenate([straight, halved])
    plain = _angles(candidates, straight)
    other = _angles(candidates, halved)
    nearest = np.minimum(np.minimum(plain, other), 2 * tolerance)  # bounds an outlier's weight
    flipped = other + tolerance < plain
    # of relations that differ within the tolerance, the one that needs fewest half turns
    price = nearest.sum(axis=1) + 0.5 * tolerance * flipped.sum(axis=1)
    k = int(np.argmin(price))
    turned, gap = flipped[k], np.minimum(plain[k], other[k])
    agree = gap < tolerance
    if not agree.any():
        agree = gap <= gap.min()
    chosen = np.where(turned[:, None, None], halved, straight)[agree]
    turn = Rotation.from_matrix(chosen[:, :3, :3]).mean().as_matrix()
    left_T_right = rigid_transform(turn, np.median(chosen[:, :3, 3], axis=0))
    half = tuple(i for i, t, a in zip(both, turned, agree, strict=True) if t and a)
    outliers = tuple(i for i, a in zip(both, agree, strict=True) if not a)
    return CameraRelation(left_T_right, axes, half, outliers, ()), float(price[k])


def _angles(one: Array, other: Array) -> Array:
    """Angle between every rotation of one (a) and of the other (b), (a, b), rad."""
    trace = np.einsum("aij,bij->ab", one[:, :3, :3], other[:, :3, :3])
    return np.asarray(np.arccos(np.clip((trace - 1) / 2, -1, 1)))


def start_state(
    lenses: Sequence[InitialLens],
    relation: CameraRelation,
    pan: Array,
    pairs: Sequence[int],
    bases: Sequence[str],
) -> BundleState:
    """Compose the start values: ideal bases, boards by the left camera where it observed them."""
    cameras = []
    for side, (lens, axis) in enumerate(zip(lenses, relation.axes, strict=True)):
        place = relation.left_T_right if side else np.eye(4)
        angle = pan[0, side] if bases[side] == BASE_FIXED else 0.0  # a fixed base is at its reading
        turn = Rotation.from_rotvec(-axis * angle).as_matrix() @ place[:3, :3]
        mount = rigid_transform(turn, np.zeros(3))
        cameras.append(Camera(lens.matrix, lens.distortion, place[:3, 3].copy(), axis, 0.0, mount))
    boards = []
    for i in pairs:
        side = 0 if i in lenses[0].poses else 1
        boards.append(cameras[side].rig_T_camera(pan[i, side]) @ lenses[side].poses[i])
    return BundleState(cameras[0], cameras[1], np.array(boards), np.zeros((len(boards), N_ERRORS)))


def other_senses(
    state: BundleState, readings: Array, bases: Sequence[str]
) -> Iterator[BundleState]:
    """The same start with the axes of bases the other way round that turned too little to tell.

    `readings` (b, 2), rad. Every camera stands where it stood at its mean reading.
    """
    little = np.ptp(readings, axis=0) < MAX_UNCLEAR_TURN
    unclear = [small and base != BASE_FIXED for small, base in zip(little, bases, strict=True)]
    ways = itertools.product(*[(False, True) if u else (False,) for u in unclear])
    for left, right in itertools.islice(ways, 1, None):
        cameras = [
            _turned_round(camera, float(own.mean())) if swap else camera
            for camera, own, swap in zip(state.cameras, readings.T, (left, right), strict=True)
        ]
        yield replace(state, left=cameras[0], right=cameras[1])


def _turned_round(camera: Camera, reading: float) -> Camera:
    """A camera whose readings grow the other way, standing alike at one of them, rad."""
    turn = rigid_transform(rotation_exp(2 * reading * camera.pan_axis), np.zeros(3))
    return replace(camera, pan_axis=-camera.pan_axis, mount=turn @ camera.mount)
