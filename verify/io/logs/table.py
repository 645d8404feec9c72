"""Read a table of another program: its separator, decimal sign and header found, its rows streamed.

Commas, semicolons, tabs or spaces between cells; decimal points or commas; lines above the header;
UTF-8, UTF-16 or Latin-1; a separator at the end of each line.
"""

import codecs
import io
import re
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice, zip_longest
from pathlib import Path

import numpy as np
import pandas as pd

from verify.core.records import Array, Progress, no_progress
from verify.errors import InputError
from verify.io.files import refused_as_input_error, require_file
from verify.io.rows import is_whole, split, unended

SEPARATORS = {";": "semicolons", "\t": "tabs", ",": "commas", " ": "spaces"}
MAX_PREAMBLE = 60  # lines above the header
SAMPLE_ROWS = 20  # that show the decimal sign
CHUNK_ROWS = 20_000
HEAD_BYTES = 400_000
PROGRESS_BYTES = 1000  # progress counts in kB
MAX_NUMBER = 1e20  # in whatever unit, ns since 1970 too; its square is finite
REMEDY = "Correct the line, or export the table again."

_NUMBER = re.compile(r"[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?", re.ASCII)
_DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d([.,]\d+)?)?(Z|[-+]\d\d:?\d\d)?", re.ASCII)
_UNIT = re.compile(  # a cell of a line of units
    r"[\[(](?P<bracketed>[^\[\]()]*)[\])]|"
    r"(?P<known>deg|degrees?|rad|radians?|°|s|sec|seconds?|ms|[uµ]s|ns|mm|m|[uµ]m)|-?",
    re.IGNORECASE,
)


