"""What the operator asks for from somewhere else: kept until the loop takes it between two turns.

A request is words: nothing in here moves anything, and what becomes of an order is the state
machine's to say, as with a key.
"""

import threading
from dataclasses import dataclass

from verify.errors import InputError
from verify.grab.loop import Loop
from verify.grab.selection import parse_drawn
from verify.grab.states import Event
from verify.grab.target import Drawn, Options
from verify.grab.target_tracking import Tracker
from verify.records import StereoPair
from verify.rig import Rig

PLACE = "selection"
LONGEST = 80  # characters of a request that an answer repeats


@dataclass(frozen=True, slots=True)
class Asked:
    """What is to be taken in now, oldest first."""

    orders: tuple[Event, ...]
    drawn: Drawn | None  # another target
    refused: tuple[str, ...]  # in words: what was no request at all


class Requests:
    """Takes requests from any thread; the newest selection counts, and a stop before all else."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._orders: list[tuple[Event, int | None]] = []
        self._drawn: Drawn | None = None
        self._refused = ""
        self.stops = 0  # taken by the loop

    def hold(self) -> None:
        """Ask for a hold; what was asked for before and was not taken yet is forgotten."""
        with self._lock:
            self._orders, self._drawn = [(Event.HOLD, None)], None

    def grab(self, seen: str) -> None:
        """Ask for the grab.

        Args:
            seen: how many passages of the state machine the one who asks had seen, in digits: an
                order that was long on its way does not meet another state.
        """
        if not (seen.isascii() and seen.isdecimal() and len(seen) < LONGEST):
            self._refuse(f'grab: "{seen[:LONGEST]}" is no number of passages')
            return
        order = (Event.GRAB, int(seen))
        with self._lock:
            if order not in self._orders:
                self._orders.append(order)

    def select(self, text: str) -> None:
        """Ask for another target.

        Args:
            text: see `parse_drawn`.
        """
        try:
            drawn = parse_drawn(text[: 2 * LONGEST], PLACE)
        except InputError as error:
            self._refuse(str(error))
            return
        with self._lock:
            self._drawn = drawn

    def taken(self, passages: int, *, pictures: bool) -> Asked:
        """Give what was asked for since the last time.

        Args:
            passages: of the state machine until now.
            pictures: there are new ones, in which a selection can be looked at.
        """
        with self._lock:
            orders, self._orders = self._orders, []
            refused, self._refused = self._refused, ""
            drawn = self._drawn if pictures else None
            self._drawn = None if pictures else self._drawn
        counts = tuple(event for event, seen in orders if seen in (None, passages))
        late = [event for event, seen in orders if seen not in (None, passages)]
        words = [f"{event.value}: the state has changed since; look again" for event in late]
        self.stops += counts.count(Event.HOLD)
        return Asked(counts, drawn, (*words, *([refused] if refused else ())))

    def _refuse(self, words: str) -> None:
        with self._lock:
            self._refused = words


def choose(loop: Loop, rig: Rig, drawn: Drawn, pair: StereoPair) -> str:
    """Go after what was drawn; says why not, where that cannot be.

    Args:
        loop: goes on after its last target where this one is refused.
        rig: the cameras.
        drawn: a box in one of the pictures.
        pair: the pictures, newest.
    """
    if not loop.may_choose:
        said = f"no other target now: the state is {loop.machine.state.value}"
        return f"{said}; the arm must have come to rest, its hand up and empty"
    tracker = Tracker(rig, drawn, Options())
    try:
        tracker.step(pair)
    except InputError as error:
        said = "; ".join(part for part in (f"the box {error.found}", error.expected) if part)
        return f"{said}. {error.remedy}".strip()
    loop.look_for(tracker)
    return ""
