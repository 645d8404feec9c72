"""A Universal Robots controller's RTDE server: set-up, stream, pause, text messages, refusals."""

import struct
from dataclasses import dataclass

from verify.simulation.emulators.server import EmulatorEngine, TimedMessage
from verify.simulation.emulators.trajectory import EmulatedTrajectory

_HEADER = struct.Struct(">HB")
_TYPES = {  # of the outputs that it has, with how a value is packed
    "timestamp": ("DOUBLE", ">d"),
    "actual_q": ("VECTOR6D", ">6d"),
    "target_q": ("VECTOR6D", ">6d"),
    "runtime_state": ("UINT32", ">I"),
}
PLAYING, STOPPED = 2, 1
ERROR_LEVEL = 1  # of a text message
UPTIME = 1000.0  # s: the time stamp at the emulator's start


@dataclass(frozen=True, slots=True)
class RtdeOptions:
    """What kind of controller it is."""

    version: tuple[int, int, int, int] = (5, 12, 0, 1101)  # of PolyScope
    protocol: int = 2  # the latest that it accepts
    starts: bool = True  # takes the request to start


class RtdeEngine(EmulatorEngine):
    """One client's session; a client that connects begins a new one."""

    RECIPE = 1

    def __init__(self, trajectory: EmulatedTrajectory, options: RtdeOptions | None = None) -> None:
        self.log: list[str] = []  # the type of every package received
        self._trajectory = trajectory
        self._options = RtdeOptions() if options is None else options
        self._protocol = self._options.protocol
        self._clock_zero = -UPTIME  # s, emulator's time at which its clock was 0
        self._texts: list[str] = []
        self._stopped = False
        self.greet(0.0)

    def greet(self, t: float) -> None:  # noqa: ARG002  an engine has this verb
        """Begin a session."""
        self._buffer = b""
        self._accepted = self._streams = False
        self._outputs: list[str] = []
        self._rate, self._next = self._fastest, 0.0

    def reset(self, t: float) -> None:
        """Start anew: the clock begins at 0, sessions are forgotten."""
        self._clock_zero, self._jump, self._stopped = t, 0.0, False
        self.greet(t)

    def afflict(self, fault: str, value: float) -> None:
        """Let the clock leap by so many s, stop the program, or accept older protocols only."""
        super().afflict(fault, value)
        if fault == "alarm":
            self._texts.append(f"C{int(value)}A0: protective stop")
            self._stopped = True
        elif fault == "version":
            self._protocol = int(value)
            self.greet(0.0)  # sessions are at an end

    def step(self, t: float, received: bytes) -> list[TimedMessage]:
        """Answer requests, then give the samples that are due."""
        self._buffer += received
        messages = []
        while len(self._buffer) >= _HEADER.size:
            size, kind = _HEADER.unpack_from(self._buffer)
            if len(self._buffer) < size or size < _HEADER.size:
                break
            payload, self._buffer = self._buffer[_HEADER.size : size], self._buffer[size:]
            self.log.append(chr(kind))
            messages.append(TimedMessage(t, self._answer(chr(kind), payload, t)))
        if self._accepted and self._texts:
            messages += [TimedMessage(t, _text(text)) for text in self._texts]
            self._texts.clear()
        while self._streams and self._next <= t:
            messages.append(TimedMessage(self._next, self._sample(self._next)))
            self._next += 1.0 / self._rate
        return messages

    @property
    def _fastest(self) -> float:
        """Rate of the control loop, Hz."""
        return 125.0 if self._options.version[0] <= 3 else 500.0

    def _answer(self, kind: str, payload: bytes, t: float) -> bytes:
        match kind:
            case "V":
                self._accepted = 1 <= int.from_bytes(payload[:2], "big") <= self._protocol
                return _package("V", bytes([self._accepted]))
            case "v":
                return _package("v", struct.pack(">4I", *self._options.version))
            case "O" if self._accepted and len(payload) > 8:
                return _package("O", self._set_up(payload))
            case "S":
                self._streams, self._next = bool(self._outputs) and self._options.starts, t
                return _package("S", bytes([self._streams]))
            case "P":
                self._streams = False
                return _package("P", b"\x01")
        return _text(f"package {kind} is not understood")

    def _set_up(self, payload: bytes) -> bytes:
        asked = struct.unpack_from(">d", payload)[0]
        if asked > 0:
            self._rate = min(asked, self._fastest)
        names = [name for name in payload[8:].decode().split(",") if name]
        types = [_TYPES.get(name, ("NOT_FOUND", ""))[0] for name in names]
        self._outputs = [] if "NOT_FOUND" in types else names
        return bytes([self.RECIPE]) + ",".join(types).encode()

    def _sample(self, t: float) -> bytes:
        q = self._trajectory(max(t, 0.0)).tolist()
        values = {
            "timestamp": [t - self._clock_zero + self._jump],
            "actual_q": q,
            "target_q": q,
            "runtime_state": [STOPPED if self._stopped else PLAYING],
        }
        fields = [struct.pack(_TYPES[name][1], *values[name]) for name in self._outputs]
        return _package("U", bytes([self.RECIPE]) + b"".join(fields))


def _package(kind: str, payload: bytes) -> bytes:
    return _HEADER.pack(_HEADER.size + len(payload), ord(kind)) + payload


def _text(text: str) -> bytes:
    parts = b"".join(bytes([len(part)]) + part for part in (text.encode(), b"RTDE"))
    return _package("M", parts + bytes([ERROR_LEVEL]))
