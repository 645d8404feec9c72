"""Drive the arm for the control loop: a stream of set points, or one move after the other.

Both kinds follow goals above a moving target, go planned trajectories one after the other, come to
rest on their path, and go back up the line to the object.
"""

from abc import ABC, abstractmethod
from typing import ClassVar, Protocol

import numpy as np

from robots.trajectory import Trajectory, TrajectoryFollower, joint_path
from verify.core.records import Array
from verify.grasping.actuators.protocols import ACCEPTING_STATES, Mover, MoverState, MoverStatus
from verify.grasping.planning.plan import JointGoal, transfer_motion
from verify.grasping.planning.workspace import Workspace

TOL_REST_SPEED = 1e-6  # rad/s: what rounding leaves of a speed
TOL_SAME_GOAL = 0.02  # rad: goals no farther apart are one
TOL_ARRIVAL = 2e-3  # rad: as near as that, read angles count as the ordered ones
MIN_MOVE = np.deg2rad(1.0)  # rad: a goal that is nearer than that is no reason to move
MOVING_STATES = frozenset({MoverState.ORDERING, MoverState.MOVING})
BUSY_STATES = MOVING_STATES | {MoverState.STOPPING}


class StreamMover(Mover, Protocol):
    """An arm that also takes a stream of set points."""

    def stream(self, q: Array) -> None:
        """Be at joint angles (joints,), rad, now.

        Raises:
            MotionRefusedError: no set point can be taken now, or q is outside the limits.
        """


class OrderedArm(ABC):
    """What is common to arms that the loop orders, one cycle at a time."""

    order_states: ClassVar[frozenset[MoverState]]  # of the mover, in which it takes orders

    def __init__(self, setup: Workspace, mover: Mover) -> None:
        self._setup, self.mover = setup, mover
        self._state = MoverState.OFF
        self.q: Array | None = None  # (n,), rad, ordered last
        self.going_back = False  # on the way up, or there

    @property
    def takes_orders(self) -> bool:
        """The controller has given its controls, and has not failed."""
        return self._state in self.order_states

    def step(self) -> MoverStatus:
        """Let the controller go on."""
        status = self.mover.step()
        self._state = status.state
        if self.q is None and status.state in ACCEPTING_STATES:
            self.q = status.q
        return status

    def arrived(self, q_read: Array | None) -> bool:
        """Nothing is under way, and the arm is where it was ordered, by angles read (n,), rad."""
        if self.q is None or q_read is None or not self.resting:
            return False
        return bool(np.abs(q_read - self.q).max() < TOL_ARRIVAL)

    @property
    @abstractmethod
    def resting(self) -> bool:
        """Nothing is under way."""


class StreamedArm(OrderedArm):
    """Sends one set point a period; a hold comes to rest on the path."""

    order_states = ACCEPTING_STATES | {MoverState.MOVING}

    def __init__(self, setup: Workspace, mover: StreamMover, period: float) -> None:
        super().__init__(setup, mover)
        self._stream, self._period = mover.stream, period
        self._follower: TrajectoryFollower | None = None
        self._trajectories: list[Trajectory] = []  # the first is under way
        self._line: Trajectory | None = None  # what was gone of the line to the object, last
        self._elapsed = 0.0  # s along the first trajectory
        self._holding = False
        self._detour_goal: Array | None = None  # (n,), rad: to which a transfer was planned last

    @property
    def resting(self) -> bool:
        """Nothing is under way."""
        follower = self._follower
        return not self._trajectories and (
            follower is None or bool(np.abs(follower.motion.velocity).max() < TOL_REST_SPEED)
        )

    def follow(self, goal: JointGoal) -> str:
        """Go one period towards a goal; returns what stands in the way, in words, or "".

        Each joint goes by itself. Where that ends at an obstacle and the goal stands, a transfer
        that is checked as a whole leads there.

        Raises:
            ValueError: the arm stands where no way may begin.
        """
        if self._trajectories:
            if self._is_detour_goal(goal) and not self._holding:
                self.go()
            else:  # a stop is under way, or begins: it comes to its end first
                self.hold()
            return ""
        self._line, self._holding, self.going_back = None, False, False
        assert self.q is not None  # `follow` is ordered only once the controls are there
        if self._follower is None:
            limits, clear = self._setup.limits, self._setup.clear
            self._follower = TrajectoryFollower(limits, self.q, self._period, clear)
        step = self._follower.step(goal.q, goal.velocity)
        self._send(step.motion.q)
        stands = not step.moving and np.abs(goal.velocity).max() < TOL_REST_SPEED
        if not (step.reason and stands) or self._is_detour_goal(goal):
            return step.reason
        self._detour_goal = np.array(goal.q)
        detour = transfer_motion(self._setup, self.q, goal.q)
        if isinstance(detour, str):
            return step.reason
        self._start(*detour)
        return ""

    def begin(self, transfer: tuple[Trajectory, ...], line: Trajectory) -> None:
        """Begin planned trajectories one after the other, the line to the object last."""
        self._start(*transfer, line)
        self._line, self._holding, self.going_back = line, False, False
        self._detour_goal = None

    def begin_back(self) -> None:
        """Go back up the line that was gone down, from wherever on it the arm rests."""
        self._line = None if self._line is None else self._line.back()
        self._start(*([] if self._line is None else [self._line]))
        self._holding, self.going_back = False, True

    def go(self) -> None:
        """Go one period along what was begun."""
        if self._trajectories:
            self._elapsed += self._period
            current = self._trajectories[0]
            self._send(current.at(self._elapsed).q)
            if self._elapsed >= current.duration:
                self._trajectories.pop(0)
                self._elapsed, self._holding = 0.0, False

    def hold(self) -> None:
        """Come to rest as quickly as the limits allow, on the path."""
        if self._trajectories:
            if not self._holding:
                current = self._trajectories[0]
                stop = current.stop_at(self._elapsed)
                # before the line there is none to go back up
                self._line = stop if current is self._line else None
                self._trajectories, self._elapsed, self._detour_goal = [stop], 0.0, None
                self._holding, self.going_back = True, False
            self.go()
        elif self._follower is not None:
            self._send(self._follower.step(None).motion.q)
            if self.resting:
                self._follower = None

    def _is_detour_goal(self, goal: JointGoal) -> bool:
        last = self._detour_goal
        return last is not None and bool(np.abs(goal.q - last).max() < TOL_SAME_GOAL)

    def _start(self, *trajectories: Trajectory) -> None:
        self._trajectories, self._elapsed, self._follower = list(trajectories), 0.0, None

    def _send(self, q: Array) -> None:
        self.q = np.array(q)
        self._stream(self.q)


