import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import robots
from tests.support.devices import bench
from tests.support.devices.bench import Emulated, running, same_angles
from verify.core.records import Array
from verify.devices.encoders.intake import AngleMap
from verify.devices.melfa.protocol import READ_COMMANDS, ForbiddenCommandError
from verify.grasping.actuators.melfa.mover import MelfaMover
from verify.grasping.actuators.melfa.orders import (
    MOVE_COMMANDS,
    MotionCommand,
    MotionSettings,
    MoveLimits,
    joint_move,
    line_move,
    parse_limits,
)
from verify.grasping.actuators.protocols import (
    ExecutePermission,
    MotionRefusedError,
    Mover,
    MoverState,
    MoverStatus,
)
from verify.simulation.emulators import trajectory
from verify.simulation.emulators.arm import MelfaArm
from verify.simulation.emulators.melfa import ControllerOptions, MelfaEngine
from verify.simulation.emulators.server import EmulatorFaults, TimedMessage

PORTS = ["tcp:0", "pty"]
RIGHT = ExecutePermission("--execute, in a test")
ARM = robots.load("rv_3sd_melfa")
LIMITS = np.column_stack([ARM.lower, ARM.upper])
HOME = np.deg2rad(trajectory.HOME_DEG)
NEXT = HOME + np.deg2rad([8.0, -5.0, 6.0, 10.0, -8.0, 12.0])
FAST = 0.01  # s, pause: tests cannot wait
GIVEN_BACK = ["STOP", "ERROR", "SRVOFF", "OVRD=100", "CNTLOFF", "STATE"]


@pytest.fixture(autouse=True)
def a_servo_that_comes_on_quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("verify.simulation.emulators.arm.SERVO_TIME", 0.05)


def controller(idle: bool = True, limits: Array = LIMITS, **options: object) -> MelfaEngine:
    assert isinstance(ARM, robots.DhArm)
    arm = MelfaArm(trajectory.load("hold", 6), 6, limits, arm=ARM, idle=idle)
    return MelfaEngine(arm, ControllerOptions(**options))  # type: ignore[arg-type]


def limits(**changed: object) -> MoveLimits:
    chosen = {"hand_speed": 2.0, "override": 60} | changed  # tests cannot wait
    return MoveLimits(LIMITS, **chosen)  # type: ignore[arg-type]


@contextmanager
def mover(
    emulated: Emulated | str,
    moving: MoveLimits | None = None,
    angles: AngleMap | None = None,
    **settings: object,
) -> Iterator[MelfaMover]:
    address = emulated if isinstance(emulated, str) else emulated.address
    chosen = {"robot_type": "RV-3SD", "pause": FAST} | settings
    with MelfaMover(
        MotionSettings(address, **chosen),  # type: ignore[arg-type]
        angles or same_angles(6),
        moving or limits(),
        RIGHT,
    ) as found:
        yield found


stepped = partial(bench.stepped, limit=15.0)  # a move takes longer


RESTS = {
    MoverState.READY, MoverState.ARRIVED, MoverState.HELD, MoverState.RELEASED, MoverState.FAILED,
}  # fmt: skip


def settled(arm: MelfaMover, state: MoverState) -> list[MoverStatus]:
    seen = stepped(arm, lambda status: status.state in RESTS)
    assert seen[-1].state is state, seen[-1]
    return seen


def after(seconds: float) -> Callable[[MoverStatus], bool]:
    end = time.monotonic() + seconds
    return lambda _: time.monotonic() > end


def ready(arm: MelfaMover) -> None:
    arm.take_controls()
    settled(arm, MoverState.READY)


def under_way(arm: MelfaMover, q: Array) -> None:
    """Order a move, and come back in its middle."""
    begin = arm.step().q
    assert begin is not None
    arm.move_joints(q)
    far = float(np.max(np.abs(q - begin)))
    stepped(
        arm,
        lambda status: (
            status.q is not None and 0.2 * far < np.max(np.abs(status.q - begin)) < 0.8 * far
        ),
    )


def names(engine: MelfaEngine) -> list[str]:
    """What the controller was told, without what only reads and without arguments."""
    told = [
        next((name for name in MOVE_COMMANDS if order.startswith(name)), "") for order in engine.log
    ]
    return [name for name in told if name]


