"""Pictures of a chessboard through a real lens: distortion, lamp, blur, sensor noise, 8 bits.

Each pixel's rays are carried back through the lens onto the board; OpenCV's projectPoints, which
says where the corners truly are, goes the other way.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from verify.core import fiducials
from verify.core.fiducials import Board
from verify.core.records import Array, Flags, Image
from verify.simulation.scenario import BoardImage
from verify.simulation.world.bench import SimulatedCamera

Picture = NDArray[np.float32]

GRAINS_PER_PX = 3  # a pixel and axis, with soft edges: light right to 1 DN, as the tests confirm
NODE_SPACING_PX = 2  # apart: linear in between, lens and tilt bend the map by less than 0.002 px
MAX_BLUR_SIGMAS = 5.0  # standard deviations of blur around the paper
FAR_AWAY = 1e3  # m: off any board
AMBIENT_SHARE = 0.3  # share of the light that comes from everywhere
UNDISTORT_CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-12)


@dataclass(frozen=True, slots=True)
class PrintedBoard:
    """A printed board and the light on it."""

    board: Board
    margin: float  # m, white around the pattern
    table: BoardImage

    def render(
        self, camera: SimulatedCamera, pan: float, rig_T_board: Array, rng: np.random.Generator
    ) -> Image:
        """Take one picture, (h, w), grey, of a board at rig_T_board (4, 4).

        `pan`, rad, is the base's true angle; `rng` gives the sensor's noise.
        """
        light = self.light(camera, pan, rig_T_board)
        noise = rng.standard_normal(light.shape, dtype=np.float32)
        noise *= np.sqrt(light / self.table.electrons_per_dn + self.table.read_noise_dn**2)
        noise += light + np.float32(self.table.black_level_dn)
        return np.clip(np.rint(noise), 0, 255).astype(np.uint8)

    def light(self, camera: SimulatedCamera, pan: float, rig_T_board: Array) -> Picture:
        """Give the light on each pixel, (h, w), DN, without noise or limits."""
        width, height = camera.image_size
        scene = np.full((height, width), self.table.room_dn, dtype=np.float32)
        u, v = _on_board(camera, np.linalg.inv(camera.rig_T_camera(pan)) @ rig_T_board)
        rows, columns = self._window(u, v)
        if rows.stop > rows.start:
            lamp = np.linalg.inv(rig_T_board) @ [*np.asarray(self.table.lamp_mm) / 1000, 1.0]
            patch = self._patch(u[rows, columns], v[rows, columns], lamp[:3])
            y, x = (NODE_SPACING_PX * (s.start - 1) for s in (rows, columns))  # 1: the outer nodes
            y0, x0 = max(y, 0), max(x, 0)
            shown = patch[y0 - y : height - y, x0 - x : width - x]
            scene[y0 : y0 + shown.shape[0], x0 : x0 + shown.shape[1]] = shown
        return scene

    def _window(self, u: Array, v: Array) -> tuple[slice, slice]:
        """Bound the nodes that see the paper, and those that its blur reaches; empty if none."""
        low, high = self._rim()
        there = (u > low[0]) & (u < high[0]) & (v > low[1]) & (v < high[1])
        reach = int(np.ceil(MAX_BLUR_SIGMAS * self.table.blur_px / NODE_SPACING_PX)) + 1
        rows, columns = (np.flatnonzero(there.any(axis=axis)) for axis in (1, 0))
        if not len(rows):
            return slice(0, 0), slice(0, 0)
        return (
            slice(max(rows[0] - reach, 0), rows[-1] + reach + 1),
            slice(max(columns[0] - reach, 0), columns[-1] + reach + 1),
        )

    def _rim(self) -> tuple[Array, Array]:
        """Bound the paper: least and greatest x and y, m, in the board's frame."""
        counts = np.array([self.board.columns, self.board.rows])
        around = self.margin + self.board.square
        return np.full(2, -around), (counts - 1) * self.board.square + around

    def _patch(self, u: Array, v: Array, lamp: Array) -> Picture:
        """Render the pixels around some nodes, NODE_SPACING_PX a node and side, DN.

        u and v, m, are x and y of each node in the board's frame, there is the lamp (3,), m.
        """
        light = _lambert(u, v, lamp, self._rim()) * self.table.white_dn
        size = (u.shape[1] * NODE_SPACING_PX, u.shape[0] * NODE_SPACING_PX)
        fine = (size[0] * GRAINS_PER_PX, size[1] * GRAINS_PER_PX)
        columns = _Lattice.across(u / self.board.square, self.board.columns, fine)
        rows = _Lattice.across(v / self.board.square, self.board.rows, fine)
        ink = columns.sign()
        ink *= rows.sign()
        ink += 1
        ink *= 0.5
        ink *= columns.within(0)
        ink *= rows.within(0)
        if self.board.markers is not None:
            ink = np.maximum(ink, _markers(self.board, columns.at, rows.at))
        margin = self.margin / self.board.square
        paper = columns.within(margin)
        paper *= rows.within(margin)
        ink *= np.float32(self.table.black_dn / self.table.white_dn - 1)
        ink += 1
        shown = _interpolate_nodes(light, fine)
        shown *= ink
        shown -= self.table.room_dn
        shown *= paper
        shown += self.table.room_dn
        blurred = cv2.GaussianBlur(shown, (0, 0), self.table.blur_px * GRAINS_PER_PX)
        return np.asarray(cv2.resize(blurred, size, interpolation=cv2.INTER_AREA), np.float32)


