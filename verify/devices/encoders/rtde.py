"""A Universal Robots controller read by RTDE (TCP port 30004), never commanded.

Every package is a big-endian header (size of the whole package, type) and a payload. The driver
asks for protocol version 2 and for the controller's version, sets up which outputs it wants, and
starts the stream, which ends with the connection. The two types that carry data to the controller
(set up inputs, data package) are not among those that it can send.

Source: Universal Robots, Real-Time Data Exchange (RTDE) guide.
"""

import struct
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final

import numpy as np

from verify.devices.encoders import intake
from verify.devices.ports import link_to
from verify.devices.protocols import EncoderReading

RTDE_JOINTS: Final = 6  # of every arm of the maker
RTDE_VERSION: Final = 2  # the first that takes a rate
MAX_RTDE_RATE: Final = 500  # Hz
MAX_PACKAGE_BYTES: Final = 4096  # bytes: none that is asked for is longer; garbage is
ANSWER_TIMEOUT: Final = 2.0  # s
PLAYING: Final = 2  # of runtime_state: a program runs
HEADER: Final = struct.Struct(">HB")  # size with header, type
OUTPUTS: Final = {"timestamp": "DOUBLE", "actual_q": "VECTOR6D", "runtime_state": "UINT32"}
SAMPLE: Final = struct.Struct(">Bd6dI")  # recipe; timestamp, s; actual_q, rad; runtime_state
NO_RTDE = "what answers there is no RTDE, whose port is 30004"


class PackageType(IntEnum):
    """The types of package that a reader has to do with."""

    VERSION = ord("V")
    CONTROLLER_VERSION = ord("v")
    TEXT = ord("M")
    DATA = ord("U")
    OUTPUTS = ord("O")
    START = ord("S")


PACKAGE_TYPES: Final = frozenset(PackageType)
# what a reader may send; neither data nor a set-up of inputs can be worded
READ_REQUESTS: Final = PACKAGE_TYPES - {PackageType.DATA, PackageType.TEXT}


