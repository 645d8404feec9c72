"""A scenario's motion without end: to its last instant, back to its first, and so on."""

from dataclasses import dataclass

import numpy as np

from verify.records import Array
from verify.sim.motion import Motion


@dataclass(frozen=True, slots=True)
class Endless:
    """Goes to and fro through a motion that was planned for a stretch of time.

    The way there and back is a cosine: no joint's speed leaps where the motion turns round, and
    nowhere is it more than π/2 times the planned one.
    """

    motion: Motion
    begin: float  # s, of the stretch
    end: float  # s

    def angles(self, t: Array) -> Array:
        """True joint angles, rad: (...,) to (..., joints)."""
        return self.motion.angles(self._place(t))

    def direction(self, t: Array) -> Array:
        """Last direction of travel, +1 or -1: (...,) to (..., joints)."""
        back = np.asarray(np.sin(self._phase(t)) < 0)
        way = np.where(back, -1.0, 1.0)[..., None]
        direction: Array = way * self.motion.direction(self._place(t))
        return direction

    def _phase(self, t: Array) -> Array:
        phase: Array = np.pi * (np.asarray(t) - self.begin) / (self.end - self.begin)
        return phase

    def _place(self, t: Array) -> Array:
        half = (self.end - self.begin) / 2
        place: Array = self.begin + half * (1 - np.cos(self._phase(t)))
        return place
