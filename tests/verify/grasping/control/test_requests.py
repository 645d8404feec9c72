"""Requests of a page: which count, in which order, and which are refused."""

from typing import Any

import pytest

from tests.support.grasp.cells import quick_cell
from tests.support.grasp.page import filled
from verify.grasping.actuators.protocols import ExecutePermission
from verify.grasping.control.aim import LoopCycle
from verify.grasping.control.requests import OperatorRequests, select_target
from verify.grasping.control.run import StopConditions, run
from verify.grasping.control.states import MOVING_STATES, GraspEvent, GraspState
from verify.grasping.tracking.target import BoxSelection, ColourSelection, TrackingOptions
from verify.grasping.tracking.track import TargetTracker
from verify.simulation.cell.grab import CellMode, CellRun, cell_grab
from verify.simulation.cell.scene import Cap, CellScene

SETUP = quick_cell()
STANDS = CellScene((Cap("blue", (0.47, 0.03)), Cap("green", (0.47, -0.12))), seed=1)
CAP = BoxSelection(filled(STANDS.caps[0], STANDS.caps[0].place(0.0)))


def made(*, execute: bool = True) -> CellRun:
    permission = ExecutePermission("test") if execute else None
    return cell_grab(SETUP, STANDS, permission=permission, mode=CellMode(closed=False))


def started(*, execute: bool = True) -> CellRun:
    grab = made(execute=execute)
    grab.loop.start()
    return grab


def cycled(grab: CellRun) -> LoopCycle:
    cycle = grab.loop.cycle(grab.source.pair())
    grab.source.wait()
    return cycle


def turned(grab: CellRun, until: GraspState, limit: int = 400) -> None:
    """Let the loop turn until it is in a state."""
    for _ in range(limit):
        if grab.loop.machine.state is until:
            return
        cycled(grab)
    raise AssertionError(grab.loop.machine.log)


def chosen(grab: CellRun, drawn: BoxSelection) -> str:
    return select_target(grab.loop, SETUP.rig, drawn, grab.source.pair())


def test_a_stop_discards_earlier_requests_and_a_late_order_is_refused() -> None:
    requests = OperatorRequests()
    requests.grab("3")
    requests.select("left 10,10,20,20")
    for _ in range(500):  # a flood stays small
        requests.hold()
        requests.grab("3")
        requests.grab("NaN")
    orders, drawn, refused = requests.taken(3, pictures=True)
    assert orders == (GraspEvent.HOLD, GraspEvent.GRAB)
    assert drawn is None
    assert (len(refused), requests.stops) == (1, 1)
    requests.grab("3")
    orders, _, refused = requests.taken(4, pictures=True)
    assert orders == ()
    assert "look again" in refused[0]


def test_a_selection_waits_for_pictures_and_the_newest_counts() -> None:
    requests = OperatorRequests()
    requests.select("left 10,10,20,20")
    requests.select("right 30,10,20,20")
    assert requests.taken(0, pictures=False)[1] is None
    assert requests.taken(0, pictures=True)[1] == BoxSelection((30, 10, 20, 20), "right")
    assert requests.taken(0, pictures=True)[1] is None


def test_a_box_without_a_colour_keeps_the_last_target() -> None:
    grab = started(execute=False)
    turned(grab, GraspState.TRACKING)
    known = grab.loop.aim.target
    assert "no colour" in chosen(grab, BoxSelection((20, 20, 40, 40)))
    assert "out of the picture" in chosen(grab, BoxSelection((600, 300, 60, 90), "right"))
    assert grab.loop.aim.target is known
    assert grab.loop.cycle(grab.source.pair()).state is GraspState.TRACKING


@pytest.mark.slow
def test_no_other_target_is_taken_while_anything_moves() -> None:
    grab = made()
    seen: set[GraspState] = set()

    def look(_: Any) -> None:
        state = grab.loop.machine.state
        if state in MOVING_STATES:
            seen.add(state)
            assert "now" in chosen(grab, CAP)
            with pytest.raises(ValueError, match="no other target"):
                grab.loop.look_for(None)

    def orders() -> list[GraspEvent]:
        return [GraspEvent.GRAB] if grab.loop.machine.planned else []

    ended = run(grab.loop, grab.source, StopConditions(20.0, 1.0), look, orders)
    assert ended.state is GraspState.LIFTED
    assert seen >= {
        GraspState.FOLLOWING, GraspState.APPROACHING, GraspState.CLOSING, GraspState.LIFTING,
    }  # fmt: skip


def test_no_plan_for_the_last_target_is_left_for_the_next() -> None:
    grab = started()
    turned(grab, GraspState.FOLLOWING)
    while not grab.loop.machine.planned:
        cycled(grab)
    assert grab.loop.tell(GraspEvent.HOLD) == ""
    for _ in range(20):
        cycled(grab)
    tracker = TargetTracker(SETUP.rig, ColourSelection("green"), TrackingOptions())
    grab.loop.look_for(tracker)
    grab.loop.tell(GraspEvent.RESUME)
    assert "lacks" in grab.loop.tell(GraspEvent.GRAB)
    turned(grab, GraspState.FOLLOWING)
    assert "lacks" in grab.loop.tell(GraspEvent.GRAB)


def test_a_hold_before_the_beginning_holds_from_the_beginning() -> None:
    grab = started()
    assert grab.loop.tell(GraspEvent.HOLD) == ""
    turned(grab, GraspState.HOLDING_OPERATOR)
    entered = [p.target for p in grab.loop.machine.log]
    assert entered == [GraspState.SEARCHING, GraspState.HOLDING_OPERATOR]
    assert grab.loop.tell(GraspEvent.RESUME) == ""
    turned(grab, GraspState.FOLLOWING)
