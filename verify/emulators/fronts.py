"""Where an emulator can be reached: TCP, UDP, a pseudo-terminal, or a serial device."""

import contextlib
import os
import select
import socket
from pathlib import Path
from typing import Protocol

from verify.devices.ports import LARGEST_READ, Port, SerialLine, host_and_port, open_port
from verify.errors import InputError


class Front(Protocol):
    """A place at which somebody may call."""

    address: str  # what a caller opens

    def receive(self, wait: float) -> tuple[bool, bytes]:
        """Wait for bytes for at most so long: whether somebody has just come, and the bytes."""
        ...

    def send(self, data: bytes) -> None:
        """Send to whoever is there; to nobody, if nobody is."""
        ...

    def unplug(self) -> None:
        """Vanish."""
        ...

    def plug(self) -> None:
        """Be back at the same address."""
        ...


class TcpFront:
    """A server for one caller; a second one is sent away."""

    def __init__(self, host: str, port: int) -> None:
        self._listener: socket.socket | None = None
        self._caller: socket.socket | None = None
        self._where = (host, port)
        self.plug()

    def receive(self, wait: float) -> tuple[bool, bytes]:
        """Take callers and bytes."""
        ready = [s for s in (self._listener, self._caller) if s is not None]
        came, data = False, b""
        for found in select.select(ready, [], [], wait)[0]:
            if found is self._listener:
                came = self._answer(found)
            elif self._caller is not None and not came:
                with contextlib.suppress(OSError):
                    data = self._caller.recv(LARGEST_READ)
                if not data:
                    self._hang_up()
        return came, data

    def send(self, data: bytes) -> None:
        """Send to the caller."""
        if self._caller is not None:
            try:
                self._caller.sendall(data)
            except OSError:
                self._hang_up()

    def unplug(self) -> None:
        """Close everything."""
        self._hang_up()
        if self._listener is not None:
            self._listener.close()
        self._listener = None

    def plug(self) -> None:
        """Listen; port 0 takes a free one, and keeps it."""
        self._listener = socket.create_server(self._where)
        self._where = (self._where[0], self._listener.getsockname()[1])
        self.address = f"tcp:{self._where[0]}:{self._where[1]}"

    def _answer(self, listener: socket.socket) -> bool:
        caller, _ = listener.accept()
        if self._caller is not None:
            caller.close()
            return False
        caller.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        caller.settimeout(1.0)
        self._caller = caller
        return True

    def _hang_up(self) -> None:
        if self._caller is not None:
            self._caller.close()
        self._caller = None


class UdpFront:
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
            data, peer = self._socket.recvfrom(LARGEST_READ)
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


class PtyFront:
    """A pseudo-terminal: a serial device to whoever opens it. Not on Windows.

    Args:
        link: a path that always leads to it; None uses the system's own name, which changes when it
            is unplugged.
    """

    def __init__(self, link: Path | None) -> None:
        self._link = link
        self._ends: tuple[int, int] | None = None
        self.plug()

    def receive(self, wait: float) -> tuple[bool, bytes]:
        """Take bytes; nobody can be seen to come."""
        if self._ends is None or not select.select([self._ends[0]], [], [], wait)[0]:
            return False, b""
        return False, os.read(self._ends[0], LARGEST_READ)

    def send(self, data: bytes) -> None:
        """Send; what nobody reads is thrown away, as a serial line does."""
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


class SerialFront:
    """A serial device; the caller is at the other end of a cable."""

    def __init__(self, path: str, line: SerialLine) -> None:
        self.address = path
        self._line = line
        self._port: Port | None = None
        self.plug()

    def receive(self, wait: float) -> tuple[bool, bytes]:
        """Take bytes; nobody can be seen to come."""
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


def front(where: str, line: SerialLine) -> Front:
    """Open the place that the user names.

    Args:
        where: `tcp:PORT`, `tcp:HOST:PORT`, `udp:…`, `pty`, `pty:LINK`, or a serial device's path.
            Without a host only this computer can call; port 0 takes a free one.
        line: how a serial device is set.

    Raises:
        InputError: it cannot be opened.
    """
    kind, _, rest = where.partition(":")
    try:
        if kind in ("tcp", "udp"):
            host, port = host_and_port(rest if ":" in rest else f"127.0.0.1:{rest}", where)
            return TcpFront(host, port) if kind == "tcp" else UdpFront(host, port)
        if kind == "pty":
            return PtyFront(Path(rest) if rest else None)
        return SerialFront(where, line)
    except OSError as error:
        said = error.strerror or str(error)
        raise InputError(f"--port {where}", said.lower(), "", "Choose another one.") from error
