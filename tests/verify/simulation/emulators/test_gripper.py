import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from pymodbus import FramerType
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.client.base import ModbusBaseSyncClient

from tests.support.command import verify
from tests.support.devices.bench import emulate_command, running
from verify.simulation.emulators.gripper import SLAVE, GripperEngine, GripperOptions, add_crc
from verify.simulation.emulators.hand import contact_positions, speed_in_positions

PORTS = ["tcp:0", "pty"]
ACTIVATE = [0x0100, 0, 0]
ACTIVATION = 0.2  # s: tests cannot wait


def frame(text: str) -> bytes:
    return bytes.fromhex(text)


def quick(contacts: object = None) -> GripperEngine:
    return GripperEngine(GripperOptions(ACTIVATION, contacts))  # type: ignore[arg-type]


def reply(engine: GripperEngine, request: str, t: float) -> str:
    """The answer at t, as hexadecimal digits, check included."""
    messages = engine.step(t, frame(request))
    return b"".join(message.data for message in messages).hex(" ").upper()


def write(engine: GripperEngine, registers: str, t: float) -> None:
    """Write registers from the first output on: how many, how many bytes, and these."""
    reply(engine, add_crc(frame(f"09 10 03E8 {registers}")).hex(), t)


def active(contacts: object = None) -> GripperEngine:
    """A gripper that is ready at 0.3 s."""
    engine = quick(contacts)
    write(engine, "0001 02 0100", 0.0)
    passed(engine, 0.0, 0.3)
    return engine


def passed(engine: GripperEngine, begin: float, end: float) -> None:
    """Let time pass as the server does, 1 ms at a time."""
    for t in np.arange(begin, end, 1e-3).tolist():
        engine.step(t, b"")


def test_the_frames_of_the_manual_byte_for_byte() -> None:
    """Sequence of the manual's section 4.7: reset, activate, close onto an object, open."""
    engine = quick(np.array([0xBC, 0xC1, 0xBD, np.inf]))
    reset = "09 10 03E8 0003 06 00 00 00 00 00 00 73 30"
    assert reply(engine, reset, 0.0) == "09 10 03 E8 00 03 01 30"
    assert reply(engine, "09 10 03E8 0003 06 01 00 00 00 00 00 72 E1", 0.1).endswith("01 30")
    assert reply(engine, "09 03 07D0 0001 85 CF", 0.15) == "09 03 02 11 00 55 D5"
    passed(engine, 0.15, 0.4)
    assert reply(engine, "09 03 07D0 0001 85 CF", 0.4) == "09 03 02 31 00 4C 15"
    assert reply(engine, "09 10 03E8 0003 06 09 00 00 FF FF FF 42 29", 0.5).endswith("01 30")
    passed(engine, 0.5, 0.515)
    moving = frame(reply(engine, "09 03 07D0 0008 45 C9", 0.515))
    recorded = frame("09 03 10 39 C0 00 FF 08 0F 00 08 10 00 08 0F 00 89 00 00")
    measured = {7, 8, 10, 11, 13, 14}  # positions and currents: of an instant on the way
    assert len(moving) == len(recorded) + 2
    assert {i for i, byte in enumerate(recorded) if moving[i] != byte} <= measured
    passed(engine, 0.515, 3.0)
    held = "09 03 10 B9 EA 00 FF BC 00 00 C1 00 00 BD 00 00 89 00 00 4E 17"
    assert reply(engine, "09 03 07D0 0008 45 C9", 3.0) == held
    reply(engine, "09 10 03E8 0003 06 09 00 00 00 FF FF 72 19", 3.1)
    passed(engine, 3.1, 6.0)
    opened = "09 03 10 F9 FF 00 00 07 00 00 06 00 00 06 00 00 89 00 00 34 8D"
    assert reply(engine, "09 03 07D0 0008 45 C9", 6.0) == opened
    assert reply(engine, "09 04 07D0 0008 F0 09", 6.1).startswith("09 04 10 F9 FF")


@contextmanager
def client(address: str, timeout: float = 0.3) -> Iterator[ModbusBaseSyncClient]:
    """The client of pymodbus as a user would make it."""
    kind, _, rest = address.partition(":")
    if kind == "tcp":
        host, port = rest.rsplit(":", 1)
        found: ModbusBaseSyncClient = ModbusTcpClient(
            host, port=int(port), framer=FramerType.RTU, timeout=timeout, retries=0
        )
    else:
        found = ModbusSerialClient(address, baudrate=115200, timeout=timeout, retries=0)
    assert found.connect()
    try:
        yield found
    finally:
        found.close()


def inputs(modbus: ModbusBaseSyncClient) -> bytes:
    answer = modbus.read_holding_registers(2000, count=8, device_id=SLAVE)
    assert not answer.isError()
    return b"".join(register.to_bytes(2, "big") for register in answer.registers)


def order(modbus: ModbusBaseSyncClient, registers: list[int]) -> None:
    answer = modbus.write_registers(1000, registers, device_id=SLAVE)
    assert not answer.isError()
    time.sleep(0.01)  # two of the gripper's cycles: the echo


def until(modbus: ModbusBaseSyncClient, satisfied: Callable[[bytes], bool]) -> bytes:
    end = time.monotonic() + 20.0
    while not satisfied(found := inputs(modbus)):
        assert time.monotonic() < end, found.hex(" ")
    return found


def stage(found: bytes) -> int:
    return found[0] >> 4 & 3


