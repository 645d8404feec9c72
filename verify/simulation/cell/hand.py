"""The simulated three-finger gripper: fingers that something stops, and that tell so."""

from collections.abc import Callable

from verify.grasping.actuators.protocols import (
    RESTING_STATES,
    ExecutePermission,
    GripperState,
    GripperStatus,
    MotionRefusedError,
)

FINGER_SPEED = 0.11  # m/s, of the opening
ACTIVATION_TIME = 0.5  # s


class CellHand:
    """The fingers themselves; `opening`, m, is the widest."""

    def __init__(self, opening: float) -> None:
        self.widest = self.opening = opening
        self.between = 0.0  # m, how wide what stands between the fingers is; 0: nothing
        self.goal = opening

    @property
    def holds(self) -> bool:
        """The fingers press on something."""
        return self.between > 0 and self.opening <= self.between + 1e-9

    def advance(self, dt: float) -> None:
        """Let dt s pass."""
        step = FINGER_SPEED * dt
        if self.goal < self.opening:
            self.opening = max(self.goal, self.between, self.opening - step)
        else:
            self.opening = min(self.goal, self.opening + step)


class SimGripper:
    """A simulated gripper behind the protocol `Gripper`."""

    def __init__(
        self, hand: CellHand, now: Callable[[], float], permission: ExecutePermission
    ) -> None:
        if not isinstance(permission, ExecutePermission):
            raise TypeError("a gripper moves only with the operator's permission")
        self._hand, self._now = hand, now
        self._state, self._since = GripperState.IDLE, now()
        self._closing = False

    def activate(self) -> None:
        """Make it ready. See `Gripper.activate`."""
        self._enter(GripperState.ACTIVATING)

    def go_to(self, opening: float, *, closing: bool) -> None:
        """Open or close the fingers. See `Gripper.go_to`."""
        if self._state not in RESTING_STATES:
            raise MotionRefusedError(f"the gripper takes no order now, it is {self._state.value}")
        if not 0 <= opening <= self._hand.widest + 1e-9:
            raise MotionRefusedError(f"{1e3 * opening:.0f} mm are outside the gripper's stroke")
        self._hand.goal, self._closing = opening, closing
        self._enter(GripperState.MOVING)

    def stop(self) -> None:
        """Stop the fingers where they are. See `Gripper.stop`."""
        self._hand.goal = self._hand.opening
        if self._state is GripperState.MOVING:
            self._enter(GripperState.IDLE)

    def step(self) -> GripperStatus:
        """Go on. See `Gripper.step`."""
        now, hand = self._now(), self._hand
        activating = self._state is GripperState.ACTIVATING
        if activating and now - self._since >= ACTIVATION_TIME:
            self._enter(GripperState.READY)
        elif self._state is GripperState.MOVING and self._closing and hand.holds:
            self._enter(GripperState.GRIPPED)
        elif self._state is GripperState.MOVING and abs(hand.opening - hand.goal) < 1e-9:
            self._enter(GripperState.REACHED)
        elif self._state is GripperState.GRIPPED and not hand.holds:
            self._enter(GripperState.LOST)
        return GripperStatus(self._state, "", hand.opening, now)

    def close(self) -> None:
        """Stop the fingers. See `Gripper.close`."""
        self.stop()

    def _enter(self, state: GripperState) -> None:
        self._state, self._since = state, self._now()
