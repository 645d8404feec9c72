"""The pixels that speak for a corner: half a square to every side, in the board's plane.

So each piece of an edge speaks for one corner, no two corners share a pixel, and their errors are
independent. Perspective leaves edges straight; only the lens bends them, by how much is taken
from the whole view's map.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from verify.records import Array

HALF_WINDOW = 0.5  # squares
REACH = 10.0  # px; beyond it from both edges a pixel says nothing on them
MARKER_GUARD = 2.0  # px, blur that a ChArUco marker's bits may have
CLEARANCE = 2  # px between what is not the corner's and what speaks for it
CELLS = 7  # a side of the window, for the scatter of scores; odd, so that edges lie within cells


@dataclass(frozen=True, slots=True)
class Place:
    """Where a corner is expected, and the board's plane about it."""

    centre: Array  # (2,), px
    jacobian: Array  # (2, 2), d px / d squares, columns along the board's x and y
    bend: Array  # (2, 2), d² px / d squares², columns likewise
    markers: tuple[float, int] | None = None  # squares between a marker and its square's edge;
    # sign of u · v (from the corner, board's axes) where the white squares are


@dataclass(frozen=True, slots=True)
class Window:
    """The pixels that speak for a corner."""

    x: Array  # (p,), px from the expected centre
    y: Array
    value: Array  # (p,), DN
    cell: NDArray[np.intp]  # (p,), a cell and its mirror image about the corner are one

    def only(self, which: NDArray[np.bool_]) -> "Window":
        """Some of the pixels."""
        return Window(self.x[which], self.y[which], self.value[which], self.cell[which])

    def far_from(self, which: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Whether pixels (p,) keep clear of some of them, as far as blur reaches."""
        if not which.any():
            return ~which
        column, row = (np.rint(v - v.min()).astype(np.intp) for v in (self.x, self.y))
        mask = np.zeros((row.max() + 1, column.max() + 1), dtype=np.uint8)
        mask[row[which], column[which]] = 1
        grown = cv2.dilate(mask, np.ones((2 * CLEARANCE + 1,) * 2, dtype=np.uint8))
        return np.asarray(grown[row, column] == 0)


@dataclass(frozen=True, slots=True)
class Edges:
    """The fixed part of the model."""

    start: tuple[float, float]  # rad, directions of the edges' normals
    curvature: tuple[float, float]  # 1/px, along the normals
    scale: float  # px, unit of the linear terms


def window_at(grey: Array, place: Place) -> Window:
    """Pixels within half a square, near an edge, and outside ChArUco markers."""
    height, width = grey.shape
    extent = HALF_WINDOW * np.abs(place.jacobian).sum(axis=1)
    low = np.maximum(np.ceil(place.centre - extent), 0).astype(int)
    high = np.minimum(np.floor(place.centre + extent), [width - 1, height - 1]).astype(int)
    rows, columns = np.mgrid[low[1] : high[1] + 1, low[0] : high[0] + 1]
    offset = np.stack([columns.ravel() - place.centre[0], rows.ravel() - place.centre[1]])
    board = np.linalg.solve(place.jacobian, offset)
    # A pixel's distance from the edge along the board's x is across it, hence its v, and so on.
    step = abs(np.linalg.det(place.jacobian)) / np.linalg.norm(place.jacobian, axis=0)[:, None]
    distance = np.abs(board[::-1]) * step
    keep = (np.abs(board) <= HALF_WINDOW).all(axis=0) & (distance.min(axis=0) <= REACH)
    if place.markers is not None:
        margin, white = place.markers
        near = distance.min(axis=0) <= margin * step.min() - MARKER_GUARD
        keep &= near | (board[0] * board[1] * white < 0)
    board, offset = board[:, keep], offset[:, keep]
    index = np.clip((board / HALF_WINDOW + 1) * CELLS / 2, 0, CELLS - 1).astype(np.intp)
    cell = index[0] * CELLS + index[1]
    value = grey[low[1] : high[1] + 1, low[0] : high[0] + 1].ravel()[keep]
    return Window(offset[0], offset[1], value, np.minimum(cell, CELLS * CELLS - 1 - cell))


def edges_at(place: Place) -> Edges:
    """Directions and curvatures of the two edges, from the board's plane."""
    start, curvature = [], []
    for along, across in ((0, 1), (1, 0)):
        tangent = place.jacobian[:, along]
        length = np.linalg.norm(tangent)
        normal = np.array([-tangent[1], tangent[0]]) / length
        if normal @ place.jacobian[:, across] < 0:
            normal = -normal
        start.append(float(np.arctan2(normal[1], normal[0])))
        curvature.append(float(place.bend[:, along] @ normal / length**2))
    scale = float(np.sqrt(abs(np.linalg.det(place.jacobian))))
    return Edges((start[0], start[1]), (curvature[0], curvature[1]), scale)