@dataclass(frozen=True, slots=True)
class _Lattice:
    """One coordinate of the pattern at every grain, in squares from the first inner corner."""

    at: Picture
    grain: Picture  # a grain's width, in squares
    count: int  # inner corners

    @classmethod
    def across(cls, nodes: Array, count: int, fine: tuple[int, int]) -> "_Lattice":
        down, across = np.gradient(nodes)
        width = np.hypot(down, across) / (NODE_SPACING_PX * GRAINS_PER_PX)
        grain = _interpolate_nodes(np.maximum(width, 1e-9), fine)  # FAR_AWAY has no slope
        return cls(_interpolate_nodes(_level_nodes(nodes), fine), grain, count)

    def sign(self) -> Picture:
        """Alternate from square to square between 1 and -1, soft over one grain at each edge."""
        wave = np.clip(self.at, -0.5, self.count - 0.5)  # the outer edges are `within`'s
        wave *= 0.5  # a turn of a triangle wave that is 0 at the edges; in place, for its size
        wave += 0.25
        wave -= np.floor(wave)
        wave *= 2
        wave -= 1
        np.abs(wave, out=wave)
        wave -= 0.5
        wave *= 2
        wave /= self.grain
        return np.clip(wave, -1, 1, out=wave)

    def within(self, margin: float) -> Picture:
        """Say what share of each grain lies in the pattern, or so many squares around it."""
        depth = self.at + 1
        depth += margin
        np.minimum(depth, self.count + margin - self.at, out=depth)
        depth /= self.grain
        depth += 0.5
        return np.clip(depth, 0, 1, out=depth)


def _markers(board: Board, across: Picture, down: Picture) -> Picture:
    """Ink a ChArUco board's markers in the white squares, hard-edged: 1 where one is black, else 0.

    No corner of the pattern is theirs. `across` and `down`: squares from the first inner corner, a
    grain each.
    """
    cells = _cells(board)
    size = cells.shape[-1]
    share = float(board.marker or 0) / board.square
    column, row = np.floor(across).astype(np.intp), np.floor(down).astype(np.intp)
    x, y = (
        np.floor(((at - whole) - (1 - share) / 2) / share * size).astype(np.intp)
        for at, whole in ((across, column), (down, row))
    )
    there = (column >= -1) & (column < board.columns) & (row >= -1) & (row < board.rows)
    there &= (x >= 0) & (x < size) & (y >= 0) & (y < size)
    ink = np.zeros(across.shape, dtype=np.float32)
    ink[there] = cells[row[there] + 1, column[there] + 1, y[there], x[there]]
    return ink