@pytest.mark.parametrize("where", PORTS)
def test_the_arm_takes_controls_moves_jointwise_and_straight_and_gives_back(where: str) -> None:
    engine = controller()
    with running(engine, where) as emulated:
        with mover(emulated) as arm:
            assert arm.step().state is MoverState.OFF
            ready(arm)
            assert engine.arm.right
            assert engine.arm.servo_on
            arm.move_joints(NEXT)
            end = settled(arm, MoverState.ARRIVED)[-1]
            np.testing.assert_allclose(end.q, NEXT, atol=np.deg2rad(0.011))
            arm.move_line(HOME)
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


def found_at(engine: MelfaEngine, override: int) -> MelfaEngine:
    """Set the override as somebody at the controller has left it."""
    engine.arm._override = override
    return engine


@pytest.mark.parametrize("where", PORTS)
@pytest.mark.parametrize("how", ["release", "hold", "alarm", "silence", "exception"])
def test_the_override_is_put_back_however_it_ends(where: str, how: str) -> None:
    engine = found_at(controller(), 37)
    silent = EmulatorFaults(silence=(0.8, 0.9)) if how == "silence" else None

    def moves(emulated: Emulated) -> None:
        with mover(emulated, limits(override=3), timeout=0.4) as arm:
            ready(arm)
            assert engine.arm._override == 3
            arm.move_joints(NEXT)
            if how == "hold":
                arm.hold()
                settled(arm, MoverState.HELD)
            elif how == "alarm":
                engine.afflict("alarm", 2140)
                settled(arm, MoverState.FAILED)
            elif how == "silence":
                settled(arm, MoverState.FAILED)
            elif how == "exception":
                raise ZeroDivisionError

    with running(engine, where, silent) as emulated:
        with suppress(ZeroDivisionError):
            moves(emulated)
        assert engine.arm._override == 37
        assert not engine.arm.right
        assert not engine.arm.servo_on
    back = engine.log.index("OVRD=37")
    assert "SRVOFF" in engine.log[:back]  # nothing is made faster that still has power


def test_an_override_that_was_not_changed_is_left_alone() -> None:
    engine = found_at(controller(idle=False), 37)  # a program runs: the right is not taken
    with running(engine) as emulated, mover(emulated) as arm:
        arm.take_controls()
        settled(arm, MoverState.FAILED)
    assert not [order for order in engine.log if order.startswith("OVRD")]


