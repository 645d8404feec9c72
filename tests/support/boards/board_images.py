"""Pictures of calibration boards with known corners: its own optics, its own sensor.

Every pixel is carried through the inverse lens (OpenCV's, iterated to the end) and a homography to
the board and divided into sub-pixels, each with an edge's exact share; then comes a Gaussian blur,
noise, 8 bits. Corners come from cv2.projectPoints. Nothing is shared with the finder.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

from verify.core.fiducials import Board
from verify.core.records import Array, Image
from verify.core.rig import Camera

FINE = 4  # sub-pixels a side
MARGIN = 1.0  # squares of white paper around the outermost squares


@dataclass(frozen=True)
class Look:
    """What the camera makes of a board."""

    white: float = 190.0  # DN
    black: float = 8.0
    background: float = 40.0
    blur: float = 0.7  # sigma, px
    shading: tuple[float, float] = (0.0, 0.0)  # relative change of light over the image's width
    gamma: float = 1.0
    read: float = 1.5  # DN
    gain: float = 1 / 35  # DN² a DN
    inverted: bool = False  # the first square is white


def camera(distortion: tuple[float, ...] = (-0.085, 0.06, 0.0006, -0.0004, 0.0)) -> Camera:
    """A camera of 1280 x 720 and some 65° of view."""
    matrix = np.array([[1010.0, 0, 642.0], [0, 1012.0, 356.0], [0, 0, 1]])
    zero = np.zeros(3)
    return Camera(matrix, np.array(distortion), zero, np.array([0.0, 1, 0]), 0.0, np.eye(4))


# a board that is not there is searched for long in larger pictures
HALF_SIZE = (640, 360)  # px
HALF_CAMERA = replace(camera(), matrix=np.diag([0.5, 0.5, 1.0]) @ camera().matrix)


def placed(
    rotation: tuple[float, float, float], centre: tuple[float, float, float], board: Board
) -> Array:
    """camera_T_board from a rotation vector (rad) and where the middle of the corners is (m)."""
    camera_T_board = np.eye(4)
    camera_T_board[:3, :3] = cv2.Rodrigues(np.array(rotation, dtype=float))[0]
    middle = board.points.mean(axis=0)
    camera_T_board[:3, 3] = np.array(centre) - camera_T_board[:3, :3] @ middle
    return camera_T_board


def random_pose(board: Board, rng: np.random.Generator) -> Array:
    """A board somewhere in the image, tilted by up to some 35° and turned by up to 20°."""
    rotation = rng.uniform([-0.6, -0.6, -0.35], [0.6, 0.6, 0.35])
    depth = rng.uniform(0.85, 1.25)
    shift = rng.uniform(-1, 1, 2) * [0.22 * depth, 0.08 * depth]
    return placed(tuple(rotation), (shift[0], shift[1], depth), board)


def corners(board: Board, view: Camera, camera_T_board: Array) -> Array:
    """True images of the inner corners, (n, 2), px."""
    turn, _ = cv2.Rodrigues(camera_T_board[:3, :3])
    pixels, _ = cv2.projectPoints(
        board.points, turn, camera_T_board[:3, 3], view.matrix, view.distortion
    )
    return pixels.reshape(-1, 2)


def picture(
    board: Board,
    view: Camera,
    camera_T_board: Array,
    rng: np.random.Generator | None,
    look: Look | None = None,
    size: tuple[int, int] = (1280, 720),
) -> Image:
    """One exposure; without rng there is no noise but that of 8 bits."""
    look = look or Look()
    squares = on_board(view, camera_T_board, size) / board.square
    paper = on_paper(board, squares)
    rows, columns = np.flatnonzero(paper.any(axis=1)), np.flatnonzero(paper.any(axis=0))
    reach = int(5 * look.blur) + 3  # px around the paper, so that its rim is blurred as well
    part = (
        slice(max(rows[0] - reach, 0), rows[-1] + reach + 1),
        slice(max(columns[0] - reach, 0), columns[-1] + reach + 1),
    )
    light = np.full((size[1], size[0]), look.background)
    light[part] = exposed(board, squares[part], look)
    across = (np.arange(size[0]) / size[0] - 0.5) * look.shading[0]
    down = (np.arange(size[1]) / size[0] - 0.5) * look.shading[1]
    light = light * (1 + across + down[:, None])
    signal = 255 * np.clip(light / 255, 0, None) ** (1 / look.gamma)
    if rng is not None:
        signal = signal + rng.normal(size=light.shape) * np.sqrt(look.read**2 + look.gain * signal)
    return np.clip(np.rint(signal), 0, 255).astype(np.uint8)


def on_board(view: Camera, camera_T_board: Array, size: tuple[int, int]) -> Array:
    """Where each pixel's centre looks on the board's plane, (h, w, 2), m."""
    rays = pixel_rays(view.matrix.tobytes(), view.distortion.tobytes(), size)
    xyw = rays @ np.linalg.inv(camera_T_board[:3, [0, 1, 3]]).T
    return (xyw[:, :2] / xyw[:, 2:]).reshape(size[1], size[0], 2)


@lru_cache(maxsize=4)
def pixel_rays(matrix: bytes, distortion: bytes, size: tuple[int, int]) -> Array:
    """Rays of all pixels' centres, (h w, 3), 1 along the axis."""
    pixels = np.stack(np.meshgrid(np.arange(size[0]), np.arange(size[1])), axis=-1).astype(float)
    end = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-12)
    lens = np.frombuffer(matrix).reshape(3, 3), np.frombuffer(distortion)
    rays = cv2.undistortPoints(pixels.reshape(-1, 1, 2), *lens, criteria=end).reshape(-1, 2)
    return np.column_stack([rays, np.ones(len(rays))])


