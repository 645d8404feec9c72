import threading
from collections import deque

import pytest
from pymodbus.pdu.register_message import ReadHoldingRegistersRequest, WriteMultipleRegistersRequest

from verify.devices.ports import Port
from verify.grasping.actuators.gripper.modbus import MAX_BUFFER_BYTES, GripperSettings, ModbusLine
from verify.grasping.actuators.protocols import BackgroundOpener

# frames of the manual, section 4.7
READ = bytes.fromhex("09 03 07D0 0001 85 CF")
READY = bytes.fromhex("09 03 02 31 00 4C 15")
WRITTEN = bytes.fromhex("09 10 03E8 0003 01 30")


class Scripted:
    """A port whose other end says what a test gives it."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.to_come: deque[bytes] = deque()

    def wait(self, _seconds: float) -> bool:
        return bool(self.to_come)

    def take(self) -> bytes:
        return self.to_come.popleft()

    def send(self, data: bytes) -> None:
        self.sent.append(data)

    def close(self) -> None:
        pass


class Clock:
    def __init__(self) -> None:
        self.t = 100.0

    def __call__(self) -> float:
        return self.t


REQUEST = ReadHoldingRegistersRequest(address=2000, count=1)


def asked() -> tuple[Scripted, Clock, ModbusLine]:
    port, clock = Scripted(), Clock()
    made = ModbusLine(GripperSettings("scripted"), lambda: port, frozenset({3}), clock)
    while not made.free:  # the port is opened in a thread
        made.step()
        clock.t += 0.3
    with pytest.raises(ValueError, match="may not send function 16"):  # a line for reading
        made.ask(WriteMultipleRegistersRequest(address=1000, registers=[0x0100]))
    made.ask(REQUEST)
    assert port.sent == [READ]
    return port, clock, made


def test_an_answer_in_pieces_behind_noise_is_understood() -> None:
    port, _, made = asked()
    for piece in (b"\xff", READY[:3]):
        port.to_come.append(piece)
        assert made.step() is None
    port.to_come.append(READY[3:])
    answer = made.step()
    assert answer.registers == [0x3100]


@pytest.mark.parametrize(
    "wrong",
    [
        READY[:-1] + b"\x16",  # check
        b"\x08" + READY[1:],  # slave, and so the check
        WRITTEN,  # to another function
        b"\x00" * MAX_BUFFER_BYTES * 3,
    ],
)
def test_an_invalid_answer_is_skipped_and_the_request_repeated(wrong: bytes) -> None:
    port, clock, made = asked()
    port.to_come.append(wrong)
    assert made.step() is None
    clock.t += 0.21
    assert made.step() is None
    assert port.sent == [READ, READ]
    port.to_come.append(READY)
    assert made.step() is not None


@pytest.mark.realtime
def test_a_port_that_opens_too_late_is_closed_again() -> None:
    closed, may_open = threading.Event(), threading.Event()

    class Late:
        close = closed.set

    def opening() -> Port:
        may_open.wait(5.0)
        return Late()  # type: ignore[return-value]

    slow = BackgroundOpener(opening)
    with pytest.raises(OSError, match="being opened"):
        slow()
    slow.close()
    may_open.set()
    assert closed.wait(5.0)
