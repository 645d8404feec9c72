"""The LEDs on the flange, calibration boards with their markers, and board corners in pictures."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from verify.core.records import Array, Index

COLOURS = ("white", "red", "green", "blue", "infrared")


@dataclass(frozen=True, slots=True)
class Marker:
    """Positions of the LEDs in the flange frame, with their standard uncertainties."""

    names: tuple[str, ...]
    leds: Array  # (n, 3), m, flange frame
    colours: tuple[str | None, ...]
    led_diameter: float  # m
    source: str | None = None  # jig, measured, motion
    datum: str | None = None
    registration: str | None = None
    body_standard_uncertainty: Array | None = None  # (6,), m and rad, flange axes
    led_standard_uncertainty: float | None = None  # m, each LED in the body
    centre_shift_standard_uncertainty: float | None = None  # m

    def __len__(self) -> int:
        return len(self.names)

    def without(self, name: str) -> "Marker":
        """The same without one of the LEDs."""
        kept = [i for i, other in enumerate(self.names) if other != name]
        return replace(
            self,
            names=tuple(self.names[i] for i in kept),
            leds=self.leds[kept],
            colours=tuple(self.colours[i] for i in kept),
        )


def unnamed_marker(points: Array, diameter: float, sigma: float | None = None) -> Marker:
    """Points (n, 3), m, of a body as a marker that names them by their number; sigma of each, m."""
    names, colours = tuple(str(i) for i in range(len(points))), (None,) * len(points)
    return Marker(names, points, colours, diameter, led_standard_uncertainty=sigma)


@dataclass(frozen=True, slots=True)
class Board:
    """A flat chessboard pattern.

    Frame: origin at the first inner corner, x along the columns, y along the rows, z into the
    board, away from the cameras. With the board upright, the first corner is at the top left.
    """

    columns: int  # inner corners along x
    rows: int  # inner corners along y
    square: float  # m, edge of a square
    square_standard_uncertainty: float | None = None  # m; None: not stated, taken as exact
    markers: str | None = None  # ChArUco: name of the ArUco dictionary (DICT_5X5_100); None: plain
    marker: float | None = None  # m, edge of a ChArUco marker

    def __len__(self) -> int:
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
        return flat * self.square


@dataclass(frozen=True, slots=True)
class BoardView:
    """Corners of one board found in one image."""

    corner: Index  # (n,), index into board.points
    centre: Array  # (n, 2), px, distorted
    covariance: Array  # (n, 2, 2), px², from the image's own noise

    def __len__(self) -> int:
        return len(self.corner)


@dataclass(frozen=True, slots=True)
class BoardPair:
    """The board in both cameras' images of one instant; None: not found."""

    frame: int
    pan_left: float  # rad, as read
    pan_right: float
    left: BoardView | None
    right: BoardView | None


DICTIONARIES = tuple(  # OpenCV spells some twice, once in small letters
    name for name in dir(cv2.aruco) if name.startswith("DICT_") and name.isupper()
)


def dictionary(name: str) -> cv2.aruco.Dictionary:
    """Look up one of `DICTIONARIES`."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def charuco_board(board: Board) -> cv2.aruco.CharucoBoard:
    """Build OpenCV's description of a board, corners as `points`; ValueError: it has no markers."""
    if board.markers is None or board.marker is None:
        raise ValueError("a plain chessboard has no markers")
    squares = (board.columns + 1, board.rows + 1)
    return cv2.aruco.CharucoBoard(squares, board.square, board.marker, dictionary(board.markers))
