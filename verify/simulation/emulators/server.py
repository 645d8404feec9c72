"""Serve an emulated device at an address, faults included."""

import math
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from verify.errors import InputError
from verify.simulation.emulators.endpoints import Endpoint

MESSAGE_FAULTS = ("noise", "half", "digit", "double", "lost", "split")
TIMED_FAULTS = ("silence", "unplug", "reset", "jump", "alarm", "status", "version")
MAX_ALARM = 99999  # five digits
MAX_JUMP = 1e8  # s, three years


@dataclass(frozen=True, slots=True)
class EmulatorFaults:
    """Faults of one emulator; times count from its start."""

    noise: float = 0.0  # share of messages with bytes that nobody sent
    half: float = 0.0  # share that break off
    digit: float = 0.0  # share in which one digit is another, so that a checksum is wrong
    double: float = 0.0  # share sent twice
    lost: float = 0.0  # share not sent
    split: float = 0.0  # share sent in two pieces, 15 ms apart
    silence: tuple[float, float] | None = None  # s: from, for
    unplug: tuple[float, float] | None = None  # s: from, for; the port itself is gone
    reset: tuple[float, float] | None = None  # s; the device starts anew
    jump: tuple[float, float] | None = None  # s: when, and by how much its clock leaps
    alarm: tuple[float, float] | None = None  # s, number: an alarm stands from then on
    status: tuple[float, float] | None = None  # s, bits: set from then on
    version: tuple[float, float] | None = None  # s, number: no later protocol is accepted any more


def parse_faults(
    texts: list[str], possible: frozenset[str], max_alarm: int = MAX_ALARM
) -> EmulatorFaults:
    """Read `noise=0.05`, `silence=10:3`, `reset=20` and the like.

    Raises:
        InputError: none of the possible ones, or a value that is none of its kind.
    """
    limits = {"alarm": (0, max_alarm), "jump": (-MAX_JUMP, MAX_JUMP)}
    limits |= {"status": (0, 0xFFFF), "version": (0, 0xFFFF)}
    values: dict[str, Any] = {}
    for text in texts:
        name, _, value = text.partition("=")
        if name not in possible:
            expected = f"this device can have {', '.join(sorted(possible))}"
            raise InputError("--fault", f'"{name}" is not known', expected, "Choose one of them.")
        try:
            numbers = [float(word) for word in value.split(":")]
        except ValueError:
            numbers = []
        numbers = [number for number in numbers if math.isfinite(number)]
        if name in MESSAGE_FAULTS and len(numbers) == 1 and 0 <= numbers[0] <= 1:
            values[name] = numbers[0]
        elif name in TIMED_FAULTS and len(numbers) == (1 if name == "reset" else 2):
            least, most = limits.get(name, (0.0, math.inf))
            if name != "reset" and not least <= numbers[1] <= most:
                expected = f"a value from {least:g} to {most:g} is expected"
                raise InputError("--fault", f'"{text}"', expected, "Correct it.")
            values[name] = (numbers[0], numbers[-1])
        else:
            right = "a share from 0 to 1" if name in MESSAGE_FAULTS else "AT:VALUE (reset: AT)"
            raise InputError("--fault", f'"{text}"', f"{right} is expected", "Correct it.")
    return EmulatorFaults(**values)


def in_span(span: tuple[float, float] | None, t: float) -> bool:
    """Whether t lies in a span given as (from, for)."""
    return span is not None and span[0] <= t < span[0] + span[1]


class FaultInjector:
    """Apply the faults of single messages, by chance."""

    PIECES_APART = 0.015  # s

    def __init__(self, faults: EmulatorFaults, seed: int) -> None:
        self._faults, self._random = faults, np.random.default_rng(seed)

    def spoil(self, data: bytes) -> list[tuple[float, bytes]]:
        """Return what is sent in place of a message: pieces, each with its delay in s."""
        faults = self._faults
        if self._falls(faults.lost):
            return []
        if self._falls(faults.half):
            data = data[: int(self._random.integers(1, max(len(data) - 1, 2)))]
        if self._falls(faults.digit):
            data = self._other_digit(data)
        if self._falls(faults.noise):
            at = int(self._random.integers(0, len(data) + 1))
            data = data[:at] + self._random.bytes(int(self._random.integers(1, 9))) + data[at:]
        if self._falls(faults.split) and len(data) > 1:
            at = int(self._random.integers(1, len(data)))
            return [(0.0, data[:at]), (self.PIECES_APART, data[at:])]
        return [(0.0, data)] * (2 if self._falls(faults.double) else 1)

    def _falls(self, share: float) -> bool:
        return bool(share) and self._random.random() < share

    def _other_digit(self, data: bytes) -> bytes:
        places = [i for i, byte in enumerate(data) if chr(byte).isdigit()]
        if not places:
            return data
        at = int(self._random.choice(places))
        other = (data[at] - ord("0") + int(self._random.integers(1, 10))) % 10 + ord("0")
        return data[:at] + bytes([other]) + data[at + 1 :]


