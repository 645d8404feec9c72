"""Read TOML into structs that mirror the file, naming the key in each refusal, and write it."""

import difflib
import math
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

import msgspec
import numpy as np
import tomli_w

from verify.core.records import Array
from verify.errors import InputError, one_line
from verify.io.files import read_bytes, refuse_utf_16

MAX_BYTES = 4_000_000  # of a TOML file
MAX_DEPTH = 20  # tables within tables
MAX_UNKNOWN_KEYS = 10  # that are named
# Names of keys that end so have values of at most so much: more is a slip of the unit. The first
# ending that fits counts.
PLAUSIBLE: tuple[tuple[str, float, str], ...] = (
    ("line_time_s", 1e-3, "s"), ("exposure_s", 10.0, "s"),
    ("standard_uncertainty_s", 1e3, "s"), ("standard_uncertainty_mm", 1e3, "mm"),
    ("standard_uncertainty_deg", 180.0, "deg"), ("temperature_c", 200.0, "°C"),
    ("_s", 1e12, "s"), ("_ms", 1e7, "ms"), ("_us", 1e7, "µs"), ("_mm", 1e5, "mm"),
    ("_deg", 3600.0, "deg"), ("_px", 1e5, "px"), ("_hz", 1e6, "Hz"), ("", 1e15, ""),
)  # fmt: skip
SLIPS = {"s": (("ms", 1e-3), ("µs", 1e-6), ("ns", 1e-9)), "mm": (("µm", 1e-3), ("nm", 1e-6))}
FORMAT = 1  # the edition of session.toml, rig.toml and marker.toml that this code reads
MM = 1e-3  # m

Positive = Annotated[float, msgspec.Meta(gt=0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0)]

S = TypeVar("S", bound=msgspec.Struct)

_DEEP_KEY = re.compile(  # bare or quoted names with dots between
    rb"""(?<![\w-])(?:(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){%d}"""
    % MAX_DEPTH
)
_COMPLAINT = re.compile(r"^(?P<what>.*?)(, got .*?)?( - at `\$\.?(?P<key>.*)`)?$", re.DOTALL)
_RANGE = re.compile(r"Number out of range|Expected `\w+` [<>]")
_MISSING = re.compile(r"Object missing required field `(?P<field>.*)`")
_UNKNOWN = re.compile(r"Object contains unknown field `(?P<field>.*)`")
_WORDS = {  # msgspec names JSON's types; the user wrote TOML
    "float": "a number",
    "int": "a whole number",
    "str": "a text in quotes",
    "bool": "true or false",
    "datetime": "a date and time, like 2026-10-02T09:30:00Z,",
    "date": "a day, like 2026-10-02,",
    "array": "a list",
    "object": "a table",
}


def key_error(path: Path, key: str, found: str, expected: str, remedy: str = "") -> InputError:
    """Word what is wrong at one key of a TOML file."""
    place = f"{path}, {shorten_key(key)}" if key else str(path)
    return InputError(place, found, expected, remedy or "Correct it there.")


def decode(path: Path, kind: type[S]) -> tuple[S, tuple[str, ...]]:
    """Decode a TOML file into a struct that mirrors it; a warning for each key it does not know.

    Raises:
        InputError: no such file, not TOML, another format, a missing key, or a value of another
            type; names the line or the key.
    """
    tree = parse(path)
    if tree.get("format") != FORMAT or isinstance(tree["format"], bool):
        found = f"is {shorten(tree['format'])}" if "format" in tree else "is missing"
        remedy = f"Write `format = {FORMAT}`, or use the program that this file was made for."
        raise key_error(path, "format", found, f"format {FORMAT} is expected", remedy)
    try:
        decoded = msgspec.convert(tree, kind)
    except msgspec.ValidationError as error:
        if _RANGE.match(str(error)):  # of a number that is none, or of another unit, more is known
            _require_all_plausible(path, tree)
        raise _reword(path, tree, kind, str(error)) from error
    _require_all_plausible(path, tree)
    return decoded, _unknown_keys(path, tree, kind)


def _require_all_plausible(path: Path, tree: dict[str, Any]) -> None:
    for key, value in leaves(tree):
        if isinstance(value, float | int) and not isinstance(value, bool):
            require_plausible(path, key, value)


def require_plausible(path: Path, key: str, value: float) -> None:
    """Refuse a number not finite or beyond its key's unit; InputError names the unit that fits."""
    if isinstance(value, float) and not math.isfinite(value):
        raise key_error(path, key, f"is {value}", "a finite number is expected")
    name = re.sub(r"(\[\d+\])+$", "", key).rpartition(".")[2]
    _, most, unit = next(rule for rule in PLAUSIBLE if name.endswith(rule[0]))
    if abs(value) <= most:
        return
    slip = next((s for s in SLIPS.get(unit, ()) if abs(value) <= most / s[1]), None)
    remedy = f"In {slip[0]} it would be {value * slip[1]:g} {unit}." if slip else ""
    expected = f"at most {most:g}{f' {unit}' if unit else ''} is plausible"
    raise key_error(path, key, f"is {shorten(value)}", expected, remedy)


