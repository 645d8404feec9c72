"""A board in an image: its corners, each with its covariance."""

import cv2
import numpy as np
from numpy.typing import NDArray

from verify.board import Board, BoardView
from verify.calibration.corner_grid import axes, oriented
from verify.calibration.corner_map import fit_map
from verify.calibration.corner_search import as_image, find_grid, grow, pictures, unscaled
from verify.calibration.saddle import Corner, Place, fit_corner
from verify.records import Array, Image

FEWEST = 4  # corners that fix a homography
PASSES = 2  # the second with the plane and lens that the first found
ENOUGH = 0.75  # of a plain board's corners: the others may be covered or in glare


def find_board(image: Image, board: Board) -> BoardView | None:
    """Find a board and measure its corners.

    The first corner is the one whose outer square is black, as on the boards that `verify board`
    and OpenCV draw. Where the pattern looks alike in several orders (see `ambiguous`), it is the
    one that is nearest the image's top left when the board is held upright; it changes when the
    board is turned past 90° in its plane. The order is never mirrored.

    Args:
        image: (h, w) grey or (h, w, 3) BGR, uint8.
        board: the pattern.

    Returns:
        The corners by rising index; None where the board is not found. A plain chessboard must be
        in view with all its inner corners, a ChArUco board in part. Corners in whose place no
        crossing of edges can be fitted (covered, in glare) are left out.
    """
    grey = grey_of(image)
    if board.markers is None:
        grid = find_grid(grey, board.columns, board.rows)
        found = None if grid is None else oriented(grey, grid, board.columns, board.rows)
        if found is None:
            return None
        view = measured(grey, board, np.arange(len(board)), found)
        return view if view is not None and len(view) >= ENOUGH * len(board) else None
    corner, start = find_charuco(grey, board)
    if len(corner) < FEWEST or flat(board.points[corner, :2]):
        return None
    return measured(grey, board, corner, start)


def ambiguous(board: Board) -> bool:
    """Whether half a turn leaves the pattern as it is, so that colours cannot settle the order.

    So it is with plain boards that have an even sum of inner corners along x and y: 9 by 7, 8 by
    6, every square one (which, with even counts, a quarter turn leaves as it is too). Of 9 by 6 and
    of ChArUco boards every corner is known in every view.
    """
    return board.markers is None and (board.columns + board.rows) % 2 == 0


def seen_instead(image: Image, board: Board) -> tuple[int, int] | None:
    """Which chessboard an image shows when the stated one was not found in it.

    Args:
        image: (h, w) grey or (h, w, 3) BGR, uint8.
        board: the pattern that was expected.

    Returns:
        Inner corners of the plain board that is there, the direction that runs more across the
        image first; None where no chessboard is seen whole.
    """
    grey = grey_of(image)
    grid = grow(grey)
    if grid is None:
        trials = ((board.columns + more, board.rows + more) for more in (-1, 1))
        grid = next((g for g in (find_grid(grey, *t) for t in trials) if g is not None), None)
    if grid is None:
        return None
    along_x, along_y = np.abs(axes(grid)[:, 0])
    rows, columns = grid.shape[:2]
    return (columns, rows) if along_x >= along_y else (rows, columns)


def grey_of(image: Image) -> Image:
    """The image without colour."""
    return image if image.ndim == 2 else as_image(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))


def measured(
    grey: Image, board: Board, corner: NDArray[np.int64], start: Array
) -> BoardView | None:
    """Refine corners (n,) from where they were found (n, 2)."""
    squares = board.points[corner, :2] / board.square
    pixels, margins = grey.astype(float), marker_margins(board, corner)
    fits: list[Corner | None] = [None] * len(corner)
    centre, good = start, np.ones(len(corner), dtype=bool)
    for _ in range(PASSES):
        board_map = fit_map(squares[good], centre[good], grey.shape)
        if board_map is None:
            return None
        centre = np.where(good[:, None], centre, board_map(squares))
        plane = zip(centre, board_map.jacobian(squares), board_map.bend(squares), strict=True)
        places = [Place(*at, margin) for at, margin in zip(plane, margins, strict=True)]
        fits = [
            fit_corner(pixels, place, None if fit is None else fit.parameters)
            for place, fit in zip(places, fits, strict=True)
        ]
        good = np.array([fit is not None for fit in fits])
        if good.sum() < FEWEST or flat(squares[good]):
            return None
        centre = np.array([c if f is None else f.centre for c, f in zip(centre, fits, strict=True)])
    found = [fit for fit in fits if fit is not None]
    return BoardView(corner[good], centre[good], covariances(found))


def covariances(corners: list[Corner]) -> Array:
    """Covariance of each corner (n, 2, 2), px².

    The noise and its ties between pixels are those of all corners together; one that fits worse
    than most is trusted less.
    """
    found, expected = np.sum([c.scatter for c in corners], axis=0)
    variance = np.array([c.variance for c in corners])
    usual = np.median(variance)
    each = np.array([c.covariance / c.variance for c in corners])
    scaled: Array = each * (found / expected * np.maximum(variance, usual))[:, None, None]
    return scaled


def marker_margins(board: Board, corner: NDArray[np.int64]) -> list[tuple[float, int] | None]:
    """For each corner of a ChArUco board how far markers keep from edges, and where white is."""
    if board.marker is None:
        return [None] * len(corner)
    margin = (1 - board.marker / board.square) / 2
    # The first square is black, hence also the one before the first corner.
    parity = (corner % board.columns + corner // board.columns) % 2
    return [(margin, 1 if odd else -1) for odd in parity]


def find_charuco(grey: Image, board: Board) -> tuple[NDArray[np.int64], Array]:
    """Corners of a ChArUco board in view: index (n,), and place (n, 2), px, to a pixel or so."""
    detector = cv2.aruco.CharucoDetector(charuco(board))
    for picture, scale in ((grey, 1.0), *pictures(grey)):
        corners, identity, _, _ = detector.detectBoard(picture)
        if identity is not None and len(identity) >= FEWEST:
            order = np.argsort(identity.ravel())
            places = unscaled(np.asarray(corners, dtype=float).reshape(-1, 2)[order], scale)
            return identity.ravel()[order].astype(np.int64), places
    return np.empty(0, dtype=np.int64), np.empty((0, 2))


def charuco(board: Board) -> cv2.aruco.CharucoBoard:
    """The board as OpenCV draws it: first square black, markers in the white ones."""
    name, marker = str(board.markers), float(board.marker or 0.0)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    return cv2.aruco.CharucoBoard(
        (board.columns + 1, board.rows + 1), board.square, marker, dictionary
    )


def flat(points: Array) -> bool:
    """Whether points (n, 2) leave a homography open: fewer than two rows or columns of them."""
    return min(len(np.unique(points[:, k].round(9))) for k in (0, 1)) < 2
