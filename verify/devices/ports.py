"""Open a port (TCP, UDP, or by pyserial), keep it open, and split its bytes into lines."""

import binascii
import contextlib
import errno
import operator
import os
import select
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial, reduce
from typing import Protocol

import serial

from verify.errors import InputError

CONNECT_TIMEOUT = 1.0  # s an address: nobody in a local network needs longer to answer
SEND_TIMEOUT = 1.0  # s
CONNECTION_CLOSED = "the other end has closed the connection"
MAX_READ_BYTES = 4096  # bytes at once
PSEUDO_TERMINALS = ("/dev/pts/", "/dev/ttys")  # Linux, macOS
POLL_PERIOD = 0.001  # s: ports that cannot be selected on are asked this often


class Port(Protocol):
    """A line to a device. Every method raises OSError once the line is gone."""

    def wait(self, seconds: float) -> bool:
        """Wait until there is something to take, for at most so long."""

    def take(self) -> bytes:
        """Take what is there; a datagram port gives one datagram."""

    def send(self, data: bytes) -> None:
        """Send all of it."""

    def close(self) -> None:
        """Close the line; never raises."""


@dataclass(frozen=True, slots=True)
class SerialLine:
    """How a serial line is set; TCP takes no notice of it."""

    baud: int = 115200
    data_bits: int = 8
    parity: str = "N"  # N, E or O
    stop_bits: int = 1
    rts_cts: bool = False


DEFAULT_LINE = SerialLine()


class SocketPort:
    """A connected socket, stream or datagram."""

    def __init__(self, connected: socket.socket) -> None:
        self._socket = connected
        self._stream = connected.type == socket.SOCK_STREAM
        connected.settimeout(SEND_TIMEOUT)

    def wait(self, seconds: float) -> bool:
        """Wait for bytes, or for the end of the line."""
        return bool(select.select([self._socket], [], [], max(seconds, 0.0))[0])

    def take(self) -> bytes:
        """Take what is there.

        Raises:
            ConnectionResetError: the other end has closed the stream.
        """
        data = self._socket.recv(MAX_READ_BYTES)
        if not data and self._stream:
            raise ConnectionResetError(CONNECTION_CLOSED)
        return data

    def send(self, data: bytes) -> None:
        """Send all of it, within SEND_TIMEOUT."""
        self._socket.sendall(data)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def wait_until(there: Callable[[], bool], seconds: float, period: float = POLL_PERIOD) -> bool:
    """Ask every `period` s whether there is something to take, for at most so long."""
    deadline = time.monotonic() + seconds
    while not there():
        rest = deadline - time.monotonic()
        if rest <= 0:
            return False
        time.sleep(min(rest, period))
    return True


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
        return wait_until(lambda: bool(self._port.in_waiting), seconds)

    def take(self) -> bytes:
        """Take what is there."""
        return bytes(self._port.read(MAX_READ_BYTES))  # its time-out is 0

    def send(self, data: bytes) -> None:
        """Send all of it, within SEND_TIMEOUT."""
        self._port.write(data)

    def close(self) -> None:
        """Close the port."""
        with contextlib.suppress(OSError):  # one that is gone cannot be flushed
            self._port.close()


def open_port(address: str, line: SerialLine) -> Port:
    """Open a line to a device; `line` is how a serial one is set.

    The address is `tcp:HOST:PORT` (or `socket://HOST:PORT`), `udp:HOST:PORT`, or what pyserial's
    serial_for_url takes: a device's path or name, `rfc2217://…`, `loop://`, `spy://…`.

    Raises:
        OSError: it cannot be opened now.
        InputError: it never can: no such kind of address, or settings that do not exist.
    """
    network = _network_address(address)
    if network is not None:
        return SocketPort(_connect(*network))
    return SerialPort(_serial_port(address, line))


def check_port(address: str, line: SerialLine) -> None:
    """Raise InputError for what `open_port` can never open; opens nothing."""
    if _network_address(address) is None:
        with contextlib.suppress(OSError):  # hwgrep:// looks for a device that may come later
            _serial_port(address, line, do_not_open=True)


