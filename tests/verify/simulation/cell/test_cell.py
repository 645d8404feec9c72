"""The simulated cell against plain geometry; its devices keep the protocols of motion_port."""

from dataclasses import replace

import numpy as np
import pytest

import robots
from verify.grasping.actuators.protocols import (
    ExecutePermission,
    Gripper,
    GripperState,
    MotionRefusedError,
    Mover,
    MoverState,
)
from verify.simulation.cell.arm import CellArm, SimMover
from verify.simulation.cell.cell import RATE, CellWorld
from verify.simulation.cell.grab import CellSource
from verify.simulation.cell.hand import CellHand, SimGripper
from verify.simulation.cell.scene import Cap, CellScene, SceneEvent
from verify.simulation.cell.setup import SMALL_SIZE, cell_setup

SETUP = cell_setup(SMALL_SIZE)
RIGHT = ExecutePermission("test")


def test_a_sliding_cap_decelerates_to_rest() -> None:
    cap = Cap("blue", (0.4, 0.0), (0.1, 0.0), 2.0)
    x = [cap.place(t)[0] for t in (0.0, 1.0, 2.0, 5.0)]
    np.testing.assert_allclose(x, [0.4, 0.475, 0.5, 0.5])  # v t - v t² / 2T


def test_the_arm_is_late_by_its_delay_and_starts_from_where_it_stood() -> None:
    world = CellWorld(SETUP, CellScene((Cap("blue", (0.47, 0.0)),)))
    source = CellSource(world)
    mover, _ = source.devices(RIGHT)
    mover.take_controls()
    while mover.step().state is not MoverState.READY:
        source.wait()
    goal = SETUP.home + 1e-3
    mover.stream(goal)
    np.testing.assert_array_equal(world.arm.q(world.t), SETUP.home)
    source.wait()
    source.wait()
    np.testing.assert_allclose(world.arm.q(world.t), goal)


@pytest.mark.parametrize("turn_deg", [0.0, 200.0, -300.0])
def test_a_straight_move_begins_where_the_arm_stands_whatever_the_turn_of_its_wrist(
    turn_deg: float,
) -> None:
    arm, start, t = SETUP.workspace.arm, SETUP.home.copy(), 0.0
    start[5] = np.deg2rad(turn_deg)
    moved = CellArm(start, 0.0)
    mover = SimMover(moved, SETUP.workspace, lambda: t, RIGHT)
    mover.take_controls()
    t = 1.0
    mover.step()
    goal = start + np.linalg.solve(robots.jacobian(arm, start), [0, 0, -0.01, 0, 0, 0])
    mover.move(goal, on_line=True)
    while mover.step().state is MoverState.MOVING:
        np.testing.assert_allclose(moved.q(t), start, atol=0.1)
        t += 0.02
    shift = robots.forward(arm, moved.q(t))[:3, 3] - robots.forward(arm, start)[:3, 3]
    np.testing.assert_allclose(shift, [0.0, 0.0, -0.01], atol=1e-3)


def test_the_devices_are_those_of_the_protocols_and_need_the_right() -> None:
    source = CellSource(CellWorld(SETUP, CellScene((Cap("blue", (0.47, 0.0)),))))
    mover: Mover
    gripper: Gripper
    mover, gripper = source.devices(RIGHT)
    assert mover.step().state is MoverState.OFF
    assert gripper.step().state is GripperState.IDLE
    with pytest.raises(TypeError, match="permission"):
        source.devices(None)  # type: ignore[arg-type]


def test_nothing_is_taken_without_controls_or_beyond_a_limit() -> None:
    source = CellSource(CellWorld(SETUP, CellScene((Cap("blue", (0.47, 0.0)),))))
    mover, gripper = source.devices(RIGHT)
    with pytest.raises(MotionRefusedError):
        mover.stream(SETUP.home)
    with pytest.raises(MotionRefusedError):
        gripper.go_to(0.0, closing=True)
    mover.take_controls()
    while mover.step().state is not MoverState.READY:
        source.wait()
    with pytest.raises(MotionRefusedError, match="joint 1"):
        mover.stream(SETUP.home + 4.0 * np.eye(6)[0])


def test_an_object_that_slips_out_is_reported_as_lost() -> None:
    now = [0.0]
    hand = CellHand(0.07)
    gripper = SimGripper(hand, lambda: now[0], RIGHT)
    hand.between = 0.03
    gripper.activate()
    now[0] = 1.0
    gripper.step()
    gripper.go_to(0.0, closing=True)
    hand.advance(1.0)
    assert gripper.step().state is GripperState.GRIPPED
    hand.between = 0.0
    assert gripper.step().state is GripperState.LOST


def test_a_cap_beside_the_fingers_does_not_come_along() -> None:
    beside = CellScene((Cap("blue", (0.5, 0.2)),))
    world = CellWorld(SETUP, beside)
    world.hand.goal = 0.0
    for _ in range(60):
        world.advance(1 / RATE)
    assert world.held is None
    assert world.hand.opening == 0.0


def test_the_light_falls_to_half_within_a_second_and_a_dead_camera_gives_nothing() -> None:
    happenings = (SceneEvent("dusk", at=0.0), SceneEvent("camera_gone", at=1.5))
    world = CellWorld(SETUP, replace(CellScene((Cap("blue", (0.47, 0.0)),)), happenings=happenings))
    before = world.pair()
    for _ in range(36):
        world.advance(1 / RATE)
    after = world.pair()
    assert after.left.mean() == pytest.approx(before.left.mean() / 2, rel=0.02)
    for _ in range(12):
        world.advance(1 / RATE)
    assert world.pair() is None
