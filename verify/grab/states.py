"""The states of a grab and every way from one to another, as data.

Nothing here moves anything: a state says what may be ordered while it lasts. Every transition
stands in TRANSITIONS; what does not is no transition, and is ignored.
"""

from dataclasses import dataclass
from enum import StrEnum


class State(StrEnum):
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


class Event(StrEnum):
    """What happens; the first group is seen, the second done, the third asked for."""

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


class Order(StrEnum):
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


class Need(StrEnum):
    """What a transition needs beside its event."""

    EXECUTE = "the right to move"
    STILL = "a target that stands still"
    LOW = "a hand that is down at the object"
    HIGH = "a hand that is up"
    CARRYING = "an object in the hand"
    EMPTY = "no object in the hand"
    PLANNED = "a grasp that is planned"


@dataclass(frozen=True, slots=True)
class Transition:
    """One way from a state to another."""

    source: State
    event: Event
    target: State
    needs: frozenset[Need]
    because: str


ORDERS: dict[State, Order] = {
    State.IDLE: Order.NONE,
    State.SEARCHING: Order.HOLD,
    State.TRACKING: Order.HOLD,
    State.FOLLOWING: Order.FOLLOW,
    State.APPROACHING: Order.DESCEND,
    State.CLOSING: Order.CLOSE,
    State.CHECKING: Order.CHECK,
    State.LIFTING: Order.LIFT,
    State.LIFTED: Order.HOLD,
    State.OPENING: Order.OPEN,
    State.RETREATING: Order.RETREAT,
    State.MISSED: Order.HOLD,
    State.HOLDING_STALE: Order.HOLD,
    State.HOLDING_LOST: Order.HOLD,
    State.HOLDING_UNREACHABLE: Order.HOLD,
    State.HOLDING_OPERATOR: Order.HOLD,
    State.FAULT: Order.HOLD,
    State.RELEASING: Order.RELEASE,
    State.RELEASED: Order.NONE,
}
ARM_MOVES = frozenset({Order.FOLLOW, Order.DESCEND, Order.LIFT, Order.RETREAT})
FINGERS_MOVE = frozenset({Order.CLOSE, Order.OPEN})
MOVING = frozenset(s for s, order in ORDERS.items() if order in ARM_MOVES | FINGERS_MOVE)
