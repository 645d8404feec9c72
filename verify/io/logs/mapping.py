"""Which column of a table is what: proposed from the header, shown, and checked by the values.

A name may end with its unit: `time [ms]`, `J1_deg`. What the names alone do not settle is a guess:
the proposal marks it, and what a guess could get wrong without a sign is asked for instead.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

import robots
from verify.errors import InputError
from verify.io.joints import DEGREES, RADIANS, JointRange, match_joint_names
from verify.io.logs.table import LogTable
from verify.io.toml import did_you_mean

TIME = "t_s"
POSITION = ("x", "y", "z")
QUATERNION = ("qw", "qx", "qy", "qz")
ANGLES = ("r1", "r2", "r3")
POINTS = tuple(f"p{point}{axis}" for point in (1, 2, 3) for axis in "xyz")
POSE_TARGETS = (*POSITION, *QUATERNION, *ANGLES, *POINTS)
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "date": 1.0}  # s
LENGTH_UNITS = {"mm": 1.0, "m": 1e3, "um": 1e-3}  # mm
MAX_RADIANS = 2 * np.pi * 1.001  # one turn either way: more is in degrees
MAX_STEP = {"s": 1.0, "ms": 500.0, "us": 5e5}  # median from row to row, where no unit is stated

_UNIT = re.compile(
    r"(?P<stem>.*?)(?:[\s_]*[\[(/]\s*|[\s_]+)"
    r"(?P<unit>deg|degrees?|rad|radians?|°|s|sec|seconds?|ms|[uµ]s|ns|mm|m|[uµ]m)\s*[\])]?",
    re.IGNORECASE,
)
_UNIT_NAMES = {
    "degree": DEGREES, "degrees": DEGREES, "°": DEGREES, "radian": RADIANS, "radians": RADIANS,
    "sec": "s", "second": "s", "seconds": "s", "µs": "us", "µm": "um",
}  # fmt: skip
_OTHER_UNIT = re.compile(r".*[\[(]\s*(?P<unit>[^\W\d][^\[\]()]*?)\s*[\])]\s*")
# of columns that are numbered as joints are, and hold no reading of an encoder
_NO_READING = re.compile(
    r"vel|speed|accel|torque|effort|current|temperature|voltage|target|command|desired|setpoint|"
    r"soll|aspos|(?<![^\W\d_])(qdd?|dd?q|tau|cmd|ref|set|err|error|temp|acc)(?![^\W\d_])"
)
# an array of a ROS message: which joint is which, its names say and not its numbers
_UNNAMED = re.compile(r"(.*[^a-z])?(?<!joint[_. ])(?<!axis[_. ])positions?[\[._ ]*\d+\]?")
_TIMES = ("t", "time", "timestamp", "zeit", "time stamp", "datetime", "date", "zeitstempel")
# names of readings by maker, with the unit that its documents state
MAKERS = (
    ("UR, RTDE", re.compile(r"actual_q_([0-5])"), 0, RADIANS, True),
    ("KUKA", re.compile(r"\$?(?:axis_act(?:_meas)?[._ ]?)?a([1-9]\d?)"), 1, DEGREES, False),
    ("ABB", re.compile(r"rax_([1-9]\d?)"), 1, DEGREES, False),
    ("Fanuc", re.compile(r"j(?:oint)?[ _]?([1-9]\d?)"), 1, DEGREES, False),
)
# names of three angles, with the axes that they turn about and their unit; capitals: moving axes
EULER = (
    ("KUKA", ("a", "b", "c"), "ZYX", DEGREES),
    ("Fanuc", ("w", "p", "r"), "xyz", DEGREES),
    ("ABB", ("ez", "ey", "ex"), "ZYX", DEGREES),
    ("roll, pitch, yaw", ("roll", "pitch", "yaw"), "xyz", ""),
    ("", ("rx", "ry", "rz"), "", ""),
)


@dataclass(frozen=True, slots=True)
class MappedColumn:
    """A column, what it is, and in which unit."""

    column: str
    target: str  # t_s; q1, q2, …; x, y, z; qw, …; r1, r2, r3; p1x, …
    unit: str = ""
    reason: str = ""  # why, where the name does not say it: a guess

    def __str__(self) -> str:
        return f"{self.target}={self.column}{f':{self.unit}' if self.unit else ''}"


@dataclass(frozen=True, slots=True)
class ColumnMapping:
    """What a table holds."""

    columns: tuple[MappedColumn, ...]
    rotation: str = ""  # rotvec, quaternion, or axes of Euler angles as scipy writes them

    def of(self, targets: Sequence[str]) -> tuple[MappedColumn, ...]:
        """Columns of these targets, in this order; () unless there are all."""
        found = {column.target: column for column in self.columns}
        return tuple(found[t] for t in targets if t in found) if set(targets) <= set(found) else ()

    @property
    def joints(self) -> tuple[MappedColumn, ...]:
        """Columns of the joints, in order."""
        found = [c for c in self.columns if re.fullmatch(r"q[1-9]\d*", c.target)]
        return tuple(sorted(found, key=lambda column: int(column.target[1:])))

    @property
    def time(self) -> MappedColumn | None:
        """The column of the time; None: there is none."""
        return next((c for c in self.columns if c.target == TIME), None)

    @property
    def has_poses(self) -> bool:
        """Whether there are positions or points."""
        return bool(self.of(POSITION) or self.of(POINTS))


def parse_name(name: str) -> tuple[str, str]:
    """Separate a column's name from its unit: ("time", "ms"); the unit is empty where none is."""
    parts = _UNIT.fullmatch(name.strip())
    if parts is None or not parts["stem"]:
        return name.strip().lower(), ""
    unit = parts["unit"].lower()
    return parts["stem"].strip(" _").lower(), _UNIT_NAMES.get(unit, unit)


