"""Jerk-limited motion along a path of joint angles: an S-curve over the way, by ruckig.

The path is a B-spline q(s), the S-curve is s(t). Since a B-spline lies within the hull of its
coefficients, and its derivatives are B-splines too, their greatest values are bounded along the
whole way, not at samples. A straight line between two postures is a path as well: then the S-curve
of the joint that needs most time rules, and all joints begin and end together.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import ruckig
from scipy.interpolate import BSpline

from verify.grab.limits import JointLimits, Motion
from verify.records import Array

STILL = 1e-9  # rad: a way this short is none


@dataclass(frozen=True, slots=True)
class Rates:
    """Greatest speed, acceleration and jerk of the way s, a second."""

    speed: float
    acceleration: float
    jerk: float

    def slowed(self, factor: float) -> "Rates":
        """The same S-curve, played `factor` times as slowly."""
        return Rates(self.speed / factor, self.acceleration / factor**2, self.jerk / factor**3)


@dataclass(frozen=True, slots=True)
class Path:
    """Joint angles over the way s, 0 to `length` (m along a line, or 1 between two postures)."""

    spline: Any  # scipy's BSpline: s to (n,), rad
    length: float

    def q(self, s: Array | float) -> Array:
        """Joint angles (..., n)."""
        found: Array = np.asarray(self.spline(np.clip(s, 0.0, self.length)))
        return found

    def derivative(self, s: Array | float, order: int) -> Array:
        """Joint angles' derivative by s, (..., n)."""
        found: Array = np.asarray(self.spline(np.clip(s, 0.0, self.length), nu=order))
        return found

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


def between(start: Array, end: Array) -> Path:
    """Go straight from one posture (n,) to another, in joint angles; its way is 1 long."""
    knots = np.array([0.0, 0.0, 1.0, 1.0])
    return Path(BSpline(knots, np.stack([start, end]), 1), 1.0)


@dataclass(frozen=True, slots=True)
class Trajectory:
    """A path with its S-curve, forwards or back; at rest before the beginning and after the end."""

    path: Path
    rates: Rates
    curve: Any  # ruckig's Trajectory of s
    duration: float  # s

    def at(self, t: float) -> Motion:
        """What the joints do, t s after the beginning."""
        return self._motion(np.array(_at(self.curve, min(max(t, 0.0), self.duration))))

    def _motion(self, way: Array) -> Motion:
        """Carry the way, its speed and its acceleration (3, ...) to the joints."""
        s, speed, acceleration = way[0], way[1, ..., None], way[2, ..., None]
        first, second = self.path.derivative(s, 1), self.path.derivative(s, 2)
        return Motion(self.path.q(s), first * speed, first * acceleration + second * speed * speed)

    def sampled(self, period: float) -> tuple[Array, Motion]:
        """Times (m,), the last one the end, and what the joints do then, (m, n) each."""
        times = np.append(np.arange(0.0, self.duration, period), self.duration)
        return times, self._motion(np.array([_at(self.curve, t) for t in times.tolist()]).T)

    def held(self, t: float) -> "Trajectory":
        """Come to rest as soon as the limits allow, from t s on, without leaving the path."""
        s, speed, acceleration = _at(self.curve, min(max(t, 0.0), self.duration))
        order = _order(s, speed, acceleration, self.rates)
        order.control_interface = ruckig.ControlInterface.Velocity
        curve = _calculated(order)
        return Trajectory(self.path, self.rates, curve, curve.duration)

    def returning(self) -> "Trajectory":
        """Go back along the path from where this one ends to the path's beginning."""
        return _along(self.path, self.rates, self._end, 0.0)

    @property
    def _end(self) -> float:
        return _at(self.curve, self.duration)[0]


def timed(path: Path, limits: JointLimits, wanted: Rates | None = None) -> Trajectory:
    """Follow a path from rest to rest as fast as the limits allow.

    Args:
        path: joint angles over the way.
        limits: of the joints.
        wanted: rates of the way that are not exceeded either; by default none. A path that is
            curved in joint angles needs them; it is played slower as far as the joints ask for it.
    """
    rates = _reached(path, _straight_rates(path, limits) if wanted is None else wanted)
    slower = max(1.0, _slowing(path, limits, rates))
    return _along(path, rates.slowed(slower), 0.0, path.length)


def slowing(path: Path, limits: JointLimits, wanted: Rates) -> float:
    """How many times slower than wanted a path must be played for the joints' limits."""
    return _slowing(path, limits, _reached(path, wanted))


def _reached(path: Path, rates: Rates) -> Rates:
    """What an S-curve from end to end comes to: on a short way not the speed that it may have."""
    profile = _along(path, rates, 0.0, path.length).curve.profiles[0][0]
    speed, acceleration = (max(map(abs, values)) for values in (profile.v, profile.a))
    return Rates(speed, acceleration, rates.jerk)


def _slowing(path: Path, limits: JointLimits, rates: Rates) -> float:
    """How many times slower than `rates` a path must be played.

    With s(t) the joints' rates are q' s', q'' s'² + q' s'', q''' s'³ + 3 q'' s' s'' + q' s''';
    played k times as slowly they shrink by k, k² and k³.
    """
    first, second, third = path.bounds()
    v, a, j = rates.speed, rates.acceleration, rates.jerk
    speed = first * v
    acceleration = second * v**2 + first * a
    jerk = third * v**3 + 3 * second * v * a + first * j
    return float(
        max(
            (speed / limits.speed).max(),
            (acceleration / limits.acceleration).max() ** (1 / 2),
            (jerk / limits.jerk).max() ** (1 / 3),
        )
    )


def _straight_rates(path: Path, limits: JointLimits) -> Rates:
    """Rates at which the first of the joints comes to its limit, each for itself."""
    moves = np.maximum(path.bounds()[0], STILL)
    rates = (limits.speed, limits.acceleration, limits.jerk)
    return Rates(*(float((greatest / moves).min()) for greatest in rates))


def _along(path: Path, rates: Rates, start: float, goal: float) -> Trajectory:
    """From rest at one place of the way to rest at another."""
    order = _order(start, 0.0, 0.0, rates)
    order.target_position = [goal]
    curve = _calculated(order)
    return Trajectory(path, rates, curve, curve.duration)


def _order(s: float, speed: float, acceleration: float, rates: Rates) -> Any:
    order = ruckig.InputParameter(1)
    order.current_position, order.current_velocity = [s], [speed]
    order.current_acceleration = [acceleration]
    order.target_velocity, order.target_acceleration = [0.0], [0.0]
    order.max_velocity, order.max_acceleration = [rates.speed], [rates.acceleration]
    order.max_jerk = [rates.jerk]
    return order


def _calculated(order: Any) -> Any:
    curve = ruckig.Trajectory(1)
    result = ruckig.Ruckig(1).calculate(order, curve)
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise ArithmeticError(f"ruckig finds no S-curve: {result}")
    return curve


def _at(curve: Any, t: float) -> tuple[float, float, float]:
    s, speed, acceleration = curve.at_time(t)
    return float(s[0]), float(speed[0]), float(acceleration[0])
