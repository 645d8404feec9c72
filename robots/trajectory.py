"""Move joints within their limits of speed, acceleration and jerk: along a path, or after a goal.

Along a path: joint angles are a B-spline q(s) of the way s; s(t) is an S-curve (ruckig) from rest
to rest. The joints' rates are then

    q' s',   q'' s'² + q' s'',   q''' s'³ + 3 q'' s' s'' + q' s'''

A B-spline and its derivatives lie within the hull of their coefficients, so these are bounded along
the whole way, not at samples. A straight line between two postures is a path too: the joint that
needs most time rules, and all joints begin and end together.

After a goal that may jump: each joint follows its own quickest S-curve. A step of it is taken only
if the arm can still stop from there without leaving the joints' limits or what `clear` allows; else
the stop that was found possible before is continued. So every ordered posture, and the stop that
follows it, stays within the limits.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import ruckig
from scipy.interpolate import BSpline

from robots.arm import Arm
from robots.errors import RobotError
from robots.transforms import Array

TOL_LIMIT = 1e-6  # of each limit: rounding of a trajectory that runs at its limit
MIN_PATH_LENGTH = 1e-9  # rad: a way this short is none
ObstacleCheck = Callable[[Array], str]  # postures (m, n) in order: what obstructs; "": nothing
TOL_REST = 1e-9  # rad/s and rad/s²: rounding of an arm at rest
N_STOP_SAMPLES = 9  # of a stop, handed to `clear`
MAX_GOAL_SPEED_RATIO = 0.95  # of the limit: a goal may be as fast as that; ruckig wants it below


@dataclass(frozen=True, slots=True)
class JointLimits:
    """Of each joint, (n,): position, rad, and its greatest rates."""

    lower: Array  # rad
    upper: Array  # rad
    speed: Array  # rad/s
    acceleration: Array  # rad/s²
    jerk: Array  # rad/s³


@dataclass(frozen=True, slots=True)
class JointMotion:
    """What the joints do at one instant, (n,) each, or at many, (m, n)."""

    q: Array  # rad
    velocity: Array  # rad/s
    acceleration: Array  # rad/s²


def joint_limits(arm: Arm, share: float) -> JointLimits:
    """Take an arm's limits, and the share, 0 to 1, of its speed, acceleration and jerk.

    Raises:
        RobotError: the file does not state them.
    """
    speed, acceleration, jerk = arm.speed, arm.acceleration, arm.jerk
    if speed is None or acceleration is None or jerk is None:
        found = "states no speed_deg_s, acceleration_deg_s2 and jerk_deg_s3 of its joints"
        remedy = "Write them into each [[joint]], from the maker's data."
        raise RobotError(f'robot "{arm.name}"', found, "nothing moves without them", remedy)
    return JointLimits(arm.lower, arm.upper, share * speed, share * acceleration, share * jerk)


def rest_motion(q: Array) -> JointMotion:
    """Stand at joint angles (n,)."""
    return JointMotion(q, np.zeros_like(q), np.zeros_like(q))


def limit_violation(limits: JointLimits, motion: JointMotion) -> str:
    """Say which limit a motion breaks, in words; empty where it keeps all. NaN breaks every one."""
    speed, most = limits.speed, limits.acceleration
    limited = (
        (motion.q, limits.lower, limits.upper, "would stand at", "°"),
        (motion.velocity, -speed, speed, "would turn at", "°/s"),
        (motion.acceleration, -most, most, "would speed up by", "°/s²"),
    )
    for values, lower, upper, what, unit in limited:
        slack = TOL_LIMIT * (upper - lower)
        outside = ~((values >= lower - slack) & (values <= upper + slack))  # NaN is outside
        if outside.any():
            first = tuple(np.argwhere(outside)[0])
            joint = first[-1]
            value, low, high = np.degrees([values[first], lower[joint], upper[joint]])
            allowed = f"allowed is {low:g} to {high:g}{unit}"
            text = f"joint {joint + 1} {what} {value:.1f}{unit}, {allowed}"
            return text.replace("-", "−")
    return ""


@dataclass(frozen=True, slots=True)
class PathLimits:
    """Greatest speed, acceleration and jerk of the way s, a second."""

    speed: float
    acceleration: float
    jerk: float

    def slow_down(self, factor: float) -> "PathLimits":
        """The same S-curve, played `factor` times as slowly."""
        return PathLimits(self.speed / factor, self.acceleration / factor**2, self.jerk / factor**3)


@dataclass(frozen=True, slots=True)
class JointPath:
    """Joint angles over the way s, 0 to `length` (m along a line, or 1 between two postures)."""

    spline: Any  # scipy's BSpline: s to (n,), rad
    length: float

    def q(self, s: Array | float) -> Array:
        """Joint angles (..., n)."""
        return self.derivative(s, 0)

    def derivative(self, s: Array | float, order: int) -> Array:
        """Joint angles' derivative by s, (..., n)."""
        return np.asarray(self.spline(np.clip(s, 0.0, self.length), nu=order))

    def range(self) -> tuple[Array, Array]:
        """Bound the joint angles from below and above, (n,) each."""
        coefficients = _coefficients(self.spline)
        return coefficients.min(axis=0), coefficients.max(axis=0)

    def bounds(self) -> Array:
        """Bound the magnitudes of the first three derivatives, (3, n)."""
        bounds = np.zeros((3, self.spline.c.shape[1]))
        for order in range(1, min(3, self.spline.k) + 1):
            bounds[order - 1] = np.abs(_coefficients(self.spline.derivative(order))).max(axis=0)
        return bounds


