"""Read, check and write marker.toml and board.toml: the LEDs of a robot, a calibration board.

The files hold millimetres and degrees, `Marker` and `Board` metres and radians.
"""

import math
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from verify.core import fiducials
from verify.core.fiducials import COLOURS, Board, Marker
from verify.core.records import Array, rigid_transform
from verify.errors import one_line
from verify.io.files import write_whole
from verify.io.rig import Matrix, Triple, nearest_pose
from verify.io.toml import (
    FORMAT,
    MM,
    decode,
    did_you_mean,
    encode_numbers,
    key_error,
    not_negative,
    one_of,
    scaled,
)
from verify.io.toml import encode as encode_toml

SOURCES = ("jig", "measured", "motion")
# m and rad in a unit of the file: x, y, z in mm, rx, ry, rz in degrees
BODY_UNITS = np.array([MM] * 3 + [np.pi / 180] * 3)

MIN_CORNERS = 3  # inner corners a side: fewer tell a tilt from nothing
MIN_SIZE_MM = 1e-3  # no camera sees a smaller square or marker, and figures lose their digits
MIN_POSITION_MM = 2.0  # no board's corner stands as near to the middle of a robot's base
MIN_SQUARE_MM = 1.0  # of a square: a smaller number was hardly meant in millimetres


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


def read_marker(path: Path) -> tuple[Marker, tuple[str, ...]]:
    """Read and check a marker.toml; warnings name unknown keys, an InputError file and key."""
    table, warnings = decode(path, MarkerTable)
    if table.led_diameter_mm <= 0:
        found = f"is {table.led_diameter_mm}"
        raise key_error(path, "led_diameter_mm", found, "a diameter is positive")
    for key in ("led_standard_uncertainty_mm", "centre_shift_standard_uncertainty_mm"):
        not_negative(path, key, getattr(table, key))
    if table.source is not None:
        one_of(path, "source", table.source, SOURCES)
    _check_leds(path, table)
    body = body_uncertainty(path, "body_standard_uncertainty", table.body_standard_uncertainty)
    return Marker(
        names=tuple(led.name for led in table.led),
        leds=np.array([led.position_mm for led in table.led]) * MM,
        colours=tuple(led.colour for led in table.led),
        led_diameter=table.led_diameter_mm * MM,
        source=table.source,
        datum=table.datum,
        registration=table.registration,
        body_standard_uncertainty=body,
        led_standard_uncertainty=scaled(table.led_standard_uncertainty_mm, MM),
        centre_shift_standard_uncertainty=scaled(table.centre_shift_standard_uncertainty_mm, MM),
    ), warnings


def encode_marker(marker: Marker) -> bytes:
    """Write a marker as the text of a marker.toml; what is None stays out."""
    body = encode_numbers(marker.body_standard_uncertainty, BODY_UNITS)
    keys = BodyUncertaintyTable.__struct_fields__
    shift = encode_numbers(marker.centre_shift_standard_uncertainty, MM)
    leds = zip(marker.names, marker.leds, marker.colours, strict=True)
    return encode_toml(
        {
            "format": FORMAT,
            "led_diameter_mm": encode_numbers(marker.led_diameter, MM),
            "source": marker.source,
            "datum": marker.datum,
            "registration": marker.registration,
            "led_standard_uncertainty_mm": encode_numbers(marker.led_standard_uncertainty, MM),
            "centre_shift_standard_uncertainty_mm": shift,
            "body_standard_uncertainty": body and dict(zip(keys, body, strict=True)),
            "led": [
                {"name": name, "position_mm": encode_numbers(position, MM), "colour": colour}
                for name, position, colour in leds
            ],
        }
    )


def write_marker(path: Path, marker: Marker) -> None:
    """Write a marker.toml, whole or not at all; raises InputError where the system refuses it."""
    write_whole(path, encode_marker(marker))


def _check_leds(path: Path, table: MarkerTable) -> None:
    """Refuse a marker without LEDs, names that do not tell them apart, and LEDs in one another."""
    if not table.led:
        raise key_error(path, "led", "is empty", "at least one [[led]] is expected")
    names = [led.name for led in table.led]
    for index, led in enumerate(table.led):
        if not led.name:
            raise key_error(path, f"led[{index}].name", "is empty", "each LED has a name")
        if led.name in names[:index]:
            found = f'repeats "{led.name}"'
            raise key_error(path, f"led[{index}].name", found, "each LED has its own name")
        if led.colour is not None:
            one_of(path, f"led[{index}].colour", led.colour, COLOURS)
    for (first, a), (second, b) in combinations(enumerate(table.led), 2):
        apart = float(np.linalg.norm(np.subtract(a.position_mm, b.position_mm)))
        if apart < table.led_diameter_mm:
            found = f"is {apart:.3g} mm from led[{first}]"
            expected = f"LEDs of {table.led_diameter_mm} mm cannot stand inside one another"
            raise key_error(path, f"led[{second}].position_mm", found, expected)


