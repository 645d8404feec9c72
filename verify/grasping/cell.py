"""Read grab.toml, the cell in which objects are grasped: millimetres in the file, metres in a Cell.

The meaning of every key is in docs/grab.md.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np

from robots.transforms import rotation_exp
from verify.core.records import Array, rigid_transform
from verify.errors import InputError
from verify.io.files import refused_as_input_error
from verify.io.toml import MM, NotNegative, Positive, decode, key_error

Triple = tuple[float, float, float]
Table = TypeVar("Table", bound=msgspec.Struct)


class TableSurface(msgspec.Struct, frozen=True, rename=lambda name: f"{name}_mm"):
    """The keys of [table]: what objects stand on; clearances of all that moves above it.

    In mm as read, in m in a Cell.
    """

    height: float  # of its top in the robot's base frame, level
    clearance: NotNegative = 30.0  # of arm and palm
    finger_clearance: NotNegative = 3.0  # of the finger tips


class WorkspaceTable(msgspec.Struct, kw_only=True):
    """The keys of [workspace]."""

    lower_mm: Triple
    upper_mm: Triple


class GripperTable(msgspec.Struct, kw_only=True):
    """The keys of [gripper]."""

    opening_mm: Positive
    position_mm: Triple
    rotation_deg: Triple = (0.0, 0.0, 0.0)
    tips_mm: Positive
    finger_length_mm: Positive
    radius_mm: Positive


class Approach(
    msgspec.Struct,
    frozen=True,
    rename={
        "toward": "direction",
        "height": "height_mm",
        "speed": "speed_mm_s",
        "acceleration": "acceleration_mm_s2",
        "jerk": "jerk_mm_s3",
        "hidden": "hidden_mm",
    },
):
    """The keys of [approach]: the straight line to the object; m in a Cell."""

    toward: Triple = (0.0, 0.0, -1.0)  # base frame, of any length
    height: Positive = 120.0  # its length
    speed: Positive = 50.0
    acceleration: Positive = 200.0
    jerk: Positive = 1000.0
    hidden: NotNegative = 60.0  # before the object: nearer, the hand may hide it from the cameras

    @property
    def direction(self) -> Array:
        """Unit vector, (3,), base frame."""
        return np.asarray(np.array(self.toward) / np.linalg.norm(self.toward))


class CellMotion(
    msgspec.Struct,
    frozen=True,
    rename={"link_radius": "link_radius_mm", "camera_clearance": "camera_clearance_mm"},
):
    """The keys of [motion]: how the arm moves, and what it keeps away from; m in a Cell."""

    share: Positive = 0.1  # of the robot's greatest speed, acceleration and jerk
    link_radius: NotNegative = 70.0  # of the arm's links about the lines between their joints
    camera_clearance: NotNegative = 100.0  # from a camera's optical centre to arm or hand
    home_deg: list[float] | None = None

    @property
    def home(self) -> Array | None:
        """Where ways lead through that are not clear directly, (n,), rad."""
        return None if self.home_deg is None else np.radians(self.home_deg)


class ArmAccuracy(msgspec.Struct, frozen=True, rename={"robot": "robot_standard_uncertainty_mm"}):
    """The keys of [accuracy]: of the arm, and the probability required; m in a Cell."""

    robot: NotNegative  # standard uncertainty of the grip point's place, a coordinate
    coverage: Positive = 0.95  # probability with which the object must be between the fingers


class StillnessCriterion(
    msgspec.Struct, frozen=True, rename={"speed": "speed_mm_s", "duration": "for_s"}
):
    """The keys of [still]: when a target counts as still; m/s in a Cell."""

    speed: Positive = 10.0
    duration: NotNegative = 0.5  # s


class WatchdogLimits(msgspec.Struct, frozen=True, rename=lambda name: f"{name}_s"):
    """The keys of [watchdog]: after how long nothing is trusted any more, s."""

    stale: Positive = 0.3  # since the newest pair of pictures was taken
    lost: Positive = 1.0  # since the target was last tracked
    joints: Positive = 0.5  # since the newest reading of the joints
    moving: Positive = 60.0  # in one state that moves arm or fingers, following left aside


class CellTable(msgspec.Struct, kw_only=True):
    """The keys of grab.toml."""

    format: int
    table: TableSurface
    workspace: WorkspaceTable
    gripper: GripperTable
    approach: Approach = Approach()
    motion: CellMotion = CellMotion()
    accuracy: ArmAccuracy
    still: StillnessCriterion = StillnessCriterion()
    watchdog: WatchdogLimits = WatchdogLimits()


MIN_DIRECTION_NORM = 1e-6  # of a direction: less is none


@dataclass(frozen=True, slots=True)
class GripperGeometry:
    """What is on the flange: a cylinder about its own z that holds palm and opened fingers."""

    flange_T_grip: Array  # (4, 4); z points out of the palm, the origin is where objects are held
    opening: float  # m, the widest object that goes in
    tips: float  # m, from the grip point to the finger tips
    finger_length: float  # m, free, from the palm to the tips
    radius: float  # m, of the cylinder


@dataclass(frozen=True, slots=True)
class Cell:
    """All of grab.toml."""

    table: TableSurface
    lower: Array  # (3,), m, base frame: the box in which the grip point may be
    upper: Array  # (3,)
    gripper: GripperGeometry
    approach: Approach
    moving: CellMotion
    accuracy: ArmAccuracy
    still: StillnessCriterion
    watch: WatchdogLimits


def read(path: str | Path, joints: int = 6) -> tuple[Cell, tuple[str, ...]]:
    """Read and check a grab.toml; a warning for each key that the format does not know.

    Raises:
        InputError: names the file, the key, what stands there, what should, and what to do.
    """
    path = Path(path)
    with refused_as_input_error(path):
        if not path.exists():
            remedy = "Write it (docs/grab.md shows one), or name another: --cell PATH."
            raise InputError(path, "does not exist", "it describes the cell", remedy)
    table, warnings = decode(path, CellTable)
    lower, upper = (np.array(v) * MM for v in (table.workspace.lower_mm, table.workspace.upper_mm))
    if np.any(lower >= upper):
        axis = "xyz"[int(np.argmax(lower >= upper))]
        found = f"lies above upper_mm in {axis}"
        raise key_error(path, "workspace.lower_mm", found, "each number is below its partner")
    if upper[2] <= table.table.height * MM:
        expected = "the box reaches above the table"
        raise key_error(path, "workspace.upper_mm", f"has z = {upper[2] / MM:g} mm", expected)
    accuracy, motion = table.accuracy, table.motion
    if accuracy.coverage >= 1:
        expected = "a probability below 1 is expected, such as 0.95"
        raise key_error(path, "accuracy.coverage", f"is {accuracy.coverage:g}", expected)
    if np.linalg.norm(table.approach.toward) < MIN_DIRECTION_NORM:
        raise key_error(path, "approach.direction", "has no length", "a direction is expected")
    if motion.share > 1:
        expected = "at most 1, all that the robot may do"
        raise key_error(path, "motion.share", f"is {motion.share:g}", expected)
    if motion.home_deg is not None and len(motion.home_deg) != joints:
        found = f"has {len(motion.home_deg)} angles"
        raise key_error(path, "motion.home_deg", found, f"the robot has {joints} joints")
    cell = Cell(
        _in_metres(table.table),
        lower,
        upper,
        _gripper(path, table.gripper),
        _in_metres(table.approach),
        _in_metres(motion),
        _in_metres(accuracy),
        _in_metres(table.still),
        table.watchdog,
    )
    return cell, warnings


def _lengths(table: msgspec.Struct) -> dict[str, float]:
    """Values of the keys `name_mm`, `name_mm_s` and the like in metres, by name."""
    fields = zip(table.__struct_fields__, table.__struct_encode_fields__, strict=True)
    values = {name: getattr(table, name) for name, key in fields if "_mm" in key}
    floats = {name: value for name, value in values.items() if isinstance(value, float)}
    return {name.partition("_mm")[0]: value * MM for name, value in floats.items()}


def _in_metres(table: Table) -> Table:
    return msgspec.structs.replace(table, **_lengths(table))


def _gripper(path: Path, table: GripperTable) -> GripperGeometry:
    if table.tips_mm >= table.finger_length_mm:
        expected = "the grip point lies between the palm and the tips (finger_length_mm)"
        raise key_error(path, "gripper.tips_mm", f"is {table.tips_mm:g}", expected)
    turn = rotation_exp(np.radians(table.rotation_deg))
    placed = rigid_transform(turn, np.array(table.position_mm) * MM)
    return GripperGeometry(placed, **_lengths(table))
