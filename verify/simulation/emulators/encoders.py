"""An encoder board that speaks LABENC 1; turning camera bases, such a board with two axes."""

from dataclasses import dataclass

import numpy as np

from verify.core.records import Array
from verify.devices.encoders.labenc.protocol import MAX_LINE_BYTES, MOVING
from verify.devices.ports import CHECKSUMS, LineBuffer
from verify.simulation.emulators.server import EmulatorEngine, TimedMessage
from verify.simulation.emulators.trajectory import EmulatedTrajectory
from verify.simulation.world.motion import move_towards

COUNTS_PER_TURN = 98304  # gear included
MAX_SAMPLE_BYTES = 91  # bytes of a six-axis J
MAX_LINE_SHARE = 0.8  # of the line's capacity; the board refuses a rate beyond it
TICK_MODULUS = 1 << 32


@dataclass(frozen=True, slots=True)
class LabencOptions:
    """What kind of board it is."""

    arm: str = "IUST6R"
    tick_rate: int = 1_000_000  # Hz
    rate: int = 100  # Hz
    unit: str = "deg"
    checksum: str = "xor"
    first_tick: int = 0  # near 2**32 the counter soon wraps
    drift: float = 0.0  # by which the board's crystal is fast
    greeting_after: float | None = 0.3  # s after a start; None: it never greets
    boot_noise: bytes = b"\x00\xf8\xffets Jan  8 boot\r\n"  # what a boot loader leaves on the line
    baud: int = 115200  # what the rate's ceiling is reckoned with
    carriage_return: bool = False


