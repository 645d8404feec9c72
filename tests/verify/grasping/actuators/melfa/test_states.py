import time
from contextlib import suppress

import numpy as np
import pytest

from tests.support.devices.bench import for_seconds, running
from tests.support.devices.melfa_mover import (
    HOME,
    NEXT,
    PORTS,
    controller,
    failure,
    found_at,
    given_back,
    limits,
    mover,
    moving,
    names,
    ready,
    settled,
    stepped,
    under_way,
)
from verify.grasping.actuators.protocols import MotionRefusedError, MoverState
from verify.simulation.emulators.melfa import ControllerOptions, MelfaEngine
from verify.simulation.emulators.server import EmulatorFaults, TimedMessage


@pytest.mark.parametrize("where", PORTS)
def test_the_arm_takes_controls_moves_jointwise_and_straight_and_gives_back(where: str) -> None:
    engine = controller()
    with running(engine, where) as emulated:
        with mover(emulated) as arm:
            assert arm.step().state is MoverState.OFF
            ready(arm)
            assert engine.arm.right
            assert engine.arm.servo_on
            arm.move(NEXT)
            end = settled(arm, MoverState.ARRIVED)[-1]
            np.testing.assert_allclose(end.q, NEXT, atol=np.deg2rad(0.011))
            arm.move(HOME, on_line=True)
            way = settled(arm, MoverState.ARRIVED)
            np.testing.assert_allclose(way[-1].q, HOME, atol=np.deg2rad(0.011))
            arm.release()
            assert settled(arm, MoverState.RELEASED)[-1].reason == ""
        assert not engine.arm.right
        assert not engine.arm.servo_on
    assert engine.log[0] == "OPEN=verify"
    assert names(engine) == [
        "CNTLON", "OVRD", "SRVON", "EXEC", "EXEC", "EXEC", "EXEC", "EXEC",
        "STOP", "SRVOFF", "OVRD", "CNTLOFF",
    ]  # fmt: skip


@pytest.mark.realtime
@pytest.mark.parametrize("where", PORTS)
def test_hold_stops_the_arm_where_it_is_and_keeps_the_controls(where: str) -> None:
    engine = controller()
    with running(engine, where) as emulated, mover(emulated, limits(override=8)) as arm:
        ready(arm)
        under_way(arm, NEXT)
        begin = time.monotonic()
        arm.hold()
        held = settled(arm, MoverState.HELD)[-1]
        assert time.monotonic() - begin < 2.0
        assert np.max(np.abs(held.q - NEXT)) > np.deg2rad(1.0)
        assert engine.arm.right
        at = engine.arm.joints(engine.arm._now, 0.0)
        stepped(arm, for_seconds(0.3))
        np.testing.assert_array_equal(engine.arm.joints(engine.arm._now, 0.0), at)
        arm.move(NEXT)
        settled(arm, MoverState.ARRIVED)


@pytest.mark.realtime
def test_a_second_move_while_one_is_under_way_is_refused_and_changes_nothing() -> None:
    with running(controller()) as emulated, mover(emulated, limits(override=3)) as arm:
        with pytest.raises(MotionRefusedError, match="it is off"):
            arm.move(NEXT)
        ready(arm)
        with pytest.raises(MotionRefusedError, match="ready already"):
            arm.take_controls()
        under_way(arm, NEXT)
        with pytest.raises(MotionRefusedError, match="it is moving"):
            arm.move(HOME)
        np.testing.assert_allclose(
            settled(arm, MoverState.ARRIVED)[-1].q, NEXT, atol=np.deg2rad(0.011)
        )


@pytest.mark.realtime
def test_a_running_program_a_standing_alarm_another_robot_keep_it_from_taking_controls() -> None:
    alarmed = controller()
    alarmed.arm.alarm = 4140
    for engine, words in [
        (controller(idle=False), "a program runs"),
        (alarmed, "alarm 4140 is active: the program is missing; clear it at the controller"),
        (controller(robot_type="RV-6S"), "the robot is RV-6S; RV-3SD is expected"),
    ]:
        with running(engine) as emulated, mover(emulated) as arm:
            arm.take_controls()
            assert words in settled(arm, MoverState.FAILED)[-1].reason
        assert names(engine) == []  # not even a stop: what runs there is not ours


