import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from pymodbus.pdu.register_message import WriteMultipleRegistersRequest

from tests.support.devices.bench import Emulated, running, stepped
from verify.grasping.actuators.gripper.gripper import GripperDriver
from verify.grasping.actuators.gripper.modbus import GripperSettings, fault_text, parse_inputs
from verify.grasping.actuators.gripper.reader import GripperReader
from verify.grasping.actuators.protocols import (
    ExecutePermission,
    GripMode,
    GripperState,
    GripperStatus,
    MotionRefusedError,
)
from verify.simulation.emulators.gripper import GripperEngine, GripperOptions
from verify.simulation.emulators.hand import NO_CONTACT, contact_positions
from verify.simulation.emulators.server import EmulatorFaults, TimedMessage

PORTS = ["tcp:0", "pty"]
RIGHT = ExecutePermission("--execute, in a test")
OPEN_MM = 150.7  # the emulated software limit: position 7 of 255


def quick(contacts: np.ndarray | None = None) -> GripperEngine:
    return GripperEngine(GripperOptions(activation=0.2, contacts=contacts))


@contextmanager
def driver(emulated: Emulated | str, **settings: object) -> Iterator[GripperDriver]:
    address = emulated if isinstance(emulated, str) else emulated.address
    chosen = GripperSettings(address, **({"speed": 255} | settings))  # type: ignore[arg-type]
    found = GripperDriver(chosen, RIGHT)
    try:
        yield found
    finally:
        found.close()


def settled(gripper: GripperDriver, *states: GripperState) -> GripperStatus:
    """Step until a state is reached that nothing but an order or a mishap ends."""
    under_way = {
        GripperState.ACTIVATING, GripperState.RESETTING, GripperState.CHANGING_MODE,
        GripperState.MOVING, GripperState.STOPPING,
    }  # fmt: skip
    status = stepped(gripper, lambda status: status.state not in under_way)[-1]
    assert status.state in states, status
    return status


def ready(gripper: GripperDriver) -> None:
    gripper.activate()
    settled(gripper, GripperState.READY)


@pytest.mark.parametrize("where", PORTS)
@pytest.mark.parametrize(
    ("width_mm", "state"), [(None, GripperState.REACHED), (115.0, GripperState.GRIPPED)]
)
def test_the_gripper_reports_whether_it_holds_an_object(
    where: str, width_mm: float | None, state: GripperState
) -> None:
    engine = quick(None if width_mm is None else contact_positions(width_mm))
    with running(engine, where) as emulated, driver(emulated) as gripper:
        ready(gripper)
        gripper.close_to(0.1)
        status = settled(gripper, state)
        assert status.opening is not None
        assert status.opening == pytest.approx((width_mm or 100.0) * 1e-3, abs=3.1e-4)
        assert status.contacts == (0 if width_mm is None else 3)
        gripper.open_to(0.155)
        status = settled(gripper, GripperState.REACHED)
        assert status.opening == pytest.approx(OPEN_MM * 1e-3, abs=1e-3)
        assert status.reason == ""


@pytest.mark.realtime
@pytest.mark.parametrize("where", PORTS)
def test_the_reader_reads_and_can_send_nothing_else(where: str) -> None:
    engine = quick()
    with running(engine, where) as emulated:
        reader = GripperReader(GripperSettings(emulated.address))
        stepped(reader, lambda status: status.opening is not None)
        seen = stepped(reader, lambda _: len(engine.log) > 20)
        assert {status.state for status in seen} == {GripperState.IDLE}
        assert not any(hasattr(reader, name) for name in ("activate", "close_to", "stop"))
        with pytest.raises(ValueError, match="may not send function 16"):
            reader._line.ask(WriteMultipleRegistersRequest(address=1000, registers=[0x0100]))
        reader.close()
    assert {request[0] for request in engine.log} == {3}


def test_without_the_operators_right_there_is_no_driver() -> None:
    for right in (None, "--execute", True):
        with pytest.raises(TypeError, match="operator's right"):
            GripperDriver(GripperSettings("/dev/none"), right)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="without words"):
        ExecutePermission(" ")


@pytest.mark.realtime
def test_nothing_moves_before_an_order_nor_when_it_is_closed() -> None:
    engine = quick()
    with running(engine) as emulated:
        with driver(emulated) as gripper:
            stepped(gripper, lambda _: len(engine.log) > 10)
        time.sleep(0.05)
    assert {request[0] for request in engine.log} == {3}


