import numpy as np
import pytest

from tests.support.devices.bench import for_seconds, running, same_angles
from tests.support.devices.melfa_mover import (
    HOME,
    LIMITS,
    NEXT,
    controller,
    limits,
    mover,
    names,
    ready,
    settled,
    stepped,
    under_way,
)
from verify.devices.encoders.intake import AngleMap
from verify.devices.melfa.protocol import READ_COMMANDS, ForbiddenCommandError
from verify.grasping.actuators.melfa import orders
from verify.grasping.actuators.melfa.mover import MelfaMover
from verify.grasping.actuators.protocols import MotionRefusedError, MoverState


def test_no_mover_is_made_without_the_operators_permission() -> None:
    settings = orders.MotionSettings("/dev/none", "RV-3SD")
    with pytest.raises(TypeError, match="operator's permission"):
        MelfaMover(settings, same_angles(6), limits(), None)  # type: ignore[arg-type]


def test_dangerous_commands_cannot_be_built() -> None:
    for name, argument in [
        ("BREAKON", "FF"), ("JOG", "00"), ("HNDON", "1"), ("RSTALRM", ""), ("RUN", ""),
        ("MOVSP", ""), ("PRGLOAD", "=1"), ("HOT", "1;M1=1"), ("CNTLON", "X"), ("OVRD", "=0"),
        ("OVRD", "=101"), ("EXEC", "MOV P1"), ("EXEC", "HOPEN 1"), ("EXEC", "MVS JVFY"),
        ("EXEC", "JVFY=(1.000)\rRUN"),
    ]:  # fmt: skip
        with pytest.raises(ForbiddenCommandError):
            orders.MotionCommand(name, argument)
    assert not {*orders.MOVE_COMMANDS} & {*READ_COMMANDS}


def test_moves_have_the_bytes_of_the_manual() -> None:
    angles = np.array([-7.42, 38.21, 77.74, 7.08, 61.72, -9.75])
    worded = [order.encoded(b"\r") for order in orders.move_commands(angles, on_line=True)]
    assert worded == [
        b"1;1;EXECJVFY=(-7.420,38.210,77.740,7.080,61.720,-9.750)\r",
        b"1;1;EXECPVFY=JTOP(JVFY)\r",
        b"1;1;EXECMVS PVFY\r",
    ]
    by_joints = orders.move_commands(angles, on_line=False)
    assert by_joints[1].encoded(b"\r\n") == b"1;1;EXECMOV JVFY\r\n"
    with pytest.raises(ForbiddenCommandError):
        orders.move_commands(np.full(6, np.nan), on_line=False)
    found = orders.parse_limits("MEJAR;-170.00,170.00,-90.00,135.00;4", 2)
    np.testing.assert_array_equal(found, [[-170, 170], [-90, 135]])
    for wrong in ("MEJAR;1.0;1", "MEJAR;5,-5,1,2;4", "nonsense", "MEJAR;a,b,c,d"):
        assert orders.parse_limits(wrong, 2) is None


@pytest.mark.realtime
def test_targets_outside_any_limit_are_refused_and_nothing_is_sent() -> None:
    narrow = LIMITS.copy()
    narrow[0] = np.deg2rad([-30.0, 30.0])
    engine = controller(limits=narrow)
    moving = limits(largest_step=np.deg2rad(60.0))
    with running(engine) as emulated, mover(emulated, moving) as arm:
        ready(arm)
        sent = len(names(engine))
        for joint, angle, words in [
            (0, 35.0, "controller's limits"),
            (2, 172.0, "joint limits"),
            (5, 65.0, "more than 60 degrees"),
            (3, np.nan, "joint limits"),
        ]:
            target = HOME.copy()
            target[joint] = np.deg2rad(angle)
            for on_line in (False, True):
                with pytest.raises(MotionRefusedError, match=words):
                    arm.move(target, on_line=on_line)
        assert len(names(engine)) == sent
        assert arm.step().state is MoverState.READY


@pytest.mark.realtime
def test_signs_and_zeros_of_the_robot_file_reach_the_controller() -> None:
    angles = AngleMap(np.array([1.0, -1, 1, 1, -1, 1]), np.deg2rad([0.0, 10, -5, 0, 0, 3]))
    everything = orders.MoveLimits(np.tile([-6.3, 6.3], (6, 1)), hand_speed=2.0, override=60)
    engine = controller()
    with running(engine) as emulated, mover(emulated, everything, angles) as arm:
        ready(arm)
        target = angles.joint_angles(NEXT)
        arm.move(target)
        np.testing.assert_allclose(
            settled(arm, MoverState.ARRIVED)[-1].q, target, atol=np.deg2rad(0.011)
        )
        np.testing.assert_allclose(
            engine.arm.joints(engine.arm._now, 0.0), NEXT, atol=np.deg2rad(1e-3)
        )


@pytest.mark.realtime
def test_the_pause_is_kept_while_moving_and_a_stop_does_not_wait() -> None:
    engine = controller(least_pause=0.0)
    with running(engine) as emulated, mover(emulated, limits(override=3), pause=0.1) as arm:
        ready(arm)
        under_way(arm, NEXT)
        times = np.unique([status.t for status in stepped(arm, for_seconds(0.4))])
        assert np.all(np.diff(times) > 0.1)
        arm.hold()
        settled(arm, MoverState.HELD)