def _network_address(address: str) -> tuple[str, tuple[str, int]] | None:
    """Take tcp:HOST:PORT, udp:HOST:PORT or socket://HOST:PORT apart; None for a serial line."""
    kind, _, rest = address.replace("socket://", "tcp:", 1).partition(":")
    return (kind, host_and_port(rest, address)) if kind in ("tcp", "udp") else None


def _serial_port(address: str, line: SerialLine, *, do_not_open: bool = False) -> serial.SerialBase:
    pseudo = os.path.realpath(address).startswith(PSEUDO_TERMINALS)
    try:
        return serial.serial_for_url(
            address,
            baudrate=line.baud,
            bytesize=line.data_bits,
            parity="N" if pseudo else line.parity,  # without a wire it means nothing, and some
            stopbits=1 if pseudo else line.stop_bits,  # systems refuse it there
            rtscts=line.rts_cts,
            timeout=0,
            write_timeout=SEND_TIMEOUT,
            exclusive=True,  # two readers of one line would each get half of it
            do_not_open=do_not_open,
        )
    except ValueError as error:
        expected = "tcp:HOST:PORT, a serial device's path, or a URL that pyserial knows is expected"
        raise InputError(f"port {address}", str(error), expected, "Correct the port.") from error
    except Exception as error:  # termios.error is no OSError, and there is no termios on Windows
        if type(error).__module__ != "termios":
            raise
        raise OSError("the port does not take these settings") from error


def host_and_port(text: str, address: str) -> tuple[str, int]:
    """Take `HOST:PORT` apart, an IPv6 address in [brackets]; InputError: no port, 0 to 65535."""
    host, _, port = text.rpartition(":")
    if not host or not port.isascii() or not port.isdigit() or int(port) > 65535:
        expected, remedy = "HOST:PORT is expected", "Example: tcp:192.168.0.20:10001"
        raise InputError(f"port {address}", f'has "{text}"', expected, remedy)
    return host.strip("[]"), int(port)


# the first row whose type or number (None: any) is the error's
ERROR_TEXTS: tuple[tuple[type[OSError], int | None, str], ...] = (
    (FileNotFoundError, errno.ENOENT, "there is no such port; is it plugged in?"),
    (
        *(PermissionError, errno.EACCES),
        "this user may not open it (on Linux: join the group dialout)",
    ),
    (ConnectionRefusedError, None, "nothing listens there, or another program uses the line"),
    (ConnectionError, None, CONNECTION_CLOSED),
    (TimeoutError, None, "no answer; check address, cable and power"),
    (socket.gaierror, None, "no computer has that name"),
    (BlockingIOError, errno.EAGAIN, "another program has it open"),
    (serial.SerialException, None, "the port is gone; was it unplugged?"),
)


def describe_port_error(error: OSError) -> str:
    """Say why a port does not work, and what to look at."""
    for kind, number, text in ERROR_TEXTS:
        if isinstance(error, kind) or (number is not None and error.errno == number):
            return text
    return (error.strerror or str(error) or type(error).__name__).lower()


def _connect(kind: str, where: tuple[str, int]) -> socket.socket:
    if kind == "tcp":
        stream = socket.create_connection(where, timeout=CONNECT_TIMEOUT)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # Nagle would add 40 ms
        return stream
    family, *_, found = socket.getaddrinfo(*where, type=socket.SOCK_DGRAM)[0]
    datagram = socket.socket(family, socket.SOCK_DGRAM)
    datagram.connect(found)  # from now on only that sender is heard
    return datagram


READ_TIMEOUT = 0.02  # s, on an open line
LINE_IN_USE = "before it said anything: another program may have the line"
MIN_RETRY_DELAY, MAX_RETRY_DELAY = 0.25, 4.0  # s: doubled from the one to the other

ClockFunction = Callable[[], float]  # s, host's monotonic clock


@dataclass(frozen=True, slots=True)
class Chunk:
    """Bytes that came together, and when."""

    data: bytes
    t: float  # s, host's monotonic clock, when they were in hand
    earliest: float  # s: before this they were not there