TIME_STEP = 0.001  # s: how finely an emulator keeps time
BITS_A_BYTE = 10  # start, eight data, stop


@dataclass(frozen=True, slots=True)
class TimedMessage:
    """Bytes to be sent as one, not before an instant."""

    at: float  # s, from the emulator's start
    data: bytes


class EmulatorEngine(ABC):
    """A device without a port: its answers, given what it receives and the time."""

    _jump = 0.0  # s, by which its clock has leapt

    @abstractmethod
    def greet(self, t: float) -> None:
        """Note that a client has just connected."""

    @abstractmethod
    def step(self, t: float, received: bytes) -> list[TimedMessage]:
        """Go on to t, s from the start, with what was received since."""

    def reset(self, t: float) -> None:
        """Start anew, as after a loss of power."""
        self.greet(t)

    def afflict(self, fault: str, value: float) -> None:
        """Begin to have a fault of its own: jump, alarm, status or version."""
        if fault == "jump":
            self._jump += value


class EmulatorServer:
    """One emulated device; `baud` paces its bytes as a serial line of so many bits/s would."""

    def __init__(
        self,
        front: Endpoint,
        engine: EmulatorEngine,
        faults: EmulatorFaults | None = None,
        baud: int | None = None,
        seed: int = 0,
    ) -> None:
        self.front, self._engine = front, engine
        self._faults = EmulatorFaults() if faults is None else faults
        self._spoiler = FaultInjector(self._faults, seed)
        self._byte_time = BITS_A_BYTE / baud if baud else 0.0
        self._queue: deque[tuple[float, bytes]] = deque()
        self._free = 0.0  # s: when the line has sent what it has
        self._plugged = True
        self._to_come = {"reset", "jump", "alarm", "status", "version"}

    @property
    def address(self) -> str:
        """What a client opens."""
        return self.front.address

    def serve(self, until: Callable[[], bool], now: Callable[[], float] = time.monotonic) -> None:
        """Serve until `until` returns True; `now` is a clock, s."""
        start = now()
        while not until():
            t = now() - start
            self._begin_faults(t)
            came, data = self.front.receive(TIME_STEP) if self._plugged else (False, b"")
            if not self._plugged:
                time.sleep(TIME_STEP)
            t = now() - start  # waiting may have taken longer
            if came:
                self._queue.clear()
                self._engine.greet(t)
            silent = in_span(self._faults.silence, t) or not self._plugged
            for message in self._engine.step(t, data):
                if not silent:
                    self._enqueue(message)
            t = now() - start
            while self._queue and self._queue[0][0] <= t:
                self.front.send(self._queue.popleft()[1])

    def close(self) -> None:
        """Close the address."""
        if self._plugged:
            self.front.unplug()

    def _begin_faults(self, t: float) -> None:
        if in_span(self._faults.unplug, t) == self._plugged:
            self._queue.clear()  # what was on its way is lost
            (self.front.unplug if self._plugged else self.front.plug)()
            self._plugged = not self._plugged
        for name in sorted(self._to_come):
            event: tuple[float, float] | None = getattr(self._faults, name)
            if event is not None and t >= event[0]:
                self._to_come.discard(name)
                if name == "reset":
                    self._engine.reset(t)
                else:
                    self._engine.afflict(name, event[1])

    def _enqueue(self, message: TimedMessage) -> None:
        for delay, piece in self._spoiler.spoil(message.data):
            begin = max(message.at + delay, self._free)  # a line sends one thing after the other
            self._free = begin + self._byte_time * len(piece)
            self._queue.append((self._free, piece))