def body_uncertainty(path: Path, key: str, table: BodyUncertaintyTable | None) -> Array | None:
    """Check a body's uncertainty on the flange, (6,), m and rad, or None; InputError: negative."""
    if table is None:
        return None
    for name, value in msgspec.structs.asdict(table).items():
        not_negative(path, f"{key}.{name}", value)
    return np.asarray(np.array(msgspec.structs.astuple(table)) * BODY_UNITS)


class BoardTable(msgspec.Struct, kw_only=True):
    """The keys of board.toml."""

    format: int
    inner_corners: tuple[int, int] | None = None  # along x, along y
    squares: tuple[int, int] | None = None  # optional: only compared with inner_corners
    square_mm: float
    square_standard_uncertainty_mm: float | None = None
    markers: str | None = None
    marker_mm: float | None = None


def read_board(path: Path) -> tuple[Board, tuple[str, ...]]:
    """Read and check a board.toml; warnings: unknown keys, a square too small to be true.

    Raises:
        InputError: names the file, the key, what stands there, what should, and what to do.
    """
    table, warnings = decode(path, BoardTable)
    board = build_board(path, table)
    if table.square_mm < MIN_SQUARE_MM:
        note = f"{path}, square_mm: is {table.square_mm} mm; is that in metres?"
        warnings = (*warnings, one_line(note))
    return board, warnings


def build_board(place: str | Path, table: BoardTable) -> Board:
    """Build a board from the keys of a file or the options of a command; `place` names either.

    Raises:
        InputError: names the place, the key, what stands there, what should, and what to do.
    """
    path = Path(place)
    columns, rows = _corners(path, table)
    _check_sizes(path, table)
    board = Board(
        columns=columns,
        rows=rows,
        square=table.square_mm * MM,
        square_standard_uncertainty=scaled(table.square_standard_uncertainty_mm, MM),
        markers=table.markers,
        marker=scaled(table.marker_mm, MM),
    )
    if table.markers is not None:
        _check_markers(path, table, board)
    return board


def write_board(path: Path, board: Board) -> None:
    """Write a board.toml, whole or not at all; raises InputError where the system refuses it."""
    tree = {
        "format": FORMAT,
        "inner_corners": [board.columns, board.rows],
        "square_mm": encode_numbers(board.square, MM),
        "square_standard_uncertainty_mm": encode_numbers(board.square_standard_uncertainty, MM),
        "markers": board.markers,
        "marker_mm": encode_numbers(board.marker, MM),
    }
    write_whole(path, encode_toml(tree))


def _corners(path: Path, table: BoardTable) -> tuple[int, int]:
    """Count the inner corners; a refusal corrects the usual mistake, squares in their place."""
    squares = table.squares
    if table.inner_corners is None:
        expected = "the format needs the corners where four squares meet, along x and along y"
        remedy = "Add it, e.g. [9, 7] for 10 x 8 squares."
        if squares is not None:
            size = _format_size(squares)
            remedy = f"Write [{squares[0] - 1}, {squares[1] - 1}] for {size} squares."
        raise key_error(path, "inner_corners", "is missing", expected, remedy)
    if min(table.inner_corners) < MIN_CORNERS:
        found = f"is {_format_size(table.inner_corners)}"
        raise key_error(path, "inner_corners", found, f"at least {MIN_CORNERS} a side are expected")
    columns, rows = table.inner_corners
    if squares is not None and squares != (columns + 1, rows + 1):
        found = f"is {_format_size(table.inner_corners)}, but squares is {_format_size(squares)}"
        expected = "inner corners are one fewer than squares each way"
        remedy = "Count again and correct one of them."
        raise key_error(path, "inner_corners", found, expected, remedy)
    return columns, rows


def _format_size(pair: tuple[int, int]) -> str:
    return f"{pair[0]} x {pair[1]}"


