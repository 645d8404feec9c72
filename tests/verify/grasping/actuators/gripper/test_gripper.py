import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from tests.support.devices.bench import Emulated, for_seconds, running, stepped
from verify.grasping.actuators.gripper.gripper import GripperDriver
from verify.grasping.actuators.gripper.modbus import (
    GripMode,
    GripperSettings,
    fault_text,
    parse_inputs,
)
from verify.grasping.actuators.protocols import (
    ExecutePermission,
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
    under_way = {GripperState.ACTIVATING, GripperState.MOVING, GripperState.STOPPING}
    status = stepped(gripper, lambda status: status.state not in under_way)[-1]
    assert status.state in states, status
    return status


def ready(gripper: GripperDriver) -> None:
    gripper.activate()
    settled(gripper, GripperState.READY)


@contextmanager
def closing(
    engine: GripperEngine,
    where: str = "tcp:0",
    faults: EmulatorFaults | None = None,
    **settings: object,
) -> Iterator[GripperDriver]:
    """A gripper that was made ready and has begun to close."""
    with running(engine, where, faults) as emulated, driver(emulated, **settings) as gripper:
        ready(gripper)
        gripper.go_to(0.0, closing=True)
        yield gripper


def fresh(status: GripperStatus) -> bool:
    return status.t is not None and time.monotonic() - status.t < 0.1


def half_closed(status: GripperStatus) -> bool:
    return status.opening is not None and status.opening < 0.12


@pytest.mark.parametrize("where", PORTS)
@pytest.mark.parametrize(
    ("contacts", "state", "width_mm"),
    [
        (NO_CONTACT, GripperState.REACHED, 100.0),
        (contact_positions(115.0), GripperState.GRIPPED, 115.0),
        (np.array([60.0, np.inf, np.inf, np.inf]), GripperState.UNSURE, 118.5),
    ],
    ids=["nothing", "an object", "one finger alone"],
)
def test_the_gripper_reports_whether_it_holds_an_object(
    where: str, contacts: np.ndarray, state: GripperState, width_mm: float
) -> None:
    engine = quick(contacts)
    with running(engine, where) as emulated, driver(emulated) as gripper:
        ready(gripper)
        gripper.go_to(0.1, closing=True)
        status = settled(gripper, state)
        assert ("stopped 1 of 3 fingers" in status.reason) == (state is GripperState.UNSURE)
        assert status.opening == pytest.approx(width_mm * 1e-3, abs=3.1e-4)
        if state is GripperState.GRIPPED:  # a stop lets go of nothing
            gripper.stop()
            assert gripper.step().state is GripperState.GRIPPED
            assert engine.hand.outputs[0] == 0x09
        gripper.go_to(0.155, closing=False)
        status = settled(gripper, GripperState.REACHED)
        assert status.opening == pytest.approx(OPEN_MM * 1e-3, abs=1e-3)
        assert status.reason == ""


def test_without_the_operators_right_there_is_no_driver() -> None:
    for right in (None, "--execute", True):
        with pytest.raises(TypeError, match="operator's permission"):
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
def test_orders_that_are_not_possible_are_refused_and_send_nothing() -> None:
    engine = quick()
    with running(engine) as emulated, driver(emulated) as gripper:
        stepped(gripper, lambda status: status.t is not None)
        with pytest.raises(MotionRefusedError, match="now, it is idle"):
            gripper.go_to(0.0, closing=True)
        ready(gripper)
        for opening in (-0.001, 0.2, float("nan")):
            with pytest.raises(MotionRefusedError, match="not within its 0 to 155 mm"):
                gripper.go_to(opening, closing=False)
        gripper.go_to(0.0, closing=True)
        with pytest.raises(MotionRefusedError, match="it is moving"):
            gripper.go_to(0.1, closing=False)
        settled(gripper, GripperState.REACHED)
    writes = [request for request in engine.log if request[0] == 16]
    assert len(writes) == 3  # activate, close, and the stop at the end
    assert all(write[6] & 1 for write in writes)  # each keeps the activation


@pytest.mark.realtime
@pytest.mark.parametrize("again", [False, True], ids=["kept closed", "closed to the same again"])
def test_what_falls_out_is_noticed(again: bool) -> None:
    engine = quick(contact_positions(60.0))
    with closing(engine) as gripper:
        settled(gripper, GripperState.GRIPPED)
        engine.hand.contacts = NO_CONTACT
        if again:
            gripper.go_to(0.0, closing=True)
            settled(gripper, GripperState.REACHED)
        else:
            status = stepped(gripper, lambda status: status.state is GripperState.LOST)[-1]
            assert "the gripped object is lost" in status.reason


@pytest.mark.realtime
def test_stop_stops_the_fingers_and_keeps_the_activation() -> None:
    engine = quick()
    with closing(engine) as gripper:
        stepped(gripper, half_closed)
        gripper.stop()
        status = settled(gripper, GripperState.READY)
        assert status.opening > 0.05
        at = engine.hand.position[0]
        stepped(gripper, for_seconds(0.2))
        assert engine.hand.position[0] == at
        gripper.go_to(0.155, closing=False)
        settled(gripper, GripperState.REACHED)


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
    with closing(engine) as gripper:
        stepped(gripper, half_closed)
        engine.afflict("alarm", number)
        assert fault_text(number) in settled(gripper, GripperState.FAILED).reason
        stepped(gripper, lambda _: engine.hand.outputs[0] == 0x01)  # active, and no more going
        with pytest.raises(MotionRefusedError, match="it is failed"):
            gripper.go_to(0.0, closing=True)
        gripper.activate()
        assert fault_text(number) in settled(gripper, GripperState.FAILED).reason


@pytest.mark.realtime
def test_a_gripper_after_power_loss_is_not_activated_by_itself() -> None:
    engine = quick()
    with running(engine) as emulated, driver(emulated) as gripper:
        ready(gripper)
        engine.reset(time.monotonic() - emulated.start)
        status = stepped(gripper, lambda status: status.state is GripperState.FAILED)[-1]
        assert "lost its activation" in status.reason
        gripper.stop()
        stepped(gripper, for_seconds(0.3))
        assert engine.hand.stage == 0


@pytest.mark.realtime
def test_silence_is_reported_keeps_the_grip_and_needs_a_new_order() -> None:
    engine = quick(contact_positions(60.0))
    with closing(engine, faults=EmulatorFaults(silence=(1.3, 1.0))) as gripper:
        settled(gripper, GripperState.GRIPPED)
        status = stepped(gripper, lambda status: status.state is GripperState.FAILED)[-1]
        assert "slave 9 is silent" in status.reason
        assert time.monotonic() - status.t > 0.5
        stepped(gripper, fresh)
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
    engine = quick()
    with closing(engine, where, EmulatorFaults(unplug=(1.0, 0.6)), speed=0) as gripper:
        assert "not connected" in settled(gripper, GripperState.FAILED).reason
        stepped(gripper, lambda _: engine.hand.outputs[0] == 0x01)
        assert 20 < engine.hand.position[0] < 250


@pytest.mark.realtime
def test_a_gripper_that_lost_its_power_while_the_cable_was_out_is_left_alone() -> None:
    """A stop carries the activation bit: it would activate it, and every finger would move."""
    engine, faults = quick(), EmulatorFaults(unplug=(1.0, 0.6), reset=(1.3, 1.3))
    with closing(engine, faults=faults, speed=0) as gripper:
        settled(gripper, GripperState.FAILED)
        stepped(gripper, fresh)
        stepped(gripper, for_seconds(0.5))
        gripper.stop()
        stepped(gripper, for_seconds(0.2))
    assert engine.hand.outputs == bytes(16)


@pytest.mark.realtime
def test_a_disturbed_line_delays_orders_without_false_status() -> None:
    faults = EmulatorFaults(noise=0.1, half=0.1, lost=0.1, double=0.1)
    with closing(quick(contact_positions(120.0)), "pty", faults, tries=8) as gripper:
        for _ in range(4):
            settled(gripper, GripperState.GRIPPED)
            gripper.go_to(0.14, closing=False)
            settled(gripper, GripperState.REACHED)
            gripper.go_to(0.0, closing=True)
        assert gripper._line.bad["request without an answer"] > 3


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
    assert (gripped.active, gripped.go, gripped.activation, gripped.fault) == (True, True, 3, 0)
    assert (gripped.mode, gripped.moving, gripped.contacts) == (GripMode.BASIC, False, 3)
    assert (gripped.echo, gripped.position) == (0xFF, 0xBC)
    moving = parse_inputs([0x39C0, 0x00FF, 0x080F, 0x0008, 0x1000, 0x080F, 0x0089, 0x0000])
    assert moving.moving
    assert moving.contacts == 0
    assert parse_inputs([0x39C0]) is None


class Stuck(GripperEngine):
    """Neither ends its activation nor closes."""

    def step(self, t: float, received: bytes) -> list[TimedMessage]:
        self.hand.position[:3] = np.minimum(self.hand.position[:3], 40.0)
        return super().step(t, received)


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("activation", "words"), [(60.0, "activating takes too long"), (0.2, "moving takes too long")]
)
def test_what_never_ends_has_a_limit_and_is_stopped(activation: float, words: str) -> None:
    engine = Stuck(GripperOptions(activation=activation))
    limits = {"activation_limit": 0.5, "move_limit": 0.6}
    with running(engine) as emulated, driver(emulated, **limits) as gripper:
        gripper.activate()
        if activation < limits["activation_limit"]:
            settled(gripper, GripperState.READY)
            gripper.go_to(0.0, closing=True)
        assert words in settled(gripper, GripperState.FAILED).reason
        stepped(gripper, lambda _: engine.hand.outputs[0] == (0x01 if activation < 1 else 0))
