"""marker.toml: millimetres and degrees in the file, the Marker in metres and radians inside."""

from itertools import combinations
from pathlib import Path

import msgspec
import numpy as np

from verify.marker import COLOURS, Marker
from verify.records import Array
from verify.toml_file import FORMAT, decode, encode_numbers, fault, not_negative, one_of
from verify.toml_file import encode as encode_toml
from verify.writing import write_whole

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


def read(path: str | Path) -> tuple[Marker, tuple[str, ...]]:
    """Read and check a marker.toml.

    Returns:
        The marker, and a warning for each key that the format does not know.

    Raises:
        InputError: names the file, the key, what stands there, what should, and what to do.
    """
    path = Path(path)
    table, warnings = decode(path, MarkerTable)
    if table.led_diameter_mm <= 0:
        raise fault(
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


def encode(marker: Marker) -> bytes:
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


def write(path: str | Path, marker: Marker) -> None:
    """Write a marker.toml, whole or not at all.

    Raises:
        InputError: the disk or the system refuses it.
    """
    write_whole(Path(path), encode(marker))


def _check_leds(path: Path, table: MarkerTable) -> None:
    """Refuse a marker without LEDs, names that do not tell them apart, and LEDs in one another."""
    if not table.led:
        raise fault(path, "led", "is empty", "at least one [[led]] is expected")
    names = [led.name for led in table.led]
    for index, led in enumerate(table.led):
        if not led.name:
            raise fault(path, f"led[{index}].name", "is empty", "each LED has a name")
        if led.name in names[:index]:
            raise fault(
                path, f"led[{index}].name", f'repeats "{led.name}"', "each LED has its own name"
            )
        if led.colour is not None:
            one_of(path, f"led[{index}].colour", led.colour, COLOURS)
    for (first, a), (second, b) in combinations(enumerate(table.led), 2):
        apart = float(np.linalg.norm(np.subtract(a.position_mm, b.position_mm)))
        if apart < table.led_diameter_mm:
            found = f"is {apart:.3g} mm from led[{first}]"
            expected = f"LEDs of {table.led_diameter_mm} mm cannot stand inside one another"
            raise fault(path, f"led[{second}].position_mm", found, expected)


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
