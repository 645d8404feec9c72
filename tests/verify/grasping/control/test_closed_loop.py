"""Grasps in the simulated cell by an arm whose joints are off, and whose encoders do not know."""

from concurrent.futures import Future
from dataclasses import replace

import numpy as np
import pytest

import robots
from tests.support.grasp.cells import grip_error, kept_limits, quick_cell
from tests.support.grasp.monitor import MonitoredRun, monitored
from verify.grasping.actuators.protocols import ExecutePermission
from verify.grasping.control.aim import Aim
from verify.grasping.control.run import GraspOutcome, StopConditions, run
from verify.grasping.control.states import GraspState
from verify.grasping.tool_offset.offset import FlangeMeasurement, OffsetMeasurement
from verify.grasping.tool_offset.watch import MAX_PICTURES, FlangeWatch
from verify.simulation.cell.cell import CellWorld
from verify.simulation.cell.grab import CellMode, cell_grab
from verify.simulation.cell.scene import Cap, CellScene

SETUP = quick_cell()
ENDS = StopConditions(duration=20.0, patience=1.0)
STANDS = CellScene((Cap("blue", (0.47, 0.03)),), seed=1)
FIRST = np.eye(6)[0]


def off_by(joint: int, degrees: float) -> CellScene:
    return replace(STANDS, joint_errors=tuple((np.deg2rad(degrees) * np.eye(6)[joint]).tolist()))


def grabbed(scene: CellScene, *, closed: bool = True) -> tuple[MonitoredRun, GraspOutcome]:
    mode = CellMode(auto=True, closed=closed)
    grab = monitored(cell_grab(SETUP, scene, permission=ExecutePermission("test"), mode=mode))
    return grab, run(grab.loop, grab.source, ENDS, lambda _: None)


def hand(grab: MonitoredRun) -> OffsetMeasurement:
    return grab.loop.aim.planned.thing.offset


@pytest.mark.slow
def test_a_joint_that_is_off_leads_beside_the_object_until_it_is_corrected() -> None:
    without, _ = grabbed(off_by(0, 0.4), closed=False)
    grab, ended = grabbed(off_by(0, 0.4))
    assert ended.state is GraspState.LIFTED
    assert hand(grab).used
    assert grip_error(without) > 2.3e-3
    assert grip_error(grab) < 1e-3
    assert kept_limits(grab)
    true, plan, found = grab.monitor.closed_on, grab.loop.aim.plan, hand(grab).hand
    left = true - SETUP.workspace.grip(plan.posture.q_grip)[:3, 3] - found.off
    assert left @ np.linalg.solve(found.covariance, left) < 16.3  # chi², 3 degrees, 0.1 %


@pytest.mark.slow
def test_dark_leds_are_reported_and_the_grasp_continues(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("verify.simulation.cell.render._draw_led", lambda *_: None)
    grab, ended = grabbed(STANDS)
    assert ended.state is GraspState.LIFTED
    found = hand(grab)
    assert not found.used
    assert found.hand is None
    assert f"in 0 of {MAX_PICTURES} pictures; nothing was corrected" in found.reason
    assert grip_error(grab) < 3e-3


@pytest.mark.slow
def test_a_hand_too_far_off_is_not_corrected_and_the_margin_decides() -> None:
    """1.4° at the first joint are 12 mm: the cap still fits between the fingers, or it does not."""
    grab, ended = grabbed(off_by(0, 1.4))
    found = hand(grab)
    assert not found.used
    assert found.hand is not None
    assert "more than the 10 mm that are corrected" in found.reason
    assert ended.state in (GraspState.LIFTED, GraspState.MISSED)
    assert (grab.world.held is not None) == (ended.state is GraspState.LIFTED)
    wide = replace(off_by(0, 1.4), caps=(Cap("blue", (0.47, 0.03), radius=0.029, height=0.03),))
    grab, ended = grabbed(wide)
    assert ended.state is GraspState.HOLDING_UNREACHABLE
    assert "gripper leaves" in ended.reason


@pytest.mark.slow
@pytest.mark.parametrize(
    "far", [(0.525, -0.06), pytest.param((0.439, -0.021), marks=pytest.mark.long)]
)
def test_the_hand_is_measured_where_it_was_hidden_before(far: tuple[float, float]) -> None:
    """At the box's far wall, where joints by themselves do not get to; where LEDs look alike."""
    grab, ended = grabbed(CellScene((Cap("blue", far),), seed=1))
    assert ended.state is GraspState.LIFTED
    assert hand(grab).used
    assert grip_error(grab) < 1e-3
    assert kept_limits(grab)


def test_no_pairs_are_taken_before_rest_or_during_motion() -> None:
    world = CellWorld(SETUP, STANDS)
    waiting: list[object] = []

    def later(work: object) -> Future[FlangeMeasurement]:
        waiting.append(work)
        return Future()

    watch = FlangeWatch(SETUP.workspace.arm, SETUP.rig, SETUP.marker, later)
    q = SETUP.home
    for now in (0.0, 0.1, 0.2):
        world.t = now
        watch.update(world.pair(), None)
        assert watch.gather(now, q) is None
    assert not waiting
    world.t = 0.4
    watch.update(world.pair(), None)
    assert watch.gather(0.4, q) is None
    assert len(waiting) == 1
    assert watch.gather(0.5, q) is None  # nobody waits for what is being measured
    assert watch.gather(0.5, q + 0.01 * FIRST) is None  # elsewhere: all begins anew
    assert len(waiting) == 1


def test_moving_encoders_end_the_measurement() -> None:
    world = CellWorld(SETUP, STANDS)
    watch = FlangeWatch(SETUP.workspace.arm, SETUP.rig, SETUP.marker)
    gathered = None
    for turn in range(100):
        world.t = turn / 30
        watch.update(world.pair(), None)
        reading = world.encoders()
        watch.update(None, replace(reading, q=reading.q + 1e-4 * turn * FIRST))
        gathered = watch.gather(world.t, SETUP.home)
        if gathered is not None:
            break
    sights, read = gathered
    assert len(sights) == MAX_PICTURES  # at home the LEDs are out of sight
    assert {sight.status for sight in sights} <= {"too_few_leds", "ambiguous_leds"}
    assert read is None


@pytest.mark.parametrize("turn_deg", [0.0, 170.0, 200.0, -300.0])
def test_a_line_down_ends_in_the_wrist_posture_in_which_it_begins(turn_deg: float) -> None:
    approach, start = SETUP.cell.approach, SETUP.home.copy()
    start[5] = np.deg2rad(turn_deg)
    end, step = start, approach.height / 500 * np.append(approach.direction, np.zeros(3))
    for _ in range(500):
        end = end + np.linalg.solve(robots.jacobian(SETUP.workspace.arm, end), step)
    found = Aim(SETUP.workspace, SETUP.rig)._end(start)
    np.testing.assert_allclose(found, end, atol=2e-3)