def _coefficients(spline: Any) -> Array:
    """All that count: after `derivative` scipy leaves some behind the last knots unused."""
    kept: Array = spline.c[: len(spline.t) - spline.k - 1]
    return kept


def joint_path(start: Array, end: Array) -> JointPath:
    """Go straight from one posture (n,) to another, in joint angles; its way is 1 long."""
    knots = np.array([0.0, 0.0, 1.0, 1.0])
    return JointPath(BSpline(knots, np.stack([start, end]), 1), 1.0)


@dataclass(frozen=True, slots=True)
class Trajectory:
    """A path with its S-curve, forwards or back; at rest before the beginning and after the end."""

    path: JointPath
    rates: PathLimits
    curve: Any  # ruckig's Trajectory of s
    duration: float  # s

    def at(self, t: float) -> JointMotion:
        """What the joints do, t s after the beginning."""
        return self._motion(np.array(_state_at(self.curve, min(max(t, 0.0), self.duration))))

    def _motion(self, way: Array) -> JointMotion:
        """Carry the way, its speed and its acceleration (3, ...) to the joints."""
        s, speed, acceleration = way[0], way[1, ..., None], way[2, ..., None]
        first, second = self.path.derivative(s, 1), self.path.derivative(s, 2)
        return JointMotion(
            self.path.q(s), first * speed, first * acceleration + second * speed * speed
        )

    def sampled(self, period: float) -> tuple[Array, JointMotion]:
        """Times (m,), the last one the end, and what the joints do then, (m, n) each."""
        times = np.append(np.arange(0.0, self.duration, period), self.duration)
        return times, self._motion(np.array([_state_at(self.curve, t) for t in times.tolist()]).T)

    def stop_at(self, t: float) -> "Trajectory":
        """Come to rest as soon as the limits allow, from t s on, without leaving the path."""
        order = _path_order(_state_at(self.curve, min(max(t, 0.0), self.duration)), self.rates)
        order.control_interface = ruckig.ControlInterface.Velocity
        curve = _calculate(order)
        return Trajectory(self.path, self.rates, curve, curve.duration)

    def back(self) -> "Trajectory":
        """Go back along the path from where this one ends to the path's beginning."""
        end = _state_at(self.curve, self.duration)[0]
        return _rest_to_rest(self.path, self.rates, end, 0.0)


