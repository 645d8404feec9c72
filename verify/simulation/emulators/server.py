"""Serve an emulated device on TCP, UDP, a pseudo-terminal or a serial port, faults included."""

import contextlib
import os
import select
import socket
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from verify.devices.ports import MAX_READ_BYTES, Port, SerialLine, host_and_port, open_port
from verify.errors import InputError


class Endpoint(Protocol):
    """An address at which one client at a time is served."""

    address: str  # what a client opens

    def receive(self, wait: float) -> tuple[bool, bytes]:
        """Wait at most `wait` s for bytes: whether a client has just connected, and the bytes."""

    def send(self, data: bytes) -> None:
        """Send to the client, if there is one."""

    def unplug(self) -> None:
        """Close the address."""

    def plug(self) -> None:
        """Open it again, the same address."""


class TcpEndpoint:
    """A server for one client; a second one is refused."""

    def __init__(self, host: str, port: int) -> None:
        self._listener: socket.socket | None = None
        self._client: socket.socket | None = None
        self._where = (host, port)
        self.plug()

    def receive(self, wait: float) -> tuple[bool, bytes]:
        """Accept clients and read bytes."""
        ready = [s for s in (self._listener, self._client) if s is not None]
        came, data = False, b""
        for found in select.select(ready, [], [], wait)[0]:
            if found is self._listener:
                client, _ = found.accept()
                if came := self._client is None:
                    client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    client.settimeout(1.0)
                    self._client = client
                else:
                    client.close()
            elif self._client is not None and not came:
                with contextlib.suppress(OSError):
                    data = self._client.recv(MAX_READ_BYTES)
                if not data:
                    self._disconnect()
        return came, data

    def send(self, data: bytes) -> None:
        """Send to the client."""
        try:
            if self._client is not None:
                self._client.sendall(data)
        except OSError:
            self._disconnect()

    def unplug(self) -> None:
        """Close everything."""
        self._disconnect()
        if self._listener is not None:
            self._listener.close()
        self._listener = None

    def plug(self) -> None:
        """Listen; port 0 takes a free one, and keeps it."""
        self._listener = socket.create_server(self._where)
        self._where = (self._where[0], self._listener.getsockname()[1])
        self.address = f"tcp:{self._where[0]}:{self._where[1]}"

    def _disconnect(self) -> None:
        if self._client is not None:
            self._client.close()
        self._client = None


