"""A table's lines cut into cells, and whether the last one, without an end of line, is whole.

1.234 that was cut to 1.2 is a number still. A row without an end of line is taken as whole only
where what is lost would show: every row above has equally many decimals in the last column, and it
has them too, or a separator follows that column. Whole numbers and numbers of varying length do not
show it.
"""

import csv
import re
from collections.abc import Sequence
from pathlib import Path

from verify.errors import InputError, one_line

HEAD_BYTES = 1_000_000  # that hold the first rows
ROWS_ABOVE = 20  # that show how the last column is written
END = "has no end of line, and may be cut off"

_FRACTION = re.compile(r"[-+]?\d*(?P<fraction>[.,]\d.*)")


def split(line: str, separator: str) -> list[str]:
    """Cut a line into cells; spaces count once."""
    if separator == " ":
        return line.split()
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error:  # a cell longer than csv takes: no quotes are looked for
        return line.split(separator)


def is_whole(cells: Sequence[str], above: Sequence[Sequence[str]], columns: int) -> bool:
    """Whether a row without an end of line lacks nothing, by its cells and those of rows above."""
    if len(cells) != columns:
        return len(cells) > columns
    shapes = {_shape(row[columns - 1]) if len(row) >= columns else "" for row in above}
    return len(shapes) == 1 and "" not in shapes and _shape(cells[-1]) in shapes


def _shape(cell: str) -> str:
    """How a number is written from its decimal sign on, digits as 0; empty: it has none."""
    parts = _FRACTION.fullmatch(cell.strip())
    return re.sub(r"\d", "0", parts["fraction"]) if parts else ""


def left_out(path: Path) -> str:
    """Warn that the last row is not used."""
    return one_line(f"{path}: the last line {END}; it is left out.")


def unended(path: Path) -> InputError:
    """Word the refusal of a table of which no row may be left out."""
    remedy = "If it is whole, end it with a line break; if not, record or export the table again."
    return InputError(f"{path}, last line", END, "", remedy)


def whole_rows(path: Path, data: bytes, torn: bool, spare: bool) -> tuple[bytes, tuple[str, ...]]:
    """Take from a CSV file's bytes, header first, those of the whole rows, and warnings.

    Without its end the last line is left out of a recording that was cut off (`torn`). Of others,
    if it may lack digits, it is left out where a row can be spared, and refused elsewhere.

    Raises:
        InputError: no row can be spared, or there is no other.
    """
    whole = data[: max(data.rfind(b"\n"), data.rfind(b"\r")) + 1]
    if torn and whole != data:
        return whole, (one_line(f"{path}: the last line was cut off and is left out."),)
    last = data[len(whole) :].strip()
    header, *above = (
        split(line.decode(errors="replace"), ",")
        for line in re.split(rb"[\r\n]+", whole[:HEAD_BYTES])[: ROWS_ABOVE + 1]
    )
    above = [cells for cells in above if any(cells)]
    if not (last and whole) or is_whole(
        split(last.decode(errors="replace"), ","), above, len(header)
    ):
        return data, ()
    if not (spare and above):
        raise unended(path)
    return whole, (left_out(path),)
