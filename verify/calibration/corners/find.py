"""Find a board in an image and measure its corners with covariance.

A corner is the crossing of two blurred edges; its parameters (13, see kernels/model.h) are fitted
by least squares to the pixels I(x) of a window about it:

    minimise   sum of (I(x) - model(p; x))²       p: place, turns and bends of both edges,
                                                  blur, brightness of the four quadrants
    covariance of the place = s² (J'J)⁻¹ * found / expected scatter of its scores

All pixels weigh the same. The noise s and the correlation of neighbouring pixels (the ratio of
scatters) are estimated from the residuals of all corners of a view.
"""

from collections.abc import Iterable

import cv2
import numpy as np
from scipy.special import ndtr

from verify.calibration.corners.grid import axes, fit_map, orient_grid
from verify.calibration.corners.search import (
    find_by_growing,
    find_grid,
    picture_variants,
    to_8_bits,
    undo_scale,
)
from verify.core.fiducials import Board, BoardView, charuco_board
from verify.core.native import entry
from verify.core.records import Array, Flags, Image, Index

MIN_CORNERS = 4  # corners that fix a homography
N_PASSES = 2  # the second with the plane and lens that the first found
MAX_MAP_ERROR = 0.1  # px by which plane and lens of a pass may miss any corner where it is the last
MIN_CORNER_SHARE = 0.75  # of a plain board's corners: the others may be covered or in glare

PAR_X, PAR_Y = range(2)
N_PARAMETERS = 13
# columns of a result: covariance of its centre where the residuals' variance is one, that
# variance (DN²), and the scatter of the centre's scores from cell to cell, found and expected
COL_XX, COL_XY, COL_YY, COL_VARIANCE, COL_FOUND, COL_EXPECTED = range(6)
N_COLUMNS = 6
# of the table of the normal distribution F; between its steps a series is off by 1e-15, F' by 1e-12
TABLE_STEP, TABLE_END = 1 / 64, 8.5
_N_STEPS = round(TABLE_END / TABLE_STEP)
_NODES = np.arange(-_N_STEPS, _N_STEPS + 1) * TABLE_STEP
STEP_TABLE = np.stack([ndtr(_NODES), np.exp(-_NODES * _NODES / 2) / np.sqrt(2 * np.pi)])

_fit_crossings = entry("fit_crossings")


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
    corner, start = find_charuco(((grey, 1.0), *picture_variants(grey)), board)
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


def refine_corners(grey: Image, board: Board, corner: Index, start: Array) -> BoardView | None:
    """Refine corners (n,) from where they were found (n, 2)."""
    squares = board.points[corner, :2] / board.square
    pixels, markers = np.array(grey, order="C"), marker_margins(board, corner)
    fitted, results = np.zeros(len(corner), dtype=bool), np.empty((len(corner), N_COLUMNS))
    parameters = np.empty((len(corner), N_PARAMETERS))
    centre, good = start, np.ones(len(corner), dtype=bool)
    for _ in range(N_PASSES):
        board_map = fit_map(squares[good], centre[good], grey.shape)
        if board_map is None:
            return None
        mapped = board_map(squares)
        centre = np.where(good[:, None], centre, mapped)
        at = (centre, board_map.jacobian(squares), board_map.bend(squares))
        _fit(pixels, at, markers, fitted, parameters, results)
        good = fitted.copy()
        if good.sum() < MIN_CORNERS or is_degenerate(squares[good]):
            return None
        centre = np.where(good[:, None], centre + parameters[:, [PAR_X, PAR_Y]], centre)
        if good.all() and np.abs(centre - mapped).max() < MAX_MAP_ERROR:
            break
    return BoardView(corner[good], centre[good], corner_covariances(results[good]))


def corner_covariances(results: Array) -> Array:
    """Covariance of each corner (n, 2, 2), px², by the results (n, 6) of the fits.

    Noise and its correlation are those of all corners together, enlarged for one that fits worse.
    """
    found, expected = results[:, [COL_FOUND, COL_EXPECTED]].sum(axis=0)
    variance = results[:, COL_VARIANCE]
    each = results[:, [COL_XX, COL_XY, COL_XY, COL_YY]].reshape(-1, 2, 2)
    noise = found / expected * np.maximum(variance, np.median(variance))
    return np.asarray(each * noise[:, None, None])


def marker_margins(board: Board, corner: Index) -> Array:
    """Distance of markers from edges, squares, and where white is, for each corner (n, 2).

    White is where u · v (from the corner, board's axes) has the sign given; 0: a plain board.
    """
    if board.marker is None:
        return np.zeros((len(corner), 2))
    margin = (1 - board.marker / board.square) / 2
    # The first square is black, hence also the one before the first corner.
    parity = (corner % board.columns + corner // board.columns) % 2
    return np.stack([np.full(len(corner), margin), 2.0 * parity - 1], axis=1)


def find_charuco(variants: Iterable[tuple[Image, float]], board: Board) -> tuple[Index, Array]:
    """Corners of a ChArUco board in view: index (n,), and place (n, 2), px, to a pixel or so.

    Of the first variant of the picture, each with its scale, that shows enough of them.
    """
    detector = cv2.aruco.CharucoDetector(charuco_board(board))
    for picture, scale in variants:
        corners, identity, _, _ = detector.detectBoard(picture)
        if identity is not None and len(identity) >= MIN_CORNERS:
            order = np.argsort(identity.ravel())
            places = undo_scale(np.asarray(corners, dtype=float).reshape(-1, 2)[order], scale)
            return identity.ravel()[order].astype(np.int64), places
    return np.empty(0, dtype=np.int64), np.empty((0, 2))


def is_degenerate(points: Array) -> bool:
    """Whether points (n, 2) leave a homography open: fewer than two rows or columns of them."""
    return min(len(np.unique(points[:, k].round(9))) for k in (0, 1)) < 2


def _fit(
    grey: Image,
    at: tuple[Array, Array, Array],
    markers: Array,
    fitted: Flags,
    parameters: Array,
    results: Array,
) -> None:
    """Fit the corners of a view (h, w), DN, all of whose pixels weigh the same.

    `at`: expected centres (n, 2), px, good to a tenth of a square; d px / d squares (n, 2, 2),
    columns along the board's x and y; d² px / d squares² (n, 2, 2), likewise. `markers` (n, 2):
    squares between a marker and its square's edge; sign of u · v (from the corner, board's axes)
    where the white squares are, 0 where none has a marker. Parameters (n, 13), see model.h, and
    results (n, 6) are filled where there is a crossing, and `fitted` (n,) says where; where it is
    true beforehand the parameters are of an earlier fit, whose centre is the expected one.
    """
    places = (np.ascontiguousarray(values) for values in at)
    height, width = grey.shape
    corners = len(fitted), *places, markers, STEP_TABLE.shape[1], STEP_TABLE
    _fit_crossings(height, width, grey, *corners, fitted, parameters, results)
