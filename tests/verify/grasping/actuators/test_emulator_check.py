"""Only an emulator of this program is taken for one; whatever else answers, or does not, is not."""

from collections.abc import Callable
from functools import partial

import pytest

from tests.support.devices.bench import running
from tests.support.devices.melfa_mover import LIMITS
from verify.devices.melfa.protocol import READ_COMMANDS
from verify.devices.ports import DEFAULT_LINE, Port, open_port
from verify.grasping.actuators import emulator_check
from verify.grasping.actuators.emulator_check import (
    EmulatorPortOpener,
    is_emulated_gripper,
    is_emulated_melfa,
)
from verify.simulation.emulators import trajectory
from verify.simulation.emulators.arm import MelfaArm
from verify.simulation.emulators.gripper import GripperEngine, GripperOptions
from verify.simulation.emulators.melfa import ControllerOptions, MelfaEngine
from verify.simulation.emulators.server import TimedMessage

pytestmark = pytest.mark.realtime

PORTS = ["tcp:0", "pty"]
REAL = "3F;3F;7,0;3,5,A,1E,32,46,64;MB4;PRM;RV-3SB;CRn-5xx;MELFA;05-07-14;Ver.K4a;ENG;;1;1;8;"


@pytest.fixture(autouse=True)
def nobody_waits_long(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(emulator_check, "TIMEOUT", 0.4)


class RealMelfa(MelfaEngine):
    """Answers as the trace of a maker's controller does."""

    identity = REAL

    def _identity(self, client: str) -> str:  # noqa: ARG002
        return self.identity


class Replayed(RealMelfa):
    """Answers what an emulator said once, to somebody else."""

    identity = MelfaEngine(
        MelfaArm(trajectory.load("hold", 6), LIMITS), ControllerOptions()
    )._identity("verify")


class OldGripper(GripperEngine):
    """Knows no function 43: silent as the grippers of 2014, or with an exception."""

    def _carry_out(self, body: bytes, t: float) -> bytes:
        return super()._carry_out(body if body[0] != 43 else b"\x63" + body[1:], t)


class Echo(MelfaEngine):
    """A line on which everything that is sent comes back."""

    def step(self, t: float, received: bytes) -> list[TimedMessage]:
        return [TimedMessage(t, received)] if received else []


def melfa(kind: type[MelfaEngine] = MelfaEngine) -> MelfaEngine:
    return kind(MelfaArm(trajectory.load("hold", 6), LIMITS), ControllerOptions())


def gripper(kind: type[GripperEngine] = GripperEngine, *, exceptions: bool = True) -> GripperEngine:
    return kind(GripperOptions(exceptions=exceptions))


def opens(address: str) -> Callable[[], Port]:
    return partial(open_port, address, DEFAULT_LINE)


@pytest.mark.parametrize("where", PORTS)
def test_an_emulated_controller_and_gripper_prove_it_again_and_again(where: str) -> None:
    with running(melfa(), where) as arm, running(gripper(), where) as fingers:
        for address, asks in [
            (arm.address, is_emulated_melfa), (fingers.address, is_emulated_gripper),
        ]:  # fmt: skip
            only = EmulatorPortOpener(opens(address), asks)
            assert only.there()
            only().close()


@pytest.mark.parametrize("where", PORTS)
def test_what_answers_as_a_real_device_is_none(where: str) -> None:
    engine = melfa(RealMelfa)
    with running(engine, where) as arm:
        only = EmulatorPortOpener(opens(arm.address), is_emulated_melfa)
        assert not only.there()
        with pytest.raises(OSError, match=r"not an emulator|reset|closed"):
            only()
    assert {order.split("=")[0] for order in engine.log} == {"OPEN", "CLOSE"} <= {*READ_COMMANDS}
    for old in (gripper(OldGripper), gripper(OldGripper, exceptions=False)):
        with running(old, where) as fingers:
            assert not EmulatorPortOpener(opens(fingers.address), is_emulated_gripper).there()


def test_silence_an_echo_a_replay_and_a_gripper_for_a_controller_are_none() -> None:
    for engine, where, checks in [
        (melfa(Echo), "pty", [is_emulated_melfa, is_emulated_gripper]),
        (melfa(Replayed), "tcp:0", [is_emulated_melfa]),
        (gripper(), "tcp:0", [is_emulated_melfa]),
        (melfa(), "tcp:0", [is_emulated_gripper]),
    ]:
        with running(engine, where) as other:
            for asks in checks:
                assert not EmulatorPortOpener(opens(other.address), asks).there()
    assert not EmulatorPortOpener(opens("tcp:127.0.0.1:1"), is_emulated_melfa).there()


def test_a_real_controller_that_takes_the_emulators_place_is_not_opened() -> None:
    with running(melfa()) as arm:
        only = EmulatorPortOpener(opens(arm.address), is_emulated_melfa)
        assert only.there()
        first = only()
        arm.server._engine = melfa(RealMelfa)
        first.close()
        with pytest.raises(OSError, match=r"not an emulator|reset|closed"):
            only()


def test_an_unused_port_is_closed() -> None:
    with running(melfa()) as arm:
        only = EmulatorPortOpener(opens(arm.address), is_emulated_melfa)
        assert only.there()
        only.close()
        assert only._kept is None