@pytest.mark.realtime
def test_a_reading_each_step_of_a_loop_at_60_hz() -> None:
    with running(quick()) as emulated, driver(emulated) as gripper:
        stepped(gripper, lambda status: status.t is not None)
        seen = stepped(gripper, after(1.0))
        times = {status.t for status in seen}
        assert len(times) > 0.7 * len(seen)


def after(seconds: float) -> Callable[[GripperStatus], bool]:
    end = time.monotonic() + seconds
    return lambda _: time.monotonic() > end


@pytest.mark.realtime
def test_orders_that_are_not_possible_are_refused_and_send_nothing() -> None:
    engine = quick()
    with running(engine) as emulated, driver(emulated) as gripper:
        stepped(gripper, lambda status: status.t is not None)
        for order in (lambda: gripper.close_to(0.0), lambda: gripper.set_mode(GripMode.PINCH)):
            with pytest.raises(MotionRefusedError, match="now, it is idle"):
                order()
        ready(gripper)
        for opening in (-0.001, 0.2, float("nan")):
            with pytest.raises(MotionRefusedError, match="not within its 0 to 155 mm"):
                gripper.open_to(opening)
        gripper.close_to(0.0)
        with pytest.raises(MotionRefusedError, match="it is moving"):
            gripper.open_to(0.1)
        settled(gripper, GripperState.REACHED)
    writes = [request for request in engine.log if request[0] == 16]
    assert len(writes) == 3  # activate, close, and the stop at the end
    assert all(write[6] & 1 for write in writes)  # each keeps the activation


@pytest.mark.realtime
def test_every_mode_is_taken_and_kept() -> None:
    engine = quick(np.array([20.0, 20.0, 20.0, 160.0]))
    with running(engine) as emulated, driver(emulated) as gripper:
        ready(gripper)
        for number, mode, contacts in [(1, GripMode.PINCH, 3), (3, GripMode.SCISSOR, 1)]:
            gripper.set_mode(mode)
            settled(gripper, GripperState.READY)
            gripper.close_to(0.0)
            assert settled(gripper, GripperState.GRIPPED).contacts == contacts
            assert engine.hand.inputs()[0] >> 1 & 3 == number


@pytest.mark.realtime
def test_one_finger_alone_is_not_called_a_grip() -> None:
    with (
        running(quick(np.array([100.0, np.inf, np.inf, np.inf]))) as emulated,
        driver(emulated) as gripper,
    ):
        ready(gripper)
        gripper.close_to(0.0)
        status = settled(gripper, GripperState.UNSURE)
        assert "something stopped 1 of 3 fingers" in status.reason
        assert status.contacts == 1


@pytest.mark.realtime
def test_what_falls_out_is_noticed() -> None:
    engine = quick(contact_positions(60.0))
    with running(engine) as emulated, driver(emulated) as gripper:
        ready(gripper)
        gripper.close_to(0.0)
        settled(gripper, GripperState.GRIPPED)
        engine.hand.contacts = NO_CONTACT
        status = stepped(gripper, lambda status: status.state is GripperState.LOST)[-1]
        assert "what was gripped is gone" in status.reason


@pytest.mark.realtime
def test_closing_twice_to_one_position_waits_for_the_new_status() -> None:
    engine = quick(contact_positions(60.0))
    with running(engine) as emulated, driver(emulated) as gripper:
        ready(gripper)
        gripper.close_to(0.0)
        settled(gripper, GripperState.GRIPPED)
        engine.hand.contacts = NO_CONTACT
        gripper.close_to(0.0)
        assert settled(gripper, GripperState.REACHED).contacts == 0


@pytest.mark.realtime
def test_stop_stops_the_fingers_and_keeps_the_activation() -> None:
    engine = quick()
    with running(engine) as emulated, driver(emulated) as gripper:
        ready(gripper)
        gripper.close_to(0.0)
        stepped(gripper, lambda status: status.opening is not None and status.opening < 0.12)
        gripper.stop()
        status = settled(gripper, GripperState.READY)
        assert status.opening is not None
        assert status.opening > 0.05
        at = engine.hand.position[0]
        stepped(gripper, after(0.2))
        assert engine.hand.position[0] == at
        gripper.open_to(0.155)
        settled(gripper, GripperState.REACHED)