def propose_mapping(
    table: LogTable, arm: robots.Arm | None, joint_names: Sequence[str] = ()
) -> ColumnMapping:
    """Propose a mapping from the header; units are empty where the names do not state them."""
    named = {column: parse_name(column) for column in table.names}
    columns = [*_propose_time(table, named), *_propose_joints(table, named, arm, joint_names)]
    taken = {column.column for column in columns}
    rest = {column: parsed for column, parsed in named.items() if column not in taken}
    pose, rotation = _propose_pose(table, rest)
    return ColumnMapping((*columns, *pose), rotation)


def _propose_time(table: LogTable, named: Mapping[str, tuple[str, str]]) -> list[MappedColumn]:
    for column, (stem, unit) in named.items():
        if stem.strip("_%") in _TIMES or column == TIME:
            if table.is_date(column):
                return [MappedColumn(column, TIME, "date")]
            return [MappedColumn(column, TIME, unit if unit in TIME_UNITS else "")]
    return []


def _propose_joints(
    table: LogTable,
    named: Mapping[str, tuple[str, str]],
    arm: robots.Arm | None,
    given: Sequence[str],
) -> list[MappedColumn]:
    """Columns of the joints; none where there is no arm, or nothing looks like its joints."""
    if arm is None:
        return []
    if not given:
        for maker, pattern, first, unit, certain in MAKERS:
            found = {}
            for column, (stem, stated) in named.items():
                if parts := pattern.fullmatch(stem):
                    found[int(parts[1]) - first] = column, stated
            if sorted(found) == list(range(arm.dof)):
                reason = "" if certain else f"as {maker} writes it"
                return [
                    MappedColumn(found[j][0], f"q{j + 1}", found[j][1] or unit,
                                 "" if found[j][1] else reason)
                    for j in range(arm.dof)
                ]  # fmt: skip
    angles = [
        column for column, (_, unit) in named.items()
        if given or (
            unit in (DEGREES, RADIANS, "")
            and not (_NO_READING.search(column.lower()) or _UNNAMED.fullmatch(column.lower()))
        )
    ]  # fmt: skip
    stems = {column if given else named[column][0]: column for column in angles}
    try:
        names = match_joint_names(table.path, list(stems), arm, given)
    except InputError:
        if given:
            raise
        return []
    return [
        MappedColumn(stems[name], f"q{j}", named[stems[name]][1])
        for j, name in enumerate(names, start=1)
    ]


