"""A session's folder: what session.toml names in it, and the robot that it speaks of."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import robots
from verify import session_file
from verify.errors import InputError
from verify.files import digest, system_refusal
from verify.rig import Rig
from verify.session_file import RunTable
from verify.toml_file import fault


def session_file_of(folder: Path) -> Path:
    """Find session.toml; say which of the usual mistakes was made."""
    remedy = "Give the folder of a recorded session."
    try:
        is_folder = folder.is_dir()
        path = folder / "session.toml"
        missing = is_folder and not path.exists()
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        refused = error if isinstance(error, OSError) else OSError(str(error))
        raise system_refusal(folder, refused) from error
    if not is_folder:
        found = "is a file" if folder.exists() else "does not exist"
        raise InputError(folder, found, "a session's folder is expected", remedy)
    if missing:
        raise InputError(folder, "has no session.toml", "a session's folder is expected", remedy)
    return path


def inside(folder: Path, path: Path, key: str, text: str) -> Path:
    """Find what a key of session.toml names; it stays in the folder, also through symlinks."""
    expected = "a path inside the session's folder is expected"
    if not text or "\0" in text:
        raise fault(path, key, "names nothing", expected)
    named = folder / text
    if not named.resolve().is_relative_to(folder.resolve()):
        remedy = "Copy the file into the folder and name it there."
        raise fault(path, key, f'is "{text}", outside the folder', expected, remedy)
    if not named.exists():
        raise fault(path, key, f'names "{text}", which does not exist', expected, "Put it there.")
    return named


def _robot_file(folder: Path, path: Path, robot: str) -> Path | None:
    """Find the robot's file in the folder; None where session.toml gives a name instead."""
    is_file = Path(robot).suffix in {".toml", ".urdf"}  # what robots.load takes for one
    return inside(folder, path, "robot", robot) if is_file else None


def arm_of(folder: Path, path: Path, table: RunTable) -> robots.Arm:
    """Load the robot that session.toml names.

    Raises:
        InputError: there is none of that name, or its file is no robot.
    """
    file = _robot_file(folder, path, table.robot)
    chain = table.robot_frames
    try:
        return robots.load(str(file or table.robot), base=chain.base, tip=chain.tip)
    except robots.RobotError as error:
        if file is not None:
            raise InputError(error.place, error.found, error.expected, error.remedy) from error
        found = f"{error.place} {error.found}"
        raise InputError(f"{path}, robot", found, error.expected, error.remedy) from error


def digests(folder: Path, path: Path, robot: str, files: Mapping[str, Path]) -> dict[str, str]:
    """Take the digest of everything that was read, by the name that session.toml gives it.

    Args:
        folder: the session's.
        path: its session.toml.
        robot: as session.toml names it.
        files: what else was read, by its name there.
    """
    read = {path.name: path, **files}
    own = _robot_file(folder, path, robot)
    if own is not None:
        read[robot] = own
    return {name: digest(file) for name, file in read.items()}


def facts(folder: Path, table: RunTable, arm: robots.Arm) -> dict[str, Any]:
    """Fields of a Recording that do not depend on what measured the robot."""
    return {
        "folder": folder,
        "name": folder.resolve().name,
        "arm": arm,
        "robot": table.robot,
        "description": table.description,
        "started": session_file.started(table.started),
        "open": table.recording == "open",
        "clock": session_file.clock(table.clock),
        "encoder_resolution": session_file.radians(table.encoder_readings.resolution_deg),
        "encoder_time_standard_uncertainty": table.encoder_readings.time_standard_uncertainty_s,
        "temperature_c": table.environment.temperature_c,
    }


def check_absorption(path: Path, rig: Rig, joints: int) -> None:
    """Refuse a registration of another robot.

    Raises:
        InputError: its absorption has another number of joints.
    """
    if rig.absorption is not None and rig.absorption.shape[1] != joints:
        found = f"has {rig.absorption.shape[1]} columns"
        remedy = "Register this robot again, or name the right one in session.toml."
        raise fault(path, "robot_base.absorption", found, f"the robot has {joints} joints", remedy)
