"""Ports: TCP, UDP, and whatever pyserial opens (serial device, pty, rfc2217://, loop://, spy://)."""

import contextlib
import os
import select
import socket
import time
from dataclasses import dataclass
from typing import Protocol

import serial

from verify.errors import InputError

CONNECT_LIMIT = 1.0  # s an address: nobody in a local network needs longer to answer
SEND_LIMIT = 1.0  # s
ENDED = "the other end has closed the connection"
LARGEST_READ = 4096  # bytes at once
PSEUDO_TERMINALS = ("/dev/pts/", "/dev/ttys")  # Linux, macOS
POLL = 0.001  # s: ports that cannot be selected on are asked this often


class Port(Protocol):
    """A line to a device. Every method raises OSError once the line is gone."""

    def wait(self, seconds: float) -> bool:
        """Wait until there is something to take, for at most so long."""
        ...

    def take(self) -> bytes:
        """Take what is there; a datagram port gives one datagram."""
        ...

    def send(self, data: bytes) -> None:
        """Send all of it."""
        ...

    def close(self) -> None:
        """Close the line; never raises."""
        ...


@dataclass(frozen=True, slots=True)
class SerialLine:
    """How a serial line is set; TCP takes no notice of it."""

    baud: int = 115200
    data_bits: int = 8
    parity: str = "N"  # N, E or O
    stop_bits: int = 1
    rts_cts: bool = False


USUAL_LINE = SerialLine()


class SocketPort:
    """A connected socket, stream or datagram."""

    def __init__(self, connected: socket.socket) -> None:
        self._socket = connected
        self._stream = connected.type == socket.SOCK_STREAM
        connected.settimeout(SEND_LIMIT)

    def wait(self, seconds: float) -> bool:
        """Wait for bytes, or for the end of the line."""
        return bool(select.select([self._socket], [], [], max(seconds, 0.0))[0])

    def take(self) -> bytes:
        """Take what is there.

        Raises:
            ConnectionResetError: the other end has closed the stream.
        """
        data = self._socket.recv(LARGEST_READ)
        if not data and self._stream:
            raise ConnectionResetError(ENDED)
        return data

    def send(self, data: bytes) -> None:
        """Send all of it, within SEND_LIMIT."""
        self._socket.sendall(data)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class SerialPort:
    """Whatever pyserial opens."""

    def __init__(self, opened: serial.SerialBase) -> None:
        self._port = opened
        try:
            self._descriptor: int | None = opened.fileno()
        except (AttributeError, OSError):  # Windows, loop://, rfc2217://
            self._descriptor = None

    def wait(self, seconds: float) -> bool:
        """Wait for bytes."""
        if self._descriptor is not None:
            return bool(select.select([self._descriptor], [], [], max(seconds, 0.0))[0])
        deadline = time.monotonic() + seconds
        while not self._port.in_waiting:
            if time.monotonic() >= deadline:
                return False
            time.sleep(POLL)
        return True

    def take(self) -> bytes:
        """Take what is there."""
        return bytes(self._port.read(LARGEST_READ))  # its time-out is 0

    def send(self, data: bytes) -> None:
        """Send all of it, within SEND_LIMIT."""
        self._port.write(data)

    def close(self) -> None:
        """Close the port."""
        with contextlib.suppress(OSError):  # one that is gone cannot be flushed
            self._port.close()


def open_port(address: str, line: SerialLine) -> Port:
    """Open a line to a device.

    Args:
        address: `tcp:HOST:PORT` (or `socket://HOST:PORT`), `udp:HOST:PORT`, or what pyserial's
            serial_for_url takes: a device's path or name, `rfc2217://…`, `loop://`, `spy://…`.
        line: how a serial line is set.

    Raises:
        OSError: it cannot be opened now.
        InputError: it never can: no such kind of address, or settings that do not exist.
    """
    kind, _, rest = address.replace("socket://", "tcp:", 1).partition(":")
    if kind in ("tcp", "udp"):
        return SocketPort(_connected(kind, host_and_port(rest, address)))
    pseudo = os.path.realpath(address).startswith(PSEUDO_TERMINALS)
    try:
        opened = serial.serial_for_url(
            address,
            baudrate=line.baud,
            bytesize=line.data_bits,
            parity="N" if pseudo else line.parity,  # without a wire it means nothing, and some
            stopbits=1 if pseudo else line.stop_bits,  # systems refuse it there
            rtscts=line.rts_cts,
            timeout=0,
            write_timeout=SEND_LIMIT,
            exclusive=True,  # two readers of one line would each get half of it
        )
    except ValueError as error:
        expected = "tcp:HOST:PORT, a serial device's path, or a URL that pyserial knows is expected"
        raise InputError(f"port {address}", str(error), expected, "Mend the port.") from error
    except Exception as error:  # termios.error is no OSError, and there is no termios on Windows
        if type(error).__module__ != "termios":
            raise
        raise OSError("the port does not take these settings") from error
    return SerialPort(opened)


def host_and_port(text: str, address: str) -> tuple[str, int]:
    """Take `HOST:PORT` apart; [brackets] hold an IPv6 address.

    Raises:
        InputError: no port from 0 to 65535.
    """
    host, _, port = text.rpartition(":")
    if not host or not port.isascii() or not port.isdigit() or int(port) > 65535:
        expected, remedy = "HOST:PORT is expected", "Example: tcp:192.168.0.20:10001"
        raise InputError(f"port {address}", f'has "{text}"', expected, remedy)
    return host.strip("[]"), int(port)


def in_words(error: OSError) -> str:
    """Say why a port does not work, and what to look at."""
    if isinstance(error, FileNotFoundError) or error.errno == 2:
        return "there is no such port; is it plugged in?"
    if isinstance(error, PermissionError) or error.errno == 13:
        return "this user may not open it (on Linux: join the group dialout)"
    if isinstance(error, ConnectionRefusedError):
        return "nobody listens there, or the line is taken by another program"
    if isinstance(error, ConnectionError):  # how it ends depends on what was under way
        return ENDED
    if isinstance(error, TimeoutError):
        return "no answer; check address, cable and power"
    if isinstance(error, socket.gaierror):
        return "there is no computer of that name"
    if error.errno == 11:  # the exclusive lock
        return "another program has it open"
    if isinstance(error, serial.SerialException):
        return "the port is gone; was it unplugged?"
    return (error.strerror or str(error) or type(error).__name__).lower()


def _connected(kind: str, where: tuple[str, int]) -> socket.socket:
    if kind == "tcp":
        stream = socket.create_connection(where, timeout=CONNECT_LIMIT)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # Nagle would add 40 ms
        return stream
    family, *_, found = socket.getaddrinfo(*where, type=socket.SOCK_DGRAM)[0]
    datagram = socket.socket(family, socket.SOCK_DGRAM)
    datagram.connect(found)  # from now on only that sender is heard
    return datagram
