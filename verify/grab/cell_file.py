"""grab.toml: the cell in which objects are grasped; millimetres in the file, a Cell in metres."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from robots.transforms import rotation_exp
from verify.grab.cell_file_tables import (
    AccuracyTable,
    ApproachTable,
    GrabTable,
    GripperTable,
    MotionTable,
    StillTable,
    WatchdogTable,
)
from verify.records import Array
from verify.toml_file import decode, fault, not_negative

_MM = 1e-3  # m
SHORTEST = 1e-6  # of a direction: less is none


@dataclass(frozen=True, slots=True)
class Table:
    """What objects stand on; clearances of everything that moves above it."""

    height: float  # m, of its top in the robot's base frame, level
    clearance: float  # m, of arm and palm
    finger_clearance: float  # m, of the finger tips


@dataclass(frozen=True, slots=True)
class Gripper:
    """What is on the flange: a cylinder about its own z that holds palm and opened fingers."""

    flange_T_grip: Array  # (4, 4); z points out of the palm, the origin is where objects are held
    opening: float  # m, the widest object that goes in
    tips: float  # m, from the grip point to the finger tips
    finger_length: float  # m, free, from the palm to the tips
    radius: float  # m, of the cylinder


@dataclass(frozen=True, slots=True)
class Approach:
    """The straight line to the object."""

    direction: Array  # (3,), unit vector, base frame
    height: float  # m, its length
    speed: float  # m/s
    acceleration: float  # m/s²
    jerk: float  # m/s³
    hidden: float  # m before the object from where on the hand may hide it from the cameras


@dataclass(frozen=True, slots=True)
class Moving:
    """How the arm moves, and what it keeps away from."""

    share: float  # of the robot's greatest speed, acceleration and jerk
    link_radius: float  # m, of the arm's links about the lines between their joints
    camera_clearance: float  # m, from a camera's optical centre to arm or hand
    home: Array | None  # (n,), rad: where ways lead through that are not clear directly


@dataclass(frozen=True, slots=True)
class Accuracy:
    """How well the arm goes where it is told."""

    robot: float  # m, standard uncertainty of the grip point's place, a coordinate
    coverage: float  # probability with which the object must be between the fingers


@dataclass(frozen=True, slots=True)
class Stillness:
    """When a target counts as still."""

    speed: float  # m/s
    duration: float  # s


@dataclass(frozen=True, slots=True)
class WatchLimits:
    """After how long nothing is trusted any more, s."""

    stale: float  # since the newest pair of pictures was taken
    lost: float  # since the target was last tracked
    joints: float  # since the newest reading of the joints
    moving: float  # in one state that moves arm or fingers, following left aside


@dataclass(frozen=True, slots=True)
class Cell:
    """All of grab.toml."""

    table: Table
    lower: Array  # (3,), m, base frame: the box in which the grip point may be
    upper: Array  # (3,)
    gripper: Gripper
    approach: Approach
    moving: Moving
    accuracy: Accuracy
    still: Stillness
    watch: WatchLimits


def read(path: str | Path, joints: int = 6) -> tuple[Cell, tuple[str, ...]]:
    """Read and check a grab.toml.

    Args:
        path: the file.
        joints: how many the robot has.

    Returns:
        The cell, and a warning for each key that the format does not know.

    Raises:
        InputError: names the file, the key, what stands there, what should, and what to do.
    """
    path = Path(path)
    table, warnings = decode(path, GrabTable)
    _check_signs(path, table)
    lower, upper = (np.array(v) * _MM for v in (table.workspace.lower_mm, table.workspace.upper_mm))
    if np.any(lower >= upper):
        axis = "xyz"[int(np.argmax(lower >= upper))]
        found = f"lies above upper_mm in {axis}"
        raise fault(path, "workspace.lower_mm", found, "each number is below its partner")
    if upper[2] <= table.table.height_mm * _MM:
        expected = "the box reaches above the table"
        raise fault(path, "workspace.upper_mm", f"has z = {upper[2] / _MM:g} mm", expected)
    cell = Cell(
        table=Table(
            table.table.height_mm * _MM,
            table.table.clearance_mm * _MM,
            table.table.finger_clearance_mm * _MM,
        ),
        lower=lower,
        upper=upper,
        gripper=_gripper(path, table.gripper),
        approach=_approach(path, table.approach),
        moving=_moving(path, table.motion, joints),
        accuracy=_accuracy(path, table.accuracy),
        still=_still(table.still),
        watch=_watch(table.watchdog),
    )
    return cell, warnings


def _check_signs(path: Path, table: GrabTable) -> None:
    """Refuse numbers that only make sense from 0, or above 0."""
    for name in ("table", "gripper", "approach", "motion", "accuracy", "still", "watchdog"):
        part = getattr(table, name)
        for key in part.__struct_fields__:
            value = getattr(part, key)
            if not isinstance(value, float) or (key == "height_mm" and name == "table"):
                continue
            not_negative(path, f"{name}.{key}", value)
            if value == 0 and f"{name}.{key}" in _ABOVE_ZERO:
                raise fault(path, f"{name}.{key}", "is 0", "a number above 0 is expected")


_ABOVE_ZERO = {
    *(f"gripper.{key}_mm" for key in ("opening", "tips", "finger_length", "radius")),
    *("approach.height_mm", "approach.speed_mm_s", "approach.acceleration_mm_s2"),
    *("approach.jerk_mm_s3", "motion.share", "accuracy.coverage", "still.speed_mm_s"),
    *(f"watchdog.{key}_s" for key in ("stale", "lost", "joints", "moving")),
}


def _gripper(path: Path, table: GripperTable) -> Gripper:
    if table.tips_mm >= table.finger_length_mm:
        found = f"is {table.tips_mm:g}"
        expected = "the grip point lies between the palm and the tips (finger_length_mm)"
        raise fault(path, "gripper.tips_mm", found, expected)
    placed = np.eye(4)
    placed[:3, :3] = rotation_exp(np.radians(table.rotation_deg))
    placed[:3, 3] = np.array(table.position_mm) * _MM
    return Gripper(
        flange_T_grip=placed,
        opening=table.opening_mm * _MM,
        tips=table.tips_mm * _MM,
        finger_length=table.finger_length_mm * _MM,
        radius=table.radius_mm * _MM,
    )


def _approach(path: Path, table: ApproachTable) -> Approach:
    direction = np.array(table.direction)
    length = float(np.linalg.norm(direction))
    if length < SHORTEST:
        raise fault(path, "approach.direction", "has no length", "a direction is expected")
    return Approach(
        direction=direction / length,
        height=table.height_mm * _MM,
        speed=table.speed_mm_s * _MM,
        acceleration=table.acceleration_mm_s2 * _MM,
        jerk=table.jerk_mm_s3 * _MM,
        hidden=table.hidden_mm * _MM,
    )


def _moving(path: Path, table: MotionTable, joints: int) -> Moving:
    if table.share > 1:
        expected = "at most 1, all that the robot may do"
        raise fault(path, "motion.share", f"is {table.share:g}", expected)
    home = None
    if table.home_deg is not None:
        if len(table.home_deg) != joints:
            found = f"has {len(table.home_deg)} angles"
            raise fault(path, "motion.home_deg", found, f"the robot has {joints} joints")
        home = np.radians(table.home_deg)
    return Moving(
        share=table.share,
        link_radius=table.link_radius_mm * _MM,
        camera_clearance=table.camera_clearance_mm * _MM,
        home=home,
    )


def _accuracy(path: Path, table: AccuracyTable) -> Accuracy:
    if table.coverage >= 1:
        expected = "a probability below 1 is expected, such as 0.95"
        raise fault(path, "accuracy.coverage", f"is {table.coverage:g}", expected)
    return Accuracy(table.robot_standard_uncertainty_mm * _MM, table.coverage)


def _still(table: StillTable) -> Stillness:
    return Stillness(table.speed_mm_s * _MM, table.for_s)


def _watch(table: WatchdogTable) -> WatchLimits:
    return WatchLimits(table.stale_s, table.lost_s, table.joints_s, table.moving_s)