def time_path(path: JointPath, limits: JointLimits, wanted: PathLimits | None = None) -> Trajectory:
    """Follow a path from rest to rest as fast as the limits of the joints allow.

    `wanted`: rates of the way that are not exceeded either; by default none. A path that is curved
    in joint angles needs them; it is played slower as far as the joints ask for it.
    """
    rates = _reached_limits(path, _straight_rates(path, limits) if wanted is None else wanted)
    slower = max(1.0, _slowdown(path, limits, rates))
    return _rest_to_rest(path, rates.slow_down(slower), 0.0, path.length)


def required_slowdown(path: JointPath, limits: JointLimits, wanted: PathLimits) -> float:
    """How many times slower than wanted a path must be played for the joints' limits."""
    return _slowdown(path, limits, _reached_limits(path, wanted))


def _reached_limits(path: JointPath, rates: PathLimits) -> PathLimits:
    """What an S-curve from end to end comes to: on a short way not the speed that it may have."""
    profile = _rest_to_rest(path, rates, 0.0, path.length).curve.profiles[0][0]
    speed, acceleration = (max(map(abs, values)) for values in (profile.v, profile.a))
    return PathLimits(speed, acceleration, rates.jerk)


def _slowdown(path: JointPath, limits: JointLimits, rates: PathLimits) -> float:
    """Find by how much, k, a path must be slowed; its rates shrink by k, k² and k³."""
    first, second, third = path.bounds()
    v, a, j = rates.speed, rates.acceleration, rates.jerk
    speed = first * v
    acceleration = second * v**2 + first * a
    jerk = third * v**3 + 3 * second * v * a + first * j
    shares = (speed / limits.speed, acceleration / limits.acceleration, jerk / limits.jerk)
    return float(max(share.max() ** (1 / power) for power, share in enumerate(shares, start=1)))


def _straight_rates(path: JointPath, limits: JointLimits) -> PathLimits:
    """Rates at which the first of the joints comes to its limit, each for itself."""
    moves = np.maximum(path.bounds()[0], MIN_PATH_LENGTH)
    rates = (limits.speed, limits.acceleration, limits.jerk)
    return PathLimits(*(float((greatest / moves).min()) for greatest in rates))


def _rest_to_rest(path: JointPath, rates: PathLimits, start: float, goal: float) -> Trajectory:
    """From rest at one place of the way to rest at another."""
    order = _path_order((start, 0.0, 0.0), rates)
    order.target_position = [goal]
    curve = _calculate(order)
    return Trajectory(path, rates, curve, curve.duration)


def _path_order(state: tuple[float, float, float], rates: PathLimits) -> Any:
    """Ruckig's input of the way s, from a state (s, speed, acceleration) to rest."""
    limits = (rates.speed, rates.acceleration, rates.jerk)
    return _order([[value] for value in state], [[value] for value in limits])


def _order(state: list[list[float]], limits: list[list[float]]) -> Any:
    """Ruckig's input of n coordinates, from a state (3, n) to rest; limits (3, n) of its rates."""
    order = ruckig.InputParameter(len(state[0]))
    order.current_position, order.current_velocity, order.current_acceleration = state
    order.max_velocity, order.max_acceleration, order.max_jerk = limits
    return order


def _calculate(order: Any) -> Any:
    curve = ruckig.Trajectory(order.degrees_of_freedom)
    result = ruckig.Ruckig(order.degrees_of_freedom).calculate(order, curve)
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise ArithmeticError(f"ruckig finds no S-curve: {result}")
    return curve


def _state_at(curve: Any, t: float) -> tuple[float, float, float]:
    s, speed, acceleration = curve.at_time(t)
    return float(s[0]), float(speed[0]), float(acceleration[0])


@dataclass(frozen=True, slots=True)
class MotionStep:
    """What the joints are ordered next, and why it is not the way to the goal, where it is not."""

    motion: JointMotion
    reason: str  # empty: on the way to the goal, or there
    moving: bool


