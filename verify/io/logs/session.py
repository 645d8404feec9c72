"""Turn tables of other programs into encoders.csv, poses.csv and, with both, a session.toml."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import robots
from verify.core.records import Array, Progress
from verify.errors import InputError
from verify.io.joints import ANGLE_UNITS, JointRange
from verify.io.logs import mapping as columns_of
from verify.io.logs.bodies import Triangle, rotations
from verify.io.logs.mapping import ColumnMapping, MappedColumn
from verify.io.logs.table import LogTable

ENCODERS, POSES = "encoders.csv", "poses.csv"
MAX_TIME = 1e6  # s: times beyond count from some other start, and are counted from the first row
MAX_SPAN = 1e7  # s, of a recording: more is a damaged number
MAX_DISTANCE = 5e4  # mm, of a pose from the first
MAX_COARSE = 0.01  # share of rows with another reading at the time of the row before
STEP_ROWS = 200  # that show the median step of the time


@dataclass(slots=True)
class LogOutline:
    """What a first pass over a table finds, in its own units."""

    rows: int = 0
    joints: JointRange | None = None
    first: np.longdouble = field(default_factory=lambda: np.longdouble(0))
    step: float = float("nan")  # median, of the time; nan: no time


def read_outline(table: LogTable, mapping: ColumnMapping, progress: Progress) -> LogOutline:
    """First pass: the number of rows, the joints' range, the step of the time.

    Raises:
        InputError: a cell that is no number; names the line.
    """
    names = tuple(c.column for c in mapping.columns)
    outline = LogOutline(joints=JointRange(len(mapping.joints)) if mapping.joints else None)
    for start, values in table.chunks(names, progress):
        if outline.joints is not None:
            outline.joints.add(np.stack([values[c.column] for c in mapping.joints], axis=1))
        if mapping.time is not None and start == 0:
            times = values[mapping.time.column]
            outline.first = np.longdouble(times[0])
            if len(times) > 1:
                outline.step = float(np.median(np.diff(times[:STEP_ROWS])))
        outline.rows = start + len(values[names[0]])
    if not outline.rows:
        raise InputError(table.path, "has no rows below its header", "", "Export it again.")
    return outline


def proposal_lines(table: LogTable, mapping: ColumnMapping, outline: LogOutline) -> Iterator[str]:
    """The mapping in words, one column a line, with what a reader can check it by."""
    rate = ""
    if mapping.time is not None and outline.step > 0:
        period = outline.step * columns_of.TIME_UNITS[mapping.time.unit]
        rate = f", {1 / period:.4g} rows per second"
    yield f"{table.path}: {outline.rows} rows{rate}; {table.describe()}"
    width = max(len(c.column) for c in mapping.columns)
    for c in mapping.columns:
        target = f"{c.target}_deg" if c in mapping.joints else c.target
        if c.target in (*columns_of.POSITION, *columns_of.POINTS):
            target += "_mm"
        extent = ""
        if outline.joints is not None and c in mapping.joints:
            joint, scale = mapping.joints.index(c), np.rad2deg(ANGLE_UNITS[c.unit])
            ends = outline.joints.least[joint], outline.joints.greatest[joint]
            least, most = (end * scale for end in ends)
            extent = f"  {least:.3f}° to {most:.3f}°"
        reason = f"  ({c.reason})" if c.reason else ""
        yield f"  {c.column:{width}}  {c.unit:4} → {target}{extent}{reason}"
    if mapping.rotation:
        yield f"  orientation: {mapping.rotation}"


def start_of(mapping: ColumnMapping, outline: LogOutline) -> np.longdouble:
    """Time that becomes 0, s: whole seconds before the first row where its times are dates."""
    if mapping.time is None:
        return np.longdouble(0)
    first = outline.first * np.longdouble(columns_of.TIME_UNITS[mapping.time.unit])
    return np.floor(first) if abs(first) > MAX_TIME else np.longdouble(0)


class RisingTimes:
    """Times of a table, s, that rise from row to row; repeats are left out."""

    def __init__(self, table: LogTable, column: MappedColumn | None, start: np.longdouble) -> None:
        self._table, self._column, self._start = table, column, start
        self._last = -np.inf
        self._row: Array | None = None  # the last one, without its time
        self._rows = self._coarse = 0  # all; those with other numbers at the time of the one before
        self.repeats = 0

    def take(self, first: int, values: dict[str, Array]) -> tuple[list[str], Array]:
        """Texts of the times of a chunk, each with its comma, and which rows are kept.

        Raises:
            InputError: a time goes back, or lies too far from the start; names the line.
        """
        if self._column is None:
            count = len(next(iter(values.values())))
            return [""] * count, np.ones(count, dtype=bool)
        scale = np.longdouble(columns_of.TIME_UNITS[self._column.unit])
        times = values[self._column.column].astype(np.longdouble) * scale - self._start
        if len(far := np.flatnonzero(np.abs(times) > MAX_SPAN)):
            found = f"{self._column.column} is {float(times[far[0]]):.4g} s after the start"
            expected = f"at most {MAX_SPAN:g} s are plausible"
            remedy = "Correct this row or the first, or state the unit."
            raise InputError(self._table.place_of(first + far[0]), found, expected, remedy)
        steps = np.diff(times, prepend=np.longdouble(self._last))
        if len(back := np.flatnonzero(steps < 0)):
            found = f"{self._column.column} goes back by {-float(steps[back[0]]):.6g} s"
            remedy = "Sort the rows, or export one run alone."
            raise InputError(self._table.place_of(first + back[0]), found, "times rise", remedy)
        self._last = times[-1]
        repeated = np.flatnonzero(steps == 0)
        self.repeats += len(repeated)
        rows = np.stack([v for name, v in values.items() if name != self._column.column], axis=1)
        before = np.vstack([rows[:1] if self._row is None else self._row, rows[:-1]])
        self._coarse += int((rows != before)[repeated].any(axis=1).sum())
        self._row, self._rows = rows[-1:], first + len(rows)
        return [f"{t:.9f}," for t in times], np.asarray(steps > 0)

    def require_fine(self) -> None:
        """Refuse times that are written too coarsely for their rows, by an InputError."""
        if self._column is not None and self._coarse > MAX_COARSE * self._rows:
            found = f"{self._coarse} of {self._rows} rows repeat the time of another row"
            expected = f"{self._column.column} is written too coarsely to say when each was taken"
            remedy = "Export the times with more decimals."
            raise InputError(self._table.path, found, expected, remedy)


def write_encoders(
    table: LogTable, mapping: ColumnMapping, start: np.longdouble, path: Path, progress: Progress
) -> int:
    """Write encoders.csv; returns how many rows repeat a time and were left out.

    Raises:
        InputError: times that go back, or are too coarse for the readings.
    """
    scale = [np.rad2deg(ANGLE_UNITS[c.unit]) for c in mapping.joints]
    times = RisingTimes(table, mapping.time, start)
    names = tuple(c.column for c in (*mapping.joints, *((mapping.time,) if mapping.time else ())))
    with path.open("w", encoding="utf-8", newline="\n") as file:
        head = "t_s," if mapping.time else ""
        file.write(head + ",".join(f"{c.target}_deg" for c in mapping.joints) + "\n")
        for first, values in table.chunks(names, progress):
            texts, kept = times.take(first, values)
            degrees = np.stack([values[c.column] for c in mapping.joints], axis=1) * scale
            rows = zip(texts, degrees.tolist(), kept, strict=True)
            file.writelines(f"{t}{','.join(f'{q:.9f}' for q in r)}\n" for t, r, k in rows if k)
    times.require_fine()
    return times.repeats


def write_poses(
    table: LogTable, mapping: ColumnMapping, start: np.longdouble, path: Path, progress: Progress
) -> int:
    """Write poses.csv; returns how many rows repeat a time and were left out.

    Raises:
        InputError: a body that is not rigid, an orientation that is none, a pose too far away,
            times that go back or are too coarse.
    """
    times = RisingTimes(table, mapping.time, start)
    names = tuple(c.column for c in mapping.columns if c not in mapping.joints)
    turned = bool(mapping.rotation or mapping.of(columns_of.POINTS))
    head = ("t_s," if mapping.time else "") + "x_mm,y_mm,z_mm" + (",qw,qx,qy,qz" if turned else "")
    triangle: Triangle | None = None
    origin: Array | None = None
    quaternion: Array | None
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(f"{head}\n")
        for first, values in table.chunks(names, progress):
            texts, kept = times.take(first, values)
            if points := mapping.of(columns_of.POINTS):
                corners = _lengths(values, points).reshape(-1, 3, 3)
                triangle = triangle or Triangle(corners[0])
                position, quaternion = triangle.poses(corners, first)
            else:
                position, quaternion = _read_poses(values, mapping, first)
            origin = position[0] if origin is None else origin
            _require_near(table, position, origin)
            numbers = [",".join(f"{v:.6f}" for v in row) for row in position.tolist()]
            if quaternion is not None:
                turns = [",".join(f"{v:.9f}" for v in row) for row in quaternion.tolist()]
                numbers = [f"{a},{b}" for a, b in zip(numbers, turns, strict=True)]
            rows = zip(texts, numbers, kept, strict=True)
            file.writelines(f"{t}{row}\n" for t, row, k in rows if k)
    times.require_fine()
    return times.repeats


def _lengths(values: dict[str, Array], columns: tuple[MappedColumn, ...]) -> Array:
    """Coordinates (m, n), mm."""
    return np.stack([values[c.column] * columns_of.LENGTH_UNITS[c.unit] for c in columns], axis=1)


def _read_poses(
    values: dict[str, Array], mapping: ColumnMapping, first: int
) -> tuple[Array, Array | None]:
    """Positions (m, 3), mm, and quaternions (m, 4) or None."""
    position = _lengths(values, mapping.of(columns_of.POSITION))
    turn = mapping.of(columns_of.QUATERNION) or mapping.of(columns_of.ANGLES)
    if not turn:
        return position, None
    numbers = [values[c.column] * ANGLE_UNITS.get(c.unit, 1.0) for c in turn]
    return position, rotations(np.stack(numbers, axis=1), mapping.rotation, first)


def _require_near(table: LogTable, position: Array, origin: Array) -> None:
    farthest = float(np.linalg.norm(position - origin, axis=1).max())
    if farthest > MAX_DISTANCE:
        found = f"has poses {farthest / 1e3:.4g} m apart"
        remedy = "Check the unit: --lengths mm."
        raise InputError(table.path, found, "an arm reaches a few metres", remedy)


def require_joints_within(
    table: LogTable, mapping: ColumnMapping, outline: LogOutline, arm: robots.Arm
) -> None:
    """Refuse readings beyond the arm's limits; the InputError names a unit that would fit."""
    if outline.joints is None:
        return
    if len(mapping.joints) != arm.dof or mapping.joints[-1].target != f"q{arm.dof}":
        found = f"{len(mapping.joints)} joints are mapped, to {mapping.joints[-1].target}"
        raise InputError(table.path, found, f"{arm.name} has {arm.dof}", "Map q1 to the last one.")
    units = {c.unit for c in mapping.joints}
    if len(units) > 1:
        raise InputError(table.path, "has joints in degrees and in radians", "one unit is expected",
                         "State it: --angles deg or --angles rad.")  # fmt: skip
    names = [c.column for c in mapping.joints]
    by_name = any(columns_of.parse_name(name)[1] for name in names)
    option = "every column by --map, these in" if by_name else "--angles"
    outline.joints.require_within(table.path, arm, names, units.pop(), option)
