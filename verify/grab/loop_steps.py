"""The arm of a control loop where the controller takes one move at a time: stop and go."""

import numpy as np

from verify.grab.loop_arm import ARRIVED
from verify.grab.motion_port import TAKES_MOVES, Mover, MoverState, MoverStatus
from verify.grab.plan import Planner
from verify.grab.plan_follow import Goal
from verify.grab.trajectory import Trajectory, between
from verify.records import Array

WORTH = np.deg2rad(1.0)  # rad: a goal that is nearer than that is no reason to move
MOVES = frozenset({MoverState.ORDERING, MoverState.MOVING})
UNDER_WAY = MOVES | {MoverState.STOPPING}


class SteppedArm:
    """Gives the controller one move after the other, each to rest.

    The controller makes the way between by itself: straight in joint angles, or the flange on a
    straight line. Each was looked at along its whole length beforehand.

    Args:
        setup: arm and cell.
        mover: makes the moves.
    """

    def __init__(self, setup: Planner, mover: Mover) -> None:
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
        if status.state in TAKES_MOVES and not self._moves:
            self.q = status.q if self.q is None or status.state is MoverState.HELD else self.q
        return status

    @property
    def takes_orders(self) -> bool:
        """The controller has given its controls, and has not failed."""
        return self._state in TAKES_MOVES | UNDER_WAY

    @property
    def resting(self) -> bool:
        """Nothing is under way."""
        return not self._moves and self._state not in UNDER_WAY

    @property
    def going_back(self) -> bool:
        """On the way up, or there."""
        return self._back

    def arrived(self, q_read: Array) -> bool:
        """Nothing is under way, and the arm is where it was ordered, by angles read (n,), rad."""
        return self.q is not None and self.resting and np.abs(q_read - self.q).max() < ARRIVED

    def follow(self, goal: Goal) -> str:
        """Move to a goal that is worth it; says what stands in the way, where something does."""
        if self._moves:
            self.go()
            return ""
        if self.q is None or self._state not in TAKES_MOVES:
            return ""
        if np.abs(goal.q - self.q).max() < WORTH:
            return ""
        self._top, self._back = None, False
        trouble = self._setup.workspace.along(between(self.q, goal.q))
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
        elif not self._sent and self._state in TAKES_MOVES:
            (self._mover.move_line if on_line else self._mover.move_joints)(q)
            self.q, self._sent, self._state = q, True, MoverState.ORDERING
            self._began_line = on_line

    def hold(self) -> None:
        """Stop where it is."""
        self._moves, self._back = [], self._back and not self._moves
        if self._state in MOVES:
            self._mover.hold()
            self._state = MoverState.STOPPING
