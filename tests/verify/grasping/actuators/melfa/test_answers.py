import socket
from pathlib import Path

import pytest

from tests.support.devices.bench import for_seconds, running
from tests.support.devices.melfa_mover import (
    NEXT,
    PORTS,
    controller,
    failure,
    given_back,
    mover,
    moving,
    names,
    ready,
    settled,
    stepped,
    under_way,
)
from verify.grasping.actuators.protocols import MoverState
from verify.simulation.emulators.melfa import ControllerOptions, MelfaEngine
from verify.simulation.emulators.server import EmulatorFaults, TimedMessage

pytestmark = pytest.mark.realtime


@pytest.mark.parametrize("where", PORTS)
@pytest.mark.parametrize(
    ("number", "words"),
    [
        (50, "alarm 50: emergency stop: external"),
        (2140, "alarm 2140: outside a joint limit"),
        (999, "alarm 999: NO MESSAGE"),
    ],
)
def test_an_alarm_in_mid_move_stops_releases_and_is_reported(
    where: str, number: int, words: str
) -> None:
    engine = controller()
    with moving(engine, where) as arm:
        under_way(arm, NEXT)
        engine.afflict("alarm", number)
        assert words in failure(arm)
        assert given_back(engine)
        arm.take_controls()
        refused = settled(arm, MoverState.FAILED)[-1].reason
        assert "clear it at the controller" in refused or "emergency" in refused
    assert "RSTALRM" not in engine.log
    assert names(engine).count("CNTLON") == 1


def test_permanent_silence_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("verify.grasping.actuators.melfa.states.RELEASE_TIMEOUT", 1.0)
    silent = EmulatorFaults(silence=(0.8, 60.0))
    with moving(controller(), faults=silent, timeout=0.3) as arm:
        arm.move(NEXT)
        reason = failure(arm)
        assert "the controller did not answer: stop, servo off, override put back" in reason
        assert "emergency stop" in reason


@pytest.mark.parametrize("kind", ["tcp", "pty"])
def test_a_line_that_breaks_in_mid_move_is_taken_up_again_to_stop(
    kind: str, tmp_path: Path
) -> None:
    where = "tcp:0" if kind == "tcp" else f"pty:{tmp_path / 'port'}"
    engine = controller()
    with moving(engine, where, EmulatorFaults(unplug=(0.8, 0.6))) as arm:
        arm.move(NEXT)
        failure(arm)
        assert given_back(engine)


@pytest.mark.parametrize("where", PORTS)
def test_late_answers_are_not_mistaken_for_others(where: str) -> None:
    class Dawdling(MelfaEngine):
        """Its twentieth answer comes long after the driver has given up."""

        def step(self, t: float, received: bytes) -> list[TimedMessage]:
            late = 0.5 if len(self.log) == 20 else 0.0
            return [
                TimedMessage(found.at + late, found.data) for found in super().step(t, received)
            ]

    engine = Dawdling(controller().arm, ControllerOptions())
    with moving(engine, where, timeout=0.2) as arm:
        reason = failure(arm)
        assert "no answer" in reason
        assert "servo" not in reason  # all was given back, and seen to be
        assert not engine.arm.servo_on


def test_a_reset_controller_is_not_taken_again_without_a_request() -> None:
    engine = controller()
    with moving(engine, faults=EmulatorFaults(reset=(1.2, 1.2))) as arm:
        assert "error 6500" in failure(arm)
        stepped(arm, for_seconds(0.2))
    assert names(engine).count("CNTLON") == 1


@pytest.mark.parametrize("fault", ["noise", "half"])
def test_an_answer_that_is_not_understood_stops_the_arm(fault: str) -> None:
    engine = controller()
    faults = EmulatorFaults(**{fault: 0.03})  # type: ignore[arg-type]
    with running(engine, "pty", faults) as emulated, mover(emulated, timeout=0.3) as arm:
        arm.take_controls()
        stepped(arm, lambda status: status.state in {MoverState.READY, MoverState.FAILED})
        if arm.step().state is MoverState.READY:
            arm.move(NEXT)
        stepped(arm, lambda status: status.state is MoverState.FAILED, limit=30.0)
    assert not engine.arm.moving


def test_a_missing_device_is_reported_without_blocking(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("verify.grasping.actuators.melfa.mover.CONNECT_TIMEOUT", 0.6)
    with socket.create_server(("127.0.0.1", 0)) as unused:
        port = unused.getsockname()[1]
    with mover(f"tcp:127.0.0.1:{port}") as arm:
        arm.take_controls()
        assert "nothing listens there" in settled(arm, MoverState.FAILED)[-1].reason


def test_a_line_that_another_program_has_is_waited_for() -> None:
    with running(controller()) as emulated, mover(emulated) as first, mover(emulated) as second:
        ready(first)
        second.take_controls()
        stepped(second, for_seconds(0.3))
        assert second.step().state is MoverState.CONNECTING
        first.close()
        settled(second, MoverState.READY)


def test_answers_without_a_terminator_are_understood() -> None:
    with running(controller(end=b"")) as emulated, mover(emulated, terminator=b"\r\n") as arm:
        ready(arm)