class LabencEngine(EmulatorEngine):
    """The board: greeting, stream, queries."""

    def __init__(self, trajectory: EmulatedTrajectory, axes: int, options: LabencOptions) -> None:
        self.log: list[str] = []  # every body received
        self._trajectory, self._axes, self._options = trajectory, axes, options
        self._status = 0
        self.greet(0.0)

    def greet(self, t: float) -> None:
        """Start anew: opening the port pulls DTR, which resets such boards."""
        options = self._options
        self._lines = LineBuffer()
        self._began = t
        self._greet_at = None if options.greeting_after is None else t + options.greeting_after
        self._boot_noise = options.boot_noise
        self._streaming = True
        self._unit, self._rate = options.unit, options.rate
        self._sequence = 0
        self._next = t + (options.greeting_after or 0.0)

    def afflict(self, fault: str, value: float) -> None:
        """Let the clock leap by so many s, or set status bits."""
        super().afflict(fault, value)
        if fault == "status":
            self._status = int(value)

    def step(self, t: float, received: bytes) -> list[TimedMessage]:
        """Answer queries, then say the samples that are due."""
        bodies: list[str] = []
        if self._greet_at is not None and t >= self._greet_at:
            self._greet_at = None
            bodies.append(self._hello())
        for line in self._lines.feed(received):
            bodies += self._answer(line, t)
        messages = [TimedMessage(t, self._framed(body)) for body in bodies]
        if self._boot_noise:
            messages.insert(0, TimedMessage(t, self._boot_noise))
            self._boot_noise = b""
        while self._streaming and self._greet_at is None and self._next <= t:
            messages.append(TimedMessage(self._next, self._framed(self._sample(self._next))))
            self._next += 1.0 / self._rate
        return messages

    def angles(self, t: float) -> Array:
        """What the encoders show, (axes,), rad."""
        return self._trajectory(t)

    def status(self, _t: float) -> int:
        """Status bits."""
        return self._status

    def go(self, _axis: int, _value: float, _t: float) -> str:
        """Answer a G: this board has no drives."""
        return "E,G,4,unknown type"

    def _hello(self) -> str:
        options = self._options
        return (
            f"H,LABENC,1.0,{options.arm},{self._axes},{self._unit},{options.tick_rate},"
            f"{self._rate},0123ABCD"
        )

    def _tick(self, t: float) -> int:
        elapsed = (t - self._began) * (1.0 + self._options.drift) + self._jump
        return (self._options.first_tick + round(elapsed * self._options.tick_rate)) % TICK_MODULUS

    def _sample(self, t: float) -> str:
        angles = self.angles(t)
        if self._unit == "counts":
            counts = np.rint(angles / (2 * np.pi) * COUNTS_PER_TURN).astype(int)
            kind, values = "C", ",".join(map(str, counts.tolist()))
        else:
            kind, values = "J", ",".join(f"{angle:.4f}" for angle in np.rad2deg(angles))
        body = f"{kind},{self._sequence},{self._tick(t)},{values},{self.status(t):X}"
        self._sequence = (self._sequence + 1) % TICK_MODULUS
        return body

    def _answer(self, line: bytes, t: float) -> list[str]:
        digits, function = CHECKSUMS[self._options.checksum]
        body, _, checksum = line.removeprefix(b"$").partition(b"*")
        if len(line) > MAX_LINE_BYTES or checksum != b"%0*X" % (digits, function(body)):
            return ["E,?,1,checksum"]
        text = body.decode("ascii", errors="replace")
        self.log.append(text)
        kind, *fields = text.split(",")
        fastest = MAX_LINE_SHARE * self._options.baud / 10 / MAX_SAMPLE_BYTES  # Hz
        match kind, fields:
            case "Q", []:
                return [self._hello(), *self._axis_lines()]
            case "S", ["0" | "1" as on]:
                self._next = self._next if self._streaming else t
                self._streaming = on == "1"
            case "R", [rate]:
                if not rate.isdigit() or not 0 < int(rate) <= fastest:
                    return ["E,R,2,bad rate"]
                self._rate = int(rate)
            case "D", ["deg" | "counts" as unit]:
                self._unit = unit
                return [f"A,{text}", *self._axis_lines()]
            case "T", [token]:
                return [f"T,{token},{self._tick(t)},{self._tick(t)}"]
            case "G", [axis, value]:
                return [self._ordered(axis, value, t)]
            case (("S" | "R" | "D" | "T" | "G"), _):
                return [f"E,{kind},2,bad value"]
            case _:
                return [f"E,{kind[:8]},4,unknown type"]
        return [f"A,{text}"]

    def _ordered(self, axis: str, value: str, t: float) -> str:
        try:
            return self.go(int(axis), float(value), t)
        except ValueError:
            return "E,G,2,bad value"

    def _axis_lines(self) -> list[str]:
        return [f"N,{axis},{COUNTS_PER_TURN},1,0" for axis in range(1, self._axes + 1)]

    def _framed(self, body: str) -> bytes:
        digits, function = CHECKSUMS[self._options.checksum]
        data = body.encode("ascii")
        end = b"\r\n" if self._options.carriage_return else b"\n"
        return b"$%s*%0*X" % (data, digits, function(data)) + end


PAN_SPEED = np.deg2rad(20.0)  # rad/s
LIMIT_DEG = 60.0  # to either side
PARALLEL_ANGLES = np.zeros(2)


class PanEngine(LabencEngine):
    """Left and right base; each goes where G orders it, at a steady speed."""

    def __init__(self, options: LabencOptions) -> None:
        self._from, self._to = PARALLEL_ANGLES.copy(), PARALLEL_ANGLES.copy()
        self._ordered_at = 0.0
        super().__init__(lambda _: PARALLEL_ANGLES, 2, options)

    def angles(self, t: float) -> Array:
        """What the encoders on the axes show, (2,), rad."""
        return move_towards(self._from, self._to, PAN_SPEED * max(t - self._ordered_at, 0.0))

    def status(self, t: float) -> int:
        """Status bits: moving, until both have arrived."""
        return super().status(t) | (MOVING if bool(np.any(self.angles(t) != self._to)) else 0)

    def go(self, axis: int, value: float, t: float) -> str:
        """Turn one base."""
        if axis not in (1, 2):
            return "E,G,2,bad value"
        if not abs(value) <= LIMIT_DEG:
            return f"E,G,3,axis {axis} limit"
        here, there = self.angles(t), self._to.copy()
        there[axis - 1] = np.deg2rad(value)
        self._from, self._to, self._ordered_at = here, there, t
        return f"A,G,{axis},{value:.2f}"
