"""What was done a moment ago is done quicker: after a rest it takes far longer.

By then the processor has given its caches, and what it had learnt of the program's course, to
others. So the last pair is measured once more, for nothing, just before the next one is due.
"""

import statistics
import time
from collections import deque
from collections.abc import Callable
from itertools import pairwise

REMEMBERED = 9  # occasions by which the next one is expected
FEWEST = 4  # of them
MARGIN = 0.005  # s that it is over before
ROOM = 3.0  # times its own duration: with less time from one occasion to the next there is none


class Rehearsal:
    """Says when to rehearse what happens again and again, and does it.

    Args:
        act: what is rehearsed; its outcome is nobody's.
        now: a monotonic clock, s.
    """

    def __init__(self, act: Callable[[], None], now: Callable[[], float] = time.monotonic) -> None:
        self._act, self._now = act, now
        self._occasions: deque[float] = deque(maxlen=REMEMBERED)
        self._took = 0.0
        self._open = False

    def note(self) -> None:
        """Note that it happens, now: the next rehearsal is for the next time."""
        self._occasions.append(self._now())
        self._open = True

    def patience(self) -> float | None:
        """How long to wait for the next occasion before it is rehearsed, s; None: for ever."""
        if not self._open or len(self._occasions) < FEWEST:
            return None
        times = list(self._occasions)
        interval = statistics.median(b - a for a, b in pairwise(times))
        if interval < ROOM * self._took:  # there was no room for it; perhaps there will be
            self._open, self._took = False, self._took / 2
            return None
        rest = times[-1] + interval - self._took - MARGIN - self._now()
        return max(rest, 0.0)

    def run(self) -> None:
        """Rehearse; once before each occasion."""
        self._open = False
        begin = self._now()
        self._act()
        self._took = self._now() - begin
