"""The grab's states: no motion without the right to it, and every failure ends safely."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.grasp.cells import DOCS
from verify.grasping.cell import StillnessCriterion, WatchdogLimits
from verify.grasping.control.states import (
    ARM_ORDERS,
    FINGER_ORDERS,
    MOVING_STATES,
    ORDERS,
    TRANSITIONS,
    DeviceOrder,
    GraspEvent,
    GraspState,
    StateMachine,
    TransitionCondition,
)
from verify.grasping.control.watchdog import Observation, StillWatch, Watchdog

LIMITS = WatchdogLimits(stale=0.3, lost=1.0, joints=0.5, moving=10.0)
STILL = StillnessCriterion(speed=0.01, duration=0.5)
# where a grab may end, or wait for as long as it likes
SAFE = {
    GraspState.IDLE, GraspState.LIFTED, GraspState.MISSED, GraspState.HOLDING_STALE,
    GraspState.HOLDING_LOST, GraspState.HOLDING_UNREACHABLE, GraspState.HOLDING_OPERATOR,
    GraspState.FAULT, GraspState.RELEASED,
}  # fmt: skip
WHOLE_GRAB = [
    GraspEvent.START, GraspEvent.FOUND, GraspEvent.FOLLOW, GraspEvent.GRAB,
    GraspEvent.AT_OBJECT, GraspEvent.CLOSED, GraspEvent.HELD, GraspEvent.AT_TOP,
]  # fmt: skip
events = st.lists(st.sampled_from(list(GraspEvent)), max_size=40)


def machine(execute: bool = True) -> StateMachine:
    made = StateMachine(execute, lambda: 0.0)
    made.still = made.planned = True
    return made


def after(*output: GraspEvent, execute: bool = True) -> StateMachine:
    made = machine(execute)
    for event in output:
        assert made.tell(event), (made.state, event)
    return made


def in_state(state: GraspState) -> StateMachine:
    """A machine led to a state by events alone: breadth first through the table."""
    ways: list[list[GraspEvent]] = [[]]
    seen = {(GraspState.IDLE, False, False)}
    for way in ways:
        made = after(*way)
        if made.state is state:
            return made
        for event in GraspEvent:
            made = after(*way)
            if made.tell(event) and (made.state, made.low, made.carrying) not in seen:
                seen.add((made.state, made.low, made.carrying))
                ways.append([*way, event])
    raise AssertionError(f"{state} is never reached")


def test_a_whole_grab_goes_through_every_step_and_is_logged() -> None:
    made = after(*WHOLE_GRAB)
    assert made.state is GraspState.LIFTED
    assert [passage.event for passage in made.log] == WHOLE_GRAB
    assert all(passage.reason for passage in made.log)
    assert made.carrying
    assert not made.low


@given(events)
def test_without_the_right_to_move_nothing_is_ever_ordered_to_move(
    output: list[GraspEvent],
) -> None:
    made = machine(execute=False)
    for event in [*WHOLE_GRAB, *output]:
        made.tell(event)
        assert made.order not in ARM_ORDERS | FINGER_ORDERS


def test_no_way_leads_into_motion_but_out_of_motion_or_with_the_right() -> None:
    assert {ORDERS[state] for state in SAFE} == {DeviceOrder.HOLD, DeviceOrder.NONE}
    for way in TRANSITIONS:
        if way.target in MOVING_STATES:
            assert (
                way.source in MOVING_STATES | {GraspState.CHECKING}
                or TransitionCondition.EXECUTE in way.needs
            )


@pytest.mark.parametrize("state", sorted(MOVING_STATES), ids=str)
def test_every_failure_stops_every_motion_at_once_and_safely(state: GraspState) -> None:
    failures = [GraspEvent.STALE, GraspEvent.DEVICE_ERROR, GraspEvent.HOLD]
    if state in {GraspState.FOLLOWING, GraspState.APPROACHING}:  # what goes after the target
        failures += [GraspEvent.LOST, GraspEvent.UNREACHABLE]
    for failure in failures:
        made = in_state(state)
        assert made.tell(failure, "because")
        assert made.state in SAFE
        assert made.reason == "because"


@given(events, st.booleans(), st.booleans())
def test_an_interrupt_holds_and_then_releases_from_anywhere_and_an_error_is_a_fault(
    output: list[GraspEvent], execute: bool, broken: bool
) -> None:
    made = machine(execute)
    for event in output:
        made.tell(event)
    if broken:
        made.tell(GraspEvent.DEVICE_ERROR)
        assert made.state in {GraspState.FAULT, GraspState.RELEASED}
    if made.state is not GraspState.RELEASED:
        made.tell(GraspEvent.INTERRUPT)
        assert made.state in {GraspState.RELEASING, GraspState.RELEASED}
        assert made.order in {DeviceOrder.RELEASE, DeviceOrder.NONE}
    made.tell(GraspEvent.STOPPED)
    assert made.state is GraspState.RELEASED
    for event in GraspEvent:  # and that is the end
        assert not made.tell(event)


@pytest.mark.parametrize("state", list(GraspState), ids=str)
def test_a_grab_begins_from_following_alone_with_a_still_target_and_a_plan(
    state: GraspState,
) -> None:
    for need in (TransitionCondition.STILL, TransitionCondition.PLANNED, None):
        made = in_state(state)
        assert made.order is ORDERS[state]
        made.still = need is not TransitionCondition.STILL
        made.planned = need is not TransitionCondition.PLANNED
        follows = state is GraspState.FOLLOWING
        assert made.lacks(GraspEvent.GRAB) == (need.value if follows and need else "")
        assert made.tell(GraspEvent.GRAB) == (follows and need is None)


def test_a_hand_that_is_low_is_never_streamed_about() -> None:
    made = after(*WHOLE_GRAB[:4], GraspEvent.LOST)
    assert made.state is GraspState.HOLDING_LOST
    made.tell(GraspEvent.FOUND)
    assert made.state is GraspState.HOLDING_OPERATOR  # not tracking, whence it would follow
    assert not made.tell(GraspEvent.RESUME)
    assert made.tell(GraspEvent.RETREAT)
    assert made.order is DeviceOrder.OPEN
    assert made.tell(GraspEvent.OPENED)
    assert made.order is DeviceOrder.RETREAT
    made.tell(GraspEvent.AT_TOP)
    assert made.state is GraspState.MISSED
    made.tell(GraspEvent.RESUME)
    assert made.state is GraspState.SEARCHING


@given(events)
def test_no_low_hand_follows_or_searches(output: list[GraspEvent]) -> None:
    made = machine()
    for event in [*WHOLE_GRAB[:4], *output]:
        made.tell(event)
        if made.low:
            assert made.order is not DeviceOrder.FOLLOW
        if made.order is DeviceOrder.LIFT:
            assert made.carrying


def seen(t: float, **changes: object) -> Observation:
    usual = {"pictures_t": t, "joints_t": t, "tracked_t": t, "position": np.zeros(3)}
    return Observation(**{**usual, **changes})  # type: ignore[arg-type]


def watched(execute: bool = True, auto: bool = False) -> tuple[StateMachine, Watchdog]:
    made = StateMachine(execute, lambda: 0.0)
    made.planned = True
    made.tell(GraspEvent.START)
    return made, Watchdog(made, LIMITS, STILL, auto=auto)


def test_a_tracked_target_is_followed_and_grabbed_once_it_is_still() -> None:
    made, dog = watched(auto=True)
    states = [dog.observe(t, seen(t)) for t in np.arange(0.0, 0.7, 0.1).tolist()]
    assert states[0] is GraspState.FOLLOWING
    assert states[-1] is GraspState.APPROACHING
    assert made.log[-1].event is GraspEvent.GRAB


@pytest.mark.parametrize(
    ("changes", "ends", "word"),
    [
        ({"pictures_t": 4.6}, GraspState.HOLDING_STALE, "pictures"),
        ({"pictures_t": float("nan")}, GraspState.HOLDING_STALE, "pictures"),
        ({"joints_t": 4.4}, GraspState.HOLDING_STALE, "joint angles"),
        ({"joints_t": None}, GraspState.HOLDING_STALE, "no joint angles yet"),
        ({"tracked_t": 3.9, "position": None}, GraspState.HOLDING_LOST, "sight"),
        ({"unreachable": "too far"}, GraspState.HOLDING_UNREACHABLE, "too far"),
        ({"device_error": "alarm 5640"}, GraspState.FAULT, "alarm 5640"),
    ],
)
def test_the_watchdog_holds_the_arm_and_states_the_reason(
    changes: dict[str, object], ends: GraspState, word: str
) -> None:
    made, dog = watched()
    dog.observe(4.9, seen(4.9))
    assert made.state is GraspState.FOLLOWING
    assert dog.observe(5.0, seen(5.0, **changes)) is ends
    assert word in made.reason


def test_the_target_may_hide_behind_the_hand_on_the_last_stretch_alone() -> None:
    _, dog = watched(auto=True)
    for t in np.arange(0.0, 0.7, 0.1).tolist():
        dog.observe(t, seen(t))
    gone = {"tracked_t": 0.6, "position": None}
    assert dog.observe(2.0, seen(2.0, **gone, hidden=True)) is GraspState.APPROACHING
    assert dog.observe(2.1, seen(2.1, **gone)) is GraspState.HOLDING_LOST


def test_what_takes_too_long_is_a_fault() -> None:
    made, dog = watched(auto=True)
    for t in np.arange(0.0, 0.7, 0.1).tolist():
        dog.observe(t, seen(t))
    assert dog.observe(9.9, seen(9.9)) is GraspState.APPROACHING
    assert dog.observe(10.1, seen(10.1)) is GraspState.FAULT
    assert "took over 10 s" in made.reason


def test_a_camera_that_comes_back_lets_it_go_on_with_or_without_the_target() -> None:
    made, dog = watched()
    dog.observe(0.0, seen(0.0))
    assert dog.observe(1.0, seen(0.0)) is GraspState.HOLDING_STALE
    nothing = {"tracked_t": -5.0, "position": None}
    assert dog.observe(1.1, seen(1.1, **nothing)) is GraspState.SEARCHING
    assert dog.observe(1.2, seen(1.2)) is GraspState.FOLLOWING
    assert made.reason


@settings(max_examples=50)
@given(
    st.lists(
        st.tuples(st.floats(0, 2), st.floats(0, 2), st.floats(0, 2), st.booleans(), st.booleans()),
        max_size=30,
    ),
    events,
)
def test_stale_or_broken_inputs_stop_all_motion(
    ages: list[tuple[float, float, float, bool, bool]], output: list[GraspEvent]
) -> None:
    made, dog = watched(auto=True)
    for step, (pictures, joints, tracked, broken, there) in enumerate(ages):
        now = 0.1 * step
        if output:
            made.tell(output[step % len(output)])
        place, error = np.zeros(3) if there else None, "alarm" if broken else ""
        times = (now - pictures, now - joints, now - tracked)
        dog.observe(now, Observation(*times, place, device_error=error))
        if broken or pictures > LIMITS.stale + 1e-9 or joints > LIMITS.joints + 1e-9:
            assert made.order not in ARM_ORDERS | FINGER_ORDERS
        if tracked > LIMITS.lost + 1e-9:
            assert made.order is not DeviceOrder.FOLLOW


@pytest.mark.parametrize(
    ("speed", "still"), [(0.0, True), (0.008, True), (0.03, False), (0.5, False)]
)
def test_still_means_that_all_places_of_a_while_lie_together(speed: float, still: bool) -> None:
    watch = StillWatch(STILL)
    output = [watch.see(t, np.array([speed * t, 0, 0])) for t in np.arange(0, 2, 0.05).tolist()]
    assert not any(output[:9])  # less than the while has passed
    assert all(output[12:]) if still else not any(output)
    assert not watch.see(2.0, None)  # out of sight it is not still, nor at once after it
    assert not watch.see(2.05, np.zeros(3))


def test_the_page_lists_every_state() -> None:
    page = DOCS.read_text("utf-8").partition("## States")[2]
    for state in GraspState:
        assert f"`{state}`" in page
