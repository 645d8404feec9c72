"""Define what the control loop orders: an arm and a gripper that never make it wait.

An order is a call that returns at once. `step`, called once a cycle, lets the device's state
machine take what has arrived and returns its status. A device is made with an `ExecutePermission`,
which the command line alone makes from the operator's order; without one there is no such device.
"""

import contextlib
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from verify.core.records import Array
from verify.devices.ports import Port


@dataclass(frozen=True, slots=True)
class ExecutePermission:
    """The operator's order that devices may move; made nowhere but at the command line."""

    order: str  # what the operator gave: `--execute`, and the words typed for a real controller

    def __post_init__(self) -> None:
        if not self.order.strip():
            raise ValueError("an order without words is none")


class MotionRefusedError(Exception):
    """An order that the device's state or its limits do not allow; nothing was sent."""


class MoverState(StrEnum):
    """Where the arm's state machine is."""

    OFF = "off"  # nothing is connected; `take_controls` begins
    CONNECTING = "connecting"
    CHECKING = "checking"  # robot type, alarms, program, joint limits, position
    TAKING_CONTROLS = "taking controls"
    POWERING = "powering"  # the servo comes on
    READY = "ready"  # has the controls and stands; takes moves
    ORDERING = "ordering"  # a move is being sent
    MOVING = "moving"
    ARRIVED = "arrived"  # as `ready`, at the target of the last move
    STOPPING = "stopping"  # `hold` was ordered
    HELD = "held"  # as `ready`, stopped where it is
    RELEASING = "releasing"  # stop, servo off, controls given back
    RELEASED = "released"
    FAILING = "failing"  # the same, after something went wrong
    FAILED = "failed"  # the reason says what went wrong and whether all was given back


ACCEPTING_STATES = frozenset({MoverState.READY, MoverState.ARRIVED, MoverState.HELD})
FINAL_STATES = frozenset({MoverState.OFF, MoverState.RELEASED, MoverState.FAILED})


@dataclass(frozen=True, slots=True)
class MoverStatus:
    """Status of the arm."""

    state: MoverState
    reason: str  # of a failure or a warning, in words; else empty
    q: Array | None  # (joints,), rad, the robot file's own; None before the first position
    t: float | None  # s, host's monotonic clock, when that was so
    speed: float | None  # m/s of the hand's end, where the controller tells
    given_back: bool = False  # it has ended, and the controller has confirmed all of it


class Mover(Protocol):
    """An arm that goes where it is ordered, one move at a time."""

    def take_controls(self) -> None:
        """Connect, check, take the operation right and power the servo: to `ready`.

        Raises:
            MotionRefusedError: not `off` or ended.
        """

    def move(self, q: Array, *, on_line: bool = False) -> None:
        """Go to joint angles (joints,), rad, straight in them, or the flange on a straight line.

        Raises:
            MotionRefusedError: no move can be taken now, or q is outside the limits.
        """

    def hold(self) -> None:
        """Stop where it is and keep the controls. Always allowed; does nothing once ended."""

    def release(self) -> None:
        """Stop, take the servo's power, give the controls back. Always allowed."""

    def step(self) -> MoverStatus:
        """Go on with what has arrived; never waits for the device."""

    def close(self) -> None:
        """Release, waiting for at most some seconds, and close the line; never raises."""


class GripperState(StrEnum):
    """Where the gripper's state machine is."""

    IDLE = "idle"  # nothing was ordered yet, or `stop` has ended it
    ACTIVATING = "activating"
    READY = "ready"  # activated; takes orders
    MOVING = "moving"
    REACHED = "reached"  # the fingers are where they were ordered: nothing is between them
    GRIPPED = "gripped"  # enough fingers were stopped by something
    UNSURE = "unsure"  # fewer fingers than that were stopped by something
    LOST = "lost"  # it was gripped, and is no more
    STOPPING = "stopping"
    FAILED = "failed"


CLOSED_STATES = frozenset(  # the fingers have come to rest
    {GripperState.REACHED, GripperState.GRIPPED, GripperState.UNSURE, GripperState.LOST}
)
RESTING_STATES = CLOSED_STATES | {GripperState.READY}  # activated, and free to take an order


@dataclass(frozen=True, slots=True)
class GripperStatus:
    """Status of the gripper."""

    state: GripperState
    reason: str  # of a failure or a warning, in words; else empty
    opening: float | None  # m between the fingers, of the widest; None before the first reading
    t: float | None  # s, host's monotonic clock, of the last reading


class Gripper(Protocol):
    """A gripper whose own sensors tell whether it holds something."""

    def activate(self) -> None:
        """Make it ready: every finger moves over its full travel, so nothing may be in between.

        Raises:
            MotionRefusedError: it is doing something else.
        """

    def go_to(self, opening: float, *, closing: bool) -> None:
        """Open or close the fingers to so many m between them, or until something stops them.

        Raises:
            MotionRefusedError: it is not ready, or the opening is outside its stroke.
        """

    def stop(self) -> None:
        """Stop the fingers where they are; what is gripped stays gripped. Always allowed."""

    def step(self) -> GripperStatus:
        """Go on with what has arrived; never waits for the device."""

    def close(self) -> None:
        """Stop the fingers and close the line; what is gripped stays gripped. Never raises."""


OPEN_WAIT = 0.005  # s: a port nearby is open by then, at the first call


class BackgroundOpener:
    """Opens a port in a thread: a computer that does not answer delays no control loop."""

    def __init__(self, open_port: Callable[[], Port]) -> None:
        self._open_port = open_port
        self._worker = ThreadPoolExecutor(1, "opening")
        self._opening: Future[Port] | None = None
        self._failed: OSError | None = None  # the last time

    def __call__(self) -> Port:
        """Give the port once it is open.

        Raises:
            OSError: not yet, or it cannot be opened now; while it is tried again, what went wrong
                the last time.
        """
        opening = self._opening or self._worker.submit(self._open_port)
        self._opening = opening
        with contextlib.suppress(TimeoutError):  # what went wrong there is raised below
            opening.exception(OPEN_WAIT)
        if not opening.done():
            raise self._failed or BlockingIOError(0, "the port is being opened")
        self._opening = None
        failed = opening.exception()
        self._failed = failed if isinstance(failed, OSError) else None
        return opening.result()

    def close(self) -> None:
        """Open nothing any more."""
        self._worker.shutdown(wait=False, cancel_futures=True)
        if self._opening is not None:
            self._opening.add_done_callback(_close_late_port)


def _close_late_port(opening: Future[Port]) -> None:
    if not opening.cancelled() and opening.exception() is None:
        opening.result().close()
