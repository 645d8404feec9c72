"""board.toml: millimetres in the file, the Board in metres inside."""

import math
from pathlib import Path

import msgspec

from verify import board_markers
from verify.board import Board
from verify.errors import one_line
from verify.toml_file import FORMAT, decode, did_you_mean, encode_numbers, fault, not_negative
from verify.toml_file import encode as encode_toml
from verify.writing import write_whole

FEWEST = 3  # inner corners a side: fewer tell a tilt from nothing
SMALLEST_MM = 1.0  # of a square: a smaller number was hardly meant in millimetres

_MM = 1e-3  # m


class BoardTable(msgspec.Struct, kw_only=True):
    """The keys of board.toml."""

    format: int
    inner_corners: tuple[int, int] | None = None  # along x, along y
    squares: tuple[int, int] | None = None  # optional: only compared with inner_corners
    square_mm: float
    square_standard_uncertainty_mm: float | None = None
    markers: str | None = None
    marker_mm: float | None = None


def read(path: str | Path) -> tuple[Board, tuple[str, ...]]:
    """Read and check a board.toml.

    Returns:
        The board, and what is worth a warning: unknown keys, a square too small to be true.

    Raises:
        InputError: names the file, the key, what stands there, what should, and what to do.
    """
    path = Path(path)
    table, warnings = decode(path, BoardTable)
    board = checked(path, table)
    if table.square_mm < SMALLEST_MM:
        said = f"{path}, square_mm: is {table.square_mm} mm; is that in metres?"
        warnings = (*warnings, one_line(said))
    return board, warnings


def checked(place: str | Path, table: BoardTable) -> Board:
    """Make a board of what a file or the options of a command say.

    Args:
        place: the file, or what else to call the board in a complaint.
        table: the keys of board.toml.

    Raises:
        InputError: names the place, the key, what stands there, what should, and what to do.
    """
    path = Path(place)
    columns, rows = _corners(path, table)
    _check_sizes(path, table)
    board = Board(
        columns=columns,
        rows=rows,
        square=table.square_mm * _MM,
        square_standard_uncertainty=_metres(table.square_standard_uncertainty_mm),
        markers=table.markers,
        marker=_metres(table.marker_mm),
    )
    if table.markers is not None:
        _check_markers(path, table, board)
    return board


def encode(board: Board) -> bytes:
    """Write a board as the text of a board.toml; what is None stays out."""
    return encode_toml(
        {
            "format": FORMAT,
            "inner_corners": [board.columns, board.rows],
            "square_mm": encode_numbers(board.square / _MM),
            "square_standard_uncertainty_mm": _millimetres(board.square_standard_uncertainty),
            "markers": board.markers,
            "marker_mm": _millimetres(board.marker),
        }
    )


def write(path: str | Path, board: Board) -> None:
    """Write a board.toml, whole or not at all.

    Raises:
        InputError: the disk or the system refuses it.
    """
    write_whole(Path(path), encode(board))


def _corners(path: Path, table: BoardTable) -> tuple[int, int]:
    """Find the inner corners; mend the usual mistake, squares counted in their place, in words."""
    squares = table.squares
    if table.inner_corners is None:
        expected = "the format needs the corners where four squares meet, along x and along y"
        remedy = "Add it, e.g. [9, 7] for 10 x 8 squares."
        if squares is not None:
            remedy = f"Write [{squares[0] - 1}, {squares[1] - 1}] for {_by(squares)} squares."
        raise fault(path, "inner_corners", "is missing", expected, remedy)
    if min(table.inner_corners) < FEWEST:
        found = f"is {_by(table.inner_corners)}"
        raise fault(path, "inner_corners", found, f"at least {FEWEST} a side are expected")
    columns, rows = table.inner_corners
    if squares is not None and squares != (columns + 1, rows + 1):
        found = f"is {_by(table.inner_corners)}, but squares is {_by(squares)}"
        expected = "inner corners are one fewer than squares each way"
        raise fault(path, "inner_corners", found, expected, "Count again and mend one of them.")
    return columns, rows


def _by(pair: tuple[int, int]) -> str:
    return f"{pair[0]} x {pair[1]}"


def _check_sizes(path: Path, table: BoardTable) -> None:
    for key in ("square_mm", "marker_mm"):
        size = getattr(table, key)
        if size is not None and not 0 < size < math.inf:  # an option may be nan
            raise fault(path, key, f"is {size}", "a size is positive")
    not_negative(path, "square_standard_uncertainty_mm", table.square_standard_uncertainty_mm)
    if (table.markers is None) != (table.marker_mm is None):
        missing, there = ("marker_mm", "markers") if table.markers else ("markers", "marker_mm")
        expected = f"{there} is there, and a ChArUco board needs both"
        raise fault(path, missing, "is missing", expected, "Add it, or delete the other.")


def _check_markers(path: Path, table: BoardTable, board: Board) -> None:
    markers, marker_mm = str(table.markers), float(table.marker_mm or 0)
    if markers not in board_markers.DICTIONARIES:
        expected = "an ArUco dictionary of OpenCV's is expected, such as DICT_5X5_100"
        remedy = did_you_mean(markers, board_markers.DICTIONARIES).strip()
        raise fault(path, "markers", f'is "{markers}"', expected, remedy)
    if marker_mm >= table.square_mm:
        found = f"is {marker_mm}"
        expected = f"a marker fits into a square of {table.square_mm} mm with white around it"
        raise fault(path, "marker_mm", found, expected)
    there, needed = board_markers.capacity(markers), board_markers.needed(board)
    if there < needed:
        found = f'is "{markers}", which has {there} markers'
        raise fault(path, "markers", found, f"the board needs {needed}", "Choose a larger one.")


def _metres(value_mm: float | None) -> float | None:
    return None if value_mm is None else value_mm * _MM


def _millimetres(value: float | None) -> float | None:
    return None if value is None else float(encode_numbers(value / _MM))
