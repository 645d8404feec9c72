"""Define the states of a grasp, every transition between them, and the machine that takes them.

A state alone says what may be ordered while it lasts (ORDERS). Every transition stands in
TRANSITIONS, with its event, its conditions and its reason; any other event is ignored.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum


class GraspState(StrEnum):
    """Where a grab stands."""

    IDLE = "idle"
    SEARCHING = "searching"
    TRACKING = "tracking"
    FOLLOWING = "following"
    APPROACHING = "approaching"
    CLOSING = "closing"
    CHECKING = "checking"
    LIFTING = "lifting"
    LIFTED = "lifted"
    OPENING = "opening"
    RETREATING = "retreating"
    MISSED = "missed"
    HOLDING_STALE = "holding-stale"
    HOLDING_LOST = "holding-lost"
    HOLDING_UNREACHABLE = "holding-unreachable"
    HOLDING_OPERATOR = "holding-operator"
    FAULT = "fault"
    RELEASING = "releasing"
    RELEASED = "released"


class GraspEvent(StrEnum):
    """Events: of the watchdog, of the devices, of the operator."""

    FOUND = "target found"
    LOST = "target lost"
    STALE = "pictures or joints too old"
    FRESH = "pictures and joints fresh again"
    UNREACHABLE = "target cannot be reached"
    REACHABLE = "target can be reached"
    DEVICE_ERROR = "device error"
    TIME_OUT = "took too long"

    AT_OBJECT = "hand at the object"
    CLOSED = "fingers at rest"
    HELD = "gripper holds an object"
    NOTHING_HELD = "gripper holds nothing"
    AT_TOP = "hand back above"
    OPENED = "fingers open"
    STOPPED = "arm at rest"

    START = "started"
    FOLLOW = "follow ordered"
    GRAB = "grab ordered"
    HOLD = "hold ordered"
    RESUME = "resume ordered"
    RETREAT = "retreat ordered"
    INTERRUPT = "interrupted"


class DeviceOrder(StrEnum):
    """What a state asks of the devices."""

    NONE = "nothing"
    HOLD = "stand still, keep the grip as it is"
    FOLLOW = "stream the arm above the target"
    DESCEND = "follow the planned line down"
    CLOSE = "close the fingers"
    CHECK = "read the gripper's status"
    LIFT = "follow the planned line up, holding"
    OPEN = "open the fingers"
    RETREAT = "follow the planned line up, empty"
    RELEASE = "hold, then give the controls back"


class TransitionCondition(StrEnum):
    """What a transition needs beside its event."""

    EXECUTE = "permission to move"
    STILL = "a target that stands still"
    LOW = "a hand that is down at the object"
    HIGH = "a hand that is up"
    CARRYING = "an object in the hand"
    EMPTY = "no object in the hand"
    PLANNED = "a grasp that is planned"


@dataclass(frozen=True, slots=True)
class Transition:
    """One way from a state to another."""

    source: GraspState
    event: GraspEvent
    target: GraspState
    because: str
    needs: frozenset[TransitionCondition] = frozenset()


# whatever is not named here holds
ORDERS = dict.fromkeys(GraspState, DeviceOrder.HOLD) | {
    GraspState.IDLE: DeviceOrder.NONE,
    GraspState.FOLLOWING: DeviceOrder.FOLLOW,
    GraspState.APPROACHING: DeviceOrder.DESCEND,
    GraspState.CLOSING: DeviceOrder.CLOSE,
    GraspState.CHECKING: DeviceOrder.CHECK,
    GraspState.LIFTING: DeviceOrder.LIFT,
    GraspState.OPENING: DeviceOrder.OPEN,
    GraspState.RETREATING: DeviceOrder.RETREAT,
    GraspState.RELEASING: DeviceOrder.RELEASE,
    GraspState.RELEASED: DeviceOrder.NONE,
}
ARM_ORDERS = frozenset(
    {DeviceOrder.FOLLOW, DeviceOrder.DESCEND, DeviceOrder.LIFT, DeviceOrder.RETREAT}
)
FINGER_ORDERS = frozenset({DeviceOrder.CLOSE, DeviceOrder.OPEN})
MOVING_STATES = frozenset(s for s, order in ORDERS.items() if order in ARM_ORDERS | FINGER_ORDERS)


S, E, C, T = GraspState, GraspEvent, TransitionCondition, Transition
HAND_HIGH, HAND_LOW = frozenset({C.HIGH}), frozenset({C.LOW})
LOW_REASON = "the hand is low: a person decides"

# what needs pictures: a camera that dies holds all of them
PICTURE_STATES = (
    S.SEARCHING, S.TRACKING, S.FOLLOWING, S.APPROACHING, S.CLOSING, S.CHECKING, S.LIFTING,
    S.OPENING, S.RETREATING, S.HOLDING_LOST, S.HOLDING_UNREACHABLE,
)  # fmt: skip
# what needs the target; a hand around it hides it, so nothing from closing on does
TARGET_STATES = (S.FOLLOWING, S.APPROACHING, S.HOLDING_UNREACHABLE)
# what takes a time that is known beforehand
TIMED_STATES = (
    S.APPROACHING, S.CLOSING, S.CHECKING, S.LIFTING, S.OPENING, S.RETREATING, S.RELEASING,
)  # fmt: skip
HOLDABLE_STATES = (*PICTURE_STATES, S.HOLDING_STALE)
RUNNING_STATES = tuple(s for s in S if s not in (S.IDLE, S.FAULT, S.RELEASING, S.RELEASED))


TRANSITIONS: tuple[Transition, ...] = (
    # the grasp
    T(S.IDLE, E.START, S.SEARCHING, "pictures and joint readings arrive"),
    T(S.SEARCHING, E.FOUND, S.TRACKING, "both cameras see the target"),
    T(S.TRACKING, E.LOST, S.SEARCHING, "nothing moves yet: it is looked for again"),
    T(
        S.TRACKING, E.FOLLOW, S.FOLLOWING, "the arm may move, and goes above the target",
        frozenset({C.EXECUTE, C.HIGH}),
    ),
    T(
        S.FOLLOWING, E.GRAB, S.APPROACHING, "the target stands still and the grasp is planned",
        frozenset({C.EXECUTE, C.STILL, C.PLANNED}),
    ),
    T(S.APPROACHING, E.AT_OBJECT, S.CLOSING, "the descent is complete"),
    T(S.CLOSING, E.CLOSED, S.CHECKING, "the fingers came to rest"),
    T(S.CHECKING, E.HELD, S.LIFTING, "the gripper's status says so, not a timer"),
    T(S.LIFTING, E.AT_TOP, S.LIFTED, "the object came along"),
    T(S.CHECKING, E.NOTHING_HELD, S.OPENING, "the fingers met nothing"),
    T(S.LIFTING, E.NOTHING_HELD, S.RETREATING, "the object slipped on the way up"),
    T(S.OPENING, E.OPENED, S.RETREATING, "up the way it came"),
    T(S.RETREATING, E.AT_TOP, S.MISSED, "empty, and out of the way"),
    T(S.MISSED, E.RESUME, S.SEARCHING, "the operator wants another try", HAND_HIGH),
    # going on after a hold
    T(S.HOLDING_STALE, E.FRESH, S.SEARCHING, "pictures and joints are fresh again", HAND_HIGH),
    T(S.HOLDING_STALE, E.FRESH, S.HOLDING_OPERATOR, LOW_REASON, HAND_LOW),
    T(S.HOLDING_LOST, E.FOUND, S.TRACKING, "the target was found again", HAND_HIGH),
    T(S.HOLDING_LOST, E.FOUND, S.HOLDING_OPERATOR, LOW_REASON, HAND_LOW),
    T(S.HOLDING_UNREACHABLE, E.REACHABLE, S.TRACKING, "the target can be reached again", HAND_HIGH),
    T(S.HOLDING_UNREACHABLE, E.REACHABLE, S.HOLDING_OPERATOR, LOW_REASON, HAND_LOW),
    T(S.HOLDING_OPERATOR, E.RESUME, S.SEARCHING, "the operator lets it go on", HAND_HIGH),
    T(
        S.HOLDING_OPERATOR, E.RESUME, S.LIFTING, "the operator lets it lift what it holds",
        frozenset({C.EXECUTE, C.LOW, C.CARRYING}),
    ),
    T(
        S.HOLDING_OPERATOR, E.RETREAT, S.OPENING, "the operator sends the empty hand up",
        frozenset({C.EXECUTE, C.LOW, C.EMPTY}),
    ),
    # what goes wrong
    *(T(s, E.STALE, S.HOLDING_STALE, "no motion on old pictures") for s in PICTURE_STATES),
    *(T(s, E.LOST, S.HOLDING_LOST, "the target is out of sight") for s in TARGET_STATES),
    *(
        T(s, E.UNREACHABLE, S.HOLDING_UNREACHABLE, "no safe way leads to the target")
        for s in (S.TRACKING, S.FOLLOWING, S.APPROACHING)
    ),
    *(T(s, E.TIME_OUT, S.FAULT, "it took longer than it may") for s in TIMED_STATES),
    *(T(s, E.HOLD, S.HOLDING_OPERATOR, "the operator's order") for s in HOLDABLE_STATES),
    *(
        T(s, E.DEVICE_ERROR, S.FAULT, "a device reported it, or stopped answering")
        for s in (*RUNNING_STATES, S.RELEASING, S.IDLE)
    ),
    # the end
    *(T(s, E.INTERRUPT, S.RELEASING, "hold, then give the controls back") for s in RUNNING_STATES),
    T(S.RELEASING, E.STOPPED, S.RELEASED, "the arm is at rest"),
    T(S.IDLE, E.INTERRUPT, S.RELEASED, "nothing was taken"),
    T(S.FAULT, E.INTERRUPT, S.RELEASED, "the operator ends it"),
)  # fmt: skip
TRANSITIONS_BY_EVENT = {
    (source, event): [t for t in TRANSITIONS if (t.source, t.event) == (source, event)]
    for source, event in {(t.source, t.event) for t in TRANSITIONS}
}


@dataclass(frozen=True, slots=True)
class StateChange:
    """One step from a state to another."""

    t: float  # s, the machine's clock
    source: GraspState
    event: GraspEvent
    target: GraspState
    reason: str  # given with the event, else the table's own


class StateMachine:
    """The state of a grasp; orders follow from the state and from nothing else.

    Without permission to move, `execute`, no state that moves arm or fingers is ever reached.
    """

    def __init__(self, execute: bool, clock: Callable[[], float]) -> None:
        self._execute, self._clock = execute, clock
        self.state = GraspState.IDLE
        self.since = clock()
        self.reason = ""
        self.low = False  # the hand is down at the object, or may be
        self.carrying = False  # the gripper reports that it holds an object
        self.still = False  # the target stands still; set by the watchdog
        self.planned = False  # there is a checked grasp of it; set by the loop
        self.log: list[StateChange] = []

    @property
    def order(self) -> DeviceOrder:
        """The order of the present state."""
        return ORDERS[self.state]

    def tell(self, event: GraspEvent, reason: str = "") -> bool:
        """Take an event in; False where it is no transition of this state, or lacks what it needs.

        The reason is in words; empty: that of the table.
        """
        for way in TRANSITIONS_BY_EVENT.get((self.state, event), []):
            if all(self._has(need) for need in way.needs):
                now = self._clock()
                reason = reason or way.because
                self.log.append(StateChange(now, self.state, event, way.target, reason))
                approaches = way.target is GraspState.APPROACHING
                lets_go = event in (GraspEvent.NOTHING_HELD, GraspEvent.OPENED)
                self.low = event is not GraspEvent.AT_TOP and (self.low or approaches)
                self.carrying = event is GraspEvent.HELD or (self.carrying and not lets_go)
                self.state, self.since, self.reason = way.target, now, reason
                return True
        return False

    def lacks(self, event: GraspEvent) -> str:
        """What an event would need in this state and has not; empty also where it is no event."""
        ways = TRANSITIONS_BY_EVENT.get((self.state, event), [])
        needs = ways[0].needs if ways else ()
        return ", ".join(sorted(need.value for need in needs if not self._has(need)))

    def _has(self, need: TransitionCondition) -> bool:
        return {
            TransitionCondition.EXECUTE: self._execute,
            TransitionCondition.STILL: self.still,
            TransitionCondition.PLANNED: self.planned,
            TransitionCondition.LOW: self.low,
            TransitionCondition.HIGH: not self.low,
            TransitionCondition.CARRYING: self.carrying,
            TransitionCondition.EMPTY: not self.carrying,
        }[need]
