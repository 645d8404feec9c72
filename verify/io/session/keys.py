"""The keys of session.toml: structs that mirror the file, their checks, and their SI values."""

from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Annotated, TypeVar

import msgspec
import numpy as np

from verify.core.records import Array
from verify.io.fiducials import SOURCES as BODY_SOURCES
from verify.io.fiducials import BodyUncertaintyTable
from verify.io.rig import BaseTable, CovarianceTable, Matrix, Triple
from verify.io.toml import MM, decode, key_error, not_negative, one_of, parse, scaled

RECORDING_STATES = ("open", "closed")
POSE_FRAMES = ("robot_base", "instrument", "rig")  # that an instrument's poses may be in
PICTURE_KEYS = ("left", "right", "frames", "marker")  # keys that [poses] replaces


CLOCK_KEYS = {
    "encoder_offset": "encoder_offset_s",
    "standard_uncertainty": "encoder_offset_standard_uncertainty_s",
}


class Clock(msgspec.Struct, frozen=True, rename=CLOCK_KEYS):
    """[clock]: the given offset between the controller's clock and the cameras'."""

    encoder_offset: float  # s, added to an encoder's time gives the cameras' clock
    standard_uncertainty: float | None = None  # s


class ReadingsTable(msgspec.Struct, kw_only=True):
    """The keys of [encoder_readings]."""

    resolution_deg: float | None = None
    time_standard_uncertainty_s: float | None = None


class ToleranceTable(msgspec.Struct, kw_only=True):
    """The keys of [tolerance]."""

    joints_deg: float | list[float] | None = None
    position_mm: float | None = None
    orientation_deg: float | None = None


class EnvironmentTable(msgspec.Struct, kw_only=True):
    """The keys of [environment]."""

    temperature_c: float | None = None


Words = Annotated[str, msgspec.Meta(max_length=80)]  # what a line of the certificate holds


class CertificateTable(msgspec.Struct, kw_only=True, omit_defaults=True):
    """The keys of [certificate]: what only its owner knows of the robot and the instrument."""

    maker: Words = ""
    model: Words = ""
    serial_number: Words = ""
    owner: Words = ""
    place: Words = ""
    operator: Words = ""
    instrument: Words = ""
    calibrated: date | None = None
    issued: date | None = None


class RobotFramesTable(msgspec.Struct, kw_only=True):
    """The keys of [robot_frames]."""

    base: str | None = None
    tip: str | None = None


class TimeInterval(msgspec.Struct, frozen=True, rename={"start": "t_start_s", "end": "t_end_s"}):
    """[[pose]] and [[path]]: a visit of a pose, a passage of a path."""

    name: str
    start: float  # s, cameras' clock
    end: float


class PosesTable(msgspec.Struct, kw_only=True):
    """The keys of [poses]."""

    file: str
    instrument: str
    frame: str
    position_standard_uncertainty_mm: float | None = None
    orientation_standard_uncertainty_deg: float | None = None
    point_mm: Triple | None = None  # None: nobody says where; the flange's origin is measured with
    rotation: Matrix | None = None
    source: str | None = None
    body_standard_uncertainty: BodyUncertaintyTable | None = None


class RunTable(msgspec.Struct, kw_only=True):
    """The keys of session.toml that every session may have."""

    format: int
    robot: str
    description: str = ""
    started: datetime | None = None
    recording: str = "closed"
    encoders: str
    clock: Clock | None = None
    encoder_readings: ReadingsTable = msgspec.field(default_factory=ReadingsTable)
    tolerance: ToleranceTable | None = None
    environment: EnvironmentTable = msgspec.field(default_factory=EnvironmentTable)
    certificate: CertificateTable = msgspec.field(default_factory=CertificateTable)
    robot_frames: RobotFramesTable = msgspec.field(default_factory=RobotFramesTable)
    pose: list[TimeInterval] = []
    path: list[TimeInterval] = []


class RecordingTable(RunTable, kw_only=True):
    """The keys of session.toml, where the robot and its LEDs need not be registered yet."""

    rig: str | None = None
    marker: str | None = None
    left: str
    right: str
    frames: str


class PosesSessionTable(RunTable, kw_only=True):
    """The keys of session.toml with an instrument's poses in place of pictures."""

    poses: PosesTable
    rig: str | None = None
    robot_base: BaseTable | None = None
    covariance: CovarianceTable | None = None
    left: str | None = None
    right: str | None = None
    frames: str | None = None
    marker: str | None = None


T = TypeVar("T", bound=RunTable)


@dataclass(frozen=True, slots=True)
class Tolerance:
    """Permissible errors of the robot; None where none is given."""

    joints: Array | None = None  # (n,), rad, bounds the error at every pose
    position: float | None = None  # m
    orientation: float | None = None  # rad