def _check_sizes(path: Path, table: BoardTable) -> None:
    for key in ("square_mm", "marker_mm"):
        size = getattr(table, key)
        if size is not None and not MIN_SIZE_MM <= size < math.inf:  # an option may be nan
            raise key_error(path, key, f"is {size}", f"a size is {MIN_SIZE_MM:g} mm or more")
    not_negative(path, "square_standard_uncertainty_mm", table.square_standard_uncertainty_mm)
    if (table.markers is None) != (table.marker_mm is None):
        missing, given = ("marker_mm", "markers") if table.markers else ("markers", "marker_mm")
        expected = f"{given} is there, and a ChArUco board needs both"
        raise key_error(path, missing, "is missing", expected, "Add it, or delete the other.")


def _check_markers(path: Path, table: BoardTable, board: Board) -> None:
    markers, marker_mm = str(table.markers), float(table.marker_mm or 0)
    if markers not in fiducials.DICTIONARIES:
        expected = "an ArUco dictionary of OpenCV's is expected, such as DICT_5X5_100"
        remedy = did_you_mean(markers, fiducials.DICTIONARIES).strip()
        raise key_error(path, "markers", f'is "{markers}"', expected, remedy)
    if marker_mm >= table.square_mm:
        expected = f"a marker fits into a square of {table.square_mm} mm with white around it"
        raise key_error(path, "marker_mm", f"is {marker_mm}", expected)
    count = len(fiducials.dictionary(markers).bytesList)
    needed = (board.columns + 1) * (board.rows + 1) // 2  # white squares, a marker in each
    if count < needed:
        found = f'is "{markers}", which has {count} markers'
        raise key_error(path, "markers", found, f"the board needs {needed}", "Choose a larger one.")


class FixtureTable(msgspec.Struct, kw_only=True):
    """The keys of a fixture file; a rotation is given in one of two ways."""

    format: int
    position_mm: Triple  # the board's first inner corner in the base frame
    rotation: Matrix | None = None  # base_R_board
    rotation_vector_deg: Triple | None = None  # the same as axis times angle
    position_standard_uncertainty_mm: Triple | float | None = None  # along the base's axes
    rotation_standard_uncertainty_deg: Triple | float | None = None  # about the base's axes


@dataclass(frozen=True, slots=True)
class Fixture:
    """Where a board sits on the robot's base."""

    base_T_board: Array  # (4, 4)
    covariance: Array  # (6, 6), m and rad, perturbation on the left, base axes; 0: not stated


def read_fixture(path: Path) -> tuple[Fixture, tuple[str, ...]]:
    """Read and check a fixture file; warnings: unknown keys, uncertainties that are not stated.

    Raises:
        InputError: names the file, the key, what stands there, what should, and what to do.
    """
    table, warnings = decode(path, FixtureTable)
    base_T_board = _base_T_board(path, table)
    sigma, missing = [], []
    for key, unit in (
        ("position_standard_uncertainty_mm", MM),
        ("rotation_standard_uncertainty_deg", np.pi / 180),
    ):
        given = getattr(table, key)
        if given is None:
            missing.append(key)
        values = np.broadcast_to(0.0 if given is None else np.array(given, dtype=float), 3)
        not_negative(path, key, float(values.min()))
        sigma.append(values * unit)
    if 0 < np.abs(table.position_mm).max() < MIN_POSITION_MM:
        given = f"position_mm is {list(table.position_mm)}; is that in metres?"
        warnings = (*warnings, one_line(f"{path}: {given}"))
    if missing:
        warning = f"{path}: {' and '.join(missing)} not stated; taken as exact."
        warnings = (*warnings, one_line(warning))
    return Fixture(base_T_board, np.diag(np.square(np.concatenate(sigma)))), warnings


def _base_T_board(path: Path, table: FixtureTable) -> Array:
    vector_deg = table.rotation_vector_deg
    if (table.rotation is None) == (vector_deg is None):
        both = table.rotation is not None
        found = "is given twice" if both else "is missing"
        expected = "either rotation (3 x 3) or rotation_vector_deg is expected"
        remedy = "Leave one of them out." if both else "Add one of them."
        raise key_error(path, "rotation", found, expected, remedy)
    if table.rotation is not None:
        return nearest_pose(path, "rotation", table.rotation, table.position_mm)
    turn = Rotation.from_rotvec(np.deg2rad(np.array(vector_deg))).as_matrix()
    return rigid_transform(turn, np.array(table.position_mm) * MM)
