"""Turning camera bases: a LABENC board with two driven axes."""

import numpy as np

from verify.devices.labenc_lines import MOVING
from verify.emulators.labenc import BoardOptions, LabencEngine
from verify.emulators.trajectory import Hold
from verify.records import Array

SPEED = np.deg2rad(20.0)  # rad/s
LIMIT_DEG = 60.0  # to either side
PARALLEL = np.zeros(2)


class PanEngine(LabencEngine):
    """Left and right base; each goes where G orders it, at a steady speed."""

    def __init__(self, options: BoardOptions) -> None:
        self._from, self._to = PARALLEL.copy(), PARALLEL.copy()
        self._ordered_at = 0.0
        super().__init__(Hold(PARALLEL), 2, options)

    def angles(self, t: float) -> Array:
        """What the encoders on the axes show, (2,), rad."""
        way = self._to - self._from
        gone = np.minimum(np.abs(way), SPEED * max(t - self._ordered_at, 0.0))
        angles: Array = self._from + np.sign(way) * gone
        return angles

    def status(self, t: float) -> int:
        """Status bits: moving, until both have arrived."""
        moving = bool(np.any(self.angles(t) != self._to))
        return super().status(t) | (MOVING if moving else 0)

    def go(self, axis: int, value: float, t: float) -> str:
        """Turn one base."""
        if axis not in (1, 2):
            return "E,G,2,bad value"
        if not abs(value) <= LIMIT_DEG:
            return f"E,G,3,axis {axis} limit"
        here, there = self.angles(t), self._to.copy()
        there[axis - 1] = np.deg2rad(value)
        self._from, self._to, self._ordered_at = here, there, t
        return f"A,G,{axis},{value:.2f}"
