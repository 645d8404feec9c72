"""The pairs that were taken: how the board stood in them, and whether another one tells more."""

from dataclasses import dataclass

import numpy as np

from verify.board import Board, BoardPair, BoardView
from verify.calibration.initial import Lens, pose_of, rough_lens
from verify.calibration.quality_coverage import Stance
from verify.records import Array

ENOUGH_FOR_LENS = 6  # pairs, from which a focal length is found; before, one is guessed
GUESSED_FOCAL = 0.8  # of the longer image side: a field of 64°, as webcams have

# One of these and the pair tells something new.
TURNED = np.deg2rad(10.0)  # between the boards' normals
ROLLED = np.deg2rad(20.0)  # in the board's own plane
NEARER = 1.15  # ratio of distances
ASIDE = 0.12  # of the image's width, of the board's middle
BASE_TURNED = np.deg2rad(1.5)


@dataclass(frozen=True, slots=True)
class Standing:
    """How a board stood before one camera."""

    stance: Stance  # in the camera's own frame
    middle: Array  # (2,), share of the image's width and height

    @property
    def roll(self) -> float:
        """Angle of the board's x in the image, rad."""
        x = self.stance.view_T_board[:3, 0]
        return float(np.arctan2(x[1], x[0]))


class TakenPairs:
    """What was taken so far.

    Args:
        board: the pattern.
        image_size: width and height, px.
    """

    def __init__(self, board: Board, image_size: tuple[int, int]) -> None:
        self.board, self.image_size = board, image_size
        self.pairs: list[BoardPair] = []
        guess = Lens(_guessed(image_size), np.zeros(5), {})
        self._lenses = (guess, guess)
        self._standings: list[tuple[Standing, Standing]] = []

    def __len__(self) -> int:
        """Count the pairs."""
        return len(self.pairs)

    def add(self, pair: BoardPair) -> None:
        """Take a pair in which both cameras see the board."""
        self.pairs.append(pair)
        if len(self.pairs) >= ENOUGH_FOR_LENS:
            self._lenses = (self._lens(0), self._lens(1))
            self._standings = [self.standings(p) for p in self.pairs]
        else:
            self._standings.append(self.standings(pair))

    def standings(self, pair: BoardPair) -> tuple[Standing, Standing]:
        """Place a board that both cameras see, as well as they are known by now."""
        left, right = _views(pair)
        return self._standing(pair.frame, left, 0), self._standing(pair.frame, right, 1)

    def of_camera(self, side: int) -> list[Standing]:
        """How the boards stood before the left (0) or right (1) camera."""
        return [standing[side] for standing in self._standings]

    def alike(self, pair: BoardPair) -> int | None:
        """Name the taken pair that this one would only repeat; None: it tells something new."""
        now = self.standings(pair)
        for other, before in zip(self.pairs, self._standings, strict=True):
            turned = max(abs(pair.pan_left - other.pan_left), abs(pair.pan_right - other.pan_right))
            if turned < BASE_TURNED and not any(map(_differ, now, before)):
                return other.frame
        return None

    def _standing(self, frame: int, view: BoardView, side: int) -> Standing:
        lens = self._lenses[side]
        pose = pose_of(view, self.board, lens.matrix, lens.distortion)
        points = self.board.points
        middle = pose @ np.append((points[0] + points[-1]) / 2, 1.0)
        normal = pose[:3, 2]  # as Stance has it: (0, 0, 1) where the board faces the camera
        stance = Stance(
            frame=frame,
            view_T_board=pose,
            distance=float(middle[2]),
            about_horizontal=float(np.arctan2(-normal[1], normal[2])),
            about_vertical=float(np.arctan2(normal[0], normal[2])),
        )
        seen = lens.matrix @ (middle[:3] / middle[2])
        return Standing(stance, seen[:2] / np.asarray(self.image_size))

    def _lens(self, side: int) -> Lens:
        views = {i: _views(pair)[side] for i, pair in enumerate(self.pairs)}
        return rough_lens(views, self.board, self.image_size)


def _guessed(image_size: tuple[int, int]) -> Array:
    focal, (width, height) = GUESSED_FOCAL * max(image_size), image_size
    return np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])


def _views(pair: BoardPair) -> tuple[BoardView, BoardView]:
    assert pair.left is not None
    assert pair.right is not None
    return pair.left, pair.right


def _differ(one: Standing, other: Standing) -> bool:
    """Whether a camera sees the board elsewhere, nearer, or turned otherwise."""
    cosine = float(one.stance.view_T_board[:3, 2] @ other.stance.view_T_board[:3, 2])
    rolled = abs(np.angle(np.exp(1j * (one.roll - other.roll))))
    ratio = one.stance.distance / other.stance.distance
    return bool(
        np.arccos(np.clip(cosine, -1.0, 1.0)) > TURNED
        or rolled > ROLLED
        or max(ratio, 1 / ratio) > NEARER
        or abs(one.middle - other.middle).max() > ASIDE
    )
