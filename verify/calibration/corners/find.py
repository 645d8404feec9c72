"""Find a board in an image and measure its corners with covariance.

A corner is the crossing of two blurred edges; its parameters (13, see `kernels.model`) are fitted
by least squares to the pixels I(x) of a window about it:

    minimise   sum of (I(x) - model(p; x))²       p: place, turns and bends of both edges,
                                                  blur, brightness of the four quadrants
    covariance of the place = s² (J'J)⁻¹ * found / expected scatter of its scores

All pixels weigh the same. The noise s and the correlation of neighbouring pixels (the ratio of
scatters) are estimated from the residuals of all corners of a view.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from verify.calibration.corners.grid import axes, fit_map, orient_grid
from verify.calibration.corners.kernels.fit import (
    COL_EXPECTED,
    COL_FOUND,
    COL_VARIANCE,
    COL_XX,
    COL_XY,
    COL_YY,
    N_COLUMNS,
    fit_crossing,
)
from verify.calibration.corners.kernels.model import N_PARAMETERS, PAR_X, PAR_Y, STEP_TABLE
from verify.calibration.corners.search import (
    find_by_growing,
    find_grid,
    picture_variants,
    to_8_bits,
    undo_scale,
)
from verify.core.fiducials import Board, BoardView, charuco_board
from verify.core.records import Array, Image

MIN_CORNERS = 4  # corners that fix a homography
N_PASSES = 2  # the second with the plane and lens that the first found
MAX_MAP_ERROR = 0.1  # px by which plane and lens of a pass may miss any corner where it is the last
MIN_CORNER_SHARE = 0.75  # of a plain board's corners: the others may be covered or in glare


@dataclass(frozen=True, slots=True)
class CornerPrediction:
    """Expected place of a corner, and the board's plane about it."""

    centre: Array  # (2,), px
    jacobian: Array  # (2, 2), d px / d squares, columns along the board's x and y
    bend: Array  # (2, 2), d² px / d squares², columns along the board's x and y
    markers: tuple[float, int] | None = None  # squares between a marker and its square's edge;
    # sign of u · v (from the corner, board's axes) where the white squares are


@dataclass(frozen=True, slots=True)
class Corner:
    """A fitted corner."""

    parameters: Array  # (13,)
    centre: Array  # (2,), px
    covariance: Array  # (2, 2), px², if its residuals were independent from pixel to pixel
    variance: float  # DN², of the residuals
    scatter: tuple[float, float]  # of the centre's scores from cell to cell: found, expected


def fit_corner(
    grey: Array, place: CornerPrediction, parameters: Array | None = None
) -> Corner | None:
    """Measure one corner in an image (h, w), DN; other threads run meanwhile.

    The place is good to a tenth of a square; `parameters` are of an earlier fit, whose centre it
    is. Returns None where there is no crossing: too few pixels, no convergence, or a place outside
    the window.
    """
    found = np.zeros(N_PARAMETERS) if parameters is None else parameters.copy()
    result = np.empty(N_COLUMNS)
    at = (place.centre, place.jacobian, place.bend)
    margin, white = place.markers or (0.0, 0)
    if not fit_crossing(
        grey, at, (float(margin), float(white)), parameters is not None, STEP_TABLE, found, result
    ):
        return None
    variance = float(result[COL_VARIANCE])
    return Corner(
        parameters=found,
        centre=place.centre + found[[PAR_X, PAR_Y]],
        covariance=variance * result[[[COL_XX, COL_XY], [COL_XY, COL_YY]]],
        variance=variance,
        scatter=(float(result[COL_FOUND]), float(result[COL_EXPECTED])),
    )


def find_board(image: Image, board: Board) -> BoardView | None:
    """Find a board in an image, (h, w) grey or (h, w, 3) BGR, and measure its corners.

    The first corner is the one whose outer square is black, as on the boards that `verify board`
    and OpenCV draw. Where the pattern looks alike in several orders (see `is_ambiguous`), it is the
    one that is nearest the image's top left when the board is held upright; it changes when the
    board is turned past 90° in its plane. The order is never mirrored.

    Corners stand by rising index; None where the board is not found. A plain chessboard must be in
    view with all its inner corners, a ChArUco board in part. Corners in whose place no crossing of
    edges can be fitted (covered, in glare) are left out.
    """
    grey = to_grey(image)
    if board.markers is None:
        grid = find_grid(grey, board.columns, board.rows)
        found = None if grid is None else orient_grid(grey, grid, board.columns, board.rows)
        if found is None:
            return None
        view = refine_corners(grey, board, np.arange(len(board)), found)
        return view if view is not None and len(view) >= MIN_CORNER_SHARE * len(board) else None
    corner, start = find_charuco(grey, board)
    if len(corner) < MIN_CORNERS or is_degenerate(board.points[corner, :2]):
        return None
    return refine_corners(grey, board, corner, start)