@pytest.mark.parametrize(
    ("answer", "words"),
    [(3110, "override put back was refused, error 3110"), ("", "the override is 3 %, it was 37 %")],
    ids=["refused", "ignored"],
)
def test_an_override_that_does_not_come_back_is_said(
    answer: int | str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = found_at(controller(), 37)
    sets = engine.arm._set_override
    monkeypatch.setattr(
        engine.arm, "_set_override", lambda text: answer if text == "=37" else sets(text)
    )
    with running(engine) as emulated, mover(emulated, limits(override=3)) as arm:
        ready(arm)
        arm.release()
        assert words in settled(arm, MoverState.FAILED)[-1].reason
    assert not engine.arm.right


def test_a_straight_move_is_straight_and_a_joint_move_is_not() -> None:
    """Seen by the arm's own kinematics, at what the encoders tell."""
    far = HOME + np.deg2rad([25.0, 10.0, -10.0, 0.0, 0.0, 0.0])
    with running(controller()) as emulated, mover(emulated) as arm:
        ready(arm)
        bends = []
        for order, target in [(arm.move_line, far), (arm.move_joints, HOME)]:
            order(target)
            way = np.array([status.q for status in settled(arm, MoverState.ARRIVED)])
            places = robots.forward(ARM, way)[:, :3, 3]
            chord = places[-1] - places[0]
            along = np.clip((places - places[0]) @ chord / (chord @ chord), 0, 1)
            away = places - places[0] - along[:, None] * chord
            bends.append(float(np.max(np.linalg.norm(away, axis=1))))
    assert bends[0] < 2e-4  # 0.01° at 0.6 m is 0.1 mm
    assert bends[1] > 5e-3


def test_a_mover_is_a_mover_and_none_is_made_without_the_operators_right() -> None:
    settings = MotionSettings("/dev/none", "RV-3SD")
    arm: Mover = MelfaMover(settings, same_angles(6), limits(), RIGHT)
    arm.close()
    with pytest.raises(TypeError, match="operator's right"):
        MelfaMover(settings, same_angles(6), limits(), None)  # type: ignore[arg-type]


def test_orders_that_could_do_harm_cannot_be_worded() -> None:
    for name, argument in [
        ("BREAKON", "FF"), ("JOG", "00"), ("HNDON", "1"), ("RSTALRM", ""), ("RUN", ""),
        ("MOVSP", ""), ("PRGLOAD", "=1"), ("HOT", "1;M1=1"), ("CNTLON", "X"), ("OVRD", "=0"),
        ("OVRD", "=101"), ("EXEC", "MOV P1"), ("EXEC", "HOPEN 1"), ("EXEC", "MVS JVFY"),
        ("EXEC", "JVFY=(1.000)\rRUN"),
    ]:  # fmt: skip
        with pytest.raises(ForbiddenCommandError):
            MotionCommand(name, argument)
    assert not {*MOVE_COMMANDS} & {*READ_COMMANDS}


def test_moves_are_worded_as_the_manual_says() -> None:
    angles = np.array([-7.42, 38.21, 77.74, 7.08, 61.72, -9.75])
    worded = [order.encoded(b"\r") for order in line_move(angles, 1)]
    assert worded == [
        b"1;1;EXECJVFY=(-7.420,38.210,77.740,7.080,61.720,-9.750)\r",
        b"1;1;EXECPVFY=JTOP(JVFY)\r",
        b"1;1;EXECMVS PVFY\r",
    ]
    assert joint_move(angles, 9)[1].encoded(b"\r\n") == b"1;9;EXECMOV JVFY\r\n"
    with pytest.raises(ForbiddenCommandError):
        joint_move(np.full(6, np.nan), 1)
    found = parse_limits("MEJAR;-170.00,170.00,-90.00,135.00;4", 2)
    np.testing.assert_array_equal(found, [[-170, 170], [-90, 135]])
    for wrong in ("MEJAR;1.0;1", "MEJAR;5,-5,1,2;4", "nonsense", "MEJAR;a,b,c,d"):
        assert parse_limits(wrong, 2) is None


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
        assert held.q is not None
        assert np.max(np.abs(held.q - NEXT)) > np.deg2rad(1.0)
        assert engine.arm.right
        at = engine.arm.joints(engine.arm._now, 0.0)
        stepped(arm, after(0.3))
        np.testing.assert_array_equal(engine.arm.joints(engine.arm._now, 0.0), at)
        arm.move_joints(NEXT)
        settled(arm, MoverState.ARRIVED)


def test_a_second_move_while_one_is_under_way_is_refused_and_changes_nothing() -> None:
    with running(controller()) as emulated, mover(emulated, limits(override=3)) as arm:
        with pytest.raises(MotionRefusedError, match="it is off"):
            arm.move_joints(NEXT)
        ready(arm)
        with pytest.raises(MotionRefusedError, match="ready already"):
            arm.take_controls()
        under_way(arm, NEXT)
        with pytest.raises(MotionRefusedError, match="it is moving"):
            arm.move_joints(HOME)
        np.testing.assert_allclose(
            settled(arm, MoverState.ARRIVED)[-1].q, NEXT, atol=np.deg2rad(0.011)
        )


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
            for order in (arm.move_joints, arm.move_line):
                with pytest.raises(MotionRefusedError, match=words):
                    order(target)
        assert len(names(engine)) == sent
        assert arm.step().state is MoverState.READY


def test_signs_and_zeros_of_the_robot_file_reach_the_controller() -> None:
    angles = AngleMap(np.array([1.0, -1, 1, 1, -1, 1]), np.deg2rad([0.0, 10, -5, 0, 0, 3]))
    everything = MoveLimits(np.tile([-6.3, 6.3], (6, 1)), hand_speed=2.0, override=60)
    engine = controller()
    with running(engine) as emulated, mover(emulated, everything, angles) as arm:
        ready(arm)
        target = angles.joint_angles(NEXT)
        arm.move_joints(target)
        np.testing.assert_allclose(
            settled(arm, MoverState.ARRIVED)[-1].q, target, atol=np.deg2rad(0.011)
        )
        np.testing.assert_allclose(
            engine.arm.joints(engine.arm._now, 0.0), NEXT, atol=np.deg2rad(1e-3)
        )


@pytest.mark.parametrize("where", PORTS)
@pytest.mark.parametrize(
    ("number", "words"),
    [
        (50, "alarm 50: emergency stop: external"),
        (2140, "alarm 2140: outside a joint limit"),
        (999, "alarm 999: NO MESSAGE"),
    ],
)
def test_an_alarm_in_mid_move_stops_gives_back_and_is_worded(
    where: str, number: int, words: str
) -> None:
    engine = controller()
    with running(engine, where) as emulated, mover(emulated, limits(override=3)) as arm:
        ready(arm)
        under_way(arm, NEXT)
        engine.afflict("alarm", number)
        failed = settled(arm, MoverState.FAILED)[-1]
        assert words in failed.reason
        assert not engine.arm.right
        assert not engine.arm.servo_on
        assert not engine.arm.moving
        arm.take_controls()
        refused = settled(arm, MoverState.FAILED)[-1]
        assert "clear it at the controller" in refused.reason or "emergency" in refused.reason
    assert "RSTALRM" not in engine.log
    assert names(engine).count("CNTLON") == 1


@pytest.mark.parametrize("where", PORTS)
def test_silence_in_mid_move_is_given_up_within_its_time_and_then_stopped(where: str) -> None:
    engine = controller()
    with (
        running(engine, where, EmulatorFaults(silence=(0.8, 0.9))) as emulated,
        mover(emulated, limits(override=3), timeout=0.4) as arm,
    ):
        ready(arm)
        arm.move_joints(NEXT)
        failing = stepped(arm, lambda status: status.state is MoverState.FAILING)[-1]
        assert "no answer" in failing.reason
        assert failing.age is not None
        assert failing.age < 1.0
        settled(arm, MoverState.FAILED)
        assert not engine.arm.right
        assert not engine.arm.servo_on


def test_silence_without_an_end_is_said_as_what_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("verify.grasping.actuators.melfa.states.RELEASE_TIMEOUT", 1.0)
    engine = controller()
    with (
        running(engine, faults=EmulatorFaults(silence=(0.8, 60.0))) as emulated,
        mover(emulated, limits(override=3), timeout=0.3) as arm,
    ):
        ready(arm)
        arm.move_joints(NEXT)
        failed = settled(arm, MoverState.FAILED)[-1]
        assert "could not be told: stop, servo off, override put back" in failed.reason
        assert "emergency stop" in failed.reason


@pytest.mark.parametrize("kind", ["tcp", "pty"])
def test_a_line_that_breaks_in_mid_move_is_taken_up_again_to_stop(
    kind: str, tmp_path: Path
) -> None:
    where = "tcp:0" if kind == "tcp" else f"pty:{tmp_path / 'port'}"
    engine = controller()
    with (
        running(engine, where, EmulatorFaults(unplug=(0.8, 0.6))) as emulated,
        mover(emulated, limits(override=3)) as arm,
    ):
        ready(arm)
        arm.move_joints(NEXT)
        failed = settled(arm, MoverState.FAILED)[-1]
        assert failed.reason.startswith(f"{emulated.address}: ")
        assert not engine.arm.right
        assert not engine.arm.servo_on
        assert not engine.arm.moving


@pytest.mark.parametrize("where", PORTS)
def test_late_answers_are_not_taken_for_others(where: str) -> None:
    class Dawdling(MelfaEngine):
        """Its twentieth answer comes long after the driver has given up."""

        def step(self, t: float, received: bytes) -> list[TimedMessage]:
            late = 0.5 if len(self.log) == 20 else 0.0
            return [
                TimedMessage(found.at + late, found.data) for found in super().step(t, received)
            ]

    engine = Dawdling(controller().arm, ControllerOptions())
    with running(engine, where) as emulated, mover(emulated, timeout=0.2) as arm:
        ready(arm)
        failed = settled_after(arm, lambda status: status.state is MoverState.FAILED)
        assert "no answer" in failed.reason
        assert "servo" not in failed.reason  # all was given back, and seen to be
        assert not engine.arm.servo_on


def test_a_controller_that_was_reset_is_not_taken_again_unasked() -> None:
    engine = controller()
    with (
        running(engine, faults=EmulatorFaults(reset=(1.2, 1.2))) as emulated,
        mover(emulated) as arm,
    ):
        ready(arm)
        failed = settled_after(arm, after(1.2))
        assert "error 6500" in failed.reason
    assert names(engine).count("CNTLON") == 1


def test_an_old_fault_is_not_told_of_an_arm_that_was_taken_anew() -> None:
    engine = controller()
    with running(engine) as emulated, mover(emulated, limits(hand_speed=1e-3)) as arm:
        ready(arm)
        arm.move_joints(NEXT)
        assert "the hand goes at" in settled(arm, MoverState.FAILED)[-1].reason
        arm.take_controls()
        assert settled(arm, MoverState.READY)[-1].reason == ""


def settled_after(arm: MelfaMover, until: Callable[[MoverStatus], bool]) -> MoverStatus:
    stepped(arm, until)
    return settled(arm, MoverState.FAILED)[-1]


@pytest.mark.parametrize("fault", ["noise", "half"])
def test_an_answer_that_is_not_understood_stops_the_arm(fault: str) -> None:
    engine = controller()
    faults = EmulatorFaults(**{fault: 0.03})  # type: ignore[arg-type]
    with running(engine, "pty", faults) as emulated, mover(emulated, timeout=0.3) as arm:
        arm.take_controls()
        stepped(arm, lambda status: status.state in {MoverState.READY, MoverState.FAILED})
        if arm.step().state is MoverState.READY:
            arm.move_joints(NEXT)
        stepped(arm, lambda status: status.state is MoverState.FAILED, limit=30.0)
    assert not engine.arm.moving


def test_a_running_program_a_standing_alarm_another_robot_keep_it_from_taking_controls() -> None:
    alarmed = controller()
    alarmed.arm.alarm = 4140
    for engine, words in [
        (controller(idle=False), "a program runs"),
        (alarmed, "alarm 4140 is standing: the program is missing; clear it at the controller"),
        (controller(robot_type="RV-6S"), "the robot is RV-6S; RV-3SD is expected"),
    ]:
        with running(engine) as emulated, mover(emulated) as arm:
            arm.take_controls()
            assert words in settled(arm, MoverState.FAILED)[-1].reason
        assert names(engine) == []  # not even a stop: what runs there is not ours


def test_a_program_that_somebody_starts_and_a_servo_that_somebody_takes_are_noticed() -> None:
    for change, words in [("running", "a program runs"), ("_servo_at", "lost its power")]:
        engine = controller()
        with running(engine) as emulated, mover(emulated) as arm:
            ready(arm)
            setattr(engine.arm, change, True if change == "running" else None)
            failed = settled_after(arm, lambda status: status.state is MoverState.FAILED)
            assert words in failed.reason


def test_a_servo_that_stays_on_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("verify.grasping.actuators.melfa.states.RELEASE_TIMEOUT", 0.5)

    class Stubborn(MelfaArm):
        def obey(self, name: str, argument: str, t: float) -> str | int:
            return "" if name == "SRVOFF" else super().obey(name, argument, t)

    plain = Stubborn(trajectory.load("hold", 6), 6, LIMITS, idle=True)
    with running(MelfaEngine(plain, ControllerOptions())) as emulated, mover(emulated) as arm:
        ready(arm)
        arm.release()
        assert "the servo is still on" in settled(arm, MoverState.FAILED)[-1].reason


def test_a_servo_that_does_not_come_on_has_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("verify.simulation.emulators.arm.SERVO_TIME", 1e9)
    monkeypatch.setattr("verify.grasping.actuators.melfa.answers.POWER_TIMEOUT", 0.5)
    with running(controller()) as emulated, mover(emulated) as arm:
        arm.take_controls()
        assert "powering takes too long" in settled(arm, MoverState.FAILED)[-1].reason


def test_an_arm_that_does_not_go_to_its_target_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("verify.grasping.actuators.melfa.states.STALL_TIMEOUT", 0.5)

    class Lazy(MelfaEngine):
        """Says yes, and stops on its way."""

        def step(self, t: float, received: bytes) -> list[TimedMessage]:
            if np.max(np.abs(self.arm.joints(t, 0.0) - HOME)) > np.deg2rad(3.0):
                self.arm.obey("STOP", "", t)
            return super().step(t, received)

    engine = Lazy(controller().arm, ControllerOptions())
    with running(engine) as emulated, mover(emulated, limits(override=10)) as arm:
        ready(arm)
        arm.move_joints(NEXT)
        failed = settled(arm, MoverState.FAILED)[-1]
        assert "degrees from its target" in failed.reason


def test_a_hand_that_goes_too_fast_is_stopped() -> None:
    far = HOME + np.deg2rad([60.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    with running(controller()) as emulated, mover(emulated, limits(hand_speed=0.1)) as arm:
        ready(arm)
        arm.move_joints(far)
        failed = settled(arm, MoverState.FAILED)[-1]
        assert "the hand goes at" in failed.reason
        assert failed.q is not None
        assert failed.q[0] < far[0]


def test_a_move_that_the_controller_refuses_ends_in_a_stop() -> None:
    """Straight to the other side of the wrist's singularity: no line leads there."""
    engine = controller()
    target = HOME.copy()
    target[4] = -target[4]
    with running(engine) as emulated, mover(emulated) as arm:
        ready(arm)
        arm.move_line(target)
        failed = settled(arm, MoverState.FAILED)[-1]
        assert "EXEC was refused, error 2603: the via point is out of reach" in failed.reason
        assert not engine.arm.servo_on


def test_an_exception_in_the_loop_gives_the_controller_back() -> None:
    engine = controller()

    def fails(emulated: Emulated) -> None:
        with mover(emulated, limits(override=3)) as arm:
            ready(arm)
            arm.move_joints(NEXT)
            stepped(arm, lambda _: engine.arm.moving)
            raise ZeroDivisionError

    with running(engine) as emulated:
        with pytest.raises(ZeroDivisionError):
            fails(emulated)
        assert not engine.arm.moving
        assert not engine.arm.servo_on
        assert not engine.arm.right
    told = [order for order in engine.log if order.split("=")[0] not in ("OPEN", "JPOSF")]
    looked = len(GIVEN_BACK) + 1  # the servo's power may take a second look to be gone
    assert told[-looked:] == [*GIVEN_BACK, "CLOSE"] or told[-looked - 1 :] == [
        *GIVEN_BACK, "STATE", "CLOSE",
    ]  # fmt: skip


def test_the_makers_pause_is_kept_while_the_arm_moves_and_a_stop_does_not_wait_for_it() -> None:
    engine = controller(least_pause=0.0)
    with running(engine) as emulated, mover(emulated, limits(override=3), pause=0.1) as arm:
        ready(arm)
        under_way(arm, NEXT)
        times = np.unique([status.t for status in stepped(arm, after(0.4))])
        assert np.all(np.diff(times) > 0.1)
        arm.hold()
        settled(arm, MoverState.HELD)


def test_nobody_there_is_said_and_no_step_waits_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("verify.grasping.actuators.melfa.mover.CONNECT_TIMEOUT", 0.6)
    with socket.create_server(("127.0.0.1", 0)) as unused:
        port = unused.getsockname()[1]
    with mover(f"tcp:127.0.0.1:{port}") as arm:
        arm.take_controls()
        assert "nobody listens there" in settled(arm, MoverState.FAILED)[-1].reason


def test_procedural_rs232_is_refused_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("verify.grasping.actuators.melfa.mover.CONNECT_TIMEOUT", 1.0)

    class Procedural(MelfaEngine):
        def step(self, t: float, received: bytes) -> list[TimedMessage]:
            return [TimedMessage(t, b"\x05")] if received else []

    engine = Procedural(controller().arm, ControllerOptions())
    with running(engine, "pty") as emulated, mover(emulated) as arm:
        arm.take_controls()
        assert "CPRC232" in settled(arm, MoverState.FAILED)[-1].reason


def test_a_line_that_another_program_has_is_waited_for() -> None:
    with running(controller()) as emulated, mover(emulated) as first, mover(emulated) as second:
        ready(first)
        second.take_controls()
        stepped(second, after(0.3))
        assert second.step().state is MoverState.CONNECTING
        first.close()
        settled(second, MoverState.READY)


@pytest.mark.parametrize("end", [b"\r\n", b"\0", b""])
@pytest.mark.parametrize("terminator", [b"\r\n", b"\0", b""])
def test_every_terminator_in_use_is_understood(end: bytes, terminator: bytes) -> None:
    with running(controller(end=end)) as emulated, mover(emulated, terminator=terminator) as arm:
        ready(arm)


def test_an_order_of_the_reading_list_and_one_of_the_moving_list_are_two_types() -> None:
    from verify.devices.melfa import reader as reading

    source = Path(reading.__file__).read_text()
    assert "grab" not in source
    assert "melfa_motion" not in source