def _propose_pose(
    table: LogTable, named: Mapping[str, tuple[str, str]]
) -> tuple[list[MappedColumn], str]:
    """Columns of positions and orientations, or of three points, and how they turn.

    Raises:
        InputError: the poses are of several targets.
    """
    stems = {stem: (column, unit) for column, (stem, unit) in named.items()}

    def take(
        names: Sequence[str], targets: Sequence[str], unit: str = "", reason: str = ""
    ) -> list[MappedColumn]:
        if not set(names) <= set(stems):
            return []
        found = [stems[name] for name in names]
        return [
            MappedColumn(column, target, stated or unit, "" if stated else reason)
            for (column, stated), target in zip(found, targets, strict=True)
        ]

    for form in ("p{n}{a}", "p{n}_{a}", "{a}{n}", "{a}_{n}", "point{n}_{a}"):
        corners = [form.format(n=n, a=a) for n in (1, 2, 3) for a in "xyz"]
        if points := take(corners, POINTS):
            return points, ""
    position: list[MappedColumn] = []
    for form in ("{a}", "pos_{a}", "position_{a}", "position.{a}", "t{a}"):
        position = position or take([form.format(a=a) for a in POSITION], POSITION)
    if not position:
        return [], ""
    if "target" in stems:
        found = f'has a column "{stems["target"][0]}"'
        remedy = "Export each target alone, or write poses.csv with its column target yourself."
        raise InputError(table.path, found, "poses of one target are expected", remedy)
    for form in ("q{a}", "q_{a}", "orientation.{a}", "orientation_{a}"):
        if turn := take([form.format(a=a) for a in "wxyz"], QUATERNION):
            return [*position, *turn], "quaternion"
    for maker, names, axes, unit in EULER:
        reason = f"{axes} as {maker} writes it" if axes else ""
        if turn := take(names, ANGLES, unit, reason):
            return [*position, *turn], axes
    return position, ""


def parse_mapping(table: LogTable, texts: Sequence[str], rotation: str) -> ColumnMapping:
    """Read what --map gives: TARGET=COLUMN[:UNIT], with commas between or repeated.

    Raises:
        InputError: no such column, no such target or unit.
    """
    columns: list[MappedColumn] = []
    for text in (part for given in texts for part in given.split(",") if part.strip()):
        target, _, rest = text.strip().partition("=")
        column, _, unit = rest.rpartition(":")
        if rest in table.names or not column:
            column, unit = rest, ""
        if target != TIME and target not in POSE_TARGETS and not re.fullmatch(r"q[1-9]\d*", target):
            expected = "known are t_s, q1, q2, …, x, y, z, qw, qx, qy, qz, r1, r2, r3, p1x … p3z"
            raise InputError("--map", f'"{target}" is no target', expected)
        if column not in table.names:
            found = f'{table.path} has no column "{column}"'
            hint = did_you_mean(column, table.names).strip()
            raise InputError("--map", found, f"it has {', '.join(table.names[:20])}", hint)
        for c in columns:
            if c.target == target:
                raise InputError("--map", f"{target} stands twice", "each target has one column")
            if c.column == column:
                found = f'"{column}" is {c.target} and {target}'
                raise InputError("--map", found, "each column has one target")
        columns.append(MappedColumn(column, target, unit or parse_name(column)[1]))
    _require_whole_groups({c.target for c in columns})
    turns = rotation or ("quaternion" if any(c.target == "qw" for c in columns) else "")
    return ColumnMapping(tuple(columns), turns)


def _require_whole_groups(targets: set[str]) -> None:
    """Refuse, by an InputError, half a position or orientation, or two of one kind."""
    for group in (POSITION, QUATERNION, ANGLES, POINTS):
        missing = [target for target in group if target not in targets]
        if missing and len(missing) < len(group):
            found = f"names no {', '.join(missing)}"
            raise InputError("--map", found, f"{', '.join(group)} go together")
    for group, other in ((QUATERNION, ANGLES), (POSITION, POINTS)):
        if targets >= {*group, *other}:
            found = f"names {group[0]} and {other[0]}"
            raise InputError("--map", found, "a body has one pose", "Leave one group out.")


@dataclass(frozen=True, slots=True)
class StatedUnits:
    """Units that the user states for all columns of a kind; empty where nothing was."""

    angles: str = ""
    lengths: str = ""
    rotation: str = ""


