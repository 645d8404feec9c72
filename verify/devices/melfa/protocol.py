"""Mitsubishi's R3 line protocol (BFP-A4288): requests that only read, and their answers; no port.

request : robot ";" slot ";" NAME [argument] terminator       1;1;JPOSF
answer  : "Qo" ("K"|"k") data  |  "Qe" ("R"|"r") number        lower case: an alarm is active

An answer ends with CR, CR LF or NUL, or after a silence where the controller sends no end mark.
"""

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import ClassVar, Final

from verify.devices.ports import MAX_LINE_BYTES, Chunk

# The only commands that this program can send to a controller while it verifies, each with the
# grammar of its argument. Several commands of the protocol do harm and ask for no right (BREAKONF
# releases the brakes), so what is not listed cannot be worded at all.
READ_COMMANDS: Final = MappingProxyType(
    {
        "OPEN": r"=[A-Za-z0-9]{1,16}",
        "CLOSE": "",
        "STATE": "",
        "JPOSF": "",
        "PAR": "MEJAR",
        "ERROR": "",
        "ERRORMES": "[0-9]{4,5}",
    }
)
# number -> meaning
ERROR_MEANINGS: Final[Mapping[int, str]] = {
    int(number): meaning
    for number, meaning in tomllib.loads(
        Path(__file__).with_name("errors.toml").read_text(encoding="utf-8")
    ).items()
}
PROCEDURAL = re.compile(rb"^[\x02\x05\x06\x15]")  # STX, ENQ, ACK, NAK: the other kind of RS-232

_ANSWER = re.compile(rb"Q(o[Kk]|e[Rr])([\x0b\x20-\x7e]*)")
_ANGLE = re.compile(r"-?[0-9]{1,4}\.[0-9]{1,4}")
_POSITIVE = re.compile(r"[0-9]{1,5}\.[0-9]{1,4}")
_PERCENT = re.compile(r"[0-9]{1,3}")
_LIMITS = re.compile(r"[0-9A-Fa-f]{8}")
_RUN = re.compile(r"([0-9A-Fa-f]{2})([0-9A-Fa-f]{2})([0-9]{1,5})")
_JOINT = re.compile(r"J([1-8])")
MIN_STATE_FIELDS = 15  # fewer are half an answer


class ForbiddenCommandError(ValueError):
    """Somebody tried to word a command that is not listed."""


@dataclass(frozen=True, slots=True)
class ControllerCommand:
    """A command of a list; one that is not listed cannot be made.

    Raises:
        ForbiddenCommandError: not on the list, or an argument that the list does not allow.
    """

    allowed: ClassVar[Mapping[str, str]]  # each with the grammar of its argument
    name: str
    argument: str = ""

    def __post_init__(self) -> None:
        grammar = self.allowed.get(self.name)
        if grammar is None or not re.fullmatch(grammar, self.argument):
            raise ForbiddenCommandError(f"{self.name}{self.argument} is no {type(self).__name__}")

    def encoded(self, terminator: bytes) -> bytes:
        """Word it for robot 1, slot 1."""
        return f"1;1;{self.name}{self.argument}".encode("ascii") + terminator


class ReadCommand(ControllerCommand):
    """A command that only reads."""

    allowed = READ_COMMANDS


@dataclass(frozen=True, slots=True)
class ControllerAnswer:
    """What the controller answered."""

    alarm: bool  # one is standing
    error: int | None  # why it refused; None if it did not
    data: str


@dataclass(frozen=True, slots=True)
class JointPosition:
    """JPOSF: all joints, with what stands beside them."""

    joints_deg: tuple[float, ...]  # the controller's own angles
    override: int  # %
    speed: float  # m/s of the hand's end; 0 at rest


@dataclass(frozen=True, slots=True)
class RunState:
    """STATE: whether the robot's program runs."""

    running: bool
    servo_on: bool
    emergency_stop: bool
    error: int  # 0 none


def parse_answer(line: bytes) -> ControllerAnswer | None:
    """Read an answer without its end; None if it is none."""
    match = _ANSWER.fullmatch(line)
    if match is None:
        return None
    status, data = match[1].decode("ascii"), match[2].decode("ascii")
    alarm = status[1].islower()
    if status.startswith("o"):
        return ControllerAnswer(alarm, None, data)
    return ControllerAnswer(alarm, int(data), "") if re.fullmatch("[0-9]{1,6}", data) else None


def parse_joints(data: str, joints: int) -> JointPosition | None:
    """Read JPOSF's data by label; None unless every field is there and well formed.

    They follow QoK: `J1;-7.42;…;J6;-9.75;;****,****;100;0.00;00000000`, for up to 8 joints.
    """
    head, separator, tail = data.partition(";;")
    fields, rest = head.split(";"), tail.removesuffix(";").split(";")
    if not separator or len(fields) % 2 or len(rest) != 4:
        return None
    labels = [_JOINT.fullmatch(label) for label in fields[::2]]
    if not all(labels) or not all(map(_ANGLE.fullmatch, fields[1::2])):
        return None
    _flags, override, speed, limits = rest
    angles = {label: float(text) for label, text in zip(fields[::2], fields[1::2], strict=True)}
    wanted = [f"J{joint}" for joint in range(1, joints + 1)]
    twice = len(angles) != len(labels)
    if twice or not set(wanted) <= set(angles) or not _LIMITS.fullmatch(limits):
        return None
    if not _PERCENT.fullmatch(override) or not _POSITIVE.fullmatch(speed):
        return None
    return JointPosition(
        tuple(angles[label] for label in wanted), int(override), float(speed) * 1e-3
    )


def parse_state(data: str) -> RunState | None:
    """Read STATE's data; None if it is not that."""
    fields = data.split(";")
    if len(fields) < MIN_STATE_FIELDS or not fields[2].isascii() or not fields[2].isdigit():
        return None
    match = _RUN.fullmatch(fields[4])
    if match is None:
        return None
    run, stop = int(match[1], 16), int(match[2], 16)
    return RunState(bool(run & 0x40), bool(run & 0x20), bool(stop & 0x01), int(match[3]))


def parse_error(data: str) -> int | None:
    """Read ERROR's data, `4140;2`: the number of the standing error; None if there is none."""
    match = re.match(r"([0-9]{1,6})(;|$)", data)
    return int(match[1]) if match else None


MAX_GAP = 0.05  # s between bytes of an answer: one without an end mark is over
_END = re.compile(rb"[\r\n\0]")


@dataclass(frozen=True, slots=True)
class ReceivedAnswer:
    """One answer, whole or not, and when it was in hand."""

    data: bytes
    t: float  # s, host's monotonic clock


class AnswerBuffer:
    """Collects bytes until an answer has come."""

    def __init__(self) -> None:
        self._data = b""
        self._t = 0.0

    @property
    def empty(self) -> bool:
        """Whether nothing is left over."""
        return not self._data.strip(b"\r\n\0")

    def clear(self) -> None:
        """Forget what has come."""
        self._data = b""

    def feed(self, chunk: Chunk | None, now: float) -> ReceivedAnswer | None:
        """Add bytes, or none; get the answer once it is over."""
        if chunk is not None:
            self._data = (self._data + chunk.data).lstrip(b"\r\n\0")[-MAX_LINE_BYTES:]
            self._t = chunk.t
        end = _END.search(self._data)
        if end is not None:
            answer, self._data = self._data[: end.start()], self._data[end.end() :]
        elif self._data and now - self._t > MAX_GAP:
            answer, self._data = self._data, b""
        else:
            return None
        return ReceivedAnswer(answer, self._t)
