"""LABENC 1, the lab encoder boards' text protocol: bytes to messages and back, no port.

    line = "$" body "*" checksum LF        body = type *("," field)

The checksum is the XOR of the body's bytes (two upper-case hexadecimal digits), or CRC-16/CCITT-
FALSE (four) where both ends are set so.
"""

import re
from dataclasses import dataclass

from verify.devices.ports import CHECKSUMS

MAX_LINE_BYTES = 120  # bytes
SUPPORTED_VERSION = (1, 0)  # version that this code knows; a newer minor one adds fields and types
MOVING = 0x20  # bit of the status
UNUSABLE = {0x01: "not homed", 0x02: "encoder fault", 0x04: "held or interpolated"}  # by bit

_LINE = re.compile(rb"\$([ !-#%-)+-~]+)\*([0-9A-F]+)")  # printable but $ and *
_DECIMAL = re.compile(r"[+-]?[0-9]{1,7}\.[0-9]{1,9}")
_WHOLE = re.compile(r"[+-]?[0-9]{1,10}")
_UNSIGNED = re.compile(r"[0-9]{1,10}")
_STATUS = re.compile(r"[0-9A-F]{1,4}")
_VERSION = re.compile(r"([0-9]{1,3})\.([0-9]{1,3})")


@dataclass(frozen=True, slots=True)
class LabencGreeting:
    """H: what the board is."""

    major: int
    minor: int
    axes: int
    unit: str  # deg or counts
    tick_rate: int  # Hz


@dataclass(frozen=True, slots=True)
class LabencAxis:
    """N: how one axis counts."""

    axis: int  # from 1
    counts_per_turn: int
    direction: int  # +1 or -1
    zero: int  # counts


@dataclass(frozen=True, slots=True)
class LabencSample:
    """J or C: all axes at one tick."""

    kind: str  # J in the unit of H, C in raw counts
    sequence: int
    tick: int
    fields: tuple[str, ...]  # values, then status; how many values, H says


@dataclass(frozen=True, slots=True)
class OtherLine:
    """Whatever else is well formed: W, E, A, M, T, and types that are not known yet."""

    kind: str
    fields: tuple[str, ...]


Message = LabencGreeting | LabencAxis | LabencSample | OtherLine


def frame_line(body: str, checksum: str = "xor") -> bytes:
    """Frame a body as a line with its checksum and LF."""
    digits, function = CHECKSUMS[checksum]
    data = body.encode("ascii")
    return b"$%s*%0*X\n" % (data, digits, function(data))


def parse_line(line: bytes, checksum: str = "xor") -> Message | str:
    """Parse one line, without its end; the reason, where it is not used."""
    digits, function = CHECKSUMS[checksum]
    if len(line) > MAX_LINE_BYTES:
        return "line too long"
    match = _LINE.fullmatch(line)
    if match is None:
        return "no whole line"
    body, total = match[1], match[2]
    if len(total) != digits or int(total, 16) != function(body):
        return "wrong checksum"
    kind, *fields = body.decode("ascii").split(",")
    match kind:
        case "H":
            return _parse_greeting(fields)
        case "N":
            return _parse_axis(fields)
        case "J" | "C":
            return _parse_sample(kind, fields)
    return OtherLine(kind, tuple(fields))


def sample_values(
    sample: LabencSample, axes: int, *, decimal: bool, exact: bool
) -> tuple[tuple[float, ...], int] | None:
    """Take the axes' values and the status out of a sample; None if it does not hold them.

    `axes`: how many, as H says; `decimal`: the values are degrees, with a decimal point, else
    counts; `exact`: nothing may follow the status (a board of a newer minor version may add
    fields).
    """
    if len(sample.fields) < axes + 1 or (exact and len(sample.fields) != axes + 1):
        return None
    grammar = _DECIMAL if decimal else _WHOLE
    texts, status = sample.fields[:axes], sample.fields[axes]
    if not all(grammar.fullmatch(text) for text in texts) or not _STATUS.fullmatch(status):
        return None
    return tuple(map(float, texts)), int(status, 16)


def _parse_greeting(fields: list[str]) -> LabencGreeting | str:
    if len(fields) < 8 or fields[0] != "LABENC":
        return "greeting of another protocol"
    version = _VERSION.fullmatch(fields[1])
    numbers = [fields[3], fields[5], fields[6]]
    if version is None or not all(map(_UNSIGNED.fullmatch, numbers)):
        return "greeting that is not understood"
    axes, tick_rate, _rate = map(int, numbers)
    if not 1 <= axes <= 16 or tick_rate < 1 or fields[4] not in ("deg", "counts"):
        return "greeting that is not understood"
    return LabencGreeting(int(version[1]), int(version[2]), axes, fields[4], tick_rate)


def _parse_axis(fields: list[str]) -> LabencAxis | str:
    if len(fields) < 4 or not all(map(_WHOLE.fullmatch, fields[:4])):
        return "axis line that is not understood"
    axis, counts, direction, zero = map(int, fields[:4])
    if not 1 <= axis <= 16 or counts < 1 or abs(direction) != 1:
        return "axis line that is not understood"
    return LabencAxis(axis, counts, direction, zero)


def _parse_sample(kind: str, fields: list[str]) -> LabencSample | str:
    if len(fields) < 4 or not all(map(_UNSIGNED.fullmatch, fields[:2])):
        return "sample that is not understood"
    sequence, tick = map(int, fields[:2])
    if max(sequence, tick) >= 1 << 32:
        return "sample that is not understood"
    return LabencSample(kind, sequence, tick, tuple(fields[2:]))