def settle_units(
    table: LogTable,
    mapping: ColumnMapping,
    stated: StatedUnits,
    spread: JointRange | None,
    step: float,
) -> ColumnMapping:
    """Fill in the units that the names do not state.

    Args:
        table: The table.
        mapping: Its columns, some without a unit.
        stated: The user's own units.
        spread: Least and greatest reading of each joint, as written; None: no joints.
        step: Median step of the time from row to row, as written; nan: no time.

    Raises:
        InputError: a unit that neither the names nor the values settle; names the option.
    """
    settled = []
    for c in mapping.columns:
        unit, reason = c.unit, c.reason
        if c.target == TIME:
            unit, reason = _time_unit(table, c, step)
        elif c in mapping.joints and spread is not None:
            unit, reason = _joint_unit(table, c, stated.angles, spread)
        elif c.target in (*POSITION, *POINTS):
            unit = _agreed_unit(table, c, stated.lengths, "--lengths")
            _require_unit(table, c, unit, LENGTH_UNITS, "--lengths mm or --lengths m")
        elif c.target in ANGLES:
            unit = _agreed_unit(table, c, stated.angles, "--angles")
            _require_unit(table, c, unit, (DEGREES, RADIANS), "--angles deg or --angles rad")
        settled.append(MappedColumn(c.column, c.target, unit, reason))
    rotation = stated.rotation or mapping.rotation
    turn = mapping.of(QUATERNION) or mapping.of(ANGLES)
    if turn and rotation and (rotation == "quaternion") != (len(turn) == len(QUATERNION)):
        found = f"is {rotation}, and {', '.join(c.column for c in turn)} are {len(turn)} numbers"
        expected = "a quaternion has four numbers, another rotation three"
        raise InputError("--rotation", found, expected, "Leave it out, or map other columns.")
    if mapping.of(ANGLES) and not rotation:
        names = ", ".join(c.column for c in mapping.of(ANGLES))
        found = f"does not say what {names} are"
        remedy = "Say it: --rotation rotvec, or the axes: --rotation xyz (fixed), ZYX (moving)."
        raise InputError(table.path, found, "a rotation vector or Euler angles", remedy)
    return ColumnMapping(tuple(settled), rotation)


def _agreed_unit(table: LogTable, c: MappedColumn, stated: str, option: str) -> str:
    """A column's unit: the one stated for all columns, else its own; InputError: they differ."""
    if stated and c.unit and not c.reason and c.unit != stated:
        found = f'"{c.column}" is in {c.unit}, and {option} says {stated}'
        example = f'"{c.target}={c.column}:{stated},…"'
        remedy = f"Leave {option} out, or name every column by --map: {example}."
        raise InputError(table.path, found, "each column has one unit", remedy)
    return stated or c.unit


def _require_unit(
    table: LogTable,
    c: MappedColumn,
    unit: str,
    known: Sequence[str] | Mapping[str, float],
    remedy: str,
) -> None:
    if unit not in known:
        found = f'{unit} of "{c.column}"' if unit else f'does not state the unit of "{c.column}"'
        expected = f"{' or '.join(known)} is expected"
        raise InputError(table.path, found, expected, f"State it: {remedy}.")


def _time_unit(table: LogTable, c: MappedColumn, step: float) -> tuple[str, str]:
    if c.unit:
        _require_unit(table, c, c.unit, TIME_UNITS, "--map t_s=COLUMN:ms")
        return c.unit, c.reason
    if step == 1.0:  # a counter of seconds, or of milliseconds
        found = f'does not state the unit of "{c.column}", which counts 1, 2, 3'
        remedy = f'Name every column by --map, this one as "{TIME}={c.column}:ms" or :s.'
        raise InputError(table.path, found, "seconds and milliseconds are plausible", remedy)
    unit = next((unit for unit, most in MAX_STEP.items() if step <= most), "ns")
    return unit, f"guess: {1 / (step * TIME_UNITS[unit]):.4g} rows per second" if step > 0 else ""


def _joint_unit(
    table: LogTable, c: MappedColumn, stated: str, spread: JointRange
) -> tuple[str, str]:
    if (other := _OTHER_UNIT.fullmatch(c.column)) and (not c.unit or c.reason):
        found = f'has "{c.column}", whose unit "{other["unit"]}" is not known'
        remedy = f'Convert it, or name every column by --map: "{c.target}={c.column}:deg,…".'
        raise InputError(table.path, found, "deg or rad is expected", remedy)
    if stated:
        return _agreed_unit(table, c, stated, "--angles"), ""
    largest = float(np.maximum(np.abs(spread.least), np.abs(spread.greatest)).max())
    if c.unit and not c.reason:
        _require_unit(table, c, c.unit, (DEGREES, RADIANS), "--angles deg or --angles rad")
        return c.unit, ""
    if largest > MAX_RADIANS:  # more than a turn in radians: degrees
        return c.unit or DEGREES, c.reason or f"guess: readings to {largest:.4g}"
    found = f'does not state the unit of "{c.column}", and its values fit degrees and radians'
    remedy = "State it: --angles deg or --angles rad."
    raise InputError(table.path, found, f"readings are at most {largest:.4g}", remedy)
