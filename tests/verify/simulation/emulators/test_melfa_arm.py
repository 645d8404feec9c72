"""The emulated controller that the motion driver is tested with: does it move as an arm does?"""

import numpy as np
import pytest

import robots
from tests.support.command import verify
from tests.support.devices.bench import emulate_command
from tests.support.devices.melfa_mover import ARM, controller, limits, mover, ready, settled
from verify.core.records import Array
from verify.devices.melfa.protocol import parse_joints, parse_state
from verify.grasping.actuators.protocols import MoverState
from verify.simulation.emulators import trajectory
from verify.simulation.emulators.arm import ACCELERATION_TIME

HOME_DEG = np.array(trajectory.HOME_DEG)


class Desk:
    """Somebody who types commands, one every 10 ms."""

    def __init__(self, idle: bool = True) -> None:
        self.engine = controller(idle, follows="command", latency=0.0, jitter=0.0)
        self.t = 0.0
        self.say("OPEN=desk")

    def say(self, command: str) -> str:
        self.t += 0.01
        (message,) = self.engine.step(self.t, f"1;1;{command}\r".encode())
        return message.data.decode().strip()

    def power(self, override: int = 100) -> None:
        for command in ("CNTLON", "SRVON", f"OVRD={override}"):
            assert self.say(command) == "QoK"
        self.t += 2.0

    def joints_deg(self) -> Array:
        position = parse_joints(self.say("JPOSF")[3:], 6)
        return np.array(position.joints_deg)

    def moving(self) -> bool:
        state = parse_state(self.say("STATE")[3:])
        return state.running

    def go(self, angles: Array, how: str = "MOV") -> str:
        self.say(f"EXECJ1=({','.join(map(str, angles))})")
        if how == "MOV":
            return self.say("EXECMOV J1")
        assert self.say("EXECP1=JTOP(J1)") == "QoK"
        return self.say("EXECMVS P1")


def test_moves_want_the_right_the_servo_and_no_other_motion() -> None:
    desk = Desk()
    assert desk.say("EXECMOV J1") == "QeR6020"
    desk.say("CNTLON")
    assert desk.say("EXECMOV J1") == "QeR2000"
    desk.power()
    for instruction, answer in [
        ("MOV J1", "QeR4340"), ("P1=JTOP(J9)", "QeR4340"), ("J1=(1,2)", "QeR4220"),
        ("J1=(1,2,x,4,5,6)", "QeR4220"), ("HOPEN 1", "QeR4220"), ("J1=(0,0,171.5,0,0,0)", "QoK"),
        ("MOV J1", "QeR2140"), ("P1=JTOP(J1)", "QoK"), ("MVS P1", "QeR2602"), ("MVS J1", "QeR4220"),
    ]:  # fmt: skip
        assert desk.say(f"EXEC{instruction}") == answer, instruction
    assert desk.go(HOME_DEG + 10.0) == "QoK"
    assert desk.go(HOME_DEG) == "QeR5640"
    busy = Desk(idle=False)
    busy.say("CNTLON")
    assert busy.say("EXECMOV J1") == "QeR5640"


@pytest.mark.parametrize("override", [5, 100])
def test_a_joint_move_takes_the_time_of_a_trapezoid_at_the_joints_own_speed(override: int) -> None:
    """D / v + (time to speed up): 60° of joint 1 at 250°/s times the override."""
    desk = Desk()
    desk.power(override)
    target = HOME_DEG.copy()
    target[0] += 60.0
    desk.go(target)
    begin = desk.t
    while desk.moving():
        assert desk.t < 60.0
    wanted = 60.0 / (250.0 * override / 100) + ACCELERATION_TIME
    assert desk.t - begin == pytest.approx(wanted, rel=0.02, abs=0.03)
    np.testing.assert_array_equal(desk.joints_deg(), target)


def test_a_straight_move_is_straight_turns_steadily_and_ends_where_it_should() -> None:
    desk = Desk()
    desk.power()
    target = HOME_DEG + np.array([20.0, 5.0, -8.0, 0.0, 5.0, 0.0])
    desk.go(target, "MVS")
    way = [desk.joints_deg()]
    while desk.moving():
        way.append(desk.joints_deg())
    np.testing.assert_allclose(desk.joints_deg(), target, atol=0.011)
    poses = robots.forward(ARM, np.deg2rad(way))
    chord = poses[-1, :3, 3] - poses[0, :3, 3]
    away = np.cross(poses[:, :3, 3] - poses[0, :3, 3], chord / np.linalg.norm(chord))
    assert len(way) > 10
    assert np.max(np.abs(away)) < 3e-4  # what 0.01° does to the hand


def test_a_stop_brakes_an_alarm_too_and_an_emergency_stop_takes_the_power() -> None:
    for act in ("STOP", "alarm", "emergency"):
        desk = Desk()
        desk.power(20)
        desk.go(HOME_DEG + np.array([40.0, 0, 0, 0, 0, 0]))
        desk.t += 0.3
        if act == "STOP":
            assert desk.say("STOP") == "QoK"
        else:
            desk.engine.afflict("alarm", 2140 if act == "alarm" else 50)
        before = desk.joints_deg()
        desk.t += 0.5
        state = parse_state(desk.say("STATE")[3:])
        assert not state.running
        assert state.servo_on is (act != "emergency")
        assert state.emergency_stop is (act == "emergency")
        after = desk.joints_deg()
        assert (
            0.0 <= after[0] - before[0] < 50.0 * ACCELERATION_TIME
        )  # 50°/s, half of it on the way
        desk.t += 1.0
        np.testing.assert_array_equal(desk.joints_deg(), after)


def test_the_reported_hand_speed_is_the_arms() -> None:
    """Joint 1 alone turns the hand about the base's axis: speed is radius times rate."""
    desk = Desk()
    desk.power(20)
    desk.go(HOME_DEG + np.array([60.0, 0, 0, 0, 0, 0]))
    desk.t += 0.5
    position = parse_joints(desk.say("JPOSF")[3:], 6)
    x, y, _ = robots.forward(ARM, np.deg2rad(HOME_DEG))[:3, 3]
    assert position.speed == pytest.approx(np.hypot(x, y) * np.deg2rad(50.0), rel=0.01)


def test_run_leads_the_arm_back_to_where_the_program_was() -> None:
    desk = Desk(idle=False)
    desk.say("CNTLON")
    desk.say("STOP")
    desk.go(HOME_DEG + 15.0)
    desk.t += 3.0
    assert not desk.moving()
    desk.say("RUN")
    steps = [desk.joints_deg() for _ in range(200)]
    assert np.max(np.abs(np.diff(steps, axis=0))) < 5.0  # no leap
    np.testing.assert_array_equal(steps[-1], HOME_DEG)
    assert desk.moving()


@pytest.mark.realtime
def test_the_command_emulates_a_controller_that_waits_to_be_moved() -> None:
    emulated = emulate_command("melfa", "--idle", "--motion", "hold", "--port", "tcp:0")
    with emulated as address, mover(address, limits(override=50)) as arm:
        ready(arm)
        arm.move(np.deg2rad(HOME_DEG + 5.0), on_line=True)
        settled(arm, MoverState.ARRIVED)
    assert "labenc runs no program" in verify("emulate", "labenc", "--idle").err
