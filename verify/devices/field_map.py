"""Any delimited text line as joint readings: which field is what, in which unit; no port.

A line is taken apart either by a separator and a list of column names, or by a regular expression
with named groups. Names are `t`, `q1` to `qN`, `seq` and `sum`; `_` is a column to skip. A device
that prints one line an axis has the groups `axis` and `value`; such lines are joined by equal `t`.
"""

import math
import re
from dataclasses import dataclass, field

import numpy as np

from verify.devices.lines import CHECKSUMS
from verify.errors import InputError
from verify.records import Array

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
_NUMBER = re.compile(r"[+-]?([0-9]{1,20}(\.[0-9]{0,12})?|\.[0-9]{1,12})([eE][+-]?[0-9]{1,2})?")
_LONGEST = 1024  # bytes: a longer line is noise


@dataclass(frozen=True, slots=True)
class FieldMap:
    """Which field of a line is what.

    Raises:
        InputError: settings that contradict each other, or a regular expression that is none.
    """

    joints: int
    columns: tuple[str, ...] = ()  # with `separator`: what each field is, in order
    separator: str = ","
    pattern: str = ""  # a regular expression with named groups, instead
    time_unit: str = "none"  # s, ms, us, ticks, or none: time of arrival
    tick_rate: float | None = None  # Hz, with ticks
    wraps_after: float | None = None  # in units of `t`: where the counter starts over
    angle_unit: str = "deg"  # deg, rad or counts
    counts_per_degree: tuple[float, ...] = ()  # one a joint, with counts
    checksum: str = "none"  # none, xor, sum8, crc8, crc16: over all before `sum` and its separator
    skip: str = ""  # lines that match this (regular expression) are left out, uncounted
    _compiled: re.Pattern[str] | None = field(init=False, default=None, repr=False)

    def __post_init__(self) -> None:
        for key in ("pattern", "skip"):
            _compile(key, getattr(self, key))
        pattern = _compile("pattern", self.pattern) if self.pattern else None
        object.__setattr__(self, "_compiled", pattern)
        names = set(pattern.groupindex) if pattern else set(self.columns)
        wanted = {f"q{joint}" for joint in range(1, self.joints + 1)}
        if {"axis", "value", "t"} <= names:
            wanted = set()
        if self.time_unit != "none":
            wanted.add("t")
        if self.checksum != "none":
            wanted.add("sum")
        if missing := sorted(wanted - names):
            raise _wrong("columns", f"name no {', '.join(missing)}", "Name what each field is.")
        if self.time_unit not in (*TIME_UNITS, "ticks", "none"):
            raise _wrong("time_unit", f'is "{self.time_unit}"', "Known: s, ms, us, ticks, none.")
        if self.time_unit == "ticks" and not self.tick_rate:
            raise _wrong("tick_rate_hz", "is missing", "Ticks need their rate.")
        if self.checksum not in ("none", *CHECKSUMS):
            raise _wrong(
                "checksum", f'is "{self.checksum}"', f"Known: none, {', '.join(CHECKSUMS)}."
            )
        if self.angle_unit not in ("deg", "rad", "counts"):
            raise _wrong("angle_unit", f'is "{self.angle_unit}"', "Known: deg, rad, counts.")
        if self.angle_unit == "counts" and len(self.counts_per_degree) != self.joints:
            raise _wrong("counts_per_degree", "is not one number a joint", "Give one a joint.")

    @property
    def seconds_per_unit(self) -> float | None:
        """Length of the unit of `t`; None where the time of arrival counts."""
        if self.time_unit == "ticks" and self.tick_rate:
            return 1.0 / self.tick_rate
        return TIME_UNITS.get(self.time_unit)

    @property
    def wrap(self) -> float | None:
        """Where the controller's clock starts over, s."""
        unit = self.seconds_per_unit
        return None if unit is None or self.wraps_after is None else self.wraps_after * unit

    @property
    def radians_per_unit(self) -> Array:
        """Size of one unit of angle, (joints,), rad."""
        if self.angle_unit == "rad":
            return np.ones(self.joints)
        if self.angle_unit == "deg":
            return np.full(self.joints, math.radians(1.0))
        return math.radians(1.0) / np.array(self.counts_per_degree, dtype=float)

    def parse(self, line: bytes) -> "Fields | str":
        """Take a line apart; where it does not fit, say why. An empty reason: to be skipped."""
        try:
            text = line.decode("ascii")
        except UnicodeDecodeError:
            return "line that is not text"
        if len(text) > _LONGEST:
            return "line too long"
        if self.skip and re.search(self.skip, text):
            return ""
        found = self._found(text)
        if found is None:
            return "line that does not fit the field map"
        if self.checksum != "none" and not self._summed(text, found):
            return "wrong checksum"
        numbers = {name: word for name, (word, _) in found.items() if name != "sum"}
        if not all(_NUMBER.fullmatch(word) for word in numbers.values()):
            return "field that is no number"
        return self._fields({name: float(word) for name, word in numbers.items()})

    def _found(self, text: str) -> dict[str, tuple[str, int]] | None:
        """Words by name, each with the place where it begins."""
        if self._compiled is not None:
            match = self._compiled.search(text)
            if match is None:
                return None
            groups = match.groupdict()
            return {k: (v.strip(), match.start(k)) for k, v in groups.items() if v is not None}
        words = text.split(self.separator)
        if len(words) != len(self.columns):
            return None
        starts = np.cumsum([0, *(len(word) + len(self.separator) for word in words)]).tolist()
        named = zip(self.columns, words, starts, strict=False)
        return {name: (word.strip(), start) for name, word, start in named if name != "_"}

    def _summed(self, text: str, found: dict[str, tuple[str, int]]) -> bool:
        digits, function = CHECKSUMS[self.checksum]
        if "sum" not in found:
            return False
        word, start = found["sum"]
        if not re.fullmatch(f"[0-9A-Fa-f]{{1,{digits}}}", word):
            return False
        before = text[:start].lstrip("$")
        covered = before[: -1 if self._compiled else -len(self.separator)]
        return int(word, 16) == function(covered.encode("ascii"))

    def _fields(self, numbers: dict[str, float]) -> "Fields | str":
        t, sequence = numbers.get("t"), numbers.get("seq")
        if "axis" in numbers and "value" in numbers:
            axis = numbers["axis"]
            if axis not in range(1, self.joints + 1):
                return "axis that the robot has not"
            return Fields(t, sequence, {int(axis): numbers["value"]})
        values = {j: numbers[f"q{j}"] for j in range(1, self.joints + 1) if f"q{j}" in numbers}
        if len(values) < self.joints:
            return "line without all joints"
        return Fields(t, sequence, values)


@dataclass(frozen=True, slots=True)
class Fields:
    """What a line says, in its own units."""

    t: float | None
    sequence: float | None
    values: dict[int, float]  # by joint, from 1: all of them, or one


def _compile(key: str, pattern: str) -> re.Pattern[str]:
    try:
        return re.compile(pattern)
    except re.error as error:
        raise _wrong(key, f"is no regular expression: {error}", "Mend it.") from error


def _wrong(key: str, found: str, remedy: str) -> InputError:
    return InputError(f"encoders, {key}", found, "", remedy)