class PortLink:
    """Keeps one port open for a driver, by the name that the user wrote.

    To open it may raise OSError while that is not possible. `now` is the host's monotonic clock, s.
    """

    def __init__(
        self, name: str, open_port: Callable[[], Port], now: ClockFunction = time.monotonic
    ) -> None:
        self.name = name
        self.now = now
        self.fault = "not opened yet"
        self.connections = 0  # drivers greet the device anew when this has risen
        self._connection = 0  # the last one that `reopened` reported
        self._open_port = open_port
        self._port: Port | None = None
        self._retry = MIN_RETRY_DELAY
        self._next_try = float("-inf")
        self._last_look = now()
        self._closed = False
        self._received = False  # anything since the port was opened

    @property
    def connected(self) -> bool:
        """Whether the port is open."""
        return self._port is not None

    def reopened(self) -> bool:
        """Whether the port was opened since the last call."""
        before, self._connection = self._connection, self.connections
        return self._connection != before

    def receive(self, wait: float = READ_TIMEOUT) -> Chunk | None:
        """Take what has come, waiting for at most so long; opens the port where that is due."""
        if not self._opened(wait) or self._port is None:
            return None
        try:
            there = self._port.wait(0.0)
            earliest = self._last_look
            if not there:
                there = self._port.wait(wait)
                earliest = self.now()
            data = self._port.take() if there else b""
        except OSError as error:
            self._broken(error)
            return None
        self._last_look = self.now()
        self._received |= bool(data)
        return Chunk(data, self._last_look, min(earliest, self._last_look)) if data else None

    def send(self, data: bytes) -> bool:
        """Send it; False if the line is not there or breaks."""
        if self._port is None:
            return False
        try:
            self._port.send(data)
        except OSError as error:
            self._broken(error)
            return False
        return True

    def drop(self, why: str) -> None:
        """Give the line up for now; it is tried again."""
        if self._port is not None:
            self._port.close()
        self._port, self.fault = None, why
        self._next_try = self.now() + self._retry

    def steady(self) -> None:
        """Note that good data come: the next break is mended at once again."""
        self._retry = MIN_RETRY_DELAY

    def close(self) -> None:
        """Close the port for good."""
        self._closed = True
        self.drop("closed")

    def _opened(self, wait: float) -> bool:
        if self._port is not None:
            return True
        now = self.now()
        if self._closed or now < self._next_try:
            time.sleep(wait)
            return False
        try:
            self._port = self._open_port()
        except (OSError, InputError) as error:  # a device may refuse a baud rate that others have
            self._retry = min(2 * self._retry, MAX_RETRY_DELAY)
            self.drop(error.found if isinstance(error, InputError) else describe_port_error(error))
            return False
        self.connections += 1
        self._last_look, self._received = self.now(), False
        return True

    def _broken(self, error: OSError) -> None:
        why = describe_port_error(error)
        self.drop(
            f"{why} {LINE_IN_USE}" if why == CONNECTION_CLOSED and not self._received else why
        )


def link_to(address: str, line: SerialLine = DEFAULT_LINE) -> PortLink:
    """Keep the port of an address open; see `open_port`."""
    return PortLink(address, partial(open_port, address, line))


MAX_LINE_BYTES = 4096  # bytes: noise without a line end must not fill the memory


class LineBuffer:
    """Collects bytes until a line is whole; never hands out half a line."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[bytes]:
        """Add bytes; get the lines that they complete, without LF, CR LF or blanks about them."""
        *whole, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > MAX_LINE_BYTES:
            self._rest = b""
        return [line for line in map(bytes.strip, whole) if line]


def _crc8(data: bytes) -> int:
    register = 0
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = (register << 1) ^ (0x107 if register & 0x80 else 0)
    return register


# width in hexadecimal digits, and the function
CHECKSUMS: dict[str, tuple[int, Callable[[bytes], int]]] = {
    "xor": (2, lambda data: reduce(operator.xor, data, 0)),  # as NMEA 0183 has it
    "sum8": (2, lambda data: sum(data) & 0xFF),
    "crc8": (2, _crc8),  # polynomial 0x07, start 0, not reflected; F4 for "123456789"
    # CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF; 29B1 for "123456789"
    "crc16": (4, lambda data: binascii.crc_hqx(data, 0xFFFF)),
}
