"""The grab's states: no motion without the right to it, and every failure ends safely."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.verify.grab.planned_cell import DOCS
from verify.grab.cell_file import Stillness, WatchLimits
from verify.grab.states import (
    ARM_MOVES,
    FINGERS_MOVE,
    MOVING,
    ORDERS,
    Event,
    Need,
    Order,
    State,
)
from verify.grab.states_machine import Machine
from verify.grab.states_table import TRANSITIONS
from verify.grab.states_watch import Observation, StillWatch, Watchdog

LIMITS = WatchLimits(stale=0.3, lost=1.0, joints=0.5, moving=10.0)
STILL = Stillness(speed=0.01, duration=0.5)
HOLDING = [s for s in State if s.value.startswith("holding-")]
SAFE = frozenset(  # where a grab may end, or wait for as long as it likes
    {
        State.IDLE,
        State.LIFTED,
        State.MISSED,
        State.HOLDING_STALE,
        State.HOLDING_LOST,
        State.HOLDING_UNREACHABLE,
        State.HOLDING_OPERATOR,
        State.FAULT,
        State.RELEASED,
    }
)
WHOLE_GRAB = [
    Event.START, Event.FOUND, Event.FOLLOW, Event.GRAB, Event.AT_OBJECT, Event.CLOSED,
    Event.HELD, Event.AT_TOP,
]  # fmt: skip
events = st.lists(st.sampled_from(list(Event)), max_size=40)


class Clock:
    def __init__(self) -> None:
        self.t = 0.0

    def __call__(self) -> float:
        return self.t


def machine(execute: bool = True) -> Machine:
    made = Machine(execute, Clock())
    made.still = made.planned = True
    return made


def after(*told: Event, execute: bool = True) -> Machine:
    made = machine(execute)
    for event in told:
        assert made.tell(event), (made.state, event)
    return made


def in_state(state: State) -> Machine:
    """A machine led to a state by events alone: breadth first through the table."""
    ways: list[list[Event]] = [[]]
    seen = {(State.IDLE, False, False)}
    for way in ways:
        made = after(*way)
        if made.state is state:
            return made
        for event in Event:
            made = after(*way)
            if made.tell(event) and (made.state, made.low, made.carrying) not in seen:
                seen.add((made.state, made.low, made.carrying))
                ways.append([*way, event])
    raise AssertionError(f"{state} is never reached")


@pytest.mark.parametrize("state", list(State), ids=str)
def test_every_state_is_reached_and_has_an_order(state: State) -> None:
    made = in_state(state)
    assert made.order is ORDERS[state]


def test_a_whole_grab_goes_through_every_step_and_is_logged() -> None:
    made = after(*WHOLE_GRAB)
    assert made.state is State.LIFTED
    assert [passage.event for passage in made.log] == WHOLE_GRAB
    assert all(passage.reason for passage in made.log)
    assert made.carrying
    assert not made.low


@given(events)
def test_without_the_right_to_move_nothing_is_ever_ordered_to_move(told: list[Event]) -> None:
    made = machine(execute=False)
    for event in [*WHOLE_GRAB, *told]:
        made.tell(event)
        assert made.order not in ARM_MOVES | FINGERS_MOVE


def test_no_way_leads_into_motion_but_out_of_motion_or_with_the_right() -> None:
    for way in TRANSITIONS:
        if way.target in MOVING:
            assert way.source in MOVING | {State.CHECKING} or Need.EXECUTE in way.needs


@pytest.mark.parametrize("state", sorted({*HOLDING, *SAFE}), ids=str)
def test_a_state_that_holds_orders_no_motion(state: State) -> None:
    assert ORDERS[state] in {Order.HOLD, Order.NONE}
    assert state not in MOVING


@pytest.mark.parametrize("state", sorted(MOVING), ids=str)
@pytest.mark.parametrize("failure", [Event.STALE, Event.DEVICE_ERROR, Event.HOLD])
def test_every_failure_stops_every_motion_at_once_and_safely(state: State, failure: Event) -> None:
    made = in_state(state)
    assert made.tell(failure, "because")
    assert made.state in SAFE
    assert made.reason == "because"


@pytest.mark.parametrize("state", [State.FOLLOWING, State.APPROACHING], ids=str)
@pytest.mark.parametrize("failure", [Event.LOST, Event.UNREACHABLE])
def test_what_goes_after_the_target_holds_without_it(state: State, failure: Event) -> None:
    made = in_state(state)
    assert made.tell(failure)
    assert made.state in SAFE


@given(events, st.booleans())
def test_an_interrupt_holds_and_then_releases_from_anywhere(
    told: list[Event], execute: bool
) -> None:
    made = machine(execute)
    for event in told:
        made.tell(event)
    if made.state is not State.RELEASED:
        made.tell(Event.INTERRUPT)
        assert made.state in {State.RELEASING, State.RELEASED}
        assert made.order in {Order.RELEASE, Order.NONE}
    made.tell(Event.STOPPED)
    assert made.state is State.RELEASED
    for event in Event:  # and that is the end
        assert not made.tell(event)


@given(events)
def test_a_device_error_is_a_fault_from_anywhere(told: list[Event]) -> None:
    made = machine()
    for event in told:
        made.tell(event)
    made.tell(Event.DEVICE_ERROR)
    assert made.state in {State.FAULT, State.RELEASED}


@pytest.mark.parametrize("need", [Need.STILL, Need.PLANNED])
def test_a_grab_needs_a_still_target_and_a_plan(need: Need) -> None:
    made = after(*WHOLE_GRAB[:3])
    made.still, made.planned = need is not Need.STILL, need is not Need.PLANNED
    assert not made.tell(Event.GRAB)
    assert made.state is State.FOLLOWING
    assert made.lacks(Event.GRAB) == {need}


@pytest.mark.parametrize("state", [s for s in State if s is not State.FOLLOWING], ids=str)
def test_a_grab_begins_from_following_alone(state: State) -> None:
    made = in_state(state)
    made.tell(Event.GRAB)
    assert made.state is state


def test_a_hand_that_is_low_is_never_streamed_about() -> None:
    made = after(*WHOLE_GRAB[:4], Event.LOST)
    assert made.state is State.HOLDING_LOST
    made.tell(Event.FOUND)
    assert made.state is State.HOLDING_OPERATOR  # not tracking, whence it would follow
    assert not made.tell(Event.RESUME)
    assert made.tell(Event.RETREAT)
    assert [made.order, made.tell(Event.OPENED), made.order] == [Order.OPEN, True, Order.RETREAT]
    made.tell(Event.AT_TOP)
    assert made.state is State.MISSED
    made.tell(Event.RESUME)
    assert made.state is State.SEARCHING


@given(events)
def test_no_low_hand_follows_or_searches(told: list[Event]) -> None:
    made = machine()
    for event in [*WHOLE_GRAB[:4], *told]:
        made.tell(event)
        if made.low:
            assert made.order is not Order.FOLLOW
        if made.order is Order.LIFT:
            assert made.carrying


def test_the_gripper_that_holds_nothing_is_opened_and_comes_back_up() -> None:
    made = after(*WHOLE_GRAB[:6], Event.NOTHING_HELD, Event.OPENED, Event.AT_TOP)
    assert made.state is State.MISSED
    assert State.LIFTED not in {passage.target for passage in made.log}


def seen(t: float, **changes: object) -> Observation:
    usual = {"pictures_t": t, "joints_t": t, "tracked_t": t, "position": np.zeros(3)}
    return Observation(**{**usual, **changes})  # type: ignore[arg-type]


def watched(execute: bool = True, auto: bool = False) -> tuple[Machine, Watchdog]:
    made = Machine(execute, Clock())
    made.planned = True
    made.tell(Event.START)
    return made, Watchdog(made, LIMITS, STILL, auto=auto)


def test_a_tracked_target_is_followed_and_grabbed_once_it_is_still() -> None:
    made, dog = watched(auto=True)
    states = [dog.observe(t, seen(t)) for t in np.arange(0.0, 0.7, 0.1).tolist()]
    assert states[0] is State.FOLLOWING
    assert states[-1] is State.APPROACHING
    assert made.log[-1].event is Event.GRAB


def test_without_the_right_to_move_it_only_tracks() -> None:
    _, dog = watched(execute=False, auto=True)
    assert {dog.observe(t, seen(t)) for t in (0.0, 0.5, 1.0)} == {State.TRACKING}


@pytest.mark.parametrize(
    ("changes", "ends", "word"),
    [
        ({"pictures_t": 4.6}, State.HOLDING_STALE, "pictures"),
        ({"pictures_t": float("nan")}, State.HOLDING_STALE, "pictures"),
        ({"joints_t": 4.4}, State.HOLDING_STALE, "joint angles"),
        ({"joints_t": None}, State.HOLDING_STALE, "no joint angles yet"),
        ({"tracked_t": 3.9, "position": None}, State.HOLDING_LOST, "sight"),
        ({"unreachable": "too far"}, State.HOLDING_UNREACHABLE, "too far"),
        ({"device_error": "alarm 5640"}, State.FAULT, "alarm 5640"),
    ],
)
def test_the_watchdog_holds_what_follows_and_says_why(
    changes: dict[str, object], ends: State, word: str
) -> None:
    made, dog = watched()
    dog.observe(4.9, seen(4.9))
    assert made.state is State.FOLLOWING
    assert dog.observe(5.0, seen(5.0, **changes)) is ends
    assert word in made.reason


def test_the_target_may_hide_behind_the_hand_on_the_last_stretch_alone() -> None:
    _, dog = watched(auto=True)
    for t in np.arange(0.0, 0.7, 0.1).tolist():
        dog.observe(t, seen(t))
    gone = {"tracked_t": 0.6, "position": None}
    assert dog.observe(2.0, seen(2.0, **gone, hidden=True)) is State.APPROACHING
    assert dog.observe(2.1, seen(2.1, **gone)) is State.HOLDING_LOST


def test_what_takes_too_long_is_a_fault() -> None:
    made, dog = watched(auto=True)
    for t in np.arange(0.0, 0.7, 0.1).tolist():
        dog.observe(t, seen(t))
    assert dog.observe(9.9, seen(9.9)) is State.APPROACHING
    assert dog.observe(10.1, seen(10.1)) is State.FAULT
    assert "took over 10 s" in made.reason


def test_a_camera_that_comes_back_lets_it_go_on_with_or_without_the_target() -> None:
    made, dog = watched()
    dog.observe(0.0, seen(0.0))
    assert dog.observe(1.0, seen(0.0)) is State.HOLDING_STALE
    nothing = {"tracked_t": -5.0, "position": None}
    assert dog.observe(1.1, seen(1.1, **nothing)) is State.SEARCHING
    assert dog.observe(1.2, seen(1.2)) is State.FOLLOWING
    assert made.reason


@settings(max_examples=50)
@given(
    st.lists(
        st.tuples(st.floats(0, 2), st.floats(0, 2), st.floats(0, 2), st.booleans(), st.booleans()),
        max_size=30,
    ),
    events,
)
def test_with_anything_old_or_broken_nothing_moves(
    ages: list[tuple[float, float, float, bool, bool]], told: list[Event]
) -> None:
    made, dog = watched(auto=True)
    for step, (pictures, joints, tracked, broken, there) in enumerate(ages):
        now = 0.1 * step
        if told:
            made.tell(told[step % len(told)])
        dog.observe(
            now,
            Observation(
                now - pictures,
                now - joints,
                now - tracked,
                np.zeros(3) if there else None,
                device_error="alarm" if broken else "",
            ),
        )
        if broken or pictures > LIMITS.stale + 1e-9 or joints > LIMITS.joints + 1e-9:
            assert made.order not in ARM_MOVES | FINGERS_MOVE
        if tracked > LIMITS.lost + 1e-9:
            assert made.order is not Order.FOLLOW


@pytest.mark.parametrize(
    ("speed", "still"), [(0.0, True), (0.008, True), (0.03, False), (0.5, False)]
)
def test_still_means_that_all_places_of_a_while_lie_together(speed: float, still: bool) -> None:
    watch = StillWatch(STILL)
    told = [watch.see(t, np.array([speed * t, 0, 0])) for t in np.arange(0, 2, 0.05).tolist()]
    assert not any(told[:9])  # less than the while has passed
    assert all(told[12:]) if still else not any(told)


def test_a_target_out_of_sight_is_not_still() -> None:
    watch = StillWatch(STILL)
    for t in np.arange(0, 2, 0.05).tolist():
        watch.see(t, np.zeros(3))
    assert not watch.see(2.0, None)
    assert not watch.see(2.05, np.zeros(3))


def test_the_page_lists_every_state() -> None:
    page = DOCS.read_text("utf-8").partition("## States")[2]
    for state in State:
        assert f"`{state}`" in page