class SteppedArm(OrderedArm):
    """Gives the controller one move after the other, each to rest.

    The controller makes the way between by itself: straight in joint angles, or the flange on a
    straight line. Each is checked along its whole length beforehand.
    """

    order_states = ACCEPTING_STATES | BUSY_STATES

    def __init__(self, setup: Workspace, mover: Mover) -> None:
        super().__init__(setup, mover)
        self._moves: list[tuple[Array, bool]] = []  # joint angles, and whether on a line
        self._top: Array | None = None  # where the line begins, once it was begun
        self._began_line = False  # the last move that was ordered is on the line
        self._sent = False  # the first of the moves was ordered

    def step(self) -> MoverStatus:
        """Let the controller go on; where it was stopped counts as ordered."""
        status = super().step()
        if status.state is MoverState.HELD and not self._moves:
            self.q = status.q
        return status

    @property
    def resting(self) -> bool:
        """Nothing is under way."""
        return not self._moves and self._state not in BUSY_STATES

    def follow(self, goal: JointGoal) -> str:
        """Move to a goal that is worth it; returns what stands in the way, in words, or ""."""
        if self._moves:
            self.go()
            return ""
        if self.q is None or self._state not in ACCEPTING_STATES:
            return ""
        if np.abs(goal.q - self.q).max() < MIN_MOVE:
            return ""
        self._top, self.going_back = None, False
        obstacle = self._setup.along(joint_path(self.q, goal.q))
        if not obstacle:
            self._moves, self._sent = [(goal.q, False)], False
            self.go()
        return obstacle

    def begin(self, transfer: tuple[Trajectory, ...], line: Trajectory) -> None:
        """Begin planned moves one after the other, the line to the object last."""
        ends = [(part.at(part.duration).q, False) for part in transfer]
        self._moves = [*ends, (line.at(line.duration).q, True)]
        self._top, self._sent, self.going_back = line.at(0.0).q, False, False

    def begin_back(self) -> None:
        """Go back up the line that was gone down, from wherever on it the arm rests."""
        self._moves = [(self._top, True)] if self._top is not None and self._began_line else []
        self._sent, self.going_back = False, True

    def go(self) -> None:
        """Order the next move once the last one has ended."""
        if not self._moves:
            return
        q, on_line = self._moves[0]
        if self._sent and self._state is MoverState.ARRIVED:
            self._moves.pop(0)
            self._sent = False
        elif not self._sent and self._state in ACCEPTING_STATES:
            self.mover.move(q, on_line=on_line)
            self.q, self._sent, self._state = q, True, MoverState.ORDERING
            self._began_line = on_line

    def hold(self) -> None:
        """Stop where it is."""
        self._moves, self.going_back = [], self.going_back and not self._moves
        if self._state in MOVING_STATES:
            self.mover.hold()
            self._state = MoverState.STOPPING


DrivenArm = StreamedArm | SteppedArm
