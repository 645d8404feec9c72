"""Encoders that print a text line of any kind, on a serial port or TCP, read by a field map.

A line is split by a separator and a list of column names, or by a regular expression with named
groups. Names are `t`, `q1` to `qN`, `seq` and `sum`; `_` is a column to skip. A device that prints
one line an axis has the groups `axis` and `value`; lines of equal `t` are joined.
"""

import math
import re
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from verify.core.records import Array
from verify.devices import ports
from verify.devices.encoders import intake
from verify.devices.protocols import EncoderReading
from verify.errors import InputError

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
_NUMBER = re.compile(r"[+-]?([0-9]{1,20}(\.[0-9]{0,12})?|\.[0-9]{1,12})([eE][+-]?[0-9]{1,2})?")
_MAX_LINE_BYTES = 1024  # bytes: a longer line is noise
_CHOICES = {
    "time_unit": (*TIME_UNITS, "ticks", "none"),
    "checksum": ("none", *ports.CHECKSUMS),
    "angle_unit": ("deg", "rad", "counts"),
}


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

    def __post_init__(self) -> None:
        _compile("skip", self.skip)
        names = set(_compile("pattern", self.pattern).groupindex if self.pattern else self.columns)
        wanted = {f"q{joint}" for joint in range(1, self.joints + 1)}
        if {"axis", "value", "t"} <= names:
            wanted = set()
        if self.time_unit != "none":
            wanted.add("t")
        if self.checksum != "none":
            wanted.add("sum")
        if missing := sorted(wanted - names):
            raise _invalid_key(
                "columns", f"name no {', '.join(missing)}", "Name what each field is."
            )
        for key, choices in _CHOICES.items():
            if (value := getattr(self, key)) not in choices:
                raise _invalid_key(key, f'is "{value}"', f"Known: {', '.join(choices)}.")
        if self.time_unit == "ticks" and not self.tick_rate:
            raise _invalid_key("tick_rate_hz", "is missing", "Ticks need their rate.")
        if self.angle_unit == "counts" and len(self.counts_per_degree) != self.joints:
            raise _invalid_key(
                "counts_per_degree", "is not one number a joint", "Give one a joint."
            )

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

    def parse(self, line: bytes) -> "LineFields | str":
        """Parse a line; the reason, where it does not fit; an empty one, where it is skipped."""
        try:
            text = line.decode("ascii")
        except UnicodeDecodeError:
            return "line that is not text"
        if len(text) > _MAX_LINE_BYTES:
            return "line too long"
        if self.skip and re.search(self.skip, text):
            return ""
        words = self._words(text)
        if words is None:
            return "line that does not fit the field map"
        if self.checksum != "none" and not self._checksum_fits(text, words):
            return "wrong checksum"
        numbers = {name: word for name, (word, _) in words.items() if name != "sum"}
        if not all(_NUMBER.fullmatch(word) for word in numbers.values()):
            return "field that is not a number"
        return self._fields({name: float(word) for name, word in numbers.items()})

    def _words(self, text: str) -> dict[str, tuple[str, int]] | None:
        """Words by name, each with the place where it begins."""
        if self.pattern:
            match = re.search(self.pattern, text)
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

    def _checksum_fits(self, text: str, words: dict[str, tuple[str, int]]) -> bool:
        digits, function = ports.CHECKSUMS[self.checksum]
        if "sum" not in words:
            return False
        word, start = words["sum"]
        if not re.fullmatch(f"[0-9A-Fa-f]{{1,{digits}}}", word):
            return False
        before = text[:start].lstrip("$")
        covered = before[: -1 if self.pattern else -len(self.separator)]
        return int(word, 16) == function(covered.encode("ascii"))

    def _fields(self, numbers: dict[str, float]) -> "LineFields | str":
        t, sequence = numbers.get("t"), numbers.get("seq")
        if "axis" in numbers and "value" in numbers:
            axis = numbers["axis"]
            if axis not in range(1, self.joints + 1):
                return "axis that the robot does not have"
            return LineFields(t, sequence, {int(axis): numbers["value"]})
        values = {j: numbers[f"q{j}"] for j in range(1, self.joints + 1) if f"q{j}" in numbers}
        if len(values) < self.joints:
            return "line without all joints"
        return LineFields(t, sequence, values)


@dataclass(frozen=True, slots=True)
class LineFields:
    """The numbers of one line, in its own units."""

    t: float | None
    sequence: float | None
    values: dict[int, float]  # by joint, from 1: all of them, or one


def _compile(key: str, pattern: str) -> re.Pattern[str]:
    try:
        return re.compile(pattern)
    except re.error as error:
        raise _invalid_key(key, f"is not a regular expression: {error}", "Correct it.") from error


def _invalid_key(key: str, found: str, remedy: str) -> InputError:
    return InputError(f"encoders, {key}", found, "", remedy)