@pytest.mark.realtime
def test_stop_and_the_end_let_go_of_nothing() -> None:
    engine = quick(contact_positions(120.0))
    with running(engine) as emulated:
        with driver(emulated) as gripper:
            ready(gripper)
            gripper.close_to(0.0)
            settled(gripper, GripperState.GRIPPED)
            gripper.stop()
            assert gripper.step().state is GripperState.GRIPPED
        assert engine.hand.outputs[0] == 0x09


@pytest.mark.realtime
@pytest.mark.parametrize("cycle", [0.005, 0.1])
def test_stop_ends_an_activation_by_a_reset(cycle: float) -> None:
    """However long the gripper takes to take an order up: until then its inputs are older."""
    engine = GripperEngine(GripperOptions(activation=5.0, cycle=cycle))
    with running(engine) as emulated, driver(emulated) as gripper:
        gripper.activate()
        stepped(gripper, lambda _: engine.hand.stage == 1)
        gripper.stop()
        settled(gripper, GripperState.IDLE)
        assert engine.hand.stage == 0


@pytest.mark.realtime
@pytest.mark.parametrize("number", [0x09, 0x0E])
def test_a_fault_in_mid_motion_stops_the_fingers_and_is_named(number: int) -> None:
    engine = quick()
    with running(engine) as emulated, driver(emulated) as gripper:
        ready(gripper)
        gripper.close_to(0.0)
        stepped(gripper, lambda status: status.opening is not None and status.opening < 0.12)
        engine.afflict("alarm", number)
        status = settled(gripper, GripperState.FAILED)
        assert fault_text(number) in status.reason
        stepped(gripper, lambda _: engine.hand.outputs[0] == 0x01)  # active, and no more going
        with pytest.raises(MotionRefusedError, match="it is failed"):
            gripper.close_to(0.0)
        gripper.activate()
        assert fault_text(number) in settled(gripper, GripperState.FAILED).reason
        gripper.activate(reset=True)
        settled(gripper, GripperState.READY)
        assert gripper.step().reason == ""


@pytest.mark.realtime
def test_a_gripper_after_power_loss_is_not_activated_by_itself() -> None:
    engine = quick(contact_positions(60.0))
    with running(engine) as emulated, driver(emulated) as gripper:
        ready(gripper)
        gripper.close_to(0.0)
        settled(gripper, GripperState.GRIPPED)
        engine.reset(time.monotonic() - emulated.start)
        status = settled_after_mishap(gripper)
        assert "lost its activation" in status.reason
        gripper.stop()
        stepped(gripper, after(0.3))
        assert engine.hand.stage == 0


def settled_after_mishap(gripper: GripperDriver) -> GripperStatus:
    return stepped(gripper, lambda status: status.state is GripperState.FAILED)[-1]


@pytest.mark.realtime
def test_silence_is_reported_keeps_the_grip_and_needs_a_new_order() -> None:
    engine = quick(contact_positions(60.0))
    with (
        running(engine, faults=EmulatorFaults(silence=(1.3, 1.0))) as emulated,
        driver(emulated) as gripper,
    ):
        ready(gripper)
        gripper.close_to(0.0)
        settled(gripper, GripperState.GRIPPED)
        status = settled_after_mishap(gripper)
        assert "slave 9 is silent" in status.reason
        assert status.age is not None
        assert status.age > 0.5
        stepped(gripper, lambda status: status.age is not None and status.age < 0.1)
        assert gripper.step().state is GripperState.FAILED
        assert engine.hand.outputs[0] == 0x09  # nobody let go
        gripper.stop()
        settled(gripper, GripperState.READY)


@pytest.mark.realtime
@pytest.mark.parametrize("kind", ["tcp", "pty"])
def test_a_cable_that_is_pulled_in_mid_motion_stops_the_fingers_once_it_is_back(
    kind: str, tmp_path: Path
) -> None:
    where = "tcp:0" if kind == "tcp" else f"pty:{tmp_path / 'port'}"
    engine, faults = quick(), EmulatorFaults(unplug=(1.0, 0.6))
    with running(engine, where, faults) as emulated, driver(emulated, speed=0) as gripper:
        ready(gripper)
        gripper.close_to(0.0)
        status = settled(gripper, GripperState.FAILED)
        assert "not connected" in status.reason
        stepped(gripper, lambda _: engine.hand.outputs[0] == 0x01)
        assert 20 < engine.hand.position[0] < 250