class TrajectoryFollower:
    """A filter from goals to a stream of motions, one a period, s.

    The arm stands at q (n,), rad, at rest. `clear` names what obstructs postures in order, or the
    way between them.

    Raises:
        ValueError: the arm stands outside its limits, or where it is not clear.
    """

    def __init__(self, limits: JointLimits, q: Array, period: float, clear: ObstacleCheck) -> None:
        # what `limit_violation` lets pass beyond
        inside = TOL_LIMIT * (limits.upper - limits.lower)
        self._limits = replace(limits, lower=limits.lower + inside, upper=limits.upper - inside)
        self._period, self._clear = period, clear
        self._motion = rest_motion(np.array(q, dtype=float))
        trouble = limit_violation(limits, self._motion) or clear(self._motion.q[None])
        if trouble:
            raise ValueError(f"the arm cannot begin here: {trouble}")
        self._stop = self._stopping(self._motion)
        self._since_stop = 0.0  # s along that stop

    @property
    def motion(self) -> JointMotion:
        """What was ordered last."""
        return self._motion

    def step(self, goal: Array | None, velocity: Array | None = None) -> MotionStep:
        """Go on for one period to a goal (n,), rad, that moves at a velocity (n,), rad/s.

        The goal is brought within the joints' limits; None: stop.
        """
        if goal is None or not np.isfinite(goal).all():
            return self._hold("" if goal is None else "the goal is not a number")
        reason = ""
        for speed in (velocity, None) if velocity is not None else (None,):
            ahead = self._towards(goal, speed)
            motion = _motion_at(ahead, self._period)
            stop = self._stopping(motion)
            reason = self._trouble(motion, stop)
            if not reason:
                self._motion, self._stop, self._since_stop = motion, stop, 0.0
                return MotionStep(motion, "", self._is_moving())
        return self._hold(reason)

    def _hold(self, reason: str) -> MotionStep:
        self._since_stop += self._period
        motion = _motion_at(self._stop, self._since_stop)
        self._motion = motion if self._since_stop < self._stop.duration else rest_motion(motion.q)
        return MotionStep(self._motion, reason, self._is_moving())

    def _is_moving(self) -> bool:
        motion = self._motion
        return bool(np.abs([motion.velocity, motion.acceleration]).max() > TOL_REST)

    def _trouble(self, motion: JointMotion, stop: Any) -> str:
        """Why the arm may not go to `motion` and that stop, in words; empty where it may."""
        extrema = stop.position_extrema
        for value in ([e.min for e in extrema], [e.max for e in extrema]):
            if problem := limit_violation(self._limits, rest_motion(np.array(value))):
                return problem
        times = np.linspace(0.0, stop.duration, N_STOP_SAMPLES)
        stops = np.array([stop.at_time(t)[0] for t in times.tolist()])
        return limit_violation(self._limits, motion) or self._clear(
            np.concatenate([self._motion.q[None], stops])
        )

    def _towards(self, goal: Array, velocity: Array | None) -> Any:
        order = self._order(self._motion)
        order.target_position = np.clip(goal, self._limits.lower, self._limits.upper).tolist()
        if velocity is not None and np.isfinite(velocity).all():
            fastest = MAX_GOAL_SPEED_RATIO * self._limits.speed
            order.target_velocity = np.clip(velocity, -fastest, fastest).tolist()
        return _calculate(order)

    def _stopping(self, motion: JointMotion) -> Any:
        order = self._order(motion)
        order.control_interface = ruckig.ControlInterface.Velocity
        return _calculate(order)

    def _order(self, motion: JointMotion) -> Any:
        limits = (self._limits.speed, self._limits.acceleration, self._limits.jerk)
        state = (motion.q, motion.velocity, motion.acceleration)
        order = _order([v.tolist() for v in state], [v.tolist() for v in limits])
        # each joint by itself: a joint that waits for another would leave its quickest stop
        order.synchronization = ruckig.Synchronization.No
        return order


def _motion_at(found: Any, t: float) -> JointMotion:
    q, velocity, acceleration = found.at_time(min(t, found.duration))
    return JointMotion(np.array(q), np.array(velocity), np.array(acceleration))