class TextIntake:
    """Turns lines into readings.

    `angles` leads from the device's angles to the robot file's own. The latency, s, is the most by
    which a line comes later than its angles were read. `in_lumps`: lines come late and together as
    a rule.
    """

    def __init__(
        self,
        fields: FieldMap,
        angles: intake.AngleMap,
        latency: float,
        counts: intake.IntakeCounts,
        *,
        in_lumps: bool = False,
    ) -> None:
        self._fields, self._latency, self._counts = fields, latency, counts
        self._intake = intake.ReadingIntake(angles, counts)
        self._clock = intake.ControllerClock(fields.wrap, in_lumps=in_lumps)
        self._partial: dict[int, float] = {}  # axes of an instant that is not complete yet
        self._partial_t: float | None = None
        self._sequence: float | None = None

    def restart(self) -> None:
        """Begin a new connection: drop a partial instant, start a new segment of the clock."""
        self._partial.clear()
        self._sequence = None
        self._clock.restart(self._fields.wrap)

    def take(self, line: bytes, chunk: ports.Chunk) -> list[EncoderReading]:
        """Make a reading of a line, or count why not."""
        fields = self._fields.parse(line)
        if isinstance(fields, str):
            if fields:
                self._counts.bad[fields] += 1
            return []
        values = self._joined(fields)
        if values is None:
            return []
        timed = self._timed(fields.t, chunk)
        if isinstance(timed, str):
            self._counts.bad[timed] += 1
            return []
        self._count_lost(fields.sequence)
        order = [values[joint] for joint in range(1, self._fields.joints + 1)]
        angle = np.array(order) * self._fields.radians_per_unit
        instant, half_width = timed
        return self._intake.take(instant, chunk.t, half_width, angle)

    def _joined(self, fields: LineFields) -> dict[int, float] | None:
        """All joints of an instant; None until the last of them has come."""
        if len(fields.values) == self._fields.joints:
            return fields.values
        if fields.t != self._partial_t:
            if self._partial:
                self._counts.bad["instant without all joints"] += 1
            self._partial, self._partial_t = {}, fields.t
        self._partial |= fields.values
        if len(self._partial) < self._fields.joints:
            return None
        values, self._partial = self._partial, {}
        return values

    def _timed(
        self, t: float | None, chunk: ports.Chunk
    ) -> tuple[intake.ControllerInstant, float] | str:
        """When the angles were read: the device's own time, else the middle of what is possible."""
        unit = self._fields.seconds_per_unit
        if unit is not None and t is not None:
            instant = self._clock.stamp(t * unit, chunk.t)
            # a counter is known within its unit; how many decimals of a second count is not known
            return instant if isinstance(instant, str) else (instant, unit / 2 if unit < 1 else 0.0)
        return intake.arrival(chunk, self._latency)

    def _count_lost(self, sequence: float | None) -> None:
        before, self._sequence = self._sequence, sequence
        if before is not None and sequence is not None and sequence > before:
            self._counts.lost += int(sequence - before) - 1


USB_LATENCY = 0.016  # s: a USB-serial bridge collects bytes for up to so long


@dataclass(frozen=True, slots=True)
class TextSettings:
    """How the device is reached, and what is sent to it."""

    port: str
    fields: FieldMap
    line: ports.SerialLine = ports.DEFAULT_LINE
    latency: float = USB_LATENCY  # s
    at_start: bytes = b""  # sent when the line is open: starts the stream
    at_end: bytes = b""  # sent before it is closed


class LineEncoders(intake.PortDriver, ABC):
    """Joint readings from lines of text; a device and a file differ in how they begin."""

    def __init__(self, link: ports.PortLink) -> None:
        super().__init__(link)
        self._lines = ports.LineBuffer()
        self._intake: TextIntake | None = None  # None: the lines cannot be read

    def read(self) -> list[EncoderReading]:
        """Give what has arrived since the last call, oldest first; waits for at most 20 ms."""
        chunk = self.link.receive()
        if self.link.reopened():
            self._lines = ports.LineBuffer()  # the other half of a half line will not come
            self._begin()
        if chunk is None or self._intake is None:
            return []
        take = self._intake.take
        readings = [r for line in self._lines.feed(chunk.data) for r in take(line, chunk)]
        if readings:
            self.link.steady()
        return readings

    @abstractmethod
    def _begin(self) -> None:
        """Prepare for the lines of a new connection."""


class TextEncoders(LineEncoders):
    """Joint readings from a device that prints lines of text."""

    def __init__(self, settings: TextSettings, angles: intake.AngleMap) -> None:
        super().__init__(ports.link_to(settings.port, settings.line))
        self._settings = settings
        self._text = TextIntake(settings.fields, angles, settings.latency, self.counts)
        self._intake = self._text

    def _begin(self) -> None:
        self._text.restart()
        self._send(self._settings.at_start)

    def close(self) -> None:
        """Send what ends the stream, if anything, and close the port."""
        self._send(self._settings.at_end)
        super().close()

    def _send(self, data: bytes) -> None:
        if data:
            self.link.send(data)
