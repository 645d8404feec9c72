"""The table of transitions: which event leads from where to where, what it needs, and why."""

from verify.grab.states import Event, Need, State, Transition

S, E = State, Event
FREELY: frozenset[Need] = frozenset()
UP = frozenset({Need.HIGH})
DOWN = frozenset({Need.LOW})

# what needs pictures: a camera that dies holds all of them
WATCHED = (
    S.SEARCHING, S.TRACKING, S.FOLLOWING, S.APPROACHING, S.CLOSING, S.CHECKING, S.LIFTING,
    S.OPENING, S.RETREATING, S.HOLDING_LOST, S.HOLDING_UNREACHABLE,
)  # fmt: skip
# what needs the target; a hand around it hides it, so nothing from closing on does
AFTER_TARGET = (S.FOLLOWING, S.APPROACHING, S.HOLDING_UNREACHABLE)
# what takes a time that is known beforehand
LIMITED = (S.APPROACHING, S.CLOSING, S.CHECKING, S.LIFTING, S.OPENING, S.RETREATING, S.RELEASING)
HOLDABLE = (*WATCHED, S.HOLDING_STALE)
RUNNING = tuple(s for s in S if s not in (S.IDLE, S.FAULT, S.RELEASING, S.RELEASED))


def _way(
    source: State, event: Event, target: State, because: str, needs: frozenset[Need] = FREELY
) -> Transition:
    return Transition(source, event, target, needs, because)


_WORK = (
    _way(S.IDLE, E.START, S.SEARCHING, "cameras and target are there"),
    _way(S.SEARCHING, E.FOUND, S.TRACKING, "both cameras see the target"),
    _way(S.TRACKING, E.LOST, S.SEARCHING, "nothing moves yet: it is looked for again"),
    _way(
        S.TRACKING, E.FOLLOW, S.FOLLOWING, "the arm may move, and goes above the target",
        frozenset({Need.EXECUTE, Need.HIGH}),
    ),
    _way(
        S.FOLLOWING, E.GRAB, S.APPROACHING, "the target stands still and the grasp is planned",
        frozenset({Need.EXECUTE, Need.STILL, Need.PLANNED}),
    ),
    _way(S.APPROACHING, E.AT_OBJECT, S.CLOSING, "the line down is done"),
    _way(S.CLOSING, E.CLOSED, S.CHECKING, "the fingers came to rest"),
    _way(S.CHECKING, E.HELD, S.LIFTING, "the gripper's status says so, not a timer"),
    _way(S.LIFTING, E.AT_TOP, S.LIFTED, "the object came along"),
    _way(S.CHECKING, E.NOTHING_HELD, S.OPENING, "the fingers met nothing"),
    _way(S.LIFTING, E.NOTHING_HELD, S.RETREATING, "the object slipped on the way up"),
    _way(S.OPENING, E.OPENED, S.RETREATING, "up the way it came"),
    _way(S.RETREATING, E.AT_TOP, S.MISSED, "empty, and out of the way"),
    _way(S.MISSED, E.RESUME, S.SEARCHING, "the operator wants another try", UP),
)  # fmt: skip

_BACK = (
    _way(S.HOLDING_STALE, E.FRESH, S.SEARCHING, "pictures and joints are fresh again", UP),
    _way(S.HOLDING_STALE, E.FRESH, S.HOLDING_OPERATOR, "the hand is low: a person decides", DOWN),
    _way(S.HOLDING_LOST, E.FOUND, S.TRACKING, "the target was found again", UP),
    _way(S.HOLDING_LOST, E.FOUND, S.HOLDING_OPERATOR, "the hand is low: a person decides", DOWN),
    _way(S.HOLDING_UNREACHABLE, E.REACHABLE, S.TRACKING, "the target can be reached again", UP),
    _way(
        S.HOLDING_UNREACHABLE, E.REACHABLE, S.HOLDING_OPERATOR,
        "the hand is low: a person decides", DOWN,
    ),
    _way(S.HOLDING_OPERATOR, E.RESUME, S.SEARCHING, "the operator lets it go on", UP),
    _way(
        S.HOLDING_OPERATOR, E.RESUME, S.LIFTING, "the operator lets it lift what it holds",
        frozenset({Need.EXECUTE, Need.LOW, Need.CARRYING}),
    ),
    _way(
        S.HOLDING_OPERATOR, E.RETREAT, S.OPENING, "the operator sends the empty hand up",
        frozenset({Need.EXECUTE, Need.LOW, Need.EMPTY}),
    ),
)  # fmt: skip

_TROUBLE = (
    *(_way(s, E.STALE, S.HOLDING_STALE, "nothing moves on old pictures") for s in WATCHED),
    *(_way(s, E.LOST, S.HOLDING_LOST, "the target is out of sight") for s in AFTER_TARGET),
    *(
        _way(s, E.UNREACHABLE, S.HOLDING_UNREACHABLE, "no safe way leads to the target")
        for s in (S.TRACKING, S.FOLLOWING, S.APPROACHING)
    ),
    *(_way(s, E.TIME_OUT, S.FAULT, "it took longer than it may") for s in LIMITED),
    *(_way(s, E.HOLD, S.HOLDING_OPERATOR, "the operator's order") for s in HOLDABLE),
    *(_way(s, E.DEVICE_ERROR, S.FAULT, "a device said so, or fell silent") for s in RUNNING),
)

_END = (
    *(_way(s, E.INTERRUPT, S.RELEASING, "hold, then give the controls back") for s in RUNNING),
    _way(S.RELEASING, E.STOPPED, S.RELEASED, "the arm is at rest"),
    _way(S.RELEASING, E.DEVICE_ERROR, S.FAULT, "a device said so, or fell silent"),
    _way(S.IDLE, E.DEVICE_ERROR, S.FAULT, "a device said so, or fell silent"),
    _way(S.IDLE, E.INTERRUPT, S.RELEASED, "nothing was taken"),
    _way(S.FAULT, E.INTERRUPT, S.RELEASED, "the operator ends it"),
)

TRANSITIONS: tuple[Transition, ...] = (*_WORK, *_BACK, *_TROUBLE, *_END)