class PackageBuffer:
    """Collects bytes until a package is whole."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[tuple[PackageType, bytes]] | None:
        """Add bytes; get the packages that they complete, or None if this is no RTDE."""
        self._rest += data
        packages = []
        while len(self._rest) >= HEADER.size:
            size, kind = HEADER.unpack_from(self._rest)
            if kind not in PACKAGE_TYPES or not HEADER.size <= size <= MAX_PACKAGE_BYTES:
                return None
            if len(self._rest) < size:
                break
            packages.append((PackageType(kind), self._rest[HEADER.size : size]))
            self._rest = self._rest[size:]
        return packages


def parse_text(payload: bytes) -> str:
    """Give the text of a message of the controller, and who sends it."""
    words, rest = [], payload
    for _ in range(2):  # message, source: each with its length before it
        length = rest[0] if rest else 0
        words.append(rest[1 : 1 + length].decode("utf-8", errors="replace").strip())
        rest = rest[1 + length :]
    text, source = words
    return f"{source}: {text}" if source else text


@dataclass(frozen=True, slots=True)
class RtdeSettings:
    """How a controller is reached."""

    port: str  # tcp:HOST:30004
    rate: float | None = None  # Hz to ask for; None: one reading a control cycle


@dataclass(slots=True)
class RtdeConnection:
    """The state of the exchange since the connection was made."""

    packages: PackageBuffer = field(default_factory=PackageBuffer)
    awaited: PackageType | None = None  # the answer that is due, data once the stream runs
    since: float = 0.0  # s, host: of the last request, or the last sample
    cycle: float = 1 / MAX_RTDE_RATE  # s, of the controller
    recipe: int = 0


class RtdeEncoders(intake.PortDriver):
    """Joint readings from a UR controller, by its own time stamps."""

    def __init__(self, settings: RtdeSettings, angles: intake.AngleMap) -> None:
        super().__init__(link_to(settings.port))
        self._settings = settings
        self._intake = intake.ReadingIntake(angles, self.counts)
        self._clock = intake.ControllerClock(None)
        self._talk = RtdeConnection()

    def read(self) -> list[EncoderReading]:
        """Give what has arrived since the last call, oldest first; waits for at most 20 ms."""
        chunk = self.link.receive()
        if self.link.reopened():
            self._talk, self._running = RtdeConnection(), None
            self._clock.restart(None)
            self._ask(PackageType.VERSION, struct.pack(">H", RTDE_VERSION))
        if chunk is None:
            self._give_up_if_late()
            return []
        packages = self._talk.packages.feed(chunk.data)
        if packages is None:
            self._drop("bytes that are no RTDE")
            self._give_up(NO_RTDE)
            return []
        readings = [r for package in packages for r in self._take(*package, chunk.t)]
        self._give_up_if_late()  # what comes may be no sample, time and again
        return readings

    def _ask(self, kind: PackageType, payload: bytes = b"") -> None:
        """Send a request; ValueError: one that a reader may not send."""
        if kind not in READ_REQUESTS:
            raise ValueError(f"{kind.name} is not among what this driver may send")
        self._talk.awaited, self._talk.since = kind, self.link.now()
        self.link.send(HEADER.pack(HEADER.size + len(payload), kind) + payload)

    def _give_up(self, why: str) -> None:
        self._fault = why
        self.link.drop(why)

    def _refuse(self, why: str) -> None:
        """Stay connected with a set-up that the controller does not take: nothing to wait for."""
        self._fault, self._talk.awaited = why, None

    def _give_up_if_late(self) -> None:
        """Connect again where nothing comes: a controller that lost its power closes nothing."""
        awaited = self._talk.awaited
        if not self.link.connected or awaited is None:
            return
        waited = self.link.now() - self._talk.since
        if awaited is PackageType.DATA:
            if waited > intake.SILENCE_TIMEOUT:
                self.link.drop(f"no sample for {waited:.1f} s")
        elif waited > ANSWER_TIMEOUT:
            self._drop("request without an answer")
            self._give_up(f"no answer to the request {awaited.name.lower().replace('_', ' ')}")

    def _take(self, kind: PackageType, payload: bytes, t_host: float) -> list[EncoderReading]:
        if kind is PackageType.TEXT:
            self._remark = f"the controller says: {parse_text(payload)}"
            return []
        if kind is not self._talk.awaited:
            return self._drop(f"package {kind.name.lower()} that is not due")
        if kind is PackageType.DATA:
            return self._sample(payload, t_host)
        try:
            self._set_up(kind, payload)
        except (struct.error, UnicodeDecodeError):
            self._give_up(NO_RTDE)
        return []

    def _set_up(self, kind: PackageType, payload: bytes) -> None:
        """Go one step further; struct.error: an answer that is too short."""
        talk = self._talk
        match kind:
            case PackageType.VERSION:
                if struct.unpack(">?", payload)[0]:
                    self._ask(PackageType.CONTROLLER_VERSION)
                else:
                    needed = f"the controller refuses RTDE version {RTDE_VERSION}"
                    self._refuse(f"{needed}; a newer PolyScope is needed")
            case PackageType.CONTROLLER_VERSION:
                major = struct.unpack_from(">I", payload)[0]
                talk.cycle = 1 / 125 if major <= 3 else 1 / MAX_RTDE_RATE  # CB3; later series
                rate = min(self._settings.rate or np.inf, 1 / talk.cycle)
                self._ask(PackageType.OUTPUTS, struct.pack(">d", rate) + ",".join(OUTPUTS).encode())
            case PackageType.OUTPUTS:
                talk.recipe = struct.unpack_from(">B", payload)[0]
                types = payload[1:].decode("ascii").split(",")
                found = dict(zip(OUTPUTS, types, strict=False))
                wrong = [name for name, kind in OUTPUTS.items() if found.get(name) != kind]
                if wrong or len(types) != len(OUTPUTS):
                    self._refuse(f"the controller has no output {', '.join(wrong or types)}")
                else:
                    self._ask(PackageType.START)
            case PackageType.START:
                if struct.unpack(">?", payload)[0]:
                    talk.awaited, talk.since = PackageType.DATA, self.link.now()
                else:
                    self._refuse("the controller refuses to start the stream")

    def _sample(self, payload: bytes, t_host: float) -> list[EncoderReading]:
        if len(payload) != SAMPLE.size or payload[0] != self._talk.recipe:
            return self._drop("sample that is not understood")
        _, stamp, *angles, runtime_state = SAMPLE.unpack(payload)
        q = np.array(angles)
        if not np.isfinite(stamp) or not np.all(np.abs(q) <= intake.MAX_JOINT_ANGLE):  # nor NaN
            return self._drop("sample with impossible numbers")
        self._talk.since = t_host
        self._running = runtime_state == PLAYING
        instant = self._clock.stamp(stamp, t_host)
        if isinstance(instant, str):
            return self._drop(instant)
        self.link.steady()
        self._fault = ""
        # where in its cycle the controller reads the joints is not documented: anywhere
        return self._intake.take(instant, t_host, self._talk.cycle / 2, q)