class UdpEndpoint:
    """A datagram socket; it answers whoever wrote last."""

    def __init__(self, host: str, port: int) -> None:
        self._where = (host, port)
        self._peer: tuple[str, int] | None = None
        self._socket: socket.socket | None = None
        self.plug()

    def receive(self, wait: float) -> tuple[bool, bytes]:
        """Take one datagram."""
        if self._socket is None or not select.select([self._socket], [], [], wait)[0]:
            return False, b""
        try:
            data, peer = self._socket.recvfrom(MAX_READ_BYTES)
        except OSError:  # the peer's port is closed
            return False, b""
        came, self._peer = peer != self._peer, peer
        return came, data

    def send(self, data: bytes) -> None:
        """Send one datagram."""
        if self._socket is not None and self._peer is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(data, self._peer)

    def unplug(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None

    def plug(self) -> None:
        """Bind; port 0 takes a free one, and keeps it."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(self._where)
        self._where = (self._where[0], self._socket.getsockname()[1])
        self.address = f"udp:{self._where[0]}:{self._where[1]}"


class PtyEndpoint:
    """A pseudo-terminal: a serial device to whoever opens it. Not on Windows.

    A link always leads to it; without one it has the system's name, which a replug changes.
    """

    def __init__(self, link: Path | None) -> None:
        self._link = link
        self._ends: tuple[int, int] | None = None
        self.plug()

    def receive(self, wait: float) -> tuple[bool, bytes]:
        """Read bytes; a client that connects cannot be noticed."""
        if self._ends is None or not select.select([self._ends[0]], [], [], wait)[0]:
            return False, b""
        return False, os.read(self._ends[0], MAX_READ_BYTES)

    def send(self, data: bytes) -> None:
        """Send; what is not read is dropped, as on a serial line."""
        if self._ends is not None:
            with contextlib.suppress(BlockingIOError):
                os.write(self._ends[0], data)

    def unplug(self) -> None:
        """Close both ends."""
        if self._ends is not None:
            for end in self._ends:
                os.close(end)
            if self._link is not None:
                self._link.unlink(missing_ok=True)
        self._ends = None

    def plug(self) -> None:
        """Make a pseudo-terminal that hands every byte through."""
        import tty  # not on Windows

        self._ends = os.openpty()
        tty.setraw(self._ends[1])
        os.set_blocking(self._ends[0], False)
        name = os.ttyname(self._ends[1])
        if self._link is not None:
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(name)
        self.address = str(self._link or name)


class SerialEndpoint:
    """A serial device; the client is at the other end of a cable."""

    def __init__(self, path: str, line: SerialLine) -> None:
        self.address = path
        self._line = line
        self._port: Port | None = None
        self.plug()

    def receive(self, wait: float) -> tuple[bool, bytes]:
        """Read bytes; a client that connects cannot be noticed."""
        if self._port is None or not self._port.wait(wait):
            return False, b""
        return False, self._port.take()

    def send(self, data: bytes) -> None:
        """Send."""
        if self._port is not None:
            self._port.send(data)

    def unplug(self) -> None:
        """Close the device."""
        if self._port is not None:
            self._port.close()
        self._port = None

    def plug(self) -> None:
        """Open the device."""
        self._port = open_port(self.address, self._line)


def open_front(where: str, line: SerialLine) -> Endpoint:
    """Open the endpoint that the user names; `line` is how a serial device is set.

    It is `tcp:PORT`, `tcp:HOST:PORT`, `udp:…`, `pty`, `pty:LINK`, or a serial device's path.
    Without a host only this computer can connect; port 0 takes a free one.

    Raises:
        InputError: it cannot be opened.
    """
    kind, _, rest = where.partition(":")
    with opening(where):
        if kind == "tcp":
            return TcpEndpoint(*listening_at(where))
        if kind == "udp":
            return UdpEndpoint(*listening_at(where, "udp"))
        if kind == "pty":
            return PtyEndpoint(Path(rest) if rest else None)
        return SerialEndpoint(where, line)


def listening_at(where: str, kind: str = "tcp") -> tuple[str, int]:
    """Take `tcp:PORT` or `tcp:HOST:PORT` apart; InputError: another kind of address."""
    found, _, rest = where.partition(":")
    if found != kind:
        raise InputError(f"--port {where}", "is another kind of line", f"{kind}:PORT is expected")
    return host_and_port(rest if ":" in rest else f"127.0.0.1:{rest}", where)


@contextlib.contextmanager
def opening(where: str) -> Iterator[None]:
    """Turn what goes wrong when an address is opened into an InputError."""
    try:
        yield
    except OSError as error:
        found = (error.strerror or str(error)).lower()
        raise InputError(f"--port {where}", found, "", "Choose another one.") from error


MESSAGE_FAULTS = ("noise", "half", "digit", "double", "lost", "split")
TIMED_FAULTS = ("silence", "unplug", "reset", "jump", "alarm", "status", "version")


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


def parse_faults(texts: list[str], possible: frozenset[str]) -> EmulatorFaults:
    """Read `noise=0.05`, `silence=10:3`, `reset=20` and the like; InputError: none of these."""
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
        if name in MESSAGE_FAULTS and len(numbers) == 1 and 0 <= numbers[0] <= 1:
            values[name] = numbers[0]
        elif name in TIMED_FAULTS and len(numbers) == (1 if name == "reset" else 2):
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


class EmulatorEngine(Protocol):
    """A device without a port: its answers, given what it receives and the time."""

    def greet(self, t: float) -> None:
        """Note that a client has just connected."""

    def step(self, t: float, received: bytes) -> list[TimedMessage]:
        """Go on to t, s from the start, with what was received since."""

    def reset(self, t: float) -> None:
        """Start anew, as after a loss of power."""

    def afflict(self, fault: str, value: float) -> None:
        """Begin to have a fault of its own: jump, alarm, status or version."""


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
        self.front.unplug()

    def _begin_faults(self, t: float) -> None:
        if in_span(self._faults.unplug, t) == self._plugged:
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

    def _enqueue(self, message: TimedMessage) -> None:
        for delay, piece in self._spoiler.spoil(message.data):
            begin = max(message.at + delay, self._free)  # a line sends one thing after the other
            self._free = begin + self._byte_time * len(piece)
            self._queue.append((self._free, piece))
