"""Readings as arrays while more come: the latest are had without going through them one by one."""

import numpy as np

from verify.readings import Readings
from verify.records import Array

FIRST_ROOM = 256  # readings


class ReadingsStore:
    """Rising times and their joint angles; not locked."""

    def __init__(self) -> None:
        self._t: Array = np.empty(0)
        self._q: Array = np.empty((0, 0))
        self._first, self._end = 0, 0

    def __len__(self) -> int:
        """Count the readings."""
        return self._end - self._first

    @property
    def t(self) -> Array:
        """Times, (m,), s; a view that the next reading may move."""
        return self._t[self._first : self._end]

    def add(self, t: float, q: Array) -> None:
        """Append a reading: s, and (joints,), rad."""
        if self._end == len(self._t):
            self._make_room(len(q))
        self._t[self._end], self._q[self._end] = t, q
        self._end += 1

    def forget_before(self, t: float) -> None:
        """Let readings before an instant go."""
        while self._first < self._end and self._t[self._first] < t:
            self._first += 1

    def clear(self) -> None:
        """Let all go."""
        self._first = self._end = 0

    def copied(self, begin: int) -> Readings | None:
        """Readings from one of them on, counted from the oldest; None where there is none."""
        chosen = slice(self._first + begin, self._end)
        if chosen.start >= chosen.stop:
            return None
        return Readings(self._t[chosen].copy(), self._q[chosen].copy())

    def _make_room(self, joints: int) -> None:
        """Move what is kept to the begin of arrays twice as long as it needs."""
        kept = slice(self._first, self._end)
        t, q = self._t[kept], self._q[kept]
        room = max(2 * len(t), FIRST_ROOM)
        self._t, self._q = np.empty(room), np.empty((room, joints))
        self._t[: len(t)] = t
        if len(t):
            self._q[: len(t)] = q
        self._first, self._end = 0, len(t)
