"""The simulated controller and its arm: orders in, joint angles out, later and a little noisy."""

import bisect
from collections import deque
from collections.abc import Callable

import numpy as np

from robots import forward, inverse, trajectory
from robots.inverse import near
from verify.core.records import Array
from verify.grasping.actuators.protocols import (
    ACCEPTING_STATES,
    FINAL_STATES,
    ExecutePermission,
    MotionRefusedError,
    MoverState,
    MoverStatus,
)
from verify.grasping.planning.approach import ApproachLine, line_path
from verify.grasping.planning.workspace import Workspace

POWER_UP_TIME = 0.4  # s from asking for the controls to having them
STREAM_TIMEOUT = 0.2  # s without a set point, and a stream counts as over
MAX_ORDER_GAP = 0.04  # s between orders that are one motion
HISTORY_TIME = 2.0  # s of orders that are kept: longer than any delay


class CellArm:
    """The arm itself: it is where it was ordered to be `delay` s ago. Moves nothing on its own."""

    def __init__(self, q: Array, delay: float) -> None:
        self._delay = delay
        self._orders: deque[tuple[float, Array]] = deque([(0.0, q)])
        self.braked: Array | None = None  # where an alarm has stopped it

    def order(self, t: float, q: Array) -> None:
        """Take a set point in."""
        last, stood = self._orders[-1]
        if t - last > MAX_ORDER_GAP:  # it stood there until now
            self._orders.append((t - min(MAX_ORDER_GAP, self._delay), stood))
        if t > last:
            self._orders.append((t, np.array(q)))
        while len(self._orders) > 2 and self._orders[1][0] < t - HISTORY_TIME:
            self._orders.popleft()

    def q(self, t: float) -> Array:
        """Where the joints are, (n,), rad."""
        if self.braked is not None:
            return self.braked
        orders, then = self._orders, t - self._delay
        later = bisect.bisect_right(orders, then, key=lambda order: order[0])
        if later in (0, len(orders)):
            return orders[min(later, len(orders) - 1)][1].copy()
        (begin, first), (end, second) = orders[later - 1], orders[later]
        return first + (then - begin) * ((second - first) / (end - begin))


class SimMover:
    """A simulated controller: a `Mover` that takes a stream of set points too."""

    def __init__(
        self,
        arm: CellArm,
        setup: Workspace,
        now: Callable[[], float],
        permission: ExecutePermission,
    ) -> None:
        if not isinstance(permission, ExecutePermission):
            raise TypeError("an arm moves only with the operator's permission")
        self._arm, self._setup, self._now = arm, setup, now
        self._state, self._reason = MoverState.OFF, ""
        self._since = now()
        self._way: trajectory.Trajectory | None = None
        self._began = 0.0
        self._ordered = arm.q(now())

    def take_controls(self) -> None:
        """Power the servo. See `Mover.take_controls`."""
        if self._state not in FINAL_STATES:
            raise MotionRefusedError(f"the arm is {self._state.value} already")
        self._enter(MoverState.TAKING_CONTROLS)

    def stream(self, q: Array) -> None:
        """Be at joint angles (n,), rad, now: one of a stream of set points.

        Raises:
            MotionRefusedError: it has no controls, makes a move of its own, or q is outside limits.
        """
        if self._state not in ACCEPTING_STATES | {MoverState.MOVING} or self._way is not None:
            raise MotionRefusedError(f"the arm takes no set point now, it is {self._state.value}")
        self._require_within(q)
        self._ordered = np.array(q)
        self._enter(MoverState.MOVING)
        self._arm.order(self._now(), self._ordered)

    def move(self, q: Array, *, on_line: bool = False) -> None:
        """Go to joint angles by joint interpolation, or on a straight line. See `Mover.move`."""
        if self._state not in ACCEPTING_STATES:
            raise MotionRefusedError(f"the arm takes no move now, it is {self._state.value}")
        self._require_within(q)
        path, rates = trajectory.joint_path(self._ordered, q), None
        if on_line:
            path, approach = self._straight_path(q), self._setup.cell.approach
            rates = trajectory.PathLimits(approach.speed, approach.acceleration, approach.jerk)
        self._way = trajectory.time_path(path, self._setup.limits, rates)
        self._began = self._now()
        self._enter(MoverState.MOVING)

    def _straight_path(self, q: Array) -> trajectory.JointPath:
        arm = self._setup.arm
        start, end = forward(arm, self._ordered), forward(arm, q)
        answers = near(inverse(arm, start, hold=self._ordered).q, self._ordered)
        branch = int(np.nanargmin(np.abs(answers - self._ordered).max(axis=1)))
        path = line_path(arm, ApproachLine(start, end[:3, 3] - start[:3, 3]), branch, self._ordered)
        if isinstance(path, str):
            raise MotionRefusedError(path)
        return path

    def hold(self) -> None:
        """Stop where it is and keep the controls. See `Mover.hold`."""
        if self._state not in ACCEPTING_STATES | {MoverState.MOVING}:
            return
        if self._way is None:
            self._enter(MoverState.HELD)
            return
        self._way = self._way.stop_at(self._now() - self._began)
        self._began = self._now()
        self._enter(MoverState.STOPPING)

    def release(self) -> None:
        """Give the controls back. See `Mover.release`."""
        if self._state not in FINAL_STATES:
            self._way = None
            self._enter(MoverState.RELEASED)

    def alarm(self, reason: str) -> None:
        """Fail as a controller does: the servo is off, the brakes are on."""
        self._arm.braked = self._arm.q(self._now())  # it stands there, for good
        self._way = None
        self._enter(MoverState.FAILED)
        self._reason = reason

    def step(self) -> MoverStatus:
        """Go on. See `Mover.step`."""
        now = self._now()
        if self._way is not None:
            self._ordered = self._way.at(now - self._began).q
            self._arm.order(now, self._ordered)
            if now - self._began >= self._way.duration:
                self._way = None
                stopped = self._state is MoverState.STOPPING
                self._enter(MoverState.HELD if stopped else MoverState.ARRIVED)
        elif self._state is MoverState.TAKING_CONTROLS and now - self._since >= POWER_UP_TIME:
            self._enter(MoverState.READY)
        elif self._state is MoverState.MOVING and now - self._since > STREAM_TIMEOUT:
            self._enter(MoverState.HELD)
        angles = None if self._state is MoverState.OFF else self._arm.q(now)
        ended = self._state in FINAL_STATES
        return MoverStatus(self._state, self._reason, angles, now, None, given_back=ended)

    def close(self) -> None:
        """Give the controls back. See `Mover.close`."""
        self.release()

    def _require_within(self, q: Array) -> None:
        if violation := self._setup.limit_violation(q):
            raise MotionRefusedError(violation)

    def _enter(self, state: MoverState) -> None:
        self._state, self._since = state, self._now()
