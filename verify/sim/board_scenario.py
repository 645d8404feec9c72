"""What a scenario file with `[boards]` may say; `scenarios/boards_turning.toml` shows every key."""

from typing import Annotated, Literal

import msgspec

from verify.sim.scenario import (
    CameraTable,
    Count,
    Index,
    NotNegative,
    Positive,
    Share,
    Table,
    Vector,
)

Corners = Annotated[int, msgspec.Meta(ge=3)]
Angle = Annotated[float, msgspec.Meta(ge=0, lt=80)]


class BoardTable(Table, frozen=True):
    """One table of a scenario with boards."""


class Boards(BoardTable, frozen=True):
    """The board, and how it is held before the cameras."""

    pairs: Count
    inner_corners: tuple[Corners, Corners] = (9, 7)
    square_mm: Positive = 40.0
    markers: str | None = None  # ChArUco: OpenCV's name of the ArUco dictionary
    marker_mm: Positive | None = None
    margin_mm: NotNegative = 20.0  # white paper around the pattern
    in_view: Share = 1.0  # of the corners, at least, in both cameras; 1: the whole pattern
    distance_mm: tuple[Positive, Positive] = (650.0, 1500.0)  # nearest, farthest
    tilt_deg: Angle = 45.0  # the most, out of the plane that faces the cameras
    roll_deg: Annotated[float, msgspec.Meta(ge=0, le=30)] = 20.0  # the most, in its own plane
    corner_noise_px: NotNegative = 0.03  # of `board_pairs`, each coordinate


class Bases(BoardTable, frozen=True):
    """How the bases are turned: about `middle_deg`, from pair to pair by whole steps."""

    middle_deg: tuple[float, float] = (0.0, 0.0)  # left, right
    range_deg: NotNegative = 0.0  # either way; 0: they stand still
    step_deg: Positive = 5.0
    standard_uncertainty_deg: NotNegative = 0.0  # of each reading; the truth is drawn about it


class BoardRig(BoardTable, frozen=True):
    """The two cameras."""

    image_size: tuple[Count, Count] = (1280, 720)
    baseline_mm: Positive = 170.0
    left: CameraTable = CameraTable()
    right: CameraTable = CameraTable()


class Fixture(BoardTable, frozen=True):
    """The board stands still on the robot's base instead of being carried about."""

    board_rotation_deg: Vector  # rotation vector of base_T_board
    board_position_mm: Vector
    base_rotation_deg: Vector  # rotation vector of rig_T_base
    base_position_mm: Vector


class BoardImage(BoardTable, frozen=True):
    """From light to numbers: lamp, paper, lens, sensor."""

    white_dn: Positive = 190.0  # of paper in full light
    black_dn: NotNegative = 18.0  # of ink there
    room_dn: NotNegative = 30.0
    lamp_mm: Vector = (-400.0, -900.0, -200.0)  # rig frame
    blur_px: Positive = 0.6  # standard deviation of the lens blur
    read_noise_dn: NotNegative = 1.5
    electrons_per_dn: Positive = 32.0
    black_level_dn: float = 0.0  # added before clipping at 0 and 255


class BoardScenario(BoardTable, frozen=True):
    """One set of board pictures to simulate."""

    format: Literal[1]
    seed: Index
    boards: Boards
    description: str = ""
    bases: Bases = Bases()
    rig: BoardRig = BoardRig()
    image: BoardImage = BoardImage()
    fixture: Fixture | None = None