@pytest.mark.realtime
def test_a_gripper_that_lost_its_power_while_the_cable_was_out_is_left_alone() -> None:
    """A stop carries the activation bit: it would activate it, and every finger would move."""
    engine, faults = quick(), EmulatorFaults(unplug=(1.0, 0.6), reset=(1.3, 1.3))
    with running(engine, faults=faults) as emulated:
        with driver(emulated, speed=0) as gripper:
            ready(gripper)
            gripper.close_to(0.0)
            settled(gripper, GripperState.FAILED)
            stepped(gripper, lambda status: status.age is not None and status.age < 0.1)
            stepped(gripper, after(0.5))
            gripper.stop()
            stepped(gripper, after(0.2))
        assert engine.hand.outputs == bytes(16)


@pytest.mark.realtime
def test_a_disturbed_line_delays_orders_without_false_status() -> None:
    faults = EmulatorFaults(noise=0.1, half=0.1, lost=0.1, double=0.1)
    engine = quick(contact_positions(120.0))
    with running(engine, "pty", faults) as emulated, driver(emulated, tries=8) as gripper:
        ready(gripper)
        for _ in range(4):
            gripper.close_to(0.0)
            settled(gripper, GripperState.GRIPPED)
            gripper.open_to(0.14)
            settled(gripper, GripperState.REACHED)
        assert gripper._line.bad["request without an answer"] > 3


@pytest.mark.realtime
def test_an_activation_that_never_ends_has_a_limit() -> None:
    engine = GripperEngine(GripperOptions(activation=60.0))
    with running(engine) as emulated, driver(emulated, activation_limit=0.5) as gripper:
        gripper.activate()
        status = settled(gripper, GripperState.FAILED)
        assert "activating takes too long" in status.reason
        stepped(gripper, lambda _: engine.hand.stage == 0)


@pytest.mark.realtime
def test_a_motion_that_never_ends_has_a_limit_and_is_stopped() -> None:
    class Stuck(GripperEngine):
        def step(self, t: float, received: bytes) -> list[TimedMessage]:
            self.hand.position[:3] = np.minimum(self.hand.position[:3], 40.0)
            return super().step(t, received)

    engine = Stuck(GripperOptions(activation=0.2))
    with running(engine) as emulated, driver(emulated, move_limit=0.6) as gripper:
        ready(gripper)
        gripper.close_to(0.0)
        assert "moving takes too long" in settled(gripper, GripperState.FAILED).reason
        stepped(gripper, lambda _: engine.hand.outputs[0] == 0x01)


@pytest.mark.realtime
def test_a_missing_device_is_reported_without_blocking() -> None:
    with socket.create_server(("127.0.0.1", 0)) as unused:
        port = unused.getsockname()[1]
    with driver(f"tcp:127.0.0.1:{port}", activation_limit=0.5) as gripper:
        gripper.activate()
        assert "nobody listens there" in settled(gripper, GripperState.FAILED).reason


@pytest.mark.realtime
def test_a_2014_gripper_is_distinguished_from_a_refusing_one() -> None:
    class Deaf(GripperEngine):
        """Knows no register 2000."""

        def _read(self, span: bytes) -> bytes:
            return super()._read(b"\x00\x00" + span[2:])

    for exceptions, words in [(True, "no such register"), (False, "is silent")]:
        engine = Deaf(GripperOptions(exceptions=exceptions))
        with running(engine) as emulated, driver(emulated) as gripper:
            stepped(gripper, lambda status, words=words: words in status.reason)  # type: ignore[misc]


def test_recorded_inputs_are_read_as_in_the_manual() -> None:
    gripped = parse_inputs([0xB9EA, 0x00FF, 0xBC00, 0x00C1, 0x0000, 0xBD00, 0x0089, 0x0000])
    assert gripped is not None
    assert (gripped.active, gripped.go, gripped.activation, gripped.fault) == (True, True, 3, 0)
    assert (gripped.mode, gripped.moving, gripped.contacts) == (GripMode.BASIC, False, 3)
    assert (gripped.echo, gripped.position) == (0xFF, 0xBC)
    moving = parse_inputs([0x39C0, 0x00FF, 0x080F, 0x0008, 0x1000, 0x080F, 0x0089, 0x0000])
    assert moving is not None
    assert moving.moving
    assert moving.contacts == 0
    assert parse_inputs([0x39C0]) is None
