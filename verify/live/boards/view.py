"""Find a board quickly, good to half a pixel, and detect whether it is held still."""

from collections import deque
from collections.abc import Sequence
from functools import reduce

import cv2
import numpy as np

from verify.calibration.corners.find import find_charuco, is_degenerate, to_grey
from verify.calibration.corners.grid import orient_grid
from verify.calibration.corners.search import to_8_bits, undo_scale
from verify.core.fiducials import Board, BoardView
from verify.core.records import Array, Image, Index

MAX_SIDE_PX = 640  # px of the longer side: larger pictures are looked at in a smaller scale
U_CORNER_PX = 0.5  # px, standard uncertainty of a corner in each direction, in pictures of 1280 px
MIN_CORNERS = 6  # corners


def find_board_coarsely(image: Image, board: Board) -> BoardView | None:
    """Find a board in an image, (h, w) grey or (h, w, 3) BGR, quickly; `find_board` measures it.

    Returns its corners, rough; None where it is not found at once, which is no proof that it is not
    there.
    """
    grey = to_grey(image)
    scale = min(MAX_SIDE_PX / max(grey.shape), 1.0)
    small = to_8_bits(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
    if board.markers is not None:
        corner, found = find_charuco([(small, scale)], board)
    else:
        corner, found = _checkerboard_corners(small, scale, board)
    if len(corner) < MIN_CORNERS or is_degenerate(board.points[corner, :2]):
        return None
    covariance = np.tile(U_CORNER_PX**2 * np.eye(2), (len(corner), 1, 1))
    return BoardView(corner, found, covariance)


def _checkerboard_corners(small: Image, scale: float, board: Board) -> tuple[Index, Array]:
    found, corners = cv2.findChessboardCornersSB(small, (board.columns, board.rows))
    if found:
        grid = np.asarray(corners, dtype=float).reshape(board.rows, board.columns, 2)
        placed = orient_grid(small, grid, board.columns, board.rows)
        if placed is not None:
            return np.arange(len(board)), undo_scale(placed, scale)
    return np.empty(0, dtype=np.int64), np.empty((0, 2))


MAX_MOTION_PX = 0.3  # rms over the corners, about their means; noise is half at most
STILL_TIME = 0.6  # s
MIN_PICTURES = 4  # at least, within it


class StillnessDetector:
    """Watches a board in both pictures.

    Two cameras that run freely take their pictures up to half a period apart. A steady drift that
    passes is 1 px/s at most: 0.02 px in the 17 ms of two cameras at 30 Hz.
    """

    def __init__(self) -> None:
        self._views: deque[tuple[float, BoardView, BoardView]] = deque()

    def add(self, t: float, left: BoardView | None, right: BoardView | None) -> None:
        """Take what was seen at t, s; a picture without a board begins anew."""
        if left is None or right is None:
            self._views.clear()
            return
        self._views.append((t, left, right))
        while len(self._views) > MIN_PICTURES and self._views[1][0] <= t - STILL_TIME:
            self._views.popleft()

    @property
    def motion(self) -> float | None:
        """How far the corners move, px: the most of both cameras; None where nothing tells yet."""
        if len(self._views) < 2:
            return None
        _, left, right = zip(*self._views, strict=True)
        return max(_corner_motion(left), _corner_motion(right))

    @property
    def still(self) -> bool:
        """Whether they have hardly moved for long enough."""
        if len(self._views) < MIN_PICTURES or self._views[-1][0] - self._views[0][0] < STILL_TIME:
            return False
        motion = self.motion
        return motion is not None and motion < MAX_MOTION_PX


def _corner_motion(views: Sequence[BoardView]) -> float:
    """The farthest that corners, rms over all, stray from their mean places, px."""
    common = reduce(np.intersect1d, [view.corner for view in views])
    if not len(common):
        return float("inf")
    places = np.stack([view.centre[np.isin(view.corner, common)] for view in views])
    astray = np.sum((places - places.mean(axis=0)) ** 2, axis=2)
    return float(np.sqrt(astray.mean(axis=1).max()))
