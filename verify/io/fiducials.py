"""marker.toml: millimetres and degrees in the file, the Marker in metres and radians inside.

board.toml: millimetres in the file, the Board in metres inside.
"""

import math
from itertools import combinations
from pathlib import Path

import msgspec
import numpy as np

from verify.core import fiducials
from verify.core.fiducials import COLOURS, Board, Marker
from verify.core.records import Array
from verify.errors import one_line
from verify.io.files import write_whole
from verify.io.toml import (
    FORMAT,
    decode,
    did_you_mean,
    encode_numbers,
    key_error,
    not_negative,
    one_of,
)
from verify.io.toml import encode as encode_toml

SOURCES = ("jig", "measured", "motion")

_MM = 1e-3  # m


class BodyUncertaintyTable(msgspec.Struct, kw_only=True):
    """The keys of body_standard_uncertainty, in the order of the Marker's vector."""

    x_mm: float
    y_mm: float
    z_mm: float
    rx_deg: float
    ry_deg: float
    rz_deg: float


class LedTable(msgspec.Struct, kw_only=True):
    """The keys of one [[led]]."""

    name: str
    position_mm: tuple[float, float, float]
    colour: str | None = None


class MarkerTable(msgspec.Struct, kw_only=True):
    """The keys of marker.toml."""

    format: int
    led_diameter_mm: float
    source: str | None = None
    datum: str | None = None
    registration: str | None = None
    body_standard_uncertainty: BodyUncertaintyTable | None = None
    led_standard_uncertainty_mm: float | None = None
    centre_shift_standard_uncertainty_mm: float | None = None
    led: list[LedTable]


def read_marker(path: str | Path) -> tuple[Marker, tuple[str, ...]]:
    """Read and check a marker.toml.

    Returns:
        The marker, and a warning for each key that the format does not know.

    Raises:
        InputError: names the file, the key, what stands there, what should, and what to do.
    """
    path = Path(path)
    table, warnings = decode(path, MarkerTable)
    if table.led_diameter_mm <= 0:
        raise key_error(
            path, "led_diameter_mm", f"is {table.led_diameter_mm}", "a diameter is positive"
        )
    for key in ("led_standard_uncertainty_mm", "centre_shift_standard_uncertainty_mm"):
        not_negative(path, key, getattr(table, key))
    if table.source is not None:
        one_of(path, "source", table.source, SOURCES)
    _check_leds(path, table)
    return Marker(
        names=tuple(led.name for led in table.led),
        leds=np.array([led.position_mm for led in table.led]) * _MM,
        colours=tuple(led.colour for led in table.led),
        led_diameter=table.led_diameter_mm * _MM,
        source=table.source,
        datum=table.datum,
        registration=table.registration,
        body_standard_uncertainty=_body(path, table.body_standard_uncertainty),
        led_standard_uncertainty=_metres(table.led_standard_uncertainty_mm),
        centre_shift_standard_uncertainty=_metres(table.centre_shift_standard_uncertainty_mm),
    ), warnings


def encode_marker(marker: Marker) -> bytes:
    """Write a marker as the text of a marker.toml; what is None stays out."""
    body = marker.body_standard_uncertainty
    keys = BodyUncertaintyTable.__struct_fields__
    leds = zip(marker.names, marker.leds, marker.colours, strict=True)
    return encode_toml(
        {
            "format": FORMAT,
            "led_diameter_mm": encode_numbers(marker.led_diameter / _MM),
            "source": marker.source,
            "datum": marker.datum,
            "registration": marker.registration,
            "led_standard_uncertainty_mm": _millimetres(marker.led_standard_uncertainty),
            "centre_shift_standard_uncertainty_mm": _millimetres(
                marker.centre_shift_standard_uncertainty
            ),
            "body_standard_uncertainty": None
            if body is None
            else dict(zip(keys, encode_numbers(body / _body_units()), strict=True)),
            "led": [
                {"name": name, "position_mm": encode_numbers(position / _MM), "colour": colour}
                for name, position, colour in leds
            ],
        }
    )


def write_marker(path: str | Path, marker: Marker) -> None:
    """Write a marker.toml, whole or not at all.

    Raises:
        InputError: the disk or the system refuses it.
    """
    write_whole(Path(path), encode_marker(marker))


def _check_leds(path: Path, table: MarkerTable) -> None:
    """Refuse a marker without LEDs, names that do not tell them apart, and LEDs in one another."""
    if not table.led:
        raise key_error(path, "led", "is empty", "at least one [[led]] is expected")
    names = [led.name for led in table.led]
    for index, led in enumerate(table.led):
        if not led.name:
            raise key_error(path, f"led[{index}].name", "is empty", "each LED has a name")
        if led.name in names[:index]:
            raise key_error(
                path, f"led[{index}].name", f'repeats "{led.name}"', "each LED has its own name"
            )
        if led.colour is not None:
            one_of(path, f"led[{index}].colour", led.colour, COLOURS)
    for (first, a), (second, b) in combinations(enumerate(table.led), 2):
        apart = float(np.linalg.norm(np.subtract(a.position_mm, b.position_mm)))
        if apart < table.led_diameter_mm:
            found = f"is {apart:.3g} mm from led[{first}]"
            expected = f"LEDs of {table.led_diameter_mm} mm cannot stand inside one another"
            raise key_error(path, f"led[{second}].position_mm", found, expected)