def shorten(value: object) -> str:
    """Show a value from a file, shortened to what fits in a sentence."""
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int) and abs(value) > 10**50:  # Python does not print very long ones
        return "a number of more than 50 digits"
    text = f'"{value}"' if isinstance(value, str) else str(value)
    return text if len(text) <= 60 else f"{text[:60]}…"  # a longer one hides the rest of the line


def shorten_key(key: str) -> str:
    """Show a key path, shortened to what fits in a sentence."""
    return key if len(key) <= 80 else f"{key[:80]}…"


def one_of(path: Path, key: str, value: str, options: tuple[str, ...]) -> str:
    """Return the value if it is among the options; the InputError says which there are."""
    if value in options:
        return value
    expected = "expected is " + " or ".join(f'"{option}"' for option in options)
    remedy = f"Write one of them.{did_you_mean(value, options)}"
    raise key_error(path, key, f'is "{value}"', expected, remedy)


def listed(names: Sequence[object], most: int = 12) -> str:
    """Name the first few of many, with commas between."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(map(str, names[:most])) + more


def did_you_mean(word: str, options: tuple[str, ...]) -> str:
    """Suggest the nearest known word, in capitals or not, as a sentence; empty: none is near."""
    by_lower = {option.lower(): option for option in options}
    near = difflib.get_close_matches(word.lower(), by_lower, n=1)
    return f" Did you mean `{by_lower[near[0]]}`?" if near else ""


def encode(tree: Mapping[str, Any]) -> bytes:
    """Write tables as TOML, each matrix one row after the other on one line.

    tomli_w alone puts every number of a nested list on a line of its own; here it encodes scalars.
    Values that are None are left out.
    """
    return "".join(_table_lines(tree, "")).encode()


def encode_numbers(values: Array | float | None, unit: Array | float = 1.0) -> Any:
    """Turn a number or an array into (nested lists of) floats for `encode`, in a unit of the file.

    Rounded to 15 significant digits, which drops the noise that a change of units leaves in the
    last bit: 7.5, not 7.500000000000001. None stays None.
    """
    if values is None:
        return None
    array = np.asarray(values, dtype=float) / unit
    if array.ndim:
        return [encode_numbers(item) for item in array]
    return float(f"{array.item():.15g}")


def scaled(value: float | None, unit: float) -> float | None:
    """Multiply a number by a unit; None stays None."""
    return None if value is None else value * unit


def not_negative(path: Path, key: str, value: float | None) -> None:
    """Refuse a negative number by an InputError; None passes."""
    if value is not None and value < 0:
        raise key_error(path, key, f"is {value}", "a number of 0 or more is expected")


def parse(path: Path) -> dict[str, Any]:
    """Read a TOML file; raises InputError with the line: no file, not UTF-8, or not TOML."""
    data = read_bytes(path, MAX_BYTES)
    refuse_utf_16(path, data)
    if _DEEP_KEY.search(data):
        raise _depth_error(path)
    try:
        return tomllib.loads(data.decode("utf-8-sig"))  # editors on Windows put a mark in front
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        remedy = "Save the file again as UTF-8."
        raise InputError(f"{path}, line {line}", "is not UTF-8", "TOML is UTF-8", remedy) from error
    except tomllib.TOMLDecodeError as error:
        what, _, where = str(error).partition(" (at ")
        place = f"{path}, {where.rstrip(')')}" if where else str(path)
        raise InputError(place, f"is not TOML: {what}", "", "Correct that line.") from error
    except RecursionError as error:
        raise _depth_error(path) from error
    except ValueError as error:  # a whole number of thousands of digits
        raise InputError(path, f"is not TOML: {error}", "", "Correct that number.") from error


def _depth_error(path: Path) -> InputError:
    return InputError(path, "is nested too deeply", "", "Write it again from the format's example.")


def leaves(value: object, key: str = "") -> Iterator[tuple[str, object]]:
    """Give each value that is neither a table nor a list, with its key path."""
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from leaves(inner, f"{key}.{name}" if key else name)
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from leaves(inner, f"{key}[{index}]")
    else:
        yield key, value


def _reword(
    path: Path, tree: dict[str, Any], kind: type[msgspec.Struct], complaint: str
) -> InputError:
    """Turn msgspec's message into key, what stands there and what is expected."""
    parts = _COMPLAINT.match(complaint)
    what, key = (parts["what"], parts["key"] or "") if parts else (complaint, "")
    if named := _MISSING.match(what) or _UNKNOWN.match(what):
        inner = f"{key}.{named['field']}" if key else named["field"]
        if named.re is _MISSING:
            return key_error(path, inner, "is missing", "the format needs it", "Add it there.")
        hint = did_you_mean(named["field"], tuple(_all_keys(kind))).strip()
        return key_error(path, inner, "is not known", "", hint or "Leave it out.")
    wanted = re.search(r"`(.*?)`|RFC3339 encoded (date\w*)", what)
    words = (
        [_WORDS.get(word, word) for word in (wanted[1] or wanted[2]).split(" | ")] if wanted else []
    )
    expected = " or ".join(word for word in words if word != "null") or "a known value"
    expected += what[wanted.end() :] if wanted else ""
    signs = ((">", "above {}"), (">=", "of {} or more"), ("<", "below {}"), ("<=", "of at most {}"))
    for sign, said in signs:
        expected = re.sub(rf"{sign} (-?[\d.]+?)(\.0)?$", said.format(r"\1"), expected)
    return key_error(path, key, f"is {shorten(_value_at(tree, key))}", f"{expected} is expected")


