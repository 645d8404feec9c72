"""The tables of a scenario file, one a class, every key with its unit.

`scenarios/example.toml` shows every key of a session, `scenarios/boards_turning.toml` of board
pictures; `library.py` reads files into these classes.
"""

from typing import Annotated, Literal

import msgspec

from verify.io.toml import NotNegative, Positive

Share = Annotated[float, msgspec.Meta(gt=0, le=1)]
Count = Annotated[int, msgspec.Meta(ge=1, le=1_000_000)]
Pixels = Annotated[int, msgspec.Meta(ge=1, le=20_000)]
Index = Annotated[int, msgspec.Meta(ge=0)]
Vector = tuple[float, float, float]
Side = Literal["left", "right", "both"]
Colour = Literal["white", "red", "green", "blue", "infrared"]


class ScenarioTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One table of a scenario file; a key that it does not know is refused."""


class QuarterCircle(ScenarioTable, frozen=True, tag_field="kind", tag="quarter_circle"):
    """Joint 1 turns once while the others hold still: the experiment of the 6R paper."""

    home_deg: list[float]  # where the turn begins
    sweep_deg: float = 95.5
    rest_s: NotNegative = 0.3  # at either end


class MultiJoint(ScenarioTable, frozen=True, tag_field="kind", tag="multi_joint"):
    """Every joint follows its own sum of sines, frequencies and phases drawn from the seed."""

    home_deg: list[float]
    amplitude_deg: list[float]  # the most by which each joint leaves home
    slowest_hz: Positive = 0.08
    fastest_hz: Positive = 0.35


class SingleJoint(ScenarioTable, frozen=True, tag_field="kind", tag="single_joint"):
    """One joint after the other swings up, down and back, from rest to rest."""

    home_deg: list[float]
    amplitude_deg: list[float]


class Visits(ScenarioTable, frozen=True, tag_field="kind", tag="visits"):
    """Still poses drawn about home, one a pair; the arm moves only in between."""

    home_deg: list[float]
    amplitude_deg: list[float]


class ConstantSpeed(ScenarioTable, frozen=True, tag_field="kind", tag="constant_speed"):
    """Every joint at a steady speed, one way; home is reached half way through."""

    home_deg: list[float]
    speed_deg_s: list[float]


MotionTable = QuarterCircle | MultiJoint | SingleJoint | Visits | ConstantSpeed


class ScenarioRecording(ScenarioTable, frozen=True):
    """When pictures are taken, and how they are kept."""

    pairs: Count
    rate_hz: Positive
    skew_s: float = 0.0  # right camera after left
    skew_jitter_s: NotNegative = 0.0  # standard deviation
    dropped: list[Index] = []  # pairs that were lost: no row, no image
    format: Literal["video", "png"] = "video"


class ScenarioCamera(ScenarioTable, frozen=True):
    """One camera as its calibration has it."""

    focal_px: tuple[Positive, Positive] = (1010.0, 1010.0)
    principal_point_px: tuple[float, float] = (639.5, 359.5)
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    pan_axis: Vector = (0.0, 1.0, 0.0)
    pan_zero_deg: float = 0.0
    mount_rotation_deg: Vector = (0.0, 0.0, 0.0)  # rotation vector
    mount_offset_mm: Vector = (0.0, 0.0, 0.0)
    line_time_s: NotNegative = 0.0
    exposure_s: NotNegative = 0.0


class ScenarioPlacement(ScenarioTable, frozen=True):
    """Where the robot stands before the rig, and where the bases are turned."""

    base_rotation_deg: Vector  # rotation vector of rig_T_base
    base_position_mm: Vector
    pan_deg: tuple[float, float]  # left, right


class BoardRig(ScenarioTable, frozen=True):
    """The two cameras."""

    image_size: tuple[Pixels, Pixels] = (1280, 720)
    baseline_mm: Positive = 170.0
    left: ScenarioCamera = ScenarioCamera()
    right: ScenarioCamera = ScenarioCamera()


class ScenarioRig(BoardRig, frozen=True):
    """The two cameras and their place; "auto" looks for one from which every LED is seen."""

    distance_mm: Positive = 650.0  # wanted between rig and LEDs; auto may step back
    bases: Literal["fixed", "follow"] = "fixed"
    pan_step_deg: Positive = 0.05
    placement: Literal["auto"] | ScenarioPlacement = "auto"


class ScenarioLed(ScenarioTable, frozen=True):
    """One LED on the flange."""

    name: str
    position_mm: Vector
    normal: Vector = (0.0, 0.0, 1.0)  # where it shines, flange axes
    colour: Colour = "white"
    peak_dn: Positive = 210.0  # brightness of its face, before blur
    falloff: NotNegative = 0.0  # brightness goes as cos(angle) to this power


class ScenarioMarker(ScenarioTable, frozen=True):
    """The LEDs, all of one size."""

    led: Annotated[list[ScenarioLed], msgspec.Meta(min_length=1, max_length=6)]
    led_diameter_mm: Positive = 5.0


class ScenarioImage(ScenarioTable, frozen=True):
    """From light to numbers: lens, sensor, room."""

    colour: bool = False
    blur_px: Positive = 0.6  # standard deviation of the lens blur
    read_noise_dn: NotNegative = 1.5
    electrons_per_dn: Positive = 32.0
    black_level_dn: float = -3.5  # added before clipping at 0 and 255; below 0 it clamps the dark
    background_dn: NotNegative = 0.0
    texture_dn: NotNegative = 0.0  # standard deviation of the room's pattern


class Distractor(ScenarioTable, frozen=True):
    """A lamp in the room, at rest or drifting."""

    position_mm: Vector  # rig frame, at t = 0
    velocity_mm_s: Vector = (0.0, 0.0, 0.0)
    diameter_mm: Positive = 5.0
    peak_dn: Positive = 200.0
    colour: Colour = "white"


class Mirror(ScenarioTable, frozen=True):
    """A shiny plane that shows every LED once more; the reflections move with the arm."""

    point_mm: Vector  # rig frame
    normal: Vector
    reflectance: Share


class Occlusion(ScenarioTable, frozen=True):
    """Something before an LED, from pair `first` to pair `last`."""

    led: str
    first: Index
    last: Index
    camera: Side = "both"
    share: Share = 1.0  # of its width that is hidden


class ScenarioEncoders(ScenarioTable, frozen=True):
    """The controller's readings: rate, grain, noise, and its clock against the cameras'."""

    rate_hz: Positive = 50.0
    noise_deg: NotNegative = 0.01
    resolution_deg: NotNegative = 0.0
    clock_offset_s: float = 0.0  # add to the encoders' time to get the cameras'
    clock_drift_ppm: float = 0.0  # how fast that offset grows


class ScenarioFault(ScenarioTable, frozen=True):
    """What is wrong with one joint's encoder, in docs/results.md's terms."""

    joint: Count
    offset_deg: float = 0.0
    gain: float = 0.0  # d reading / d true - 1
    backlash_deg: float = 0.0  # reading moving up less reading moving down
    eccentricity_deg: NotNegative = 0.0
    phase_deg: float = 0.0
    per_turn: Count = 1
    step_deg: float = 0.0  # by which the offset changes at an instant
    step_t_s: float = 0.0  # of the cameras' clock, on which the first pair is taken at 1 s


class ScenarioClock(ScenarioTable, frozen=True):
    """Present if session.toml tells the clock offset."""

    encoder_offset_standard_uncertainty_s: NotNegative = 0.0  # the told value is drawn from it


class ScenarioTolerance(ScenarioTable, frozen=True):
    """Copied to session.toml."""

    joints_deg: Positive | list[Positive]
    position_mm: Positive | None = None
    orientation_deg: Positive | None = None


class ScenarioUncertainty(ScenarioTable, frozen=True):
    """Standard uncertainties of what the user believes; the true world is drawn from them."""

    focal_px: NotNegative = 0.0
    principal_point_px: NotNegative = 0.0
    camera_rotation_deg: NotNegative = 0.0  # right camera against left, each axis
    base_position_mm: NotNegative = 0.0
    base_rotation_deg: NotNegative = 0.0
    led_body_mm: NotNegative = 0.0
    led_body_deg: NotNegative = 0.0
    led_mm: NotNegative = 0.0
    pan_deg: NotNegative = 0.0
    draw: bool = True  # false: stated all the same, but rig and marker are exact


class Scenario(ScenarioTable, frozen=True):
    """One session to simulate."""

    format: Literal[1]
    robot: str
    seed: Index
    motion: MotionTable
    recording: ScenarioRecording
    marker: ScenarioMarker
    description: str = ""
    rig: ScenarioRig = ScenarioRig()
    image: ScenarioImage = ScenarioImage()
    encoders: ScenarioEncoders = ScenarioEncoders()
    fault: list[ScenarioFault] = []
    distractor: list[Distractor] = []
    mirror: list[Mirror] = []
    occlusion: list[Occlusion] = []
    clock: ScenarioClock | None = None
    tolerance: ScenarioTolerance | None = None
    uncertainty: ScenarioUncertainty | None = None


Corners = Annotated[int, msgspec.Meta(ge=3)]
Angle = Annotated[float, msgspec.Meta(ge=0, lt=80)]


class ScenarioBoards(ScenarioTable, frozen=True):
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
    corner_noise_px: NotNegative = 0.03  # where corners are drawn without pictures


class BoardScenarioBases(ScenarioTable, frozen=True):
    """How the bases are turned: about `middle_deg`, from pair to pair by whole steps."""

    middle_deg: tuple[float, float] = (0.0, 0.0)  # left, right
    range_deg: NotNegative = 0.0  # either way; 0: they stand still
    step_deg: Positive = 5.0
    standard_uncertainty_deg: NotNegative = 0.0  # of each reading; the truth is drawn about it


class BoardScenarioFixture(ScenarioTable, frozen=True):
    """The board stands still on the robot's base instead of being carried about."""

    board_rotation_deg: Vector  # rotation vector of base_T_board
    board_position_mm: Vector
    base_rotation_deg: Vector  # rotation vector of rig_T_base
    base_position_mm: Vector


class BoardImage(ScenarioTable, frozen=True):
    """From light to numbers: lamp, paper, lens, sensor."""

    white_dn: Positive = 190.0  # of paper in full light
    black_dn: NotNegative = 18.0  # of ink there
    room_dn: NotNegative = 30.0
    lamp_mm: Vector = (-400.0, -900.0, -200.0)  # rig frame
    blur_px: Positive = 0.6  # standard deviation of the lens blur
    read_noise_dn: NotNegative = 1.5
    electrons_per_dn: Positive = 32.0
    black_level_dn: float = 0.0  # added before clipping at 0 and 255


class BoardScenario(ScenarioTable, frozen=True):
    """One set of board pictures to simulate."""

    format: Literal[1]
    seed: Index
    boards: ScenarioBoards
    description: str = ""
    bases: BoardScenarioBases = BoardScenarioBases()
    rig: BoardRig = BoardRig()
    image: BoardImage = BoardImage()
    fixture: BoardScenarioFixture | None = None
