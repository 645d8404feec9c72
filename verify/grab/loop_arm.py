"""The arm as a control loop drives it: one set point a period, whatever the state asks for."""

from typing import Protocol

import numpy as np

from verify.grab.limits import at_rest
from verify.grab.motion_port import TAKES_MOVES, Mover, MoverState, MoverStatus
from verify.grab.plan import Planner, over
from verify.grab.plan_follow import Goal
from verify.grab.trajectory import Trajectory
from verify.grab.trajectory_follow import Follower
from verify.records import Array

TAKES_STREAM = TAKES_MOVES | {MoverState.MOVING}
STILL = 1e-6  # rad/s: what rounding leaves of a speed
SAME_GOAL = 0.02  # rad: goals no farther apart are one
ARRIVED = 2e-3  # rad: as near as that, read angles count as the ordered ones


class StreamMover(Mover, Protocol):
    """An arm that also takes a stream of set points."""

    def stream(self, q: Array) -> None:
        """Be at joint angles (joints,), rad, now.

        Raises:
            MotionRefusedError: no set point can be taken now, or q is outside the limits.
        """
        ...


class DrivenArm(Protocol):
    """What the loop orders, a turn at a time."""

    q: Array | None  # (n,), rad, ordered last

    @property
    def takes_orders(self) -> bool:
        """The controller has given its controls, and has not failed."""
        ...

    @property
    def resting(self) -> bool:
        """Nothing is under way."""
        ...

    @property
    def going_back(self) -> bool:
        """On the way up, or there."""
        ...

    def take_controls(self) -> None:
        """Ask for the controls. See `Mover.take_controls`."""
        ...

    def release(self) -> None:
        """Give the controls back."""
        ...

    def step(self) -> MoverStatus:
        """Let the controller go on."""
        ...

    def arrived(self, q_read: Array) -> bool:
        """Nothing is under way, and the arm is where it was ordered, by angles read (n,), rad."""
        ...

    def follow(self, goal: Goal) -> str:
        """Go towards a goal; says what stands in the way, where something does."""
        ...

    def begin(self, ways: tuple[Trajectory, ...], line: Trajectory) -> None:
        """Go planned ways one after the other, the line to the object last."""
        ...

    def begin_back(self) -> None:
        """Go back up the line that was gone down, from wherever on it the arm rests."""
        ...

    def go(self) -> None:
        """Go on along what was begun."""
        ...

    def hold(self) -> None:
        """Come to rest; called again until it does."""
        ...


class StreamedArm:
    """Follows goals, or planned ways one after the other; a hold leaves neither its path.

    Args:
        setup: arm and cell.
        mover: takes the set points.
        period: s, from one to the next.
    """

    def __init__(self, setup: Planner, mover: StreamMover, period: float) -> None:
        self._setup, self._mover, self._period = setup, mover, period
        self._follower: Follower | None = None
        self._ways: list[Trajectory] = []
        self._line: Trajectory | None = None  # what was gone of the line to the object, last
        self._gone = 0.0  # s along the first of the ways
        self._holding = False
        self._back = False
        self._over: Array | None = None  # (n,), rad: the goal to which a way was last looked for
        self._state = MoverState.OFF
        self.q: Array | None = None  # (n,), rad, ordered last

    def step(self) -> MoverStatus:
        """Let the controller go on."""
        status = self._mover.step()
        self._state = status.state
        if self.q is None and status.state in TAKES_MOVES:
            self.q = status.q
        return status

    @property
    def takes_orders(self) -> bool:
        """The controller has given its controls, and has not failed."""
        return self._state in TAKES_STREAM

    @property
    def resting(self) -> bool:
        """Nothing is under way."""
        follower = self._follower
        return not self._ways and (
            follower is None or bool(np.abs(follower.motion.velocity).max() < STILL)
        )

    def arrived(self, q_read: Array) -> bool:
        """Nothing is under way, and the arm is where it was ordered, by angles read (n,), rad."""
        return self.q is not None and self.resting and np.abs(q_read - self.q).max() < ARRIVED

    def follow(self, goal: Goal) -> str:
        """Go a period's way towards a goal; says what stands in the way, where something does.

        Each joint goes by itself. Where that ends at something that is in the way, and the goal
        stands, a way that was looked at as a whole leads there.

        Raises:
            ValueError: the arm stands where no way may begin.
        """
        if self._ways and self._near(goal) and not self._holding:
            self.go()
            return ""
        if self._ways:  # a stop is under way, or begins: it comes to its end first
            self.hold()
            return ""
        self._line, self._holding, self._back = None, False, False
        step = self._filter().step(goal.q, goal.velocity)
        self._send(step.motion.q)
        stands = not step.moving and np.abs(goal.velocity).max() < STILL
        if step.reason and stands and not self._near(goal):
            return self._begin_over(goal, step.reason)
        return step.reason

    def _near(self, goal: Goal) -> bool:
        """Whether a way to this goal was looked for already."""
        return self._over is not None and bool(np.abs(goal.q - self._over).max() < SAME_GOAL)

    def _begin_over(self, goal: Goal, reason: str) -> str:
        """Begin a way around what stopped the joints; says what it was where there is none."""
        assert self.q is not None  # it was just sent
        self._over = np.array(goal.q)
        ways = over(self._setup, self.q, goal.q)
        if isinstance(ways, str):
            return reason
        self._ways, self._gone, self._follower = list(ways), 0.0, None
        return ""

    def begin(self, ways: tuple[Trajectory, ...], line: Trajectory) -> None:
        """Go planned ways one after the other, the line to the object last."""
        self._ways, self._line, self._gone = [*ways, line], line, 0.0
        self._follower, self._holding, self._back, self._over = None, False, False, None

    def begin_back(self) -> None:
        """Go back up the line that was gone down, from wherever on it the arm rests."""
        self._line = None if self._line is None else self._line.returning()
        self._ways = [] if self._line is None else [self._line]
        self._gone, self._follower, self._holding, self._back = 0.0, None, False, True

    def go(self) -> None:
        """Go a period's way along what was begun."""
        if self._ways:
            self._gone += self._period
            way = self._ways[0]
            self._send(way.at(self._gone).q)
            if self._gone >= way.duration:
                self._ways.pop(0)
                self._gone, self._holding = 0.0, False

    def hold(self) -> None:
        """Come to rest as quickly as the limits allow, on the path."""
        if self._ways:
            if not self._holding:
                self._held()
            self.go()
        elif self._follower is not None:
            self._send(self._follower.step(None).motion.q)
            if self.resting:
                self._follower = None

    @property
    def going_back(self) -> bool:
        """On the way up, or there."""
        return self._back

    def take_controls(self) -> None:
        """Ask for the controls. See `Mover.take_controls`."""
        self._mover.take_controls()

    def release(self) -> None:
        """Give the controls back."""
        self._mover.release()

    def _held(self) -> None:
        on_line, self._over = self._ways[0] is self._line, None
        stopping = self._ways[0].held(self._gone)
        self._ways, self._gone, self._holding, self._back = [stopping], 0.0, True, False
        self._line = stopping if on_line else None  # before the line there is none to go back up

    def _filter(self) -> Follower:
        assert self.q is not None  # `follow` is ordered only once the controls are there
        if self._follower is None:
            limits, clear = self._setup.limits, self._setup.workspace.clear
            self._follower = Follower(limits, at_rest(self.q).q, self._period, clear)
        return self._follower

    def _send(self, q: Array) -> None:
        self.q = np.array(q)
        self._mover.stream(self.q)