def _all_keys(kind: Any) -> Iterator[str]:
    """Give every key of the structs in a type and of the structs in their fields."""
    for struct in _structs_in(kind):
        for field in msgspec.structs.fields(struct):
            yield field.encode_name
            yield from _all_keys(field.type)


def _value_at(tree: Any, key: str) -> object:
    value = tree
    for name, index in re.findall(r"([^.\[\]]+)|\[(\d+)\]", key):
        if index and isinstance(value, list):
            value = value[int(index)]
        elif name and isinstance(value, dict) and name in value:
            value = value[name]
    return value


def _unknown_keys(path: Path, tree: dict[str, Any], kind: type[msgspec.Struct]) -> tuple[str, ...]:
    """Warn of the keys that the format does not know; of very many the first ones."""
    unknown = list(_find_unknown(tree, kind))
    named = [
        one_line(
            f"{path}, {shorten_key(key)}: the format does not know this key; it is ignored."
            f"{did_you_mean(key.rpartition('.')[2], fields)}"
        )
        for key, fields in unknown[:MAX_UNKNOWN_KEYS]
    ]
    if len(unknown) > len(named):
        more = len(unknown) - len(named)
        named.append(f"{path}: {more} further keys that the format does not know are ignored.")
    return tuple(named)


def _find_unknown(
    tree: dict[str, Any], kind: type[msgspec.Struct], key: str = ""
) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield each unknown key with the names that its table knows."""
    fields = {field.encode_name: field.type for field in msgspec.structs.fields(kind)}
    for name, value in tree.items():
        inner = f"{key}.{name}" if key else name
        if name not in fields:
            yield inner, tuple(fields)
            continue
        table = next(_structs_in(fields[name]), None)
        if table is None:
            continue
        for index, item in enumerate(value if isinstance(value, list) else [value]):
            if isinstance(item, dict):
                place = f"{inner}[{index}]" if isinstance(value, list) else inner
                yield from _find_unknown(item, table, place)


def _structs_in(kind: Any) -> Iterator[type[msgspec.Struct]]:
    """Give the structs in `Table`, `Table | None` or `list[Table]`."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        yield kind
    for part in get_args(kind):
        yield from _structs_in(part)


def _table_lines(tree: Mapping[str, Any], name: str) -> Iterator[str]:
    """Yield a table's own values, then its tables: TOML wants them in that order."""
    present = {key: value for key, value in tree.items() if value is not None}
    tables = {key: value for key, value in present.items() if _has_tables(value)}
    for key in present:
        if key not in tables:
            yield f"{key} = {_inline(present[key])}\n"
    for key, value in tables.items():
        inner = f"{name}.{key}" if name else key
        several = isinstance(value, list)
        for table in value if several else [value]:
            yield f"\n[[{inner}]]\n" if several else f"\n[{inner}]\n"
            yield from _table_lines(table, inner)


def _has_tables(value: object) -> bool:
    return isinstance(value, dict) or (
        isinstance(value, list) and bool(value) and isinstance(value[0], dict)
    )


def _inline(value: object) -> str:
    if not isinstance(value, list):
        return tomli_w.dumps({"v": value}).removeprefix("v = ").rstrip("\n")
    inner = [_inline(item) for item in value]
    if len(value) > 3 and isinstance(value[0], list):  # a rotation fits on one line
        return "[\n" + "".join(f"  {row},\n" for row in inner) + "]"
    return f"[{', '.join(inner)}]"
