"""Serves a device on a front: bytes to the engine, its messages back, spoilt where asked for."""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from verify.emulators.faults import Faults, Spoiler, during
from verify.emulators.fronts import Front

TICK = 0.001  # s: how finely an emulator keeps time
BITS_A_BYTE = 10  # start, eight data, stop


@dataclass(frozen=True, slots=True)
class Message:
    """Bytes to be sent as one, not before an instant."""

    at: float  # s, from the emulator's start
    data: bytes


class Engine(Protocol):
    """A device without a port: what it says, given what it hears and the time."""

    def greet(self, t: float) -> None:
        """Note that somebody has just come."""
        ...

    def step(self, t: float, received: bytes) -> list[Message]:
        """Go on to t, s from the start, with what was received since."""
        ...

    def reset(self, t: float) -> None:
        """Start anew, as after a loss of power."""
        ...

    def afflict(self, fault: str, value: float) -> None:
        """Begin to have a fault of its own: jump, alarm or status."""
        ...


class Server:
    """One emulated device.

    Args:
        front: where it can be reached.
        engine: the device.
        faults: what goes wrong.
        baud: paces the bytes as a serial line of so many bits/s would; None does not.
        seed: of the faults' chance.
    """

    def __init__(
        self,
        front: Front,
        engine: Engine,
        faults: Faults | None = None,
        baud: int | None = None,
        seed: int = 0,
    ) -> None:
        self.front, self._engine = front, engine
        self._faults = faults or Faults()
        self._spoiler = Spoiler(self._faults, seed)
        self._byte_time = BITS_A_BYTE / baud if baud else 0.0
        self._queue: deque[tuple[float, bytes]] = deque()
        self._free = 0.0  # s: when the line has sent what it has
        self._plugged = True
        self._to_come = {"reset", "jump", "alarm", "status"}

    def serve(self, until: Callable[[], bool], now: Callable[[], float] = time.monotonic) -> None:
        """Serve until told to stop."""
        start = now()
        while not until():
            t = now() - start
            self._begin_faults(t)
            came, data = self.front.receive(TICK) if self._plugged else (False, b"")
            if not self._plugged:
                time.sleep(TICK)
            t = now() - start  # a busy machine may have made us wait
            if came:
                self._queue.clear()
                self._engine.greet(t)
            silent = during(self._faults.silence, t) or not self._plugged
            for message in self._engine.step(t, data):
                if not silent:
                    self._enqueue(message)
            self._send_due(now() - start)

    def close(self) -> None:
        """Vanish."""
        self.front.unplug()

    def _begin_faults(self, t: float) -> None:
        if during(self._faults.unplug, t) == self._plugged:
            self._plugged = not self._plugged
            (self.front.plug if self._plugged else self.front.unplug)()
        for name in sorted(self._to_come):
            event: tuple[float, float] | None = getattr(self._faults, name)
            if event is not None and t >= event[0]:
                self._to_come.discard(name)
                if name == "reset":
                    self._engine.reset(t)
                else:
                    self._engine.afflict(name, event[1])

    def _enqueue(self, message: Message) -> None:
        for delay, piece in self._spoiler.spoil(message.data):
            begin = max(message.at + delay, self._free)  # a line sends one thing after the other
            self._free = begin + self._byte_time * len(piece)
            self._queue.append((self._free, piece))

    def _send_due(self, t: float) -> None:
        while self._queue and self._queue[0][0] <= t:
            self.front.send(self._queue.popleft()[1])
