"""Addresses at which an emulated device is reached: TCP, UDP, a pseudo-terminal, a serial port."""

import contextlib
import os
import select
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol

from verify.devices.ports import (
    MAX_READ_BYTES,
    PSEUDO_TERMINALS,
    SerialLine,
    host_and_port,
    open_port,
)
from verify.errors import InputError


class Endpoint(Protocol):
    """An address at which one client at a time is served.

    Between `unplug` and `plug` nothing else is called.
    """

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
        self._client: socket.socket | None = None
        self._where = (host, port)
        self.plug()

    def receive(self, wait: float) -> tuple[bool, bytes]:
        """Accept clients and read bytes."""
        ready = [self._listener, *([] if self._client is None else [self._client])]
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
        self._listener.close()

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
        self.plug()

    def receive(self, wait: float) -> tuple[bool, bytes]:
        """Take one datagram."""
        if not select.select([self._socket], [], [], wait)[0]:
            return False, b""
        try:
            data, peer = self._socket.recvfrom(MAX_READ_BYTES)
        except OSError:  # the peer's port is closed
            return False, b""
        came, self._peer = peer != self._peer, peer
        return came, data

    def send(self, data: bytes) -> None:
        """Send one datagram."""
        if self._peer is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(data, self._peer)

    def unplug(self) -> None:
        """Close the socket."""
        self._socket.close()

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
        self.plug()

    def receive(self, wait: float) -> tuple[bool, bytes]:
        """Read bytes; a client that connects cannot be noticed."""
        if not select.select([self._ends[0]], [], [], wait)[0]:
            return False, b""
        return False, os.read(self._ends[0], MAX_READ_BYTES)

    def send(self, data: bytes) -> None:
        """Send; what is not read is dropped, as on a serial line."""
        with contextlib.suppress(BlockingIOError):
            os.write(self._ends[0], data)

    def unplug(self) -> None:
        """Close both ends."""
        for end in self._ends:
            os.close(end)
        self._remove_link()

    def plug(self) -> None:
        """Make a pseudo-terminal that hands every byte through."""
        import tty  # not on Windows

        self._remove_link()
        self._ends = os.openpty()
        tty.setraw(self._ends[1])
        os.set_blocking(self._ends[0], False)
        name = os.ttyname(self._ends[1])
        if self._link is not None:
            self._link.symlink_to(name)  # refused where something else has that name
        self.address = str(self._link or name)

    def _remove_link(self) -> None:
        """Remove a link to a pseudo-terminal, perhaps of an emulator that was killed; no file."""
        link = self._link
        if link is not None and os.path.realpath(link).startswith(PSEUDO_TERMINALS):
            link.unlink()


class SerialEndpoint:
    """A serial device; the client is at the other end of a cable."""

    def __init__(self, path: str, line: SerialLine) -> None:
        self.address = path
        self._line = line
        self.plug()

    def receive(self, wait: float) -> tuple[bool, bytes]:
        """Read bytes; a client that connects cannot be noticed."""
        if not self._port.wait(wait):
            return False, b""
        return False, self._port.take()

    def send(self, data: bytes) -> None:
        """Send."""
        self._port.send(data)

    def unplug(self) -> None:
        """Close the device."""
        self._port.close()

    def plug(self) -> None:
        """Open the device."""
        self._port = open_port(self.address, self._line)


def open_front(
    where: str, line: SerialLine, server: Callable[[str, int], Endpoint] = TcpEndpoint
) -> Endpoint:
    """Open the endpoint that the user names; `line` sets a serial device, `server` serves TCP.

    It is `tcp:PORT`, `tcp:HOST:PORT`, `udp:…`, `pty`, `pty:LINK`, or a serial device's path.
    Without a host only this computer can connect; port 0 takes a free one.

    Raises:
        InputError: it cannot be opened.
    """
    kind, _, rest = where.partition(":")
    with opening(where):
        if kind == "tcp":
            return server(*listening_at(where))
        if kind == "udp":
            return UdpEndpoint(*listening_at(where))
        if kind == "pty":
            return PtyEndpoint(Path(rest) if rest else None)
        return SerialEndpoint(where, line)


def listening_at(where: str) -> tuple[str, int]:
    """Take `tcp:PORT`, `tcp:HOST:PORT` or the same of `udp` apart; InputError: no such port."""
    rest = where.partition(":")[2]
    return host_and_port(rest if ":" in rest else f"127.0.0.1:{rest}", where)


@contextlib.contextmanager
def opening(where: str) -> Iterator[None]:
    """Turn what goes wrong when an address is opened into an InputError."""
    try:
        yield
    except OSError as error:
        found = (error.strerror or str(error)).lower()
        raise InputError(f"--port {where}", found, "", "Choose another one.") from error