def read(path: Path, kind: type[T]) -> tuple[T, tuple[str, ...]]:
    """Read session.toml and check what needs no other file; a warning for each unknown key.

    Raises:
        InputError: names the key, what stands there, what should, and what to do.
    """
    table, warnings = decode(path, kind)
    one_of(path, "recording", table.recording, RECORDING_STATES)
    check_clock(path, table.clock)
    for key in ("resolution_deg", "time_standard_uncertainty_s"):
        not_negative(path, f"encoder_readings.{key}", getattr(table.encoder_readings, key))
    for key, intervals in (("pose", table.pose), ("path", table.path)):
        for index, interval in enumerate(intervals):
            place = f"{key}[{index}]"
            if not interval.name.strip():
                raise key_error(path, f"{place}.name", "is empty", "a name is expected")
            if interval.end <= interval.start:
                expected = f"a time after t_start_s, {interval.start}, is expected"
                raise key_error(path, f"{place}.t_end_s", f"is {interval.end}", expected)
    return table, warnings


def check_clock(path: Path, clock: Clock | None) -> None:
    """Refuse a negative uncertainty of [clock]; the InputError names the key."""
    if clock is not None:
        key = CLOCK_KEYS["standard_uncertainty"]
        not_negative(path, f"clock.{key}", clock.standard_uncertainty)


def has_poses(path: Path) -> bool:
    """Whether session.toml has [poses] in place of pictures; raises InputError: it is not TOML."""
    return "poses" in parse(path)


def read_poses(path: Path, *, registered: bool = True) -> tuple[PosesSessionTable, tuple[str, ...]]:
    """Read session.toml with an instrument's poses in place of pictures, as `read` does.

    With `registered` False it need not say where the robot stands in the instrument's frame.
    """
    table, warnings = read(path, PosesSessionTable)
    for key in PICTURE_KEYS:
        if getattr(table, key) is not None:
            expected = "a session has one or the other"
            remedy = "Leave it out, or leave out [poses]."
            raise key_error(path, key, "stands beside [poses]", expected, remedy)
    poses = table.poses
    if not poses.instrument.strip():
        raise key_error(path, "poses.instrument", "is empty", "the instrument's name is expected")
    one_of(path, "poses.frame", poses.frame, POSE_FRAMES)
    if poses.source is not None:
        one_of(path, "poses.source", poses.source, BODY_SOURCES)
    for key in ("position_standard_uncertainty_mm", "orientation_standard_uncertainty_deg"):
        _positive(path, f"poses.{key}", getattr(poses, key), "a standard uncertainty")
    _check_frame(path, table, registered=registered)
    return table, warnings


def _check_frame(path: Path, table: PosesSessionTable, *, registered: bool) -> None:
    """Require the key that carries the poses to the robot's base, and refuse others."""
    frame = table.poses.frame
    wanted = {"rig": "rig", "instrument": "robot_base"}.get(frame)
    for key in ("rig", "robot_base"):
        given = getattr(table, key) is not None
        if key == wanted and not given and (registered or key == "rig"):
            expected = f'it says where the robot stands in poses.frame, "{frame}"'
            remedy = "Register the robot first: `verify calibrate register`; or add it there."
            raise key_error(path, key, "is missing", expected, remedy)
        if given and key != wanted:
            expected = f'poses in the frame "{frame}" do not ask for it'
            remedy = "Leave it out, or correct poses.frame."
            raise key_error(path, key, "is given", expected, remedy)
    if table.covariance is not None and frame == "rig":
        raise key_error(path, "covariance", "is given", "that of rig.toml counts", "Leave it out.")


def tolerance(path: Path, table: ToleranceTable | None, joints: int) -> Tolerance | None:
    """[tolerance] in rad and m, one number for all joints; InputError: not positive, bad length."""
    if table is None or table == ToleranceTable():
        return None
    given = table.joints_deg
    if isinstance(given, list):
        if len(given) != joints:
            expected = f"one number, or one for each of the {joints} joints, is expected"
            raise key_error(path, "tolerance.joints_deg", f"is a list of {len(given)}", expected)
        for index, value in enumerate(given):
            _positive(path, f"tolerance.joints_deg[{index}]", value)
    else:
        _positive(path, "tolerance.joints_deg", given)
    angles = given if isinstance(given, list) else [given] * joints
    _positive(path, "tolerance.position_mm", table.position_mm)
    _positive(path, "tolerance.orientation_deg", table.orientation_deg)
    return Tolerance(
        joints=None if given is None else np.deg2rad(np.array(angles, dtype=float)),
        position=scaled(table.position_mm, MM),
        orientation=to_radians(table.orientation_deg),
    )


def parse_start(text: str | None) -> datetime | None:
    """Read a session's start, ISO 8601; a time without a zone is taken as UTC."""
    if text is None:
        return None
    read = datetime.fromisoformat(text)
    return read.replace(tzinfo=UTC) if read.tzinfo is None else read.astimezone(UTC)


def to_radians(degrees: float | None) -> float | None:
    """Convert an angle; None stays None."""
    return scaled(degrees, np.pi / 180)


def _positive(path: Path, key: str, value: float | None, what: str = "a tolerance") -> None:
    if value is not None and value <= 0:
        raise key_error(path, key, f"is {value}", f"{what} is positive")
