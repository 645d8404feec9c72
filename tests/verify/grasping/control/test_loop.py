"""Grasps in the simulated cell from start to a named end, against the world's truth."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from tests.support.grasp.cells import grip_error, kept_limits, quick_cell
from tests.support.grasp.monitor import MonitoredRun, monitored
from verify.grasping.actuators.protocols import ExecutePermission, MoverState, MoverStatus
from verify.grasping.control.aim import LoopCycle
from verify.grasping.control.run import GraspOutcome, StopConditions, run
from verify.grasping.control.states import GraspEvent, GraspState
from verify.simulation.cell.arm import SimMover
from verify.simulation.cell.grab import CellMode, cell_grab
from verify.simulation.cell.scene import Cap, CellScene, SceneEvent

ENDS = StopConditions(duration=20.0, patience=1.0)
STANDS = CellScene((Cap("blue", (0.47, 0.03)), Cap("green", (0.47, -0.12))), seed=1)


def made(
    scene: CellScene, *, execute: bool = True, auto: bool = True, stepped: bool = False
) -> MonitoredRun:
    permission = ExecutePermission("test") if execute else None
    # grasps with a look at the hand: test_closed_loop.py
    mode = CellMode(auto=auto, stepped=stepped, closed=False)
    return monitored(cell_grab(quick_cell(), scene, permission=permission, mode=mode))


def grabbed(
    scene: CellScene,
    *happenings: SceneEvent,
    orders: dict[GraspState, GraspEvent] | None = None,
    stepped: bool = False,
) -> tuple[MonitoredRun, GraspOutcome, list[LoopCycle]]:
    """Run to the end; each order is given once, ten cycles into its state."""
    grab = made(replace(scene, happenings=happenings), stepped=stepped)
    seen: list[LoopCycle] = []
    waiting = dict(orders or {})

    def given() -> Sequence[GraspEvent]:
        state = grab.loop.machine.state
        long = len(seen) > 10 and all(cycle.state is state for cycle in seen[-10:])
        return [waiting.pop(state)] if long and state in waiting else []

    return grab, run(grab.loop, grab.source, ENDS, seen.append, given), seen


def rests(seen: list[LoopCycle]) -> bool:
    last = [cycle.q for cycle in seen[-5:] if cycle.q is not None]
    return bool(np.abs(np.diff(last, axis=0)).max() < 1e-3)


def test_a_cap_is_tracked_gripped_within_3_mm_and_lifted() -> None:
    grab, ended, _ = grabbed(STANDS)
    world = grab.world
    assert ended.state is GraspState.LIFTED
    assert ended.released
    assert world.held[0] == 0
    assert grip_error(grab) < 3e-3
    height = world.cap(0, world.t)
    assert height[2, 3] > 0.1
    assert kept_limits(grab)
    assert [p.target for p in ended.passages] == [
        GraspState.SEARCHING, GraspState.TRACKING, GraspState.FOLLOWING, GraspState.APPROACHING,
        GraspState.CLOSING, GraspState.CHECKING, GraspState.LIFTING, GraspState.LIFTED,
        GraspState.RELEASING, GraspState.RELEASED,
    ]  # fmt: skip


def test_nothing_moves_without_the_right() -> None:
    grab = made(STANDS, execute=False, auto=False)
    home = grab.world.arm.q(0.0)
    ended = run(grab.loop, grab.source, ENDS, lambda _: None)
    assert ended.state is GraspState.TRACKING
    assert grab.loop.aim.plan is not None
    assert np.array_equal(grab.world.arm.q(grab.world.t), home)


SLIDES = CellScene((Cap("blue", (0.46, -0.06), (0.02, 0.06), 2.0),), seed=2)
OUT_OF_REACH = CellScene((Cap("blue", (0.345, 0.0)),), seed=3)
TOO_WIDE = CellScene((Cap("blue", (0.47, 0.0), radius=0.042, height=0.03),), seed=3)
CAMERA_GONE = SceneEvent("camera_gone", near=0.09)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "happenings", "stepped", "state", "reason"),
    [
        (STANDS, [], True, GraspState.LIFTED, ""),
        (SLIDES, [], False, GraspState.LIFTED, ""),
        (STANDS, [SceneEvent("dusk", at=1.0)], False, GraspState.LIFTED, ""),
        (STANDS, [SceneEvent("hidden", at=0.9, lasts=1.6)], False, GraspState.LIFTED, ""),
        (STANDS, [CAMERA_GONE], False, GraspState.HOLDING_STALE, ""),
        (STANDS, [CAMERA_GONE], True, GraspState.HOLDING_STALE, ""),
        (STANDS, [SceneEvent("alarm", near=0.08)], False, GraspState.FAULT, "0930"),
        (STANDS, [SceneEvent("taken", near=0.03)], False, GraspState.MISSED, ""),
        (STANDS, [SceneEvent("taken", near=0.16)], False, GraspState.HOLDING_LOST, ""),
        (OUT_OF_REACH, [], False, GraspState.HOLDING_UNREACHABLE, "posture"),
        (TOO_WIDE, [], False, GraspState.HOLDING_UNREACHABLE, "wide"),
    ],
    ids=[
        "one move at a time", "it slides and stops", "the light halves", "hidden a while",
        "no camera", "no camera, one move at a time", "alarm", "taken at the last moment",
        "taken before", "out of reach", "too wide",
    ],
)  # fmt: skip
def test_a_grasp_ends_in_the_state_that_fits(
    scene: CellScene, happenings: list[SceneEvent], stepped: bool, state: GraspState, reason: str
) -> None:
    grab, ended, seen = grabbed(scene, *happenings, stepped=stepped)
    assert ended.state is state
    assert reason in ended.reason
    assert (grab.world.held is not None) == (state is GraspState.LIFTED)
    assert kept_limits(grab) or state is GraspState.FAULT  # power off stops harder
    assert rests(seen)
    if state is GraspState.MISSED:
        assert grab.world.grip()[2, 3] > 0.1
    if happenings and happenings[0].what == "hidden":
        assert GraspState.HOLDING_LOST in [p.target for p in ended.passages]


@pytest.mark.slow
def test_a_target_that_leaves_both_pictures_and_returns_is_grasped_after_it() -> None:
    leaves = Cap("blue", (0.45, 0.0), (0.0, 1.2), 1.0, away=0.8)
    grab, ended, seen = grabbed(replace(STANDS, caps=(leaves,)))
    away = [cycle for cycle in seen if 1.2 < cycle.t < 1.8]
    assert {c.observation.status for c in away if c.observation is not None} == {"lost"}
    assert {cycle.state for cycle in away} == {GraspState.SEARCHING}
    assert rests(away)
    assert ended.state is GraspState.LIFTED
    assert grab.world.held is not None
    assert kept_limits(grab)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("during", "then", "stepped", "state"),
    [
        (GraspState.APPROACHING, GraspEvent.RETREAT, False, GraspState.MISSED),
        (GraspState.APPROACHING, GraspEvent.RETREAT, True, GraspState.MISSED),
        (GraspState.LIFTING, GraspEvent.RESUME, False, GraspState.LIFTED),
    ],
)
def test_a_hold_stops_down_and_up_keeps_the_grip_and_the_hand_rises_on_order(
    during: GraspState, then: GraspEvent, stepped: bool, state: GraspState
) -> None:
    orders = {during: GraspEvent.HOLD, GraspState.HOLDING_OPERATOR: then}
    grab, ended, _ = grabbed(STANDS, orders=orders, stepped=stepped)
    assert GraspState.HOLDING_OPERATOR in [p.target for p in ended.passages]
    assert ended.state is state
    assert (grab.world.held is not None) == (state is GraspState.LIFTED)
    assert grab.world.grip()[2, 3] > 0.1
    assert kept_limits(grab)


@pytest.mark.slow
def test_a_hold_on_the_way_around_a_wall_stops_there_and_the_hand_gets_above_after() -> None:
    """Joints by themselves end at the box's far wall: a way that was looked at leads on."""
    grab = made(CellScene((Cap("blue", (0.525, -0.06)),), seed=1))
    orders = [(1.75, GraspEvent.HOLD), (2.3, GraspEvent.RESUME)]
    above: list[float] = []

    def given() -> Sequence[GraspEvent]:
        if grab.loop.machine.state is GraspState.APPROACHING and not above:
            above.append(float(np.linalg.norm(grab.world.grip()[:2, 3] - (0.525, -0.06))))
        return [orders.pop(0)[1]] if orders and grab.world.t >= orders[0][0] else []

    ended = run(grab.loop, grab.source, ENDS, lambda _: None, given)
    assert ended.state is GraspState.LIFTED
    assert GraspState.HOLDING_OPERATOR in [p.target for p in ended.passages]
    assert above[0] < 5e-3  # it began where the line down does
    assert kept_limits(grab)


