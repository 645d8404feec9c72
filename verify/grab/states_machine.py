"""The machine that walks the table: one state at a time, each passage kept with its reason."""

from collections.abc import Callable
from dataclasses import dataclass

from verify.grab.states import ORDERS, Event, Need, Order, State
from verify.grab.states_table import TRANSITIONS

WAYS = {
    (source, event): [t for t in TRANSITIONS if (t.source, t.event) == (source, event)]
    for source, event in {(t.source, t.event) for t in TRANSITIONS}
}


@dataclass(frozen=True, slots=True)
class Passage:
    """One step from a state to another."""

    t: float  # s, the machine's clock
    source: State
    event: Event
    target: State
    reason: str  # what the one who told the event said, else the table's own words


class Machine:
    """Where a grab stands; orders follow from the state and from nothing else.

    Args:
        execute: the right to move: without it no state that moves arm or fingers is ever reached.
        clock: s, monotonic.
    """

    def __init__(self, execute: bool, clock: Callable[[], float]) -> None:
        self._execute, self._clock = execute, clock
        self.state = State.IDLE
        self.since = clock()
        self.reason = ""
        self.low = False  # the hand is down at the object, or may be
        self.carrying = False  # the gripper said that it holds an object
        self.still = False  # the target stands still; whoever watches it says so
        self.planned = False  # there is a checked grasp of it; whoever plans says so
        self.log: list[Passage] = []

    @property
    def order(self) -> Order:
        """What is asked of the devices now."""
        return ORDERS[self.state]

    def tell(self, event: Event, reason: str = "") -> bool:
        """Take an event in; False where it is no transition of this state, or lacks what it needs.

        Args:
            event: what happened.
            reason: in words, where there is more to say than the table does.
        """
        for way in WAYS.get((self.state, event), []):
            if all(self._has(need) for need in way.needs):
                now = self._clock()
                said = reason or way.because
                self.log.append(Passage(now, self.state, event, way.target, said))
                self._take_note(event, way.target)
                self.state, self.since, self.reason = way.target, now, said
                return True
        return False

    def lacks(self, event: Event) -> frozenset[Need]:
        """What an event would need in this state and has not; empty also where it is no event."""
        for way in WAYS.get((self.state, event), []):
            return frozenset(need for need in way.needs if not self._has(need))
        return frozenset()

    def _has(self, need: Need) -> bool:
        return {
            Need.EXECUTE: self._execute,
            Need.STILL: self.still,
            Need.PLANNED: self.planned,
            Need.LOW: self.low,
            Need.HIGH: not self.low,
            Need.CARRYING: self.carrying,
            Need.EMPTY: not self.carrying,
        }[need]

    def _take_note(self, event: Event, target: State) -> None:
        if target is State.APPROACHING:
            self.low = True
        if event is Event.AT_TOP:
            self.low = False
        if event is Event.HELD:
            self.carrying = True
        if event in (Event.NOTHING_HELD, Event.OPENED):
            self.carrying = False