@pytest.mark.realtime
@pytest.mark.parametrize("where", PORTS)
@pytest.mark.parametrize("how", ["release", "hold", "alarm", "silence", "exception"])
def test_the_controller_is_given_back_with_its_override_however_it_ends(
    where: str, how: str
) -> None:
    engine = found_at(controller(), 37)
    silent = EmulatorFaults(silence=(0.8, 0.9)) if how == "silence" else None
    with suppress(ZeroDivisionError), moving(engine, where, silent, timeout=0.4) as arm:
        assert engine.arm._override == 3
        arm.move(NEXT)
        if how == "hold":
            arm.hold()
            settled(arm, MoverState.HELD)
        elif how == "alarm":
            engine.afflict("alarm", 2140)
            failure(arm)
        elif how == "silence":  # given up within its time, and then stopped
            failing = stepped(arm, lambda status: status.state is MoverState.FAILING)[-1]
            assert "no answer" in failing.reason
            assert time.monotonic() - failing.t < 1.0
            failure(arm)
        elif how == "exception":
            raise ZeroDivisionError
    assert engine.arm._override == 37
    assert given_back(engine)
    back = engine.log.index("OVRD=37")
    assert "SRVOFF" in engine.log[:back]  # nothing is made faster that still has power


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("name", "argument", "answer", "words"),
    [
        ("OVRD", "=37", 3110, "override put back was refused, error 3110"),
        ("OVRD", "=37", "", "the override is 3 %, it was 37 %"),
        ("SRVOFF", "", "", "the servo is still on"),
    ],
)
def test_what_the_controller_does_not_do_at_the_end_is_reported(
    name: str, argument: str, answer: int | str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("verify.grasping.actuators.melfa.states.RELEASE_TIMEOUT", 0.5)
    engine = found_at(controller(), 37)
    obey = engine.arm.obey

    def disobey(order: str, text: str, t: float, axes: int) -> int | str:
        return answer if (order, text) == (name, argument) else obey(order, text, t, axes)

    monkeypatch.setattr(engine.arm, "obey", disobey)
    with moving(engine) as arm:
        arm.release()
        assert words in failure(arm)
    assert not engine.arm.right


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("change", "value", "words"),
    [("running", True, "a program runs"), ("_servo_at", None, "lost its power")],
)
def test_an_external_program_start_and_servo_off_are_noticed(
    change: str, value: bool | None, words: str
) -> None:
    engine = controller()
    with moving(engine) as arm:
        setattr(engine.arm, change, value)
        assert words in failure(arm)


@pytest.mark.realtime
def test_a_servo_that_does_not_come_on_has_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("verify.simulation.emulators.arm.SERVO_TIME", 1e9)
    monkeypatch.setattr("verify.grasping.actuators.melfa.answers.POWER_TIMEOUT", 0.5)
    with running(controller()) as emulated, mover(emulated) as arm:
        arm.take_controls()
        assert "powering takes too long" in failure(arm)


@pytest.mark.realtime
def test_an_arm_that_does_not_go_to_its_target_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("verify.grasping.actuators.melfa.states.STALL_TIMEOUT", 0.5)

    class Lazy(MelfaEngine):
        """Says yes, and stops on its way."""

        def step(self, t: float, received: bytes) -> list[TimedMessage]:
            if np.max(np.abs(self.arm.joints(t, 0.0) - HOME)) > np.deg2rad(3.0):
                self.arm.obey("STOP", "", t)
            return super().step(t, received)

    with moving(Lazy(controller().arm, ControllerOptions()), chosen=limits(override=10)) as arm:
        arm.move(NEXT)
        assert "degrees from its target" in failure(arm)


@pytest.mark.realtime
def test_a_hand_that_goes_too_fast_is_stopped_and_may_be_taken_again() -> None:
    far = HOME + np.deg2rad([60.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    with moving(controller(), chosen=limits(hand_speed=0.1)) as arm:
        arm.move(far)
        assert "the hand goes at" in failure(arm)
        q = arm.step().q
        assert q[0] < far[0]
        arm.take_controls()
        assert settled(arm, MoverState.READY)[-1].reason == ""


@pytest.mark.realtime
def test_a_move_that_the_controller_refuses_ends_in_a_stop() -> None:
    """Straight to the other side of the wrist's singularity: no line leads there."""
    engine, target = controller(), HOME.copy()
    target[4] = -target[4]
    with moving(engine, chosen=limits()) as arm:
        arm.move(target, on_line=True)
        assert "EXEC was refused, error 2603: the via point is out of reach" in failure(arm)
        assert not engine.arm.servo_on
