"""A session's folder: what session.toml names in it, and the robot that it speaks of.

The last pairs of a recording that was cut off: they are in pending.raw, not in the videos.
"""

from collections.abc import Generator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

import robots
from verify.core.records import Image
from verify.core.rig import Rig
from verify.errors import InputError
from verify.io.files import digest, system_refusal
from verify.io.series import FrameSeries
from verify.io.session import keys
from verify.io.session.keys import RunTable
from verify.io.toml import key_error
from verify.io.unfinished import NAME, UnfinishedPair, UnfinishedPicture, pending_pairs
from verify.io.video import Images


def find_session_file(folder: Path) -> Path:
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


def resolve_inside(folder: Path, path: Path, key: str, text: str) -> Path:
    """Find what a key of session.toml names; it stays in the folder, also through symlinks."""
    expected = "a path inside the session's folder is expected"
    if not text or "\0" in text:
        raise key_error(path, key, "names nothing", expected)
    named = folder / text
    if not named.resolve().is_relative_to(folder.resolve()):
        remedy = "Copy the file into the folder and name it there."
        raise key_error(path, key, f'is "{text}", outside the folder', expected, remedy)
    if not named.exists():
        raise key_error(
            path, key, f'names "{text}", which does not exist', expected, "Put it there."
        )
    return named


def _robot_file(folder: Path, path: Path, robot: str) -> Path | None:
    """Find the robot's file in the folder; None where session.toml gives a name instead."""
    is_file = Path(robot).suffix in {".toml", ".urdf"}  # what robots.load takes for one
    return resolve_inside(folder, path, "robot", robot) if is_file else None


def load_arm(folder: Path, path: Path, table: RunTable) -> robots.Arm:
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


def file_digests(folder: Path, path: Path, robot: str, files: Mapping[str, Path]) -> dict[str, str]:
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


def recording_fields(folder: Path, table: RunTable, arm: robots.Arm) -> dict[str, Any]:
    """Fields of a Recording that do not depend on what measured the robot."""
    return {
        "folder": folder,
        "name": folder.resolve().name,
        "arm": arm,
        "robot": table.robot,
        "description": table.description,
        "started": keys.format_start(table.started),
        "open": table.recording == "open",
        "clock": keys.clock(table.clock),
        "encoder_resolution": keys.to_radians(table.encoder_readings.resolution_deg),
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
        raise key_error(
            path, "robot_base.absorption", found, f"the robot has {joints} joints", remedy
        )


Sides = tuple[Images, Images]


class UnfinishedImages(Images):
    """A camera's images up to one, and those that were not encoded any more.

    Args:
        before: the images.
        count: how many of them.
        after: the others.
    """

    def __init__(self, before: Images, count: int, after: Sequence[UnfinishedPicture]) -> None:
        super().__init__(before.path)
        self._before, self._count, self._after = before, count, after

    def count(self, torn: bool = False) -> int:
        """Count the images; none of them is damaged, or it would not be counted here."""
        del torn
        return self._count + len(self._after)

    def images(self) -> Generator[Image]:
        """Decode the images one after the other."""
        yield from islice(self._before.images(), self._count)
        for picture in self._after:
            yield picture.read()


def append_unfinished(
    folder: Path, frames: FrameSeries, sides: Sides
) -> tuple[FrameSeries, Sides, int]:
    """Add the pairs that were set aside.

    Args:
        folder: the session's.
        frames: the pairs that the videos hold, all of them whole.
        sides: the videos.

    Returns:
        Frames and sides with the others, and how many those are.

    Raises:
        InputError: pending.raw cannot be read.
    """
    count = len(frames)
    pending = pending_pairs(folder / NAME, count)
    if not pending:
        return frames, sides, 0
    left, right = (
        UnfinishedImages(images, count, [pair.pictures[side] for pair in pending])
        for side, images in enumerate(sides)
    )
    return _join_frames(frames, pending), (left, right), len(pending)


def _join_frames(frames: FrameSeries, pending: list[UnfinishedPair]) -> FrameSeries:
    told = np.array([(*pair.t, *pair.pan) for pair in pending])
    before = (frames.t_left, frames.t_right, frames.pan_left, frames.pan_right)
    return FrameSeries(*(np.append(old, new) for old, new in zip(before, told.T, strict=True)))
