"""Read a bag or tables into a session's folder, whole or not at all."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

import robots
from verify.cli.terminal import terminal
from verify.core.records import Progress
from verify.errors import InputError
from verify.io import fiducials
from verify.io import rig as io_rig
from verify.io.bags.bag import choose_topics, open_bag
from verify.io.bags.cameras import rig_from_bag
from verify.io.bags.session import BagRequest, BagSession, write_bag_session
from verify.io.files import read_bytes, require_apart, restated, write_folder_whole
from verify.io.joints import RADIANS
from verify.io.logs import mapping as columns_of
from verify.io.logs import session as logs
from verify.io.logs.bodies import require_rotation
from verify.io.logs.table import LogTable, open_log
from verify.io.rows import left_out, unended
from verify.io.session.folder import ROBOT_FILES, SESSION_FILE, copy_robot, load_arm
from verify.io.session.keys import RunTable
from verify.io.session.keys import read as read_keys
from verify.io.toml import FORMAT, encode

CHECK = "Check the mapping above, then give --yes, or --map with what is right."


@dataclass(frozen=True, slots=True)
class ImportOptions:
    """What the user says of a recording; empty where the recording is to say it."""

    robot: str | None
    joint_names: tuple[str, ...]
    topics: tuple[str | None, str | None, str | None]  # left, right, joints
    stamps: str
    rig: Path | None
    marker: Path | None
    angles: str
    lengths: str
    rotation: str
    instrument: str | None
    frame: str
    mapping: tuple[str, ...]
    yes: bool


def convert_bag(sources: Sequence[Path], out: Path, options: ImportOptions, *, force: bool) -> None:
    """Write a session of a bag's pictures and joint readings.

    Raises:
        InputError: the bag or an option cannot be used; nothing is written then.
    """
    (source,) = sources
    require_apart(out, source)
    boards = [name for name in ("board.toml", "left", "right") if (out / name).exists()]
    if boards and not (out / SESSION_FILE).exists():
        found, expected = f"holds {boards[0]}, of board pictures", "a session has its own folder"
        raise InputError(out, found, expected, "Choose another -o.")
    arm, robot, frames = _load_robot(options.robot, out)
    with open_bag(source) as bag:
        topics = choose_topics(bag, *options.topics)
        if options.rig is not None:
            rig, notes = io_rig.read(options.rig, registered=False)
            rig_bytes = read_bytes(options.rig)
        else:
            rig, notes = rig_from_bag(bag, topics.left.name, topics.right.name)
            rig_bytes = io_rig.encode(rig)
        if options.marker is not None:
            fiducials.read_marker(options.marker)
        request = BagRequest(
            topics, arm, options.joint_names, options.angles or RADIANS, options.stamps,
            rig.image_size,
        )  # fmt: skip
        with write_folder_whole(out, force) as folder:
            with terminal.progress("messages") as progress:
                written = write_bag_session(bag, request, folder, progress)
            (folder / "rig.toml").write_bytes(rig_bytes)
            if options.marker is not None:
                (folder / "marker.toml").write_bytes(read_bytes(options.marker))
            keys = _bag_keys(copy_robot(robot, folder), source, written, options)
            (folder / SESSION_FILE).write_bytes(encode(keys | {"robot_frames": frames}))
    terminal.say(f"topics: {', '.join(topic.name for topic in topics)}", *notes, *written.notes)
    if options.stamps != "header":
        terminal.warn(
            "Times are those of recording, not of exposure: delays of the computer count."
        )
    terminal.say(f"{out}: {written.pairs} pairs, {written.readings} readings")
    if options.marker is None or not rig.registered:
        terminal.say(f"Next: verify calibrate register {out}, which finds the robot and the LEDs.")
    terminal.record("result", out=str(out), pairs=written.pairs, readings=written.readings)


def _bag_keys(
    robot: str, source: Path, written: BagSession, options: ImportOptions
) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "robot": robot,
        "description": f"converted from {source.name}",
        "started": written.started,
        "rig": "rig.toml",
        "marker": None if options.marker is None else "marker.toml",
        "left": "left.mkv",
        "right": "right.mkv",
        "frames": "frames.csv",
        "encoders": "encoders.csv",
    }


def _load_robot(robot: str | None, out: Path) -> tuple[robots.Arm, str, dict[str, Any] | None]:
    """Load the robot that --robot names, or the session.toml that stands in `out`.

    With its name or file, and [robot_frames] of that session.toml, where it has some.
    """
    if robot is None:
        path = out / SESSION_FILE
        if not path.is_file():
            expected = "joints are matched and checked by the robot's own"
            remedy = "Give a name that `verify robots` lists, or a robot file or URDF."
            raise InputError("--robot", "is missing", expected, remedy)
        table = read_keys(path, RunTable)[0]
        is_file = Path(table.robot).suffix in ROBOT_FILES
        frames = msgspec.to_builtins(table.robot_frames)
        name = str(out / table.robot) if is_file else table.robot
        return load_arm(path, table), name, frames if any(frames.values()) else None
    with restated(robots.RobotError, place="--robot"):
        return robots.load(robot), robot, None


@dataclass(frozen=True, slots=True)
class MappedTable:
    """A table whose mapping is settled."""

    table: LogTable
    mapping: columns_of.ColumnMapping
    outline: logs.LogOutline


def convert_tables(
    sources: Sequence[Path], out: Path, options: ImportOptions, *, force: bool
) -> None:
    """Write encoders.csv, poses.csv and, with both, session.toml, of one table or several.

    Raises:
        InputError: a table or an option cannot be used, or nobody confirms the mapping; nothing is
            written then.
    """
    if options.rotation:
        require_rotation(options.rotation)
    for source in sources:
        require_apart(out, source, (logs.ENCODERS, logs.POSES, SESSION_FILE))
    tables = [open_log(source) for source in sources]
    needs_robot = options.robot is not None or (out / SESSION_FILE).is_file()
    arm, robot, frames = _load_robot(options.robot, out) if needs_robot else (None, "", None)
    with terminal.progress("kB") as progress:
        mapped = [_settle(table, arm, options, progress) for table in tables]
    joints = [m for m in mapped if m.mapping.joints]
    poses = [m for m in mapped if m.mapping.has_poses]
    for name, found in (("joint readings", joints), ("poses", poses)):
        if len(found) > 1:
            paths = f"{found[0].table.path} and {found[1].table.path}"
            raise InputError(paths, f"hold {name} both", "one table has them", "Give one of them.")
    _confirm(mapped, options)
    with write_folder_whole(out, force) as folder, terminal.progress("kB") as progress:
        written = _write_tables(joints[:1], poses[:1], folder, progress)
        if joints and poses:
            keys = _pose_keys(copy_robot(robot, folder), joints[0], poses[0], options)
            (folder / SESSION_FILE).write_bytes(encode(keys | {"robot_frames": frames}))
            written.append(SESSION_FILE)
    terminal.say(f"{out}: {', '.join(written)}")
    if not poses:
        terminal.say("A session needs pictures or an instrument's poses beside the readings.")
    elif joints and options.frame == "instrument":
        terminal.say(f"Next: [robot_base] in {out / SESSION_FILE}, where the robot stands.")
    terminal.record("result", out=str(out), files=written)


def _settle(
    table: LogTable, arm: robots.Arm | None, options: ImportOptions, progress: Progress
) -> MappedTable:
    """Map a table's columns, settle their units by its values, and check these."""
    if options.mapping:
        mapping = columns_of.parse_mapping(table, options.mapping, options.rotation)
    else:
        mapping = columns_of.propose_mapping(table, arm, options.joint_names)
    if mapping.has_poses and options.instrument is None:
        columns = (c for c in mapping.columns if c.target not in columns_of.POSE_TARGETS)
        mapping = columns_of.ColumnMapping(tuple(columns))
        terminal.warn(
            f"{table.path}: its poses are left out. Those that a controller shows come from its "
            "own encoders and prove nothing; --instrument NAME takes another instrument's."
        )
    if not mapping.joints and not mapping.has_poses:
        names = ", ".join(table.names[:20])
        robot = ", and give --robot" if arm is None else ""
        remedy = f'Name them by --map "q1=COLUMN:rad,…"{robot}.'
        expected = "joint readings, or poses of an instrument, are expected"
        raise InputError(table.path, f"has the columns {names}", expected, remedy)
    if mapping.joints and arm is None:
        remedy = "Give --robot; the readings are checked by its limits."
        raise InputError("--robot", "is missing", "joint readings belong to a robot", remedy)
    if table.cut_off:
        if mapping.time is None:  # rows belong to those of another table by their number
            raise unended(table.path)
        terminal.warn(left_out(table.path))
    if mapping.time is None:
        terminal.warn(
            f"{table.path}: no column is taken for the time, so its rows are visits in order. "
            "Name it by --map if there is one."
        )
    outline = logs.read_outline(table, mapping, progress)
    stated = columns_of.StatedUnits(options.angles, options.lengths, options.rotation)
    mapping = columns_of.settle_units(table, mapping, stated, outline.joints, outline.step)
    if arm is not None:
        logs.require_joints_within(table, mapping, outline, arm)
    return MappedTable(table, mapping, outline)