def on_paper(board: Board, squares: Array) -> Array:
    """Whether points of the board's plane (…, 2), in squares, lie on its paper."""
    return within(board, squares, MARGIN)


def within(board: Board, squares: Array, margin: float) -> Array:
    """Whether points (…, 2), in squares, lie in the pattern or so many squares about it."""
    x, y = squares[..., 0], squares[..., 1]
    inside = (x > -1 - margin) & (x < board.columns + margin)
    inside &= (y > -1 - margin) & (y < board.rows + margin)
    return inside


def exposed(board: Board, squares: Array, look: Look) -> Array:
    """Light on each pixel: sub-pixels first, then the lens's blur, then the pixel's own area."""
    by_row, by_column = np.gradient(squares, axis=(0, 1))
    ramp = (np.abs(by_row) + np.abs(by_column)) / FINE
    fine = np.empty((FINE * squares.shape[0], FINE * squares.shape[1]), dtype=np.float32)
    for i, down in enumerate((np.arange(FINE) + 0.5) / FINE - 0.5):
        for j, right in enumerate((np.arange(FINE) + 0.5) / FINE - 0.5):
            fine[i::FINE, j::FINE] = sub_pixels(
                board, squares + down * by_row + right * by_column, ramp, look
            )
    if look.blur:
        fine = cv2.GaussianBlur(fine, (0, 0), look.blur * FINE, borderType=cv2.BORDER_REPLICATE)
    light = fine.reshape(squares.shape[0], FINE, squares.shape[1], FINE).mean(axis=(1, 3))
    return light.astype(float)


def sub_pixels(board: Board, at: Array, ramp: Array, look: Look) -> Array:
    """Brightness at points (…, 2), in squares; an edge's share is linear over `ramp` squares."""
    count = np.array([board.columns, board.rows])
    nearest = np.clip(np.rint(at), -1, count)
    side = np.clip(2 * (at - nearest) / ramp, -1, 1) * np.where(nearest % 2 == 0, 1, -1)
    share = -side[..., 0] * side[..., 1] * (-1 if look.inverted else 1)  # 1 white, -1 black
    share[~within(board, at, 0.0)] = 1.0
    if board.markers is not None:
        share[marker_ink(board, at)] = -1.0
    brightness = look.black + (look.white - look.black) * (share + 1) / 2
    return np.where(on_paper(board, at), brightness, look.background)


def marker_ink(board: Board, at: Array) -> Array:
    """Whether points of the board (…, 2), in squares, lie on a marker's black."""
    known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, str(board.markers)))
    edge = float(board.marker or 0) / board.square
    counts = (board.columns + 1, board.rows + 1)
    layout = cv2.aruco.CharucoBoard(counts, board.square, float(board.marker or 0), known)
    side = known.markerSize + 2
    black = np.zeros((counts[1], counts[0], side, side), dtype=bool)
    for number, frame in zip(layout.getIds().ravel(), layout.getObjPoints(), strict=True):
        column, row = np.floor(np.asarray(frame)[:, :2].mean(axis=0) / board.square).astype(int)
        black[row, column] = known.generateImageMarker(int(number), side) < 128
    square = np.floor(at).astype(int)
    cell = np.floor((at - square - (1 - edge) / 2) / edge * side).astype(int)
    inside = ((cell >= 0) & (cell < side)).all(axis=-1)
    inside &= ((square >= -1) & (square < np.array(counts) - 1)).all(axis=-1)
    ink = np.zeros(at.shape[:-1], dtype=bool)
    x, y, column, row = square[inside, 0] + 1, square[inside, 1] + 1, *cell[inside].T
    ink[inside] = black[y, x, row, column]
    return ink
