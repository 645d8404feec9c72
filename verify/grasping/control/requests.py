"""Keep the operator's requests of other threads until the loop takes them between two cycles.

Nothing here moves anything; whether an order counts, the state machine decides, as with a key.
"""

import threading

from verify.core.records import StereoPair
from verify.core.rig import Rig
from verify.errors import InputError
from verify.grasping.control.loop import GraspLoop
from verify.grasping.control.states import GraspEvent
from verify.grasping.tracking.selection import parse_drawn
from verify.grasping.tracking.target import BoxSelection
from verify.grasping.tracking.track import TargetTracker

SELECTION_PLACE = "selection"
MAX_REPEATED_LETTERS = 80  # characters of a request that an answer repeats


class OperatorRequests:
    """Takes requests from any thread; the newest selection counts, and a stop before all else."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._orders: list[tuple[GraspEvent, int | None]] = []
        self._drawn: BoxSelection | None = None
        self._refused = ""
        self.stops = 0  # taken by the loop

    def hold(self) -> None:
        """Ask for a hold; earlier requests that were not taken yet are dropped."""
        with self._lock:
            self._orders, self._drawn = [(GraspEvent.HOLD, None)], None

    def grab(self, shown: str) -> None:
        """Ask for the grab; a late order must not count in another state.

        `shown`: how many passages of the state machine the page showed, in digits.
        """
        if not (shown.isascii() and shown.isdecimal() and len(shown) < MAX_REPEATED_LETTERS):
            self._refuse(f'grab: "{shown[:MAX_REPEATED_LETTERS]}" is not a number of passages')
            return
        order = (GraspEvent.GRAB, int(shown))
        with self._lock:
            if order not in self._orders:
                self._orders.append(order)

    def select(self, text: str) -> None:
        """Ask for another target."""
        try:
            drawn = parse_drawn(text[: 2 * MAX_REPEATED_LETTERS], SELECTION_PLACE)
        except InputError as error:
            self._refuse(str(error))
            return
        with self._lock:
            self._drawn = drawn

    def taken(
        self, passages: int, *, pictures: bool
    ) -> tuple[tuple[GraspEvent, ...], BoxSelection | None, tuple[str, ...]]:
        """Return since the last call: orders, another target, and why a request was none.

        `passages`: of the state machine until now; `pictures`: there are new ones, in which a
        selection can be found.
        """
        with self._lock:
            orders, self._orders = self._orders, []
            refused, self._refused = self._refused, ""
            drawn = self._drawn if pictures else None
            self._drawn = None if pictures else self._drawn
        counts = tuple(event for event, shown in orders if shown in (None, passages))
        late = [event for event, shown in orders if shown not in (None, passages)]
        late_reasons = [f"{event.value}: the state has changed since; look again" for event in late]
        self.stops += counts.count(GraspEvent.HOLD)
        return counts, drawn, (*late_reasons, *([refused] if refused else ()))

    def _refuse(self, reason: str) -> None:
        with self._lock:
            self._refused = reason


def select_target(loop: GraspLoop, rig: Rig, drawn: BoxSelection, pair: StereoPair) -> str:
    """Go after what was drawn; says why not, where that cannot be."""
    if not loop.may_choose:
        reason = f"no other target now: the state is {loop.machine.state.value}"
        return f"{reason}; the arm must have come to rest, its hand up and empty"
    tracker = TargetTracker(rig, drawn)
    try:
        tracker.step(pair)
    except InputError as error:
        reason = "; ".join(part for part in (f"the box {error.found}", error.expected) if part)
        return f"{reason}. {error.remedy}".strip()
    loop.look_for(tracker)
    return ""