def _confirm(mapped: Sequence[MappedTable], options: ImportOptions) -> None:
    """Show what each column is taken for, and have the user agree; InputError: nobody did."""
    for m in mapped:
        terminal.say(*logs.proposal_lines(m.table, m.mapping, m.outline))
    terminal.record("mapping", columns=[str(c) for m in mapped for c in m.mapping.columns])
    if options.yes or options.mapping:
        return
    if sys.stdin.isatty() and terminal.draws:
        sys.stdout.write("Correct? [y/N] ")
        sys.stdout.flush()
        if sys.stdin.readline().strip().lower() in ("y", "yes"):
            return
        found = "was not confirmed"
    else:
        found = "is a proposal that nobody has confirmed"
    mapping = ",".join(str(c) for c in mapped[0].mapping.columns)
    raise InputError(mapped[0].table.path, f'the mapping {found}: --map "{mapping}"', "", CHECK)


def _write_tables(
    joints: Sequence[MappedTable], poses: Sequence[MappedTable], folder: Path,
    progress: Progress,
) -> list[str]:  # fmt: skip
    """Write the files; returns their names."""
    written = []
    common = _common_start([*joints, *poses])
    tasks = ((joints, logs.write_encoders, logs.ENCODERS), (poses, logs.write_poses, logs.POSES))
    for tables, write, name in tasks:
        for m in tables:
            start = logs.start_of(m.mapping, m.outline)
            start = start if common is None else common
            repeats = write(m.table, m.mapping, np.longdouble(start), folder / name, progress)
            if repeats:
                terminal.warn(f"{m.table.path}: {repeats} rows repeat a time and are left out.")
            written.append(name)
    return written


def _common_start(tables: Sequence[MappedTable]) -> np.longdouble | None:
    """Time that becomes 0 in all tables, s, if all count from one epoch; else None."""
    starts = [logs.start_of(m.mapping, m.outline) for m in tables]
    one_epoch = all(starts) and max(starts) - min(starts) <= logs.MAX_TIME
    return min(starts) if one_epoch else None


def _pose_keys(
    robot: str, joints: MappedTable, poses: MappedTable, options: ImportOptions
) -> dict[str, Any]:
    time, start, started = joints.mapping.time, _common_start([joints, poses]), None
    if time is not None and time.unit == "date":
        first = logs.start_of(joints.mapping, joints.outline) if start is None else start
        started = datetime.fromtimestamp(float(first), UTC)
    return {
        "format": FORMAT,
        "robot": robot,
        "started": started,
        "encoders": logs.ENCODERS,
        "poses": {
            "file": logs.POSES,
            "instrument": options.instrument or "",
            "frame": options.frame,
        },
    }