def test_ctrl_c_in_mid_approach_comes_to_rest_and_gives_the_controls_back() -> None:
    grab = made(STANDS)
    near = lambda: bool(grab.loop.machine.state is GraspState.APPROACHING)  # noqa: E731
    ended = run(grab.loop, grab.source, ENDS, lambda _: None, stop=near)
    assert ended.stopped
    assert ended.released
    assert kept_limits(grab)


def test_controls_of_an_arm_that_does_not_answer_are_not_said_to_be_given_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    step, why = SimMover.step, "the controller did not answer: stop, servo off"

    def unanswered(mover: SimMover) -> MoverStatus:
        status = step(mover)
        if status.state is not MoverState.RELEASED:
            return status
        return replace(status, state=MoverState.FAILED, reason=why, given_back=False)

    monkeypatch.setattr(SimMover, "step", unanswered)
    said: list[str] = []
    grab = made(STANDS)
    near = lambda: bool(grab.loop.machine.state is GraspState.FOLLOWING)  # noqa: E731
    ended = run(grab.loop, grab.source, ENDS, lambda _: None, say=said.append, stop=near)
    assert not ended.released
    assert said == [f"the controls were NOT given back: {why}. Look whether it stands"]
    # neither is the arm said to be at rest
    assert GraspEvent.STOPPED not in [passage.event for passage in ended.passages]


def test_a_grasp_that_never_began_says_what_it_waited_for() -> None:
    grab = made(STANDS, execute=False, auto=False)
    grab.loop._joints = lambda: None
    ended = run(grab.loop, grab.source, StopConditions(0.5, 5.0), lambda _: None)
    assert (ended.state, ended.reason) == (GraspState.IDLE, "no joint angles yet")
