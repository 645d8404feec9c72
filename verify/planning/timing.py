"""Time a tour: jerk-limited legs from rest to rest, each at its own share of the greatest speed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from robots import Arm
from robots.trajectory import JointLimits, Trajectory, joint_path, time_path
from verify.core.records import Array
from verify.planning.roadmap import MotionStop

# Shares of the greatest speed, leg after leg: what tells a clock's error from a backlash is speed
# that varies (corr(latency, backlash) is -0.15 to -0.73 at one speed).
PACES = (1.0, 0.5, 0.8, 0.4)
SPEED_UP_TIME = 0.4  # s to full speed, where the arm's file states no acceleration
ACCELERATION_TIME = 0.15  # s to full acceleration, where it states no jerk
PERIOD = 0.05  # s between the rows of plan.csv


@dataclass(frozen=True)
class TimedMotion:
    """A motion from rest to rest; k stops."""

    stops: tuple[MotionStop, ...]
    arrive: Array  # (k,), s; the first at 0
    leave: Array  # (k,), s
    legs: tuple[Trajectory, ...]  # (k - 1)
    pace: Array  # (k - 1,), share of the greatest speed

    @property
    def duration(self) -> float:
        """In s."""
        return float(self.leave[-1])

    def times(self, step: float) -> Array:
        """Instants from the beginning in even steps, and the end, (n,), s."""
        return np.append(np.arange(0.0, self.duration, step), self.duration)

    def q(self, t: Array) -> Array:
        """Joint angles (n, j), rad, at times (n,), s; at rest before and after."""
        leg = np.clip(np.searchsorted(self.leave, t, side="right") - 1, -1, len(self.legs) - 1)
        found = np.tile(self.stops[0].q, (len(t), 1))
        for i in np.unique(leg[leg >= 0]).tolist():
            own = leg == i
            part = self.legs[i]
            since = np.clip(t[own] - self.leave[i], 0.0, part.duration).tolist()
            found[own] = part.path.q(np.array([part.curve.at_time(s)[0][0] for s in since]))
        return found

    def resting(self, t: Array) -> list[int | None]:
        """Which pose the arm rests at, at times (n,)."""
        at = np.clip(np.searchsorted(self.arrive, t, side="right") - 1, 0, len(self.stops) - 1)
        rests = t <= self.leave[at]
        return [
            self.stops[k].pose if rest else None
            for k, rest in zip(at.tolist(), rests.tolist(), strict=True)
        ]


def joint_limits(arm: Arm, speed: float) -> JointLimits:
    """Limits of the joints: those of the arm's file, and no joint faster than requested."""
    most = np.full(arm.dof, speed)
    if arm.speed is not None:
        most = np.minimum(most, arm.speed)
    acceleration, jerk = most / SPEED_UP_TIME, most / SPEED_UP_TIME / ACCELERATION_TIME
    if arm.acceleration is not None:
        acceleration = np.minimum(acceleration, arm.acceleration)
    if arm.jerk is not None:
        jerk = np.minimum(jerk, arm.jerk)
    return JointLimits(arm.lower, arm.upper, most, acceleration, jerk)


def schedule(stops: Sequence[MotionStop], greatest: JointLimits, hold: float) -> TimedMotion:
    """Give each leg its speed and each pose `hold` s of rest; stops only passed have none."""
    now, arrive, leave, legs, paces = 0.0, [], [], [], []
    for k, stop in enumerate(stops):
        if k:
            pace = PACES[(k - 1) % len(PACES)]
            leg = time_path(
                joint_path(stops[k - 1].q, stop.q), replace(greatest, speed=pace * greatest.speed)
            )
            now += leg.duration
            legs.append(leg)
            paces.append(pace)
        arrive.append(now)
        now += hold if stop.pose is not None else 0.0
        leave.append(now)
    return TimedMotion(
        tuple(stops), np.array(arrive), np.array(leave), tuple(legs), np.array(paces)
    )
