"""A calibration board, and how its corners were seen."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.records import Array


@dataclass(frozen=True, slots=True)
class Board:
    """A flat chessboard pattern.

    Frame: origin at the first inner corner, x along the columns, y along the rows, z into the
    board, away from the cameras. Seen the right way up, the first corner is at the top left.
    """

    columns: int  # inner corners along x
    rows: int  # inner corners along y
    square: float  # m, edge of a square
    square_standard_uncertainty: float | None = None  # m; None: not stated, taken as exact
    markers: str | None = None  # ChArUco: name of the ArUco dictionary (DICT_5X5_100); None: plain
    marker: float | None = None  # m, edge of a ChArUco marker

    def __len__(self) -> int:
        """Count the inner corners."""
        return self.columns * self.rows

    @property
    def four_fold(self) -> bool:
        """Whether a quarter turn leaves the pattern as it is: plain, square, of even counts."""
        return self.markers is None and self.columns == self.rows and self.columns % 2 == 0

    @property
    def points(self) -> Array:
        """Inner corners in the board's frame, (columns * rows, 3), m, along x first."""
        y, x = np.mgrid[: self.rows, : self.columns]
        flat = np.stack([x.ravel(), y.ravel(), np.zeros(len(self))], axis=1)
        points: Array = flat * self.square
        return points


@dataclass(frozen=True, slots=True)
class BoardView:
    """One board in one image."""

    corner: NDArray[np.int64]  # (n,), index into board.points
    centre: Array  # (n, 2), px, distorted, as seen
    covariance: Array  # (n, 2, 2), px², from the image's own noise

    def __len__(self) -> int:
        """Count the corners seen."""
        return len(self.corner)


@dataclass(frozen=True, slots=True)
class BoardPair:
    """What both cameras saw of the board at one instant; None: not found."""

    frame: int
    pan_left: float  # rad, as read
    pan_right: float
    left: BoardView | None
    right: BoardView | None