@dataclass(frozen=True, slots=True)
class LogTable:
    """A table that is open to be read, in any number of passes."""

    path: Path
    encoding: str
    separator: str
    decimal: str
    header_line: int  # from 1
    skipped: int  # lines above the rows: to the names, or to their units below them
    names: tuple[str, ...]
    sample: tuple[tuple[str, ...], ...]  # the first rows, as they are written
    cut_off: bool  # the last line may lack digits, and is left out

    def describe(self) -> str:
        """How the table is written, in words."""
        decimals = "decimal commas" if self.decimal == "," else "decimal points"
        between = f"{SEPARATORS[self.separator]} between cells"
        return f"{between}, {decimals}, names in line {self.header_line}"

    def is_date(self, name: str) -> bool:
        """Whether a column holds dates with a time of day."""
        place = self.names.index(name)
        written = [cell for row in self.sample if (cell := row[place].strip())]
        return bool(written) and all(_DATE.fullmatch(cell) for cell in written)

    def chunks(
        self, names: tuple[str, ...], progress: Progress = no_progress
    ) -> Iterator[tuple[int, dict[str, Array]]]:
        """Stream some columns, a few thousand rows at once, with the number of the first row.

        Dates become seconds since 1970, (m,) longdouble; all others are numbers, (m,) float.

        Raises:
            InputError: a cell that is no number, or a row that lacks one; names the line.
        """
        dates = {name for name in names if self.is_date(name)}
        places = {name: self.names.index(name) for name in names}
        kinds = {place: str if name in dates else np.float64 for name, place in places.items()}
        done = characters = 0
        with refused_as_input_error(self.path):
            total = self.path.stat().st_size // PROGRESS_BYTES
            file = self.path.open(encoding=self.encoding, errors="replace", newline="")
        with file:
            lines = (line for line in islice(file, self.skipped, None) if self._is_row(line))
            while block := list(islice(lines, CHUNK_ROWS)):
                if any(self._is_too_long(line) for line in block):  # pandas would cut it off
                    raise self._fault(names)
                try:
                    chunk = pd.read_csv(
                        io.StringIO("".join(block)),
                        sep=r"\s+" if self.separator == " " else self.separator,
                        decimal=self.decimal,
                        header=None,
                        names=range(len(self.names)),
                        usecols=list(kinds),
                        dtype=kinds,
                        index_col=False,
                        keep_default_na=False,
                    )
                    values = {
                        name: _seconds(chunk[place]) if name in dates else chunk[place].to_numpy()
                        for name, place in places.items()
                    }
                except (ValueError, pd.errors.ParserError) as error:
                    raise self._fault(names) from error
                if not all((np.abs(column) <= MAX_NUMBER).all() for column in values.values()):
                    raise self._fault(names)
                yield done, values
                done += len(block)
                characters += sum(map(len, block))
                progress(min(characters // PROGRESS_BYTES, total), total)

    def _is_too_long(self, line: str) -> bool:
        """Whether a row has more cells than there are names, but for empty ones."""
        if self.separator != " " and line.count(self.separator) < len(self.names):
            return False
        return any(cell.strip() for cell in split(line.rstrip(), self.separator)[len(self.names) :])

    def _is_row(self, line: str) -> bool:
        """Whether a line below the header is a row: not blank, and not cut off."""
        return bool(line.strip()) and not (self.cut_off and line[-1] not in "\r\n")

    def place_of(self, row: int) -> str:
        """File and line of a row, which is counted from 0, as an editor counts lines."""
        return f"{self.path}, line {next(islice(self._rows(), row, None))[0]}"

    def _rows(self) -> Iterator[tuple[int, list[str]]]:
        with self.path.open(encoding=self.encoding, errors="replace", newline="") as file:
            for number, line in enumerate(file, start=1):
                if number > self.skipped and self._is_row(line):
                    yield number, split(line.rstrip("\r\n"), self.separator)

    def _is_number(self, cell: str) -> bool:
        other_sign = {".": ",", ",": "."}[self.decimal]
        return other_sign not in cell and abs(float(cell.replace(",", "."))) <= MAX_NUMBER

    def _fault(self, names: tuple[str, ...]) -> InputError:
        """Word what is wrong with the first row that cannot be read."""
        for line, cells in self._rows():
            if any(cell.strip() for cell in cells[len(self.names) :]):
                found = f"has {len(cells)} cells"
                expected = f"line {self.header_line} names {len(self.names)} columns"
                return InputError(f"{self.path}, line {line}", found, expected, REMEDY)
            for name in names:
                place = self.names.index(name)
                cell = cells[place].strip() if place < len(cells) else None
                kind = _DATE if self.is_date(name) else _NUMBER
                fits = _is_time if kind is _DATE else self._is_number
                if cell and kind.fullmatch(cell) and fits(cell):
                    continue
                found = f'{name} is "{cell[:40]}"' if cell else f"{name} is empty"
                expected = "a date" if kind is _DATE else f'a number with "{self.decimal}"'
                if kind is _NUMBER and cell and ":" in cell:
                    expected += " or a date such as 2026-10-25T09:30:07.5Z"
                if kind is _NUMBER and cell and kind.fullmatch(cell):
                    expected += f" of at most {MAX_NUMBER:g}"
                return InputError(
                    f"{self.path}, line {line}", found, f"{expected} is expected", REMEDY
                )
        return InputError(self.path, "cannot be read as a table", self.describe(), REMEDY)


def _seconds(cells: "pd.Series[str]") -> Array:
    """Seconds since 1970, to the nanosecond, of dates; without a zone they are UTC."""
    dates = pd.to_datetime(cells.str.replace(",", "."), utc=True, format="ISO8601")
    nanoseconds = dates.dt.as_unit("ns").astype("int64").to_numpy()
    return np.asarray(nanoseconds.astype(np.longdouble) / 1_000_000_000)


def _is_time(date: str) -> bool:
    """Whether there is such a day and time, in the 500 years that nanoseconds count."""
    try:
        _seconds(pd.Series([date]))
    except ValueError:
        return False
    return True


def open_log(path: Path) -> LogTable:
    """Find out how a table is written.

    Raises:
        InputError: no line names columns with whole rows of numbers below it.
    """
    require_file(path)
    with refused_as_input_error(path), path.open("rb") as file:
        data = file.read(HEAD_BYTES)
    encoding = _encoding(data)
    # line ends as a file opened with newline="" has them: CR alone is one
    text = io.StringIO(data.decode(encoding, errors="replace"), newline="")
    written = list(islice(text, MAX_PREAMBLE + SAMPLE_ROWS))
    lines = [line.rstrip("\r\n") for line in written]
    ended = written[-1:] != lines[-1:]
    for separator in SEPARATORS:
        for number, line in enumerate(lines[:MAX_PREAMBLE]):
            names = [name.strip() for name in split(line.lstrip("# "), separator)]
            while names and not names[-1]:
                names.pop()  # a separator at the end of the line
            units = _units("".join(lines[number + 1 : number + 2]), separator, len(names))
            skipped = number + (2 if units else 1)
            rows = [split(row, separator) for row in lines[skipped:] if row.strip()]
            above = rows if ended else rows[:-1]  # of a line that may be cut off
            rows = (above or rows)[:SAMPLE_ROWS]
            if _is_header(names, rows):
                if not above:
                    raise unended(path)
                names = [
                    f"{name} [{unit}]" if unit and not name.endswith(("]", ")")) else name
                    for name, unit in zip_longest(names, units, fillvalue="")
                ]
                _require_unique(path, number + 1, names)
                width = len(names)
                sample = tuple(tuple((row + [""] * width)[:width]) for row in rows)
                return LogTable(
                    path=path,
                    encoding=encoding,
                    separator=separator,
                    decimal=_decimal(path, separator, sample),
                    header_line=number + 1,
                    skipped=skipped,
                    names=tuple(names),
                    sample=sample,
                    cut_off=not _ends_whole(path, encoding, separator, sample),
                )
    expected = "a line with the columns' names and rows of numbers below it are expected"
    raise InputError(path, "is no table", expected, "Export it with a header line.")


def _units(line: str, separator: str, columns: int) -> list[str]:
    """Units of the columns, of the line below their names; [] where that is no line of units."""
    cells = [_UNIT.fullmatch(cell.strip()) for cell in split(line.lstrip("# "), separator)]
    if len(cells) != columns or None in cells:
        return []
    units = [(cell["bracketed"] or cell["known"] or "").strip() for cell in cells if cell]
    return units if any(units) else []


def _ends_whole(
    path: Path, encoding: str, separator: str, sample: tuple[tuple[str, ...], ...]
) -> bool:
    """Whether the last line has its end, or shows that it lacks no digit."""
    with path.open(encoding=encoding, errors="replace", newline="") as file:
        last = deque(file, 1).pop()
    if last[-1] in "\r\n" or not last.strip():
        return True
    return is_whole(split(last, separator), sample, len(sample[0]))


def _encoding(data: bytes) -> str:
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    try:
        codecs.getincrementaldecoder("utf-8-sig")().decode(data)
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8-sig"


def _is_value(cell: str) -> bool:
    cell = cell.strip()
    return bool(_NUMBER.fullmatch(cell) or _DATE.fullmatch(cell))


def _is_header(names: list[str], rows: list[list[str]]) -> bool:
    """Whether a line names columns: no cell is a number, and most cells below are."""
    if len(names) < 2 or not all(names) or any(map(_is_value, names)) or not rows:
        return False
    if any(len(row) < len(names) for row in rows[:2]):
        return False
    return sum(map(_is_value, rows[0])) * 2 >= len(names)


def _require_unique(path: Path, line: int, names: list[str]) -> None:
    twice = next((name for name, count in Counter(names).items() if count > 1), None)
    if twice is not None:
        found = f'names two columns "{twice}"'
        raise InputError(f"{path}, line {line}", found, "", "Rename one of them.")


def _decimal(path: Path, separator: str, sample: tuple[tuple[str, ...], ...]) -> str:
    cells = [cell.strip() for row in sample for cell in row if _NUMBER.fullmatch(cell.strip())]
    commas, points = (any(sign in cell for cell in cells) for sign in ",.")
    if separator != "," and commas and points:
        found = "has decimal commas and decimal points"
        raise InputError(path, found, "one of them is expected", "Export it again.")
    return "," if commas and separator != "," else "."