def overall(found: bytes) -> int:
    return found[0] >> 6


@pytest.mark.realtime
@pytest.mark.parametrize("where", PORTS)
def test_all_functions_and_exceptions_reach_the_client_of_pymodbus(where: str) -> None:
    with running(quick(), where) as emulated, client(emulated.address) as modbus:
        assert modbus.read_input_registers(2000, count=8, device_id=SLAVE).registers[0] == 0
        assert not modbus.write_register(1000, 0x0100, device_id=SLAVE).isError()
        both = modbus.readwrite_registers(
            read_address=2000, read_count=2, address=1000, values=ACTIVATE, device_id=SLAVE
        )
        assert len(both.registers) == 2
        for answer, code in [
            (modbus.read_holding_registers(2001, count=8, device_id=SLAVE), 2),
            (modbus.read_holding_registers(0, count=1, device_id=SLAVE), 2),
            (modbus.write_registers(2000, [0], device_id=SLAVE), 2),
            (modbus.read_coils(2000, count=1, device_id=SLAVE), 1),
            (modbus.mask_write_register(address=1000, device_id=SLAVE), 1),
        ]:
            assert answer.isError()
            assert answer.exception_code == code


def test_another_slave_a_wrong_check_and_half_a_request_get_no_answer() -> None:
    engine = quick()
    assert reply(engine, add_crc(frame("08 03 07D0 0001")).hex(), 0.0) == ""
    assert reply(engine, "09 03 07D0 0001 85 CE", 0.1) == ""
    passed(engine, 0.1, 0.12)
    assert reply(engine, "09 03 07D0", 0.2) == ""
    passed(engine, 0.2, 0.22)
    assert engine.dropped == {"other slave": 1, "wrong check, or cut short": 2}
    assert engine.log == []
    assert reply(engine, "09 03 07D0 0001 85 CF", 0.3) != ""


def test_actions_that_come_too_early_are_faults() -> None:
    engine = quick()
    write(engine, "0001 02 0800", 0.0)
    passed(engine, 0.0, 0.05)
    assert engine.hand.inputs()[2] == 7  # not activated
    write(engine, "0001 02 0900", 0.1)
    passed(engine, 0.1, 0.15)
    assert engine.hand.inputs()[2] == 5  # waits for the activation
    passed(engine, 0.15, 0.4)
    assert engine.hand.inputs()[2] == 0
    write(engine, "0001 02 0B00", 0.4)  # pinch mode, and go
    passed(engine, 0.4, 0.45)
    found = engine.hand.inputs()
    assert (found[0] >> 1 & 3, stage(found), found[2]) == (1, 2, 6)
    passed(engine, 0.45, 2.0)
    found = engine.hand.inputs()
    assert (stage(found), found[2]) == (3, 0)


def test_automatic_release_opens_slowly_and_ends_in_a_fault_that_a_reset_clears() -> None:
    engine = active()
    write(engine, "0003 06 0900 00FF FFFF", 0.3)
    passed(engine, 0.3, 1.3)
    write(engine, "0001 02 1100", 1.3)
    passed(engine, 1.3, 1.4)
    assert engine.hand.inputs()[2] == 0x0B
    passed(engine, 1.4, 10.0)
    assert engine.hand.inputs()[2] == 0x0F
    assert engine.hand.inputs()[4] == 7
    write(engine, "0001 02 0000", 10.0)
    passed(engine, 10.0, 10.1)
    assert engine.hand.inputs()[2] == 0


@pytest.mark.parametrize("speed", [0, 255])
def test_fingers_move_at_the_speed_that_is_ordered(speed: int) -> None:
    engine = active()
    write(engine, f"0003 06 0900 00FF {speed:02X}00", 0.3)
    passed(engine, 0.3, 0.805)
    mm_s = 110 if speed else 22  # the range of the maker's driver
    assert engine.hand.position[0] == pytest.approx(7 + 0.5 * mm_s * 255 / 155, abs=1.0)
    assert speed_in_positions(speed) == pytest.approx(mm_s * 255 / 155)


def test_in_scissor_mode_the_scissor_axis_moves_and_the_fingers_do_not() -> None:
    engine = quick(contact_positions(40.0))
    write(engine, "0001 02 0700", 0.0)
    passed(engine, 0.0, 0.3)
    write(engine, "0003 06 0F00 00FF FF00", 0.3)
    passed(engine, 0.3, 3.0)
    found = engine.hand.inputs()
    assert found[0] >> 1 & 3 == 3
    assert (found[4], found[13]) == (7, round(255 * (1 - 40 / 155)))
    assert (overall(found), found[1]) == (2, 0b10_11_11_11)


@pytest.mark.realtime
def test_the_command_serves_an_object_between_the_fingers_and_refuses_one_elsewhere() -> None:
    emulated = emulate_command("gripper", "--port", "tcp:0", "--object-mm", "60")
    with emulated as address, client(address) as modbus:
        order(modbus, ACTIVATE)
        assert stage(inputs(modbus)) == 1
        until(modbus, lambda found: stage(found) == 3)
        order(modbus, [0x0900, 0x00FF, 0xFFFF])
        found = until(modbus, lambda found: overall(found) != 0)
        assert (overall(found), found[1] & 0x3F) == (2, 0b10_10_10)
        assert [found[4], found[7], found[10]] == [round(255 * (1 - 60 / 155))] * 3
    assert "melfa has no fingers" in verify("emulate", "melfa", "--object-mm", "60").err
