"""What the world of a simulated grasp saw of it: the arm's limits, and where the fingers closed."""

from dataclasses import dataclass, field

import numpy as np

from robots.trajectory import JointLimits
from verify.core.records import Array
from verify.simulation.cell.grab import CellRun


@dataclass
class LimitMonitor:
    """What the world saw of the arm: the judge of limits, who knows nothing of the planner."""

    limits: JointLimits
    lower: Array  # (3,), m: the box of the grip point
    upper: Array
    speed: float = 0.0  # greatest share of the limit that was used
    acceleration: float = 0.0
    outside: float = 0.0  # m, farthest that the grip point was outside the box
    _last: list[tuple[float, Array]] = field(default_factory=list)

    def see(self, t: float, q: Array, grip: Array) -> None:
        """Take note of joint angles (n,), rad, and the grip point (3,), m, at t, s."""
        self._last = [*self._last[-2:], (t, q)]
        beyond = np.maximum(self.lower - grip, grip - self.upper).max()
        self.outside = max(self.outside, float(beyond))
        if len(self._last) == 3:
            (t0, q0), (t1, q1), (t2, q2) = self._last
            fast = (q2 - q1) / (t2 - t1)
            before = (q1 - q0) / (t1 - t0)
            harder = (fast - before) / ((t2 - t0) / 2)
            self.speed = max(self.speed, float(np.abs(fast / self.limits.speed).max()))
            hard = float(np.abs(harder / self.limits.acceleration).max())
            self.acceleration = max(self.acceleration, hard)


class GraspMonitor:
    """Looks on at a run in the cell, from its beginning."""

    def __init__(self, grab: CellRun) -> None:
        setup = grab.world.setup
        self.limits = LimitMonitor(setup.workspace.limits, setup.cell.lower, setup.cell.upper)
        self.closed_on: Array | None = None  # (3,), m, base: the grip point when fingers closed
        self.closed_at: Array | None = None  # (3,), m: where the target was then
        self._world, self._held = grab.world, False
        self._advance, self._wait = grab.world.advance, grab.source.wait
        grab.world.advance = self._let_pass
        grab.source.wait = self._judge

    def _let_pass(self, dt: float) -> None:
        self._advance(dt)
        held, before = self._world.held, self._held
        self._held = held is not None
        if held is not None and not before:
            grip = self._world.grip()
            self.closed_on, self.closed_at = grip[:3, 3], (grip @ held[1])[:3, 3]

    def _judge(self) -> None:
        """Look whether the arm keeps its limits; once a set point, as those are made."""
        self._wait()
        world = self._world
        q = world.arm.q(world.t)
        grip = world.setup.workspace.grip(q)  # limits are of the ordered angles
        self.limits.see(world.t, q, grip[:3, 3])


@dataclass(frozen=True, slots=True)
class MonitoredRun(CellRun):
    """A run in the cell that is looked on at."""

    monitor: GraspMonitor


def monitored(grab: CellRun) -> MonitoredRun:
    """Look on at a run that has not begun yet."""
    return MonitoredRun(grab.world, grab.source, grab.loop, GraspMonitor(grab))