def _cells(board: Board) -> Flags:
    """Look up which cells of the squares' markers are black, (rows, columns, cells, cells).

    The dictionary's markers fill the white squares row by row, as OpenCV has it.
    """
    dictionary = fiducials.dictionary(str(board.markers))
    size = dictionary.markerSize + 2  # its black border is a cell wide
    cells = np.zeros((board.rows + 1, board.columns + 1, size, size), dtype=bool)
    white = [(r, c) for r in range(board.rows + 1) for c in range(board.columns + 1) if (r + c) % 2]
    for number, (row, column) in enumerate(white):
        cells[row, column] = np.asarray(dictionary.generateImageMarker(number, size)) == 0
    return cells


def _on_board(camera: SimulatedCamera, camera_T_board: Array) -> tuple[Array, Array]:
    """Carry the picture's nodes' rays onto the board's plane: its x and y, m.

    A node stands in the middle of its NODE_SPACING_PX x NODE_SPACING_PX pixels, as
    `_interpolate_nodes` expects; one row and column of nodes lie outside the picture on each side.
    """
    rays = _node_rays(camera.image_size, camera.matrix.tobytes(), camera.distortion.tobytes())
    height, width = rays.shape[:2]
    homography = np.linalg.inv(camera_T_board[:3, [0, 1, 3]])
    on_board = rays.reshape(-1, 3) @ homography.T
    before = on_board[:, 2:] > 0  # else the ray meets the board's plane behind the camera
    uv = np.where(before, on_board[:, :2] / np.where(before, on_board[:, 2:], 1.0), FAR_AWAY)
    return uv[:, 0].reshape(height, width), uv[:, 1].reshape(height, width)


@lru_cache(maxsize=4)  # both cameras of a rig, for each picture of it
def _node_rays(image_size: tuple[int, int], matrix: bytes, distortion: bytes) -> Array:
    """Rays of a picture's nodes, (rows, columns, 3), in the camera's frame, 1 along its axis."""
    px, py = (
        NODE_SPACING_PX * np.arange(-1, -(-extent // NODE_SPACING_PX) + 1)
        + (NODE_SPACING_PX - 1) / 2
        for extent in image_size
    )
    pixels = np.stack(np.meshgrid(px, py), axis=-1)
    lens = np.frombuffer(matrix).reshape(3, 3), np.frombuffer(distortion)
    rays = cv2.undistortPoints(
        pixels.reshape(-1, 1, 2), *lens, None, None, None, UNDISTORT_CRITERIA
    ).reshape(pixels.shape)
    return np.concatenate([rays, np.ones((*pixels.shape[:2], 1))], axis=-1)


def _lambert(u: Array, v: Array, lamp: Array, rim: tuple[Array, Array]) -> Array:
    """Light a matt plane by a point lamp and the room: 1 at the board's brightest place.

    u and v, m, are x and y of each node in the board's frame, there is the lamp (3,), m; the rim is
    the paper's least and greatest x and y, (2,) each, m.

    Source: Lambert's law, cosine over distance squared.
    """
    least = np.sum((np.clip(lamp[:2], *rim) - lamp[:2]) ** 2) + lamp[2] ** 2
    squared = (u - lamp[0]) ** 2 + (v - lamp[1]) ** 2 + lamp[2] ** 2
    return np.asarray(AMBIENT_SHARE + (1 - AMBIENT_SHARE) * (least / squared) ** 1.5)


def _level_nodes(nodes: Array) -> Array:
    """Shift nodes of a curved map so that straight lines between them are right on average.

    A chord of a parabola lies off it by a twelfth of its second difference on average.
    """
    bent = np.zeros_like(nodes)
    bent[1:-1] += np.diff(nodes, 2, axis=0)
    bent[:, 1:-1] += np.diff(nodes, 2, axis=1)
    return nodes - bent / 12


def _interpolate_nodes(nodes: Array, fine: tuple[int, int]) -> Picture:
    """Interpolate node values for every grain."""
    return np.asarray(
        cv2.resize(nodes.astype(np.float32), fine, interpolation=cv2.INTER_LINEAR), np.float32
    )
