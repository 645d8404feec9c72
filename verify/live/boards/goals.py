"""The board pairs taken so far: whether another one adds information, and which goals are open."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from verify.calibration.quality import advice
from verify.calibration.quality.coverage import (
    BoardOrientation,
    board_middle,
    board_orientation,
    pixel_counts,
)
from verify.calibration.stereo.start import InitialLens, board_pose, start_lens
from verify.core.fiducials import Board, BoardPair, BoardView
from verify.core.records import SIDES, Array

MIN_PAIRS_FOR_LENS = 6  # pairs, from which a focal length is found; before, one is guessed
DEFAULT_FOCAL_RATIO = 0.8  # of the longer image side: a field of 64°, as webcams have

# One of these and the pair tells something new.
MIN_TILT_CHANGE = np.deg2rad(10.0)  # between the boards' normals
MIN_ROLL_CHANGE = np.deg2rad(20.0)  # in the board's own plane
MIN_DISTANCE_RATIO = 1.15  # ratio of distances
MIN_SHIFT_RATIO = 0.12  # of the image's width, of the board's middle
MIN_PAN_CHANGE = np.deg2rad(1.5)


@dataclass(frozen=True, slots=True)
class BoardPlacement:
    """How a board stood before one camera."""

    orientation: BoardOrientation  # in the camera's own frame
    middle: Array  # (2,), share of the image's width and height

    @property
    def roll(self) -> float:
        """Angle of the board's x in the image, rad."""
        x = self.orientation.view_T_board[:3, 0]
        return float(np.arctan2(x[1], x[0]))


class CapturedPairs:
    """What was taken so far, in pictures of one size (width, height), px."""

    def __init__(self, board: Board, image_size: tuple[int, int]) -> None:
        self.board, self.image_size = board, image_size
        self.pairs: list[BoardPair] = []
        focal, (width, height) = DEFAULT_FOCAL_RATIO * max(image_size), image_size
        matrix = [[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]]
        guess = InitialLens(np.array(matrix), np.zeros(5), {})
        self._lenses = (guess, guess)
        self._placements: list[tuple[BoardPlacement, BoardPlacement]] = []

    def __len__(self) -> int:
        """Count the pairs."""
        return len(self.pairs)

    def add(self, pair: BoardPair) -> None:
        """Take a pair in which both cameras see the board."""
        self.pairs.append(pair)
        if len(self.pairs) >= MIN_PAIRS_FOR_LENS:
            self._lenses = (self._lens(0), self._lens(1))
            self._placements = [self.placements(p) for p in self.pairs]
        else:
            self._placements.append(self.placements(pair))

    def placements(self, pair: BoardPair) -> tuple[BoardPlacement, BoardPlacement]:
        """Place a board that both cameras see, as well as they are known by now."""
        left, right = _views(pair)
        return self._placement(pair.frame, left, 0), self._placement(pair.frame, right, 1)

    def of_camera(self, side: int) -> list[BoardPlacement]:
        """How the boards stood before the left (0) or right (1) camera."""
        return [placement[side] for placement in self._placements]

    def alike(self, pair: BoardPair) -> int | None:
        """Name the taken pair that this one would only repeat; None: it tells something new."""
        now = self.placements(pair)
        for other, before in zip(self.pairs, self._placements, strict=True):
            turned = max(abs(pair.pan_left - other.pan_left), abs(pair.pan_right - other.pan_right))
            if turned < MIN_PAN_CHANGE and not any(map(_placements_differ, now, before)):
                return other.frame
        return None

    def _placement(self, frame: int, view: BoardView, side: int) -> BoardPlacement:
        lens = self._lenses[side]
        pose = board_pose(view, self.board, lens.matrix, lens.distortion)
        middle = board_middle(pose, self.board)
        pixels = lens.matrix @ (middle / middle[2])
        orientation = board_orientation(frame, pose, self.board)
        return BoardPlacement(orientation, pixels[:2] / np.asarray(self.image_size))

    def _lens(self, side: int) -> InitialLens:
        views = {i: _views(pair)[side] for i, pair in enumerate(self.pairs)}
        return start_lens(views, self.board, self.image_size)


def _views(pair: BoardPair) -> tuple[BoardView, BoardView]:
    assert pair.left is not None
    assert pair.right is not None
    return pair.left, pair.right


def _placements_differ(one: BoardPlacement, other: BoardPlacement) -> bool:
    """Whether a camera sees the board elsewhere, nearer, or turned otherwise."""
    cosine = float(one.orientation.view_T_board[:3, 2] @ other.orientation.view_T_board[:3, 2])
    rolled = abs(np.angle(np.exp(1j * (one.roll - other.roll))))
    ratio = one.orientation.distance / other.orientation.distance
    return bool(
        np.arccos(np.clip(cosine, -1.0, 1.0)) > MIN_TILT_CHANGE
        or rolled > MIN_ROLL_CHANGE
        or max(ratio, 1 / ratio) > MIN_DISTANCE_RATIO
        or abs(one.middle - other.middle).max() > MIN_SHIFT_RATIO
    )


