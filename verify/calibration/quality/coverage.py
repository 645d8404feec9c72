"""Coverage by the boards: image areas, distances, tilts."""

from dataclasses import dataclass

import numpy as np

from verify.calibration.stereo.records import Calibration
from verify.core.fiducials import Board
from verify.core.records import Array, rigid_transform
from verify.core.rig import Rig

CELLS_ACROSS = 12  # of the coverage grid; as many down as keep them square
REGIONS_PER_SIDE = 3  # regions that sentences can name


@dataclass(frozen=True, slots=True)
class ImageCoverage:
    """Corners over one camera's image."""

    camera: int  # 0 left, 1 right
    x: Array  # (columns,), px, centres of the cells
    y: Array  # (rows,), px
    counts: Array  # (rows, columns), corners used
    regions: Array  # (3, 3), corners used, upper left first
    margins: Array  # (4,), share of the width or height left, above, right and below all corners
    reach: float  # farthest corner from the image's centre, as a share of half the diagonal


@dataclass(frozen=True, slots=True)
class BoardOrientation:
    """Pose of one board before the cameras.

    A positive tilt about the horizontal axis brings the upper edge nearer, one about the vertical
    axis the right edge.
    """

    frame: int
    view_T_board: Array  # (4, 4)
    distance: float  # m, depth of the board's middle before the cameras
    about_horizontal: float  # rad
    about_vertical: float  # rad

    @property
    def tilt(self) -> float:
        """Angle between the board and the plane that faces the cameras, rad."""
        return float(np.arccos(np.clip(self.view_T_board[2, 2], -1.0, 1.0)))


def view_frame(rig: Rig, pan: Array) -> Array:
    """The frame midway between the cameras: x along the baseline, z along the mean axis; (4, 4).

    It is rig_T_view; the mean of the optical axes is made square to the baseline. `pan` (2,), rad,
    is the reading of either base.
    """
    left, right = rig.left.rig_T_camera(float(pan[0])), rig.right.rig_T_camera(float(pan[1]))
    x = right[:3, 3] - left[:3, 3]
    x = x / np.linalg.norm(x)
    z = left[:3, 2] + right[:3, 2]
    z = z - (z @ x) * x
    z = z / np.linalg.norm(z)
    turn = np.stack([x, np.cross(z, x), z], axis=1)
    return rigid_transform(turn, (left[:3, 3] + right[:3, 3]) / 2)


def image_coverage(calibration: Calibration) -> tuple[ImageCoverage, ...]:
    """Count the corners that entered the adjustment over the cells of either image."""
    size = width, height = calibration.rig.image_size
    residuals = calibration.residuals
    half = np.hypot(width, height) / 2
    found = []
    for camera in (0, 1):
        pixels = residuals.observed[(residuals.camera == camera) & residuals.used]
        offset = pixels - np.array([width - 1, height - 1]) / 2
        reach = float(np.linalg.norm(offset, axis=1).max() / half) if len(pixels) else 0.0
        counts, regions, margins = pixel_counts(pixels, size)
        rows, columns = counts.shape
        x, y = _centres(width, columns), _centres(height, rows)
        found.append(ImageCoverage(camera, x, y, counts, regions, margins, reach))
    return tuple(found)


def pixel_counts(pixels: Array, size: tuple[int, int]) -> tuple[Array, Array, Array]:
    """Count pixels (n, 2) over a grid of square cells, (rows, columns); size: width, height.

    Also over the regions that sentences can name, (3, 3); and the share of the width or height
    left, above, right and below all pixels, (4,).
    """
    cells = _counts(pixels, size, CELLS_ACROSS, max(round(CELLS_ACROSS * size[1] / size[0]), 1))
    regions = _counts(pixels, size, REGIONS_PER_SIDE, REGIONS_PER_SIDE)
    if not len(pixels):
        return cells, regions, np.ones(4)
    low, high = (pixels.min(axis=0) + 0.5) / size, (pixels.max(axis=0) + 0.5) / size
    return cells, regions, np.concatenate([low, 1 - high])


def _centres(extent: int, cells: int) -> Array:
    return (np.arange(cells) + 0.5) * extent / cells - 0.5  # pixel centres are whole


def _counts(pixels: Array, size: tuple[int, int], across: int, down: int) -> Array:
    width, height = size
    edges = (np.linspace(-0.5, height - 0.5, down + 1), np.linspace(-0.5, width - 0.5, across + 1))
    return np.histogram2d(pixels[:, 1], pixels[:, 0], bins=edges)[0]


def board_orientations(calibration: Calibration, pan: Array) -> tuple[BoardOrientation, ...]:
    """Find distance and tilts of each of b boards; pan (b, 2), rad, are readings of the bases."""
    poses = zip(calibration.frames.tolist(), calibration.rig_T_board, pan, strict=True)
    return tuple(
        board_orientation(
            frame, np.linalg.inv(view_frame(calibration.rig, own)) @ rig_T_board, calibration.board
        )
        for frame, rig_T_board, own in poses
    )


def board_orientation(frame: int, view_T_board: Array, board: Board) -> BoardOrientation:
    """Find distance and tilts of a board in the frame of a view, z forward."""
    normal = view_T_board[:3, 2]  # into the board: (0, 0, 1) where it faces the cameras
    return BoardOrientation(
        frame=frame,
        view_T_board=view_T_board,
        distance=float(board_middle(view_T_board, board)[2]),
        about_horizontal=float(np.arctan2(-normal[1], normal[2])),
        about_vertical=float(np.arctan2(normal[0], normal[2])),
    )


def board_middle(view_T_board: Array, board: Board) -> Array:
    """Where the middle of the corners lies, (3,), m."""
    middle = (board.points[0] + board.points[-1]) / 2
    return np.asarray(view_T_board[:3, :3] @ middle + view_T_board[:3, 3])
