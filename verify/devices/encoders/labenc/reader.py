"""The lab's encoder board: a LABENC 1 line over a serial port or TCP, read as it streams."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from verify.core.records import Array
from verify.devices.encoders import intake
from verify.devices.encoders.labenc import protocol as lines
from verify.devices.encoders.labenc.protocol import UNUSABLE
from verify.devices.ports import DEFAULT_LINE, LineBuffer, SerialLine, link_to
from verify.devices.protocols import DeviceState, EncoderReading

READ_COMMANDS = frozenset({"Q", "S", "R", "D"})  # messages of a reader: none moves anything
GREETING_TIMEOUT = 2.0  # s: opening the port may reset the board
REQUEST_PERIOD, N_REQUESTS = 0.5, 3  # s; then the missing greeting is reported
SLOW_REQUEST_PERIOD = 5.0  # s, from then on
ANSWER_TIMEOUT = 1.0  # s: a later greeting is no answer, the board has started
COUNTER_MODULUS = 1 << 32  # the counters are unsigned 32-bit
MAX_GAP = 1 << 20  # samples: hours at any rate; more is a number that was garbled


@dataclass(frozen=True, slots=True)
class LabencSettings:
    """How a LABENC board is reached."""

    port: str
    line: SerialLine = DEFAULT_LINE
    checksum: str = "xor"  # or crc16
    rate: int | None = None  # Hz to ask for; None leaves the board's own
    unit: str | None = None  # "deg" or "counts" to ask for; None leaves the board's own
    latch_span: float = 100e-6  # s, from the first to the last axis that is read


@dataclass(frozen=True, slots=True)
class LabencReading:
    """All axes at one tick, checked."""

    instant: intake.ControllerInstant
    t_host: float  # s
    angle: Array  # (axes,), rad, sign and zero of the board
    status: int  # bits of LABENC


class LabencBoard(intake.PortDriver):
    """One board on one line: greeting, clock, sequence, checks. Drivers build on it.

    Closing leaves the board as it is: it may stream to a logger too.
    """

    orders: ClassVar[frozenset[str]] = READ_COMMANDS  # message types; no other may be sent

    def __init__(self, settings: LabencSettings, angles: intake.AngleMap) -> None:
        super().__init__(link_to(settings.port, settings.line))
        self._settings, self._angles = settings, angles
        self._half_width = settings.latch_span / 2
        self._greeting: lines.LabencGreeting | None = None
        self._lines = LineBuffer()
        self._scale: dict[int, lines.LabencAxis] = {}
        self._clock = intake.ControllerClock(None)
        self._sequence: tuple[int, int] | None = None  # and its clock segment
        self._scale_missing = False
        # requests for a greeting: how many, when the next is due, when the last was sent
        self._requests, self._request_due, self._requested_at = 0, 0.0, float("-inf")

    def samples(self) -> list[LabencReading]:
        """Take the samples that have come; waits for at most 20 ms on an open line."""
        chunk = self.link.receive()
        if self.link.reopened():
            self._connect()
        self._request_greeting()
        if chunk is None:
            return []
        return [s for line in self._lines.feed(chunk.data) for s in self._take(line, chunk.t)]

    def send(self, kind: str, *fields: str) -> bool:
        """Send a message; False: the line is down; ValueError: a type that may not be sent."""
        if kind not in self.orders:
            raise ValueError(f"{kind} is not among the messages that this driver may send")
        return self.link.send(lines.frame_line(",".join((kind, *fields)), self._settings.checksum))

    def _connect(self) -> None:
        self._lines = LineBuffer()  # the other half of a half line will not come
        self._greeting, self._sequence, self._remark = None, None, ""
        self._scale.clear()
        self._requests, self._request_due = 0, self.link.now() + GREETING_TIMEOUT

    def _request_greeting(self) -> None:
        """Request a greeting; also for the axes' scale, without which counts are no angles."""
        complete = self._greeting is not None and not self._scale_missing
        if complete or not self.link.connected or self.link.now() < self._request_due:
            return
        self._scale_missing = False
        self.send("Q")
        self._requests, self._requested_at = self._requests + 1, self.link.now()
        period = REQUEST_PERIOD if self._requests < N_REQUESTS else SLOW_REQUEST_PERIOD
        self._request_due = self.link.now() + period

    def state(self) -> DeviceState:
        """Describe the board."""
        self._fault = self._unfit()
        return super().state()

    def _unfit(self) -> str:
        """Why no reading comes; empty: they do."""
        if self._greeting is None:
            if self._requests < N_REQUESTS:
                return "waiting for the board's greeting"
            return "no LABENC greeting; for another kind of line use encoders of kind text"
        version, supported = self._greeting.major, lines.SUPPORTED_VERSION[0]
        if version > supported:
            return f"the board speaks LABENC {version}, this program up to {supported}"
        if self._greeting.axes != self._angles.joints:
            return f"the board has {self._greeting.axes} axes, {self._angles.joints} are expected"
        return ""

    def _take(self, line: bytes, t_host: float) -> list[LabencReading]:
        message = lines.parse_line(line, self._settings.checksum)
        match message:
            case str():
                if self._greeting is not None:  # before it, a boot loader may print its own
                    self._drop(message)
            case lines.LabencGreeting():
                self._greet(message)
            case lines.LabencAxis():
                self._scale[message.axis] = message
            case lines.LabencSample():
                return self._sample(message, t_host)
            case lines.OtherLine("W", fields):
                self._remark = f"the board warns: {','.join(fields)}"
            case lines.OtherLine("E", fields):
                self._remark = f"the board refuses: {','.join(fields)}"
        return []

    def _greet(self, greeting: lines.LabencGreeting) -> None:
        """Take a greeting: the answer to a request, or that of a board just started."""
        answer = self.link.now() - self._requested_at < ANSWER_TIMEOUT
        started = self._greeting is None or not answer
        self._greeting = greeting
        self._requests, self._request_due = 0, self.link.now()
        if not started:
            return
        self._clock.restart(COUNTER_MODULUS / greeting.tick_rate)
        self._sequence = None
        self._scale.clear()
        if self._settings.rate is not None:
            self.send("R", str(self._settings.rate))
        if self._settings.unit is not None:
            self.send("D", self._settings.unit)
        self.send("S", "1")

    def _sample(self, sample: lines.LabencSample, t_host: float) -> list[LabencReading]:
        greeting = self._greeting
        if greeting is None:
            # it streams, so it was not reset: no greeting comes without a request
            self._request_due = min(self._request_due, self._requested_at + REQUEST_PERIOD)
            return self._drop("sample before the greeting")
        if self._unfit():
            return self._drop("sample of an unfit board")
        counts = sample.kind == "C" or greeting.unit == "counts"
        exact = (greeting.major, greeting.minor) <= lines.SUPPORTED_VERSION
        values = lines.sample_values(sample, greeting.axes, decimal=not counts, exact=exact)
        if values is None:
            return self._drop("sample that is not understood")
        if counts and len(self._scale) < greeting.axes:
            self._scale_missing = True
            return self._drop("counts before their scale")
        instant = self._clock.stamp(sample.tick / greeting.tick_rate, t_host)
        if isinstance(instant, str):
            return self._drop(instant)
        self._count_lost(sample.sequence, instant.segment)
        axes, status = values
        self.link.steady()
        if flaws := [word for bit, word in UNUSABLE.items() if status & bit]:
            return self._drop(flaws[0])
        angle = self._angles_of_counts(axes) if counts else np.deg2rad(axes)
        return [LabencReading(instant, t_host, angle, status)]

    def _count_lost(self, sequence: int, segment: int) -> None:
        before = self._sequence
        self._sequence = (sequence, segment)
        if before is not None and before[1] == segment:
            gap = (sequence - before[0]) % COUNTER_MODULUS - 1
            self.counts.lost += gap if 0 < gap < MAX_GAP else 0

    def _angles_of_counts(self, counts: tuple[float, ...]) -> Array:
        axes = ((self._scale[number], count) for number, count in enumerate(counts, start=1))
        turns = [a.direction * (count - a.zero) / a.counts_per_turn for a, count in axes]
        return np.array(turns) * math.tau


class LabencEncoders(LabencBoard):
    """Joint readings from a LABENC board; see `LabencBoard`."""

    def __init__(self, settings: LabencSettings, angles: intake.AngleMap) -> None:
        super().__init__(settings, angles)
        self._intake = intake.ReadingIntake(angles, self.counts)

    def read(self) -> list[EncoderReading]:
        """Give what has arrived since the last call, oldest first; waits for at most 20 ms."""
        readings = []
        for sample in self.samples():
            readings += self._intake.take(
                sample.instant, sample.t_host, self._half_width, sample.angle
            )
        return readings
