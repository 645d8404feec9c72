"""The lab's encoder board: a LABENC 1 line over a serial port or TCP, read as it streams."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from verify.core.records import Array
from verify.devices.encoders.intake import (
    AngleMap,
    ControllerClock,
    ControllerInstant,
    IntakeCounts,
    ReadingIntake,
)
from verify.devices.encoders.labenc import protocol as lines
from verify.devices.encoders.labenc.protocol import UNUSABLE
from verify.devices.ports import (
    DEFAULT_LINE,
    ClockFunction,
    LineBuffer,
    Port,
    PortLink,
    SerialLine,
    open_port,
)
from verify.devices.protocols import DeviceState, EncoderReading

READ_COMMANDS = frozenset({"Q", "S", "R", "D"})  # what a reader may ask: none of it moves anything
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

    instant: ControllerInstant
    t_host: float  # s
    angle: Array  # (axes,), rad, sign and zero of the board
    status: int  # bits of LABENC


class LabencBoard:
    """One board on one line: greeting, clock, sequence, checks. Drivers build on it.

    Args:
        settings: how it is reached.
        axes: how many it must have.
        orders: the message types that may be sent; everything else is refused.
        port: opens the port instead of the settings' address.
        now: the host's monotonic clock, s.
    """

    def __init__(
        self,
        settings: LabencSettings,
        axes: int,
        orders: frozenset[str] = READ_COMMANDS,
        port: Callable[[], Port] | None = None,
        now: ClockFunction = time.monotonic,
    ) -> None:
        self.counts = IntakeCounts()
        self.settings = settings
        self.hello: lines.LabencGreeting | None = None
        self._axes, self._orders = axes, orders
        opens = port or partial(open_port, settings.port, settings.line)
        self.link = PortLink(settings.port, opens, now)
        self._lines = LineBuffer()
        self._scale: dict[int, lines.LabencAxis] = {}
        self._clock = ControllerClock(None)
        self._sequence: tuple[int, int] | None = None  # and its clock segment
        self._scale_wanted = False
        self._asked, self._ask_at, self._asked_at = 0, 0.0, float("-inf")
        self._note = ""

    def samples(self) -> list[LabencReading]:
        """Take the samples that have come; waits for at most 20 ms on an open line."""
        chunk = self.link.receive()
        if self.link.reopened():
            self._connect()
        self._ask_for_greeting()
        if chunk is None:
            return []
        found = []
        for line in self._lines.feed(chunk.data):
            found += self._take(line, chunk.t)
        return found

    def send(self, kind: str, *fields: str) -> bool:
        """Send a message; False if the line is down.

        Raises:
            ValueError: this driver may not send that type.
        """
        if kind not in self._orders:
            raise ValueError(f"{kind} is not among the messages that this driver may send")
        return self.link.send(lines.frame_line(",".join((kind, *fields)), self.settings.checksum))

    def state(self) -> DeviceState:
        """Say how the board is."""
        return self.counts.state(self.link, self._complaint(), self._note)

    def close(self) -> None:
        """Leave the board as it is: it may stream to a logger beside us."""
        self.link.close()

    def _connect(self) -> None:
        self._lines.clear()
        self.hello, self._sequence, self._note = None, None, ""
        self._scale.clear()
        self._asked, self._ask_at = 0, self.link.now() + GREETING_TIMEOUT

    def _ask_for_greeting(self) -> None:
        """Ask who is there; also for the axes' scale, without which counts are no angles."""
        known = self.hello is not None and not self._scale_wanted
        if known or not self.link.connected or self.link.now() < self._ask_at:
            return
        self._scale_wanted = False
        self.send("Q")
        self._asked, self._asked_at = self._asked + 1, self.link.now()
        self._ask_at = self.link.now() + (
            REQUEST_PERIOD if self._asked < N_REQUESTS else SLOW_REQUEST_PERIOD
        )

    def _complaint(self) -> str:
        if self.hello is None:
            if self._asked < N_REQUESTS:
                return "waiting for the board's greeting"
            return "no LABENC greeting; for another kind of line use encoders of kind text"
        if self.hello.major > lines.SUPPORTED_VERSION[0]:
            spoken, known = self.hello.major, lines.SUPPORTED_VERSION[0]
            return f"the board speaks LABENC {spoken}, this program up to {known}"
        if self.hello.axes != self._axes:
            return f"the board has {self.hello.axes} axes, {self._axes} are expected"
        return ""

    def _take(self, line: bytes, t_host: float) -> list[LabencReading]:
        message = lines.parse_line(line, self.settings.checksum)
        match message:
            case lines.InvalidLine():
                if self.hello is not None:  # before it, a boot loader may have its say
                    self.counts.bad[message.reason] += 1
            case lines.LabencGreeting():
                self._greet(message)
            case lines.LabencAxis():
                self._scale[message.axis] = message
            case lines.LabencSample():
                return self._sample(message, t_host)
            case lines.OtherLine("W", fields):
                self._note = f"the board warns: {','.join(fields)}"
            case lines.OtherLine("E", fields):
                self._note = f"the board refuses: {','.join(fields)}"
        return []

    def _greet(self, hello: lines.LabencGreeting) -> None:
        """Take note of a greeting: an answer to our question, or that of a board just started."""
        answer = self.link.now() - self._asked_at < ANSWER_TIMEOUT
        started = self.hello is None or not answer
        if started:
            self._clock.restart(COUNTER_MODULUS / hello.tick_rate)
            self._sequence = None
            self._scale.clear()
        self.hello = hello
        self._asked, self._ask_at = 0, self.link.now()
        if started:
            self._begin_stream()

    def _begin_stream(self) -> None:
        if self.settings.rate is not None:
            self.send("R", str(self.settings.rate))
        if self.settings.unit is not None:
            self.send("D", self.settings.unit)
        self.send("S", "1")

    def _sample(self, sample: lines.LabencSample, t_host: float) -> list[LabencReading]:
        hello = self.hello
        if hello is None:
            # it streams, so it was not reset: no greeting comes unasked
            self._ask_at = min(self._ask_at, self._asked_at + REQUEST_PERIOD)
            return self._dropped("sample before the greeting")
        if self._complaint():
            return self._dropped("sample of an unfit board")
        counts = sample.kind == "C" or hello.unit == "counts"
        exact = (hello.major, hello.minor) <= lines.SUPPORTED_VERSION
        found = lines.sample_values(sample, hello.axes, decimal=not counts, exact=exact)
        if found is None:
            return self._dropped("sample that is not understood")
        if counts and len(self._scale) < hello.axes:
            self._scale_wanted = True
            return self._dropped("counts before their scale")
        instant = self._clock.stamp(sample.tick / hello.tick_rate, t_host)
        if isinstance(instant, str):
            return self._dropped(instant)
        self._count_lost(sample.sequence, instant.segment)
        values, status = found
        if flaws := [word for bit, word in UNUSABLE.items() if status & bit]:
            self.link.steady()
            return self._dropped(flaws[0])
        angle = self._turned(values) if counts else np.deg2rad(values)
        self.link.steady()
        return [LabencReading(instant, t_host, angle, status)]

    def _dropped(self, reason: str) -> list[LabencReading]:
        self.counts.bad[reason] += 1
        return []

    def _count_lost(self, sequence: int, segment: int) -> None:
        before = self._sequence
        self._sequence = (sequence, segment)
        if before is not None and before[1] == segment:
            gap = (sequence - before[0]) % COUNTER_MODULUS - 1
            self.counts.lost += gap if 0 < gap < MAX_GAP else 0

    def _turned(self, counts: tuple[float, ...]) -> Array:
        axes = [self._scale[axis] for axis in range(1, len(counts) + 1)]
        turns = [
            axis.direction * (count - axis.zero) / axis.counts_per_turn
            for axis, count in zip(axes, counts, strict=True)
        ]
        return np.array(turns) * math.tau


class LabencEncoders(LabencBoard):
    """Joint readings from a LABENC board.

    Args:
        settings: how the board is reached.
        angles: from the board's angles to the robot file's own.
        port: opens the port instead of the settings' address.
        now: the host's monotonic clock, s.
    """

    def __init__(
        self,
        settings: LabencSettings,
        angles: AngleMap,
        port: Callable[[], Port] | None = None,
        now: ClockFunction = time.monotonic,
    ) -> None:
        super().__init__(settings, angles.joints, port=port, now=now)
        self._intake = ReadingIntake(angles, self.counts)
        self._half_width = settings.latch_span / 2

    def read(self) -> list[EncoderReading]:
        """Give what has arrived since the last call, oldest first; waits for at most 20 ms."""
        readings = []
        for sample in self.samples():
            readings += self._intake.take(
                sample.instant, sample.t_host, self._half_width, sample.angle
            )
        return readings