def _body(path: Path, table: BodyUncertaintyTable | None) -> Array | None:
    if table is None:
        return None
    for key, value in msgspec.structs.asdict(table).items():
        not_negative(path, f"body_standard_uncertainty.{key}", value)
    vector: Array = np.array(msgspec.structs.astuple(table)) * _body_units()
    return vector


def _body_units() -> Array:
    """Turn x, y, z in mm and rx, ry, rz in degrees into m and rad; (6,)."""
    return np.array([_MM] * 3 + [np.pi / 180] * 3)


def _metres(value_mm: float | None) -> float | None:
    return None if value_mm is None else value_mm * _MM


def _millimetres(value: float | None) -> float | None:
    return None if value is None else float(encode_numbers(value / _MM))


MIN_CORNERS = 3  # inner corners a side: fewer tell a tilt from nothing
MIN_SQUARE_MM = 1.0  # of a square: a smaller number was hardly meant in millimetres

# m


class BoardTable(msgspec.Struct, kw_only=True):
    """The keys of board.toml."""

    format: int
    inner_corners: tuple[int, int] | None = None  # along x, along y
    squares: tuple[int, int] | None = None  # optional: only compared with inner_corners
    square_mm: float
    square_standard_uncertainty_mm: float | None = None
    markers: str | None = None
    marker_mm: float | None = None


def read_board(path: str | Path) -> tuple[Board, tuple[str, ...]]:
    """Read and check a board.toml.

    Returns:
        The board, and what is worth a warning: unknown keys, a square too small to be true.

    Raises:
        InputError: names the file, the key, what stands there, what should, and what to do.
    """
    path = Path(path)
    table, warnings = decode(path, BoardTable)
    board = build_board(path, table)
    if table.square_mm < MIN_SQUARE_MM:
        said = f"{path}, square_mm: is {table.square_mm} mm; is that in metres?"
        warnings = (*warnings, one_line(said))
    return board, warnings


def build_board(place: str | Path, table: BoardTable) -> Board:
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


def encode_board(board: Board) -> bytes:
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


def write_board(path: str | Path, board: Board) -> None:
    """Write a board.toml, whole or not at all.

    Raises:
        InputError: the disk or the system refuses it.
    """
    write_whole(Path(path), encode_board(board))


def _corners(path: Path, table: BoardTable) -> tuple[int, int]:
    """Find the inner corners; mend the usual mistake, squares counted in their place, in words."""
    squares = table.squares
    if table.inner_corners is None:
        expected = "the format needs the corners where four squares meet, along x and along y"
        remedy = "Add it, e.g. [9, 7] for 10 x 8 squares."
        if squares is not None:
            remedy = (
                f"Write [{squares[0] - 1}, {squares[1] - 1}] for {_format_size(squares)} squares."
            )
        raise key_error(path, "inner_corners", "is missing", expected, remedy)
    if min(table.inner_corners) < MIN_CORNERS:
        found = f"is {_format_size(table.inner_corners)}"
        raise key_error(path, "inner_corners", found, f"at least {MIN_CORNERS} a side are expected")
    columns, rows = table.inner_corners
    if squares is not None and squares != (columns + 1, rows + 1):
        found = f"is {_format_size(table.inner_corners)}, but squares is {_format_size(squares)}"
        expected = "inner corners are one fewer than squares each way"
        raise key_error(path, "inner_corners", found, expected, "Count again and mend one of them.")
    return columns, rows


def _format_size(pair: tuple[int, int]) -> str:
    return f"{pair[0]} x {pair[1]}"


def _check_sizes(path: Path, table: BoardTable) -> None:
    for key in ("square_mm", "marker_mm"):
        size = getattr(table, key)
        if size is not None and not 0 < size < math.inf:  # an option may be nan
            raise key_error(path, key, f"is {size}", "a size is positive")
    not_negative(path, "square_standard_uncertainty_mm", table.square_standard_uncertainty_mm)
    if (table.markers is None) != (table.marker_mm is None):
        missing, there = ("marker_mm", "markers") if table.markers else ("markers", "marker_mm")
        expected = f"{there} is there, and a ChArUco board needs both"
        raise key_error(path, missing, "is missing", expected, "Add it, or delete the other.")


def _check_markers(path: Path, table: BoardTable, board: Board) -> None:
    markers, marker_mm = str(table.markers), float(table.marker_mm or 0)
    if markers not in fiducials.DICTIONARIES:
        expected = "an ArUco dictionary of OpenCV's is expected, such as DICT_5X5_100"
        remedy = did_you_mean(markers, fiducials.DICTIONARIES).strip()
        raise key_error(path, "markers", f'is "{markers}"', expected, remedy)
    if marker_mm >= table.square_mm:
        found = f"is {marker_mm}"
        expected = f"a marker fits into a square of {table.square_mm} mm with white around it"
        raise key_error(path, "marker_mm", found, expected)
    there, needed = fiducials.dictionary_size(markers), fiducials.count_white_squares(board)
    if there < needed:
        found = f'is "{markers}", which has {there} markers'
        raise key_error(path, "markers", found, f"the board needs {needed}", "Choose a larger one.")
