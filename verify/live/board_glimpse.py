"""A board found quickly: good to half a pixel, several times a second."""

import cv2
import numpy as np
from numpy.typing import NDArray

from verify.board import Board, BoardView
from verify.calibration.corner_grid import oriented
from verify.calibration.corner_search import as_image, unscaled
from verify.calibration.find import charuco, flat, grey_of
from verify.records import Array, Image

ENOUGH = 640  # px of the longer side: larger pictures are looked at in a smaller scale
GOOD_TO = 0.5  # px, standard uncertainty of a corner in each direction, in pictures of 1280 px
FEWEST = 6  # corners


def glimpse(image: Image, board: Board) -> BoardView | None:
    """Find a board, quickly; `find_board` measures it.

    Args:
        image: (h, w) grey or (h, w, 3) BGR.
        board: the pattern.

    Returns:
        Its corners, rough; None where it is not found at once, which is no proof that it is not
        there.
    """
    grey = grey_of(image)
    scale = min(ENOUGH / max(grey.shape), 1.0)
    small = as_image(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
    corner, found = _marked(small, board) if board.markers is not None else _plain(small, board)
    if len(corner) < FEWEST or flat(board.points[corner, :2]):
        return None
    covariance = np.tile(GOOD_TO**2 * np.eye(2), (len(corner), 1, 1))
    return BoardView(corner, unscaled(found, scale), covariance)


def _plain(small: Image, board: Board) -> tuple[NDArray[np.int64], Array]:
    counts = (board.columns, board.rows)
    found, corners = cv2.findChessboardCornersSB(small, counts)
    if found:
        grid = np.asarray(corners, dtype=float).reshape(board.rows, board.columns, 2)
        placed = oriented(small, grid, board.columns, board.rows)
        if placed is not None:
            return np.arange(len(board)), placed
    return np.empty(0, dtype=np.int64), np.empty((0, 2))


def _marked(small: Image, board: Board) -> tuple[NDArray[np.int64], Array]:
    corners, identity, _, _ = cv2.aruco.CharucoDetector(charuco(board)).detectBoard(small)
    if identity is None:
        return np.empty(0, dtype=np.int64), np.empty((0, 2))
    order = np.argsort(identity.ravel())
    places = np.asarray(corners, dtype=float).reshape(-1, 2)[order]
    return identity.ravel()[order].astype(np.int64), places