MIN_CORNERS_IN_REGION = 10  # corners
MIN_PAN_ANGLES = 3  # of each base that turns


@dataclass(frozen=True, slots=True)
class BoardGoal:
    """Something that the pictures must have."""

    name: str
    reached: bool
    words: str  # how far it is, or what to do


@dataclass(frozen=True, slots=True)
class CameraCoverage:
    """What one camera's pictures have covered."""

    cells: Array  # (rows, columns), corners seen, over a grid of square cells
    regions: Array  # (3, 3), likewise, upper left first
    margins: Array  # (4,), share left, above, right and below all corners
    placements: tuple[BoardPlacement, ...]


def coverage(taken: CapturedPairs, side: int) -> CameraCoverage:
    """Count what the left (0) or right (1) camera has seen."""
    views = [(pair.left, pair.right)[side] for pair in taken.pairs]
    pixels = np.concatenate([v.centre for v in views if v is not None] or [np.empty((0, 2))])
    counted = pixel_counts(pixels, taken.image_size)
    return CameraCoverage(*counted, tuple(taken.of_camera(side)))


def goals(
    taken: CapturedPairs, covered: Sequence[CameraCoverage], *, turning: bool
) -> tuple[BoardGoal, ...]:
    """Say what the pictures must have and how far they are, most needed first.

    The limits are those by which the report judges (`verify.calibration.quality.advice`).
    """
    wanted = 2 * advice.MIN_PAIRS
    count = BoardGoal("pairs", len(taken) >= wanted, f"{len(taken)} of {wanted}")
    images = [_image_goal(side, c) for side, c in zip(SIDES, covered, strict=True)]
    orientations = [s.orientation for s in covered[0].placements]
    return (
        *images,
        _tilt_goal("horizontal", [s.about_horizontal for s in orientations], ("upper", "lower")),
        _tilt_goal("vertical", [s.about_vertical for s in orientations], ("right", "left")),
        _distance_goal([s.distance for s in orientations]),
        *(_pan_goals(taken) if turning else ()),
        count,
    )


def _image_goal(side: str, covered: CameraCoverage) -> BoardGoal:
    name = f"{side} image"
    bare = np.argwhere(covered.regions < MIN_CORNERS_IN_REGION).tolist()
    if bare:
        parts = covered.regions.size
        where = advice.region_name(*bare[0])
        words = f"{parts - len(bare)} of {parts} parts; hold the board in the {where}"
        return BoardGoal(name, False, words)
    far = int(np.argmax(covered.margins))
    if covered.margins[far] > advice.MAX_EDGE_GAP:
        return BoardGoal(name, False, f"bring the board nearer to the {advice.EDGES[far]} edge")
    return BoardGoal(name, True, "covered up to its edges")


def _tilt_goal(axis: str, angles: Sequence[float], edges: tuple[str, str]) -> BoardGoal:
    """Judge the tilts about one axis; a positive one brings the first edge nearer."""
    name = f"tilt, {edges[0]} and {edges[1]}"
    most = [max((sign * a for a in angles), default=0.0) for sign in (1, -1)]
    if max(most) >= advice.MIN_TILT and min(most) >= advice.MIN_TILT_OTHER_SIDE:
        return BoardGoal(name, True, f"up to {np.rad2deg(max(most)):.0f}° about the {axis} axis")
    edge = edges[int(most[1] < most[0])]
    return BoardGoal(name, False, f"tilt the board by 30° to 45°, its {edge} edge nearer")


def _distance_goal(distances: Sequence[float]) -> BoardGoal:
    if not distances:
        return BoardGoal("distance", False, "hold the board near, then far")
    near, far = min(distances), max(distances)
    if far >= advice.MIN_DEPTH_RATIO * near:
        return BoardGoal("distance", True, f"{near:.2f} m to {far:.2f} m")
    nearer, farther = far / advice.MIN_DEPTH_RATIO, near * advice.MIN_DEPTH_RATIO
    words = f"hold the board at {nearer:.2f} m or nearer, or at {farther:.2f} m or farther"
    return BoardGoal("distance", False, words)


def _pan_goals(taken: CapturedPairs) -> Iterator[BoardGoal]:
    for side, name in enumerate(SIDES):
        angles = [(pair.pan_left, pair.pan_right)[side] for pair in taken.pairs]
        places = len(np.unique(np.round(np.rad2deg(angles)))) if angles else 0
        reached = places >= MIN_PAN_ANGLES
        words = f"{places} angles" if reached else f"{places} of {MIN_PAN_ANGLES} angles; turn it"
        yield BoardGoal(f"{name} base", reached, words)