def is_ambiguous(board: Board) -> bool:
    """Whether half a turn leaves the pattern as it is, so that colours do not determine the order.

    True of plain boards with an even sum of inner corners along x and y: 9 by 7, every square one.
    """
    return board.markers is None and (board.columns + board.rows) % 2 == 0


def find_other_board(image: Image, board: Board) -> tuple[int, int] | None:
    """Find which chessboard an image shows when the stated one was not found in it.

    The image is (h, w) grey or (h, w, 3) BGR. Returns inner corners of the plain board, the
    direction that runs more across the image first; None where no whole chessboard is in view.
    """
    grey = to_grey(image)
    grid = find_by_growing(grey)
    if grid is None:
        trials = ((board.columns + more, board.rows + more) for more in (-1, 1))
        grid = next((g for g in (find_grid(grey, *t) for t in trials) if g is not None), None)
    if grid is None:
        return None
    along_x, along_y = np.abs(axes(grid)[:, 0])
    rows, columns = grid.shape[:2]
    return (columns, rows) if along_x >= along_y else (rows, columns)


def to_grey(image: Image) -> Image:
    """The image without colour."""
    return image if image.ndim == 2 else to_8_bits(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))


def refine_corners(
    grey: Image, board: Board, corner: NDArray[np.int64], start: Array
) -> BoardView | None:
    """Refine corners (n,) from where they were found (n, 2)."""
    squares = board.points[corner, :2] / board.square
    pixels, margins = grey.astype(float), marker_margins(board, corner)
    fits: list[Corner | None] = [None] * len(corner)
    centre, good = start, np.ones(len(corner), dtype=bool)
    for _ in range(N_PASSES):
        board_map = fit_map(squares[good], centre[good], grey.shape)
        if board_map is None:
            return None
        centre = np.where(good[:, None], centre, board_map(squares))
        plane = zip(centre, board_map.jacobian(squares), board_map.bend(squares), strict=True)
        places = [CornerPrediction(*at, margin) for at, margin in zip(plane, margins, strict=True)]
        fits = [
            fit_corner(pixels, place, None if fit is None else fit.parameters)
            for place, fit in zip(places, fits, strict=True)
        ]
        good = np.array([fit is not None for fit in fits])
        if good.sum() < MIN_CORNERS or is_degenerate(squares[good]):
            return None
        centre = np.array([c if f is None else f.centre for c, f in zip(centre, fits, strict=True)])
        if good.all() and np.abs(centre - board_map(squares)).max() < MAX_MAP_ERROR:
            break
    found = [fit for fit in fits if fit is not None]
    return BoardView(corner[good], centre[good], corner_covariances(found))


def corner_covariances(corners: list[Corner]) -> Array:
    """Covariance of each corner (n, 2, 2), px².

    Noise and its correlation are those of all corners together, enlarged for one that fits worse.
    """
    found, expected = np.sum([c.scatter for c in corners], axis=0)
    variance = np.array([c.variance for c in corners])
    usual = np.median(variance)
    each = np.array([c.covariance / c.variance for c in corners])
    scaled: Array = each * (found / expected * np.maximum(variance, usual))[:, None, None]
    return scaled


def marker_margins(board: Board, corner: NDArray[np.int64]) -> list[tuple[float, int] | None]:
    """Distance of markers from edges, and where white is, for each corner; None: a plain board."""
    if board.marker is None:
        return [None] * len(corner)
    margin = (1 - board.marker / board.square) / 2
    # The first square is black, hence also the one before the first corner.
    parity = (corner % board.columns + corner // board.columns) % 2
    return [(margin, 1 if odd else -1) for odd in parity]


def find_charuco(grey: Image, board: Board) -> tuple[NDArray[np.int64], Array]:
    """Corners of a ChArUco board in view: index (n,), and place (n, 2), px, to a pixel or so."""
    detector = cv2.aruco.CharucoDetector(charuco_board(board))
    for picture, scale in ((grey, 1.0), *picture_variants(grey)):
        corners, identity, _, _ = detector.detectBoard(picture)
        if identity is not None and len(identity) >= MIN_CORNERS:
            order = np.argsort(identity.ravel())
            places = undo_scale(np.asarray(corners, dtype=float).reshape(-1, 2)[order], scale)
            return identity.ravel()[order].astype(np.int64), places
    return np.empty(0, dtype=np.int64), np.empty((0, 2))


def is_degenerate(points: Array) -> bool:
    """Whether points (n, 2) leave a homography open: fewer than two rows or columns of them."""
    return min(len(np.unique(points[:, k].round(9))) for k in (0, 1)) < 2
