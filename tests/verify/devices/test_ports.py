import itertools
import os
import socket
import struct
import time
from functools import partial

import pytest

from tests.support.devices.bench import gather, kept, same_angles
from verify.devices.encoders.labenc.reader import LabencEncoders, LabencSettings
from verify.devices.ports import (
    DEFAULT_LINE,
    Port,
    PortLink,
    SerialLine,
    describe_port_error,
    open_port,
)
from verify.errors import InputError


@pytest.mark.parametrize("address", ["tcp:host", "tcp:host:x", "udp:1.2.3.4:99999", "nonsense://a"])
def test_an_address_that_never_can_be_opened_is_refused(address: str) -> None:
    with pytest.raises(InputError, match=r"port .*expected"):
        open_port(address, DEFAULT_LINE)
    with pytest.raises(InputError, match="parity"):
        open_port("loop://", SerialLine(parity="X"))


def test_a_device_that_takes_no_such_settings_is_said_to_be_not_connected() -> None:
    def refuses() -> Port:
        raise InputError("port COM1", "it takes no 12345 baud")

    link = PortLink("COM1", refuses)
    assert link.receive(0.0) is None
    assert (link.connected, link.fault) == (False, "it takes no 12345 baud")


@pytest.mark.realtime
def test_a_line_without_a_descriptor_is_waited_on_all_the_same() -> None:
    port = open_port("loop://", DEFAULT_LINE)
    begin = time.monotonic()
    assert not port.wait(0.05)
    assert time.monotonic() - begin >= 0.05
    port.send(b"abc")
    assert port.wait(0.05)
    assert port.take() == b"abc"
    port.close()


def test_socket_urls_are_taken_too() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = open_port(f"socket://127.0.0.1:{server.getsockname()[1]}", DEFAULT_LINE)
        port.close()


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (FileNotFoundError(2, "x"), "is it plugged in"),
        (PermissionError(13, "x"), "dialout"),
        (ConnectionRefusedError(111, "x"), "nothing listens"),
        (TimeoutError("x"), "check address, cable and power"),
        (socket.gaierror("x"), "no computer has that name"),
        (OSError(113, "No route to host"), "no route to host"),
    ],
)
def test_the_reason_why_a_port_does_not_open_is_reported(error: OSError, message: str) -> None:
    assert message in describe_port_error(error)


@pytest.mark.realtime
def test_one_program_at_a_time_has_a_serial_port() -> None:
    ends = os.openpty()
    name = os.ttyname(ends[1])
    first = open_port(name, DEFAULT_LINE)
    second = kept(LabencEncoders(LabencSettings(name), same_angles(6)))
    gather(second, lambda _: "another program has it open" in second.state().sentence)
    first.close()
    gather(second, lambda _: second.state().connected)
    for end in ends:
        os.close(end)
    gather(second, lambda _: not second.state().connected)


def test_a_port_is_tried_at_growing_intervals() -> None:
    t, tries = [0.0], []

    def refuse() -> None:
        tries.append(t[0])
        raise ConnectionRefusedError

    link = PortLink("somewhere", refuse, lambda: t[0])  # type: ignore[arg-type]
    for step in range(3000):
        t[0] = 0.01 * step
        link.receive(0.0)
    gaps = [b - a for a, b in itertools.pairwise(tries)]
    assert gaps[0] < 0.6
    assert 3.9 < gaps[-1] < 4.2
    assert gaps == sorted(gaps)


@pytest.mark.realtime
@pytest.mark.parametrize("reset", [False, True])
@pytest.mark.parametrize("greeting", [b"", b"hello"])
def test_a_closed_line_is_distinguished_from_a_taken_one(reset: bool, greeting: bytes) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp:127.0.0.1:{server.getsockname()[1]}"
        link = PortLink(address, partial(open_port, address, DEFAULT_LINE))
        assert link.receive(0.0) is None
        there, _ = server.accept()
        if greeting:
            there.sendall(greeting)
            chunk = link.receive(1.0)
            assert chunk.data == greeting
        if reset:
            there.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        there.close()
        end = time.monotonic() + 1.0
        while link.connected and time.monotonic() < end:
            link.receive(0.02)
    assert "the other end has closed the connection" in link.fault
    assert ("another program may have the line" in link.fault) == (not greeting)
