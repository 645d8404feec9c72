"""Motion as a stream: jerk-limited, after a goal that jumps about, and never without a way to stop.

Each joint goes after its goal on the quickest S-curve within its limits (ruckig). One step of it is
taken only if from there the arm can still stop without leaving the joints' limits or what `clear`
allows; else it goes on along the stop that was found possible before. So whatever goals come, what
is ordered stays within the limits, and so does the stop that follows.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import ruckig

from verify.grab.limits import SLACK, JointLimits, Motion, at_rest, violation
from verify.records import Array

Clear = Callable[[Array], str]  # postures (m, n) in order: what stands in the way; "": nothing
RESTS = 1e-9  # rad/s and rad/s²: rounding of an arm at rest
STOP_SAMPLES = 9  # of a stop, handed to `clear`
GOAL_SPEED = 0.95  # of the limit: a goal may be as fast as that; ruckig wants it below


@dataclass(frozen=True, slots=True)
class Step:
    """What the joints are ordered next, and why it is not the way to the goal, where it is not."""

    motion: Motion
    reason: str  # empty: on the way to the goal, or there
    moving: bool


class Follower:
    """A filter from goals to a stream of motions, one a period.

    Args:
        limits: of the joints.
        q: (n,), rad, where the arm stands, at rest.
        period: s, from one step to the next.
        clear: says of postures in order what stands in the way, between them too.

    Raises:
        ValueError: the arm stands outside its limits, or where it is not clear.
    """

    def __init__(self, limits: JointLimits, q: Array, period: float, clear: Clear) -> None:
        inside = SLACK * (limits.upper - limits.lower)  # what `violation` lets pass beyond
        self._limits = replace(limits, lower=limits.lower + inside, upper=limits.upper - inside)
        self._period, self._clear = period, clear
        self._motion = at_rest(np.array(q, dtype=float))
        trouble = violation(limits, self._motion) or clear(self._motion.q[None])
        if trouble:
            raise ValueError(f"the arm cannot begin here: {trouble}")
        self._otg = ruckig.Ruckig(len(q))
        self._stop = self._stopping(self._motion)
        self._since_stop = 0.0  # s along that stop

    @property
    def motion(self) -> Motion:
        """What was ordered last."""
        return self._motion

    def step(self, goal: Array | None, velocity: Array | None = None) -> Step:
        """Go on for one period.

        Args:
            goal: (n,), rad; None: stop. Brought within the joints' limits.
            velocity: (n,), rad/s, with which the goal moves; by default it stands.
        """
        if goal is None or not np.isfinite(goal).all():
            return self._hold("" if goal is None else "the goal is not a number")
        reason = ""
        for speed in (velocity, None) if velocity is not None else (None,):
            ahead = self._towards(goal, speed)
            motion = _at(ahead, self._period)
            stop = self._stopping(motion)
            reason = self._trouble(motion, stop)
            if not reason:
                self._motion, self._stop, self._since_stop = motion, stop, 0.0
                return Step(motion, "", self._is_moving())
        return self._hold(reason)

    def _hold(self, reason: str) -> Step:
        self._since_stop += self._period
        motion = _at(self._stop, self._since_stop)
        self._motion = motion if self._since_stop < self._stop.duration else at_rest(motion.q)
        return Step(self._motion, reason, self._is_moving())

    def _is_moving(self) -> bool:
        motion = self._motion
        return bool(max(np.abs(motion.velocity).max(), np.abs(motion.acceleration).max()) > RESTS)

    def _trouble(self, motion: Motion, stop: Any) -> str:
        """What speaks against standing at `motion` with that stop before one, in words."""
        extrema = stop.position_extrema
        for value in ([e.min for e in extrema], [e.max for e in extrema]):
            said = violation(self._limits, at_rest(np.array(value)))
            if said:
                return said
        times = np.linspace(0.0, stop.duration, STOP_SAMPLES)
        stops = np.array([stop.at_time(t)[0] for t in times.tolist()])
        return violation(self._limits, motion) or self._clear(
            np.concatenate([self._motion.q[None], stops])
        )

    def _towards(self, goal: Array, velocity: Array | None) -> Any:
        order = self._order(self._motion)
        order.target_position = np.clip(goal, self._limits.lower, self._limits.upper).tolist()
        if velocity is not None and np.isfinite(velocity).all():
            fastest = GOAL_SPEED * self._limits.speed
            order.target_velocity = np.clip(velocity, -fastest, fastest).tolist()
        return self._calculated(order)

    def _stopping(self, motion: Motion) -> Any:
        order = self._order(motion)
        order.control_interface = ruckig.ControlInterface.Velocity
        return self._calculated(order)

    def _order(self, motion: Motion) -> Any:
        count = len(motion.q)
        order = ruckig.InputParameter(count)
        order.current_position = motion.q.tolist()
        order.current_velocity = motion.velocity.tolist()
        order.current_acceleration = motion.acceleration.tolist()
        order.target_velocity = [0.0] * count
        order.target_acceleration = [0.0] * count
        order.max_velocity = self._limits.speed.tolist()
        order.max_acceleration = self._limits.acceleration.tolist()
        order.max_jerk = self._limits.jerk.tolist()
        # each joint by itself: a joint that waits for another would leave its quickest stop
        order.synchronization = ruckig.Synchronization.No
        return order

    def _calculated(self, order: Any) -> Any:
        found = ruckig.Trajectory(order.degrees_of_freedom)
        result = self._otg.calculate(order, found)
        if result not in (ruckig.Result.Working, ruckig.Result.Finished):
            raise ArithmeticError(f"ruckig finds no S-curve: {result}")
        return found


def _at(found: Any, t: float) -> Motion:
    q, velocity, acceleration = found.at_time(min(t, found.duration))
    return Motion(np.array(q), np.array(velocity), np.array(acceleration))
