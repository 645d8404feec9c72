"""A session's folder: its session.toml, the files and the robot named there, and their digests."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

import robots
from verify.core.rig import Rig
from verify.errors import InputError
from verify.io.files import digest, read_bytes, refused_as_input_error, require_folder, restated
from verify.io.session import keys
from verify.io.session.keys import RunTable
from verify.io.toml import key_error, listed, shorten

SESSION_FILE = "session.toml"
ROBOT_FILES = {".toml", ".urdf"}  # what robots.load takes for a file; else it is a name
MAX_NAMED = 6  # sessions of a folder


def find_session_file(folder: Path) -> Path:
    """Find session.toml in a folder; raises InputError: it is no folder, or holds none."""
    expected, remedy = "a session's folder is expected", "Give the folder of a recorded session."
    require_folder(folder, expected, remedy)
    path = folder / SESSION_FILE
    with refused_as_input_error(folder):
        if path.exists() or path.is_symlink():  # a link without an end is refused when it is read
            return path
        inside = sorted(p.name for p in folder.iterdir() if (p / SESSION_FILE).is_file())
    if inside:
        names = listed(inside, MAX_NAMED)
        remedy = f"Give one of its sessions: {names}; or `verify batch {folder}` for all."
    raise InputError(folder, f"has no {SESSION_FILE}", expected, remedy)


def resolve_inside(path: Path, key: str, text: str) -> Path:
    """Find the file that a key of session.toml names.

    Raises:
        InputError: it names nothing, or what is outside the folder (by symlinks too) or not there.
    """
    expected = "a path inside the session's folder is expected"
    if not text or "\0" in text:
        raise key_error(path, key, "names nothing", expected)
    named = path.parent / text
    with refused_as_input_error(f"{path}, {key}"):
        inside = named.resolve().is_relative_to(path.parent.resolve())
        exists = named.exists()
    if not inside:
        remedy = "Copy the file into the folder and name it there."
        raise key_error(path, key, f"is {shorten(text)}, outside the folder", expected, remedy)
    if not exists:
        found = f"names {shorten(text)}, which does not exist"
        raise key_error(path, key, found, expected, "Put it there.")
    return named


def _robot_file(path: Path, robot: str) -> Path | None:
    """Find the robot's file in the folder; None where session.toml gives a name instead."""
    return resolve_inside(path, "robot", robot) if Path(robot).suffix in ROBOT_FILES else None


def copy_robot(robot: str, folder: Path) -> str:
    """Copy a robot's own file into the session, which must not reach outside; return its name."""
    if Path(robot).suffix not in ROBOT_FILES:
        return robot
    name = Path(robot).name
    name = f"robot_{name}" if name in (SESSION_FILE, "rig.toml", "marker.toml") else name
    (folder / name).write_bytes(read_bytes(Path(robot)))
    return name


def load_arm(path: Path, table: RunTable) -> robots.Arm:
    """Load the robot that session.toml names; InputError: no such name, or its file is no robot."""
    file = _robot_file(path, table.robot)
    chain = table.robot_frames
    with restated(robots.RobotError, place=f"{path}, robot" if file is None else None):
        return robots.load(str(file or table.robot), base=chain.base, tip=chain.tip)


def file_digests(path: Path, robot: str, files: Mapping[str, Path]) -> dict[str, str]:
    """Take the digest of session.toml, the robot's file and others, by their names there."""
    own = _robot_file(path, robot)
    read = {path.name: path, **files, **({} if own is None else {robot: own})}
    return {name: digest(file) for name, file in read.items()}


def recording_fields(
    path: Path, table: RunTable, arm: robots.Arm, *, timed: bool
) -> dict[str, Any]:
    """Fields of a Recording but its measurements; InputError: a clock, and nothing has a time."""
    clock = table.clock
    if not timed:  # row i belongs to row i
        if clock is not None:
            expected = "readings without times have no clock"
            raise key_error(path, "clock", "is given", expected, "Leave it out.")
        clock = keys.Clock(0.0, 0.0)
    return {
        "folder": path.parent,
        "name": path.parent.resolve().name,
        "arm": arm,
        "robot": table.robot,
        "description": table.description,
        "started": msgspec.to_builtins(table.started),
        "open": table.recording == "open",
        "clock": clock,
        "encoder_resolution": keys.to_radians(table.encoder_readings.resolution_deg),
        "encoder_time_standard_uncertainty": table.encoder_readings.time_standard_uncertainty_s,
        "temperature_c": table.environment.temperature_c,
        "certificate": msgspec.to_builtins(table.certificate),
    }


def check_absorption(path: Path, rig: Rig, joints: int) -> None:
    """Refuse, by an InputError, a registration whose absorption has another number of joints."""
    if rig.absorption is not None and rig.absorption.shape[1] != joints:
        found = f"has {rig.absorption.shape[1]} columns"
        expected = f"the robot has {joints} joints"
        remedy = "Register this robot again, or name the right one in session.toml."
        raise key_error(path, "robot_base.absorption", found, expected, remedy)
