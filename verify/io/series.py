"""Read frames.csv, encoders.csv and alarms.csv: checked arrays in s and rad from degrees."""

import codecs
import csv
import io
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from verify.core.records import Array, take_rows
from verify.errors import InputError
from verify.io import left_out
from verify.io.files import read_bytes, refuse_utf_16
from verify.io.rows import whole_rows
from verify.io.toml import did_you_mean

if TYPE_CHECKING:  # imported where a file is read: what measures live reads none, and starts sooner
    import pandas as pd

_PAIR_TIMES = ("t_left_s", "t_right_s")
PAN_COLUMNS = ("pan_left_deg", "pan_right_deg")
OTHER_UNITS = ("rad", "m", "ms", "us", "ns")  # that a column may be in by mistake
MAX_NUMBER = 1e20  # in whatever unit; its square is finite
MAX_PAN = 3600.0  # deg, as in rig.toml: no base turns by more than ten turns
VISIT_PERIOD = 60.0  # s, of visits without times
_JOINT = re.compile(r"q[1-9]\d*_deg")
MAX_FAR_BEYOND = 4 * np.pi  # beyond the limits, in most rows: no count of turns, but another unit
_REMEDY = "Delete the row or export again."
_MATCHED_REMEDY = (
    "Export it again: rows belong to images or readings by their order, so none can be deleted."
)
_ALARMS_REMEDY = "Restore the file as `verify run` wrote it, or delete it."
SORT_REMEDY = "Sort the rows and delete repeats."
ALARMS = "alarms.csv"  # of a watched run: beside the recording, and in its report's folder
ALARM_COLUMNS = (
    "alarm", "kind", "began_utc", "ended_utc", "t_s", "device", "joint",
    "not_told_apart_from", "error_deg", "standard_uncertainty_deg", "text",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class FrameSeries:
    """Instants of the stereo pairs, and the pan angles of both bases."""

    t_left: Array  # (n,), s, cameras' clock, mid-exposure, strictly increasing
    t_right: Array  # (n,), s
    pan_left: Array  # (n,), rad, as read; the rig's own where the file gives none
    pan_right: Array  # (n,), rad
    # False: single visits in order, whose times nobody noted
    timed: bool = field(default=True, kw_only=True)

    def __len__(self) -> int:
        return len(self.t_left)


@dataclass(frozen=True, slots=True)
class EncoderSeries:
    """The robot's own joint readings."""

    t: Array  # (m,), s, controller's clock, strictly increasing
    q: Array  # (m, dof), rad
    t_host: Array | None = None  # (m,), s, cameras' clock, when each reading arrived
    late: float = 0.0  # s, standard uncertainty of t where the log repeats each reading

    def __len__(self) -> int:
        return len(self.t)


def read_frames(
    path: Path, pan: tuple[float, float] = (0.0, 0.0), torn: bool = False
) -> tuple[FrameSeries, tuple[str, ...]]:
    """Read frames.csv: one row a stereo pair; `pan`, rad, left and right, where it gives none.

    Where the recording was cut off (`torn`), half a last line is left out, with a warning.

    Raises:
        InputError: names the file, the line and the column.
    """
    table, warnings = open_table(path, torn)
    timed = any(name in table.header for name in _PAIR_TIMES)
    required = ("frame", *_PAIR_TIMES) if timed else ("frame",)
    turning = any(name in table.header for name in PAN_COLUMNS)  # one alone is refused
    columns = table.columns((*required, *PAN_COLUMNS) if turning else required)
    count = len(columns["frame"])
    table.require_counting(columns["frame"], "images")
    columns |= {} if timed else dict.fromkeys(_PAIR_TIMES, visit_times(count))
    for name in _PAIR_TIMES:
        table.require_rising(name, columns[name])
    turned = [
        np.deg2rad(columns[name]) if turning else np.full(count, rest)
        for name, rest in zip(PAN_COLUMNS, pan, strict=True)
    ]
    return FrameSeries(*(columns[name] for name in _PAIR_TIMES), *turned, timed=timed), warnings


def visit_times(count: int) -> Array:
    """Stand-ins for times that nobody noted, (count,), s: none is near another."""
    return VISIT_PERIOD * np.arange(float(count))


def read_encoders(
    path: Path,
    joints: int,
    torn: bool = False,
    limits: tuple[Array, Array] | None = None,
    pairs: FrameSeries | None = None,
) -> tuple[EncoderSeries, tuple[str, ...]]:
    """Read encoders.csv: one row a reading of all joints.

    Where the recording was cut off (`torn`), half a last line is left out, as is a spike, with a
    warning. `limits`, rad, are each joint's lowest and highest angle, where the robot is known.
    Readings at the very times of `pairs` are single visits; without times, row i belongs to pair i.

    Raises:
        InputError: names the file, the line and the column.
    """
    table, warnings = open_table(path, torn, spare="t_s")
    wanted = tuple(f"q{joint}_deg" for joint in range(1, joints + 1))
    present = [name for name in table.header if _JOINT.fullmatch(name)]
    if present and (len(present) < joints or set(present) - set(wanted)):
        found = f"has {len(present)} joint columns, {present[0]} to {present[-1]}"
        remedy = "Export every joint, or name the right robot in session.toml."
        raise InputError(f"{path}, line 1", found, f"the robot has {joints} joints", remedy)
    arrivals = ("t_host_s",) if "t_host_s" in table.header else ()
    untimed = pairs is not None and not pairs.timed
    columns = table.columns((*wanted, *arrivals) if untimed else ("t_s", *wanted, *arrivals))
    q = np.deg2rad(np.stack([columns[name] for name in wanted], axis=-1))
    t = columns.get("t_s", visit_times(len(q)))
    table.require_rising("t_s", t)
    q = q if untimed or len(t) < 2 else left_out.without_turns(t, q)
    if untimed and (len(q) != len(pairs or ()) or {"t_s", "t_host_s"} & set(table.header)):
        times = "has times" if "t_s" in table.header else f"has {len(q)} rows"
        expected = f"the {len(pairs or ())} poses or pairs have no times, and a reading each"
        remedy = "Export both with their times, or both without and row by row."
        raise InputError(path, times, expected, remedy)
    if limits is not None:
        _refuse_far_beyond(path, q, limits)
    if leap := left_out.find_leap(t, q):
        found = f"t_s leaps by {leap[1]:.3f} s to {leap[0]:.2f}, and the joints go on as without it"
        remedy = f"If the clock was set, subtract {leap[1]:.3f} s from there on."
        raise InputError(path, found, "times of one clock", remedy)
    spike = left_out.find_stray(t, q, limits)
    if pairs is None or not np.array_equal(t, pairs.t_left):
        spike |= left_out.find_spikes(t, q)
    kept = np.flatnonzero(~spike.any(axis=1))
    repeats, period = left_out.find_repeats(t[kept], q[kept])
    # a reading is renewed at any time between two rows
    late = float(np.median(np.diff(t))) / np.sqrt(12) if repeats.any() else 0.0
    series = take_rows(EncoderSeries(t, q, columns.get("t_host_s"), late), kept[~repeats])
    notes = (*left_out.warn_of_repeats(repeats, period), *left_out.warn_of_spikes(spike))
    return series, (*warnings, *(f"{path.name}: {note}" for note in notes))


def _refuse_far_beyond(path: Path, q: Array, limits: tuple[Array, Array]) -> None:
    """Refuse a column of readings q (m, j), rad, that is in another unit by its size.

    Raises:
        InputError: names the column, its readings and the limits.
    """
    beyond = np.median(np.maximum(limits[0] - q, q - limits[1]), axis=0)
    for joint in np.flatnonzero(beyond > MAX_FAR_BEYOND).tolist():
        ends = [q[:, joint].min(), q[:, joint].max(), limits[0][joint], limits[1][joint]]
        least, most, low, high = np.rad2deg(ends).tolist()
        found = f"q{joint + 1}_deg runs from {least:.5g}° to {most:.5g}°"
        expected = f"joint {joint + 1} turns from {low:.5g}° to {high:.5g}°"
        raise InputError(path, found, expected, "Check the column's unit; degrees are expected.")


@dataclass(frozen=True, slots=True)
class CsvTable:
    """A CSV file's bytes and header; its refusals name the line."""

    path: Path
    data: bytes
    header: list[str]
    matched: bool  # rows belong to images or readings by their number

    def columns(self, names: tuple[str, ...]) -> dict[str, Array]:
        """Parse these columns; every cell is a finite number.

        Raises:
            InputError: a missing column, a row of another length, a cell that is no number or one
                beyond MAX_NUMBER, of a base beyond MAX_PAN.
        """
        for name in names:
            if self.header.count(name) > 1:
                expected, remedy = "each has a name of its own", "Delete or rename one of them."
                raise InputError(
                    f"{self.path}, line 1", f"has two columns {name}", expected, remedy
                )
            if name not in self.header:
                expected = f"expected are {', '.join(names)}"
                others = tuple(n for n in self.header if n not in names)
                stem, _, unit = name.rpartition("_")
                alike = [n for n in others if n in {f"{stem}_{u}" for u in OTHER_UNITS}]
                remedy = f"Name the column in the first line.{did_you_mean(name, others)}"
                if alike:  # a name alone would pass its numbers off for another unit's
                    remedy = f"Convert {alike[0]} to {unit}, and name it {name}."
                raise InputError(f"{self.path}, line 1", f"has no column {name}", expected, remedy)
        places = {name: self.header.index(name) for name in names}
        parsed = self._parsed_fast(places) or self._parsed_by_row(places)
        if not len(parsed[names[0]]):
            remedy = "Record or export it again."
            raise InputError(self.path, "has no rows below its header", "", remedy)
        for name, values in parsed.items():
            most = MAX_PAN if name in PAN_COLUMNS else MAX_NUMBER
            beyond = np.flatnonzero(np.abs(values) > most)
            if len(beyond):
                found = f"{name} is {values[beyond[0]]:g}"
                raise self.fault(int(beyond[0]), found, f"at most {most:g} is plausible")
        return parsed

    def require_counting(self, frame: Array, streams: str) -> None:
        """Refuse frame numbers that do not count the `streams` (images, pictures) from 0."""
        wrong = np.flatnonzero(frame != np.arange(len(frame)))
        if len(wrong):
            row = int(wrong[0])
            expected = f"{row} is expected, counted from 0 in step with the {streams}"
            raise self.fault(row, f"frame is {frame[row]:g}", expected)

    def require_rising(self, name: str, times: Array) -> None:
        """Refuse times that do not rise strictly; the InputError names the first such line."""
        stuck = np.flatnonzero(np.diff(times) <= 0)
        if len(stuck):
            row = int(stuck[0]) + 1
            found = f"{name} is {times[row]:.10g} after {times[row - 1]:.10g}"
            remedy = "" if self.matched else SORT_REMEDY
            raise self.fault(row, found, "times rise strictly", remedy)

    def fault(self, row: int, found: str, expected: str, remedy: str = "") -> InputError:
        """Word a refusal of a row, counted from 0, by its line number in the file."""
        remedy = remedy or self._row_remedy
        line = next(line for index, (line, _) in enumerate(self._rows()) if index == row)
        return InputError(f"{self.path}, line {line}", found, expected, remedy)

    def _parsed_fast(self, places: dict[str, int]) -> dict[str, Array] | None:
        """Parse a clean file by pandas; None if any cell or row is irregular.

        Not by Arrow: its threads may outlive a refusal, and then end the process.
        """
        import pandas as pd

        try:
            table = pd.read_csv(
                io.BytesIO(self.data),
                header=None,
                names=range(len(self.header)),  # its own names may repeat
                skiprows=1,
                dtype=dict.fromkeys(places.values(), np.float64),
                keep_default_na=False,
            )
        except (ValueError, pd.errors.ParserError):  # UnicodeDecodeError is a ValueError
            return None
        if not isinstance(table.index, pd.RangeIndex) or table.isna().any(axis=None):
            return None  # a row of another length
        parsed = {name: table[place].to_numpy() for name, place in places.items()}
        return parsed if all(np.isfinite(column).all() for column in parsed.values()) else None

    def _parsed_by_row(self, places: dict[str, int]) -> dict[str, Array]:
        """Parse row by row; a refusal names the first cell that is no number."""
        rows = []
        for line, cells in self._rows():
            if len(cells) != len(self.header):
                if any("\n" in cell or "\r" in cell for cell in cells):
                    raise _quote_refusal(f"{self.path}, line {line}")
                found = f"has {len(cells)} cells"
                expected = f"the first line names {len(self.header)} columns"
                remedy = "Write decimal points, and a comma between cells alone."
                raise InputError(f"{self.path}, line {line}", found, expected, remedy)
            row = [_number(cells[place]) for place in places.values()]
            numbers = zip(places, row, strict=True)
            wrong = next((name for name, v in numbers if not math.isfinite(v)), None)
            if wrong is not None:
                cell = cells[places[wrong]].strip()
                found = f'{wrong} is "{cell[:40]}"' if cell else f"{wrong} is empty"
                expected = f"every row needs a number for {', '.join(places)}"
                raise InputError(f"{self.path}, line {line}", found, expected, self._row_remedy)
            rows.append(row)
        columns = np.array(rows).reshape(-1, len(places)).T
        return dict(zip(places, columns, strict=True))

    @property
    def _row_remedy(self) -> str:
        return _MATCHED_REMEDY if self.matched else _REMEDY

    def _rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield the rows below the header, blank lines left out, each with its first line."""
        reader = csv.reader(io.StringIO(self.data.decode(errors="replace"), newline=""))
        line = 1
        try:
            next(reader, None)
            line = reader.line_num + 1
            for cells in reader:
                if len(cells) > 1 or any(cell.strip() for cell in cells):
                    yield line, cells
                line = reader.line_num + 1
        except csv.Error as error:
            place = f"{self.path}, line {line}"
            if reader.line_num > line:  # the rest of the file stands in one cell, too long for csv
                raise _quote_refusal(place) from error
            raise InputError(place, f"is not CSV: {error}", "", "Export it again.") from error


def _quote_refusal(place: str) -> InputError:
    found, expected = "has a quote that is not closed", "quotes stand in pairs around a cell"
    return InputError(place, found, expected, "Close it, or export the table again.")


def open_table(path: Path, torn: bool, spare: str = "") -> tuple[CsvTable, tuple[str, ...]]:
    """Read a CSV file's header and rows; the warnings name a last row that is left out.

    A last row without an end of line is left out where the recording was cut off (`torn`). Else,
    if it may lack digits, it is left out of a table that has the column `spare`, and refused in
    others, whose rows belong to something by their number.
    """
    data = read_bytes(path)
    refuse_utf_16(path, data)
    data = data.removeprefix(codecs.BOM_UTF8)
    header = _header(path, data)
    data, warnings = whole_rows(path, data, torn, spare in header)
    return CsvTable(path, data, header, spare not in header), warnings


def _header(path: Path, data: bytes) -> list[str]:
    """Read the column names in the first line."""
    first = re.split(rb"[\r\n]", data, maxsplit=1)[0].decode(errors="replace")
    place = f"{path}, line 1"
    for separator, name in ((";", "semicolons"), ("\t", "tabs")):
        if separator in first and "," not in first:
            expected = "commas between cells and decimal points are expected"
            raise InputError(place, f"separates by {name}", expected, "Export it again that way.")
    names = [name.strip() for name in next(csv.reader([first]), [])]
    if all(math.isfinite(_number(name)) for name in names):
        found = "holds numbers" if names else "is empty"
        raise InputError(place, found, "it names the columns", "Put the header there.")
    return names


def read_alarms(path: Path, joints: int) -> "pd.DataFrame | None":
    """Read the alarms of a watched run, ALARM_COLUMNS one a row; None where there is no file.

    Raises:
        InputError: a missing column, a row of another length, or no such number or joint.
    """
    if not path.exists():
        return None
    import pandas as pd

    table, _ = open_table(path, torn=False)
    rows = []
    for line, cells in table._rows():
        row = dict(zip(table.header, cells, strict=False))
        known = row.get("joint", "") in ("", *map(str, range(1, joints + 1)))
        known &= all(math.isfinite(_number(row.get(key) or "0")) for key in ("alarm", "t_s"))
        if len(cells) != len(table.header) or not known:
            found = f'is "{",".join(cells)[:60]}"'
            expected = f"alarm and t_s are numbers, joint is 1 to {joints} or empty"
            raise InputError(f"{path}, line {line}", found, expected, _ALARMS_REMEDY)
        rows.append(row)
    if missing := [name for name in ALARM_COLUMNS if name not in table.header]:
        expected = f"expected are {', '.join(ALARM_COLUMNS)}"
        raise InputError(f"{path}, line 1", f"has no column {missing[0]}", expected, _ALARMS_REMEDY)
    alarms = pd.DataFrame(rows, columns=list(ALARM_COLUMNS))
    numbers = ["alarm", "t_s", "joint", "error_deg", "standard_uncertainty_deg"]
    alarms[numbers] = alarms[numbers].apply(pd.to_numeric, errors="coerce")
    return alarms.astype({"joint": "Int64"})


def _number(cell: str) -> float:
    """Parse a cell; NaN for what is no number, `1_000` included, which Python takes for one."""
    try:
        return float(cell) if "_" not in cell else math.nan
    except ValueError:
        return math.nan
