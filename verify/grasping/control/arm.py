"""The arm as a control loop drives it: one set point a period, whatever the state asks for.

The arm of a control loop where the controller takes one move at a time: stop and go.
"""

from typing import Protocol

import numpy as np

from robots.trajectory import Trajectory, TrajectoryFollower, joint_path, rest_motion
from verify.core.records import Array
from verify.grasping.actuators.protocols import ACCEPTING_STATES, Mover, MoverState, MoverStatus
from verify.grasping.planning.plan import GraspPlanner, JointGoal, transfer_motion

STREAM_STATES = ACCEPTING_STATES | {MoverState.MOVING}
TOL_REST_SPEED = 1e-6  # rad/s: what rounding leaves of a speed
TOL_SAME_GOAL = 0.02  # rad: goals no farther apart are one
TOL_ARRIVAL = 2e-3  # rad: as near as that, read angles count as the ordered ones


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

    def follow(self, goal: JointGoal) -> str:
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

    def __init__(self, setup: GraspPlanner, mover: StreamMover, period: float) -> None:
        self._setup, self._mover, self._period = setup, mover, period
        self._follower: TrajectoryFollower | None = None
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
        if self.q is None and status.state in ACCEPTING_STATES:
            self.q = status.q
        return status

    @property
    def takes_orders(self) -> bool:
        """The controller has given its controls, and has not failed."""
        return self._state in STREAM_STATES

    @property
    def resting(self) -> bool:
        """Nothing is under way."""
        follower = self._follower
        return not self._ways and (
            follower is None or bool(np.abs(follower.motion.velocity).max() < TOL_REST_SPEED)
        )

    def arrived(self, q_read: Array) -> bool:
        """Nothing is under way, and the arm is where it was ordered, by angles read (n,), rad."""
        return self.q is not None and self.resting and np.abs(q_read - self.q).max() < TOL_ARRIVAL

    def follow(self, goal: JointGoal) -> str:
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
        stands = not step.moving and np.abs(goal.velocity).max() < TOL_REST_SPEED
        if step.reason and stands and not self._near(goal):
            return self._begin_over(goal, step.reason)
        return step.reason

    def _near(self, goal: JointGoal) -> bool:
        """Whether a way to this goal was looked for already."""
        return self._over is not None and bool(np.abs(goal.q - self._over).max() < TOL_SAME_GOAL)

    def _begin_over(self, goal: JointGoal, reason: str) -> str:
        """Begin a way around what stopped the joints; says what it was where there is none."""
        assert self.q is not None  # it was just sent
        self._over = np.array(goal.q)
        ways = transfer_motion(self._setup, self.q, goal.q)
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

    def _filter(self) -> TrajectoryFollower:
        assert self.q is not None  # `follow` is ordered only once the controls are there
        if self._follower is None:
            limits, clear = self._setup.limits, self._setup.workspace.clear
            self._follower = TrajectoryFollower(limits, rest_motion(self.q).q, self._period, clear)
        return self._follower

    def _send(self, q: Array) -> None:
        self.q = np.array(q)
        self._mover.stream(self.q)


MIN_MOVE = np.deg2rad(1.0)  # rad: a goal that is nearer than that is no reason to move
MOVING_STATES = frozenset({MoverState.ORDERING, MoverState.MOVING})
BUSY_STATES = MOVING_STATES | {MoverState.STOPPING}


class SteppedArm:
    """Gives the controller one move after the other, each to rest.

    The controller makes the way between by itself: straight in joint angles, or the flange on a
    straight line. Each was looked at along its whole length beforehand.

    Args:
        setup: arm and cell.
        mover: makes the moves.
    """

    def __init__(self, setup: GraspPlanner, mover: Mover) -> None:
        self._setup, self._mover = setup, mover
        self._state = MoverState.OFF
        self._moves: list[tuple[Array, bool]] = []  # joint angles, and whether on a line
        self._top: Array | None = None  # where the line begins, once it was begun
        self._began_line = False  # the last move that was ordered is on the line
        self._sent = False  # the first of the moves was ordered
        self._back = False
        self.q: Array | None = None  # (n,), rad, ordered last

    def take_controls(self) -> None:
        """Ask for the controls. See `Mover.take_controls`."""
        self._mover.take_controls()

    def release(self) -> None:
        """Give the controls back."""
        self._mover.release()

    def step(self) -> MoverStatus:
        """Let the controller go on."""
        status = self._mover.step()
        self._state = status.state
        if status.state in ACCEPTING_STATES and not self._moves:
            self.q = status.q if self.q is None or status.state is MoverState.HELD else self.q
        return status

    @property
    def takes_orders(self) -> bool:
        """The controller has given its controls, and has not failed."""
        return self._state in ACCEPTING_STATES | BUSY_STATES

    @property
    def resting(self) -> bool:
        """Nothing is under way."""
        return not self._moves and self._state not in BUSY_STATES

    @property
    def going_back(self) -> bool:
        """On the way up, or there."""
        return self._back

    def arrived(self, q_read: Array) -> bool:
        """Nothing is under way, and the arm is where it was ordered, by angles read (n,), rad."""
        return self.q is not None and self.resting and np.abs(q_read - self.q).max() < TOL_ARRIVAL

    def follow(self, goal: JointGoal) -> str:
        """Move to a goal that is worth it; says what stands in the way, where something does."""
        if self._moves:
            self.go()
            return ""
        if self.q is None or self._state not in ACCEPTING_STATES:
            return ""
        if np.abs(goal.q - self.q).max() < MIN_MOVE:
            return ""
        self._top, self._back = None, False
        trouble = self._setup.workspace.along(joint_path(self.q, goal.q))
        if not trouble:
            self._moves, self._sent = [(goal.q, False)], False
            self.go()
        return trouble

    def begin(self, ways: tuple[Trajectory, ...], line: Trajectory) -> None:
        """Go planned ways one after the other, the line to the object last."""
        ends = [(way.at(way.duration).q, False) for way in ways]
        self._moves = [*ends, (line.at(line.duration).q, True)]
        self._top, self._sent, self._back = line.at(0.0).q, False, False

    def begin_back(self) -> None:
        """Go back up the line that was gone down, from wherever on it the arm rests."""
        self._moves = []
        if self._top is not None and self._began_line:
            self._moves = [(self._top, True)]
        self._sent, self._back = False, True

    def go(self) -> None:
        """Order the next move once the last one has ended."""
        if not self._moves:
            return
        q, on_line = self._moves[0]
        if self._sent and self._state is MoverState.ARRIVED:
            self._moves.pop(0)
            self._sent = False
        elif not self._sent and self._state in ACCEPTING_STATES:
            (self._mover.move_line if on_line else self._mover.move_joints)(q)
            self.q, self._sent, self._state = q, True, MoverState.ORDERING
            self._began_line = on_line

    def hold(self) -> None:
        """Stop where it is."""
        self._moves, self._back = [], self._back and not self._moves
        if self._state in MOVING_STATES:
            self._mover.hold()
            self._state = MoverState.STOPPING
