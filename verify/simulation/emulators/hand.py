"""What an emulated Robotiq 3-finger gripper controls: fingers, scissor axis, and what is between.

Register layout, states and faults: Robotiq 3-Finger Adaptive Robot Gripper Instruction Manual,
section 4; fingers are ordered together, not singly. A position is 0 (open) to 255 (closed), as a
real number inside.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from verify.core.records import Array
from verify.simulation.world.motion import move_towards

N_BYTES = 16  # of outputs and of inputs; the last of each is not used
STROKE_MM = 155.0  # between the fingertips at position 0; taken as linear in the position
MIN_SPEED_MM_S, MAX_SPEED_MM_S = 22.0, 110.0  # at speed 0 and 255
OPEN_LIMIT = np.array([7.0, 6.0, 6.0, 0.0])  # software limits: A, B, C, scissor
CLOSED_LIMIT = np.full(4, 255.0)
SCISSOR_POSITIONS = {0: 137.0, 1: 220.0, 2: 25.0, 3: 137.0}  # mode -> where the scissor axis rests
SCISSOR_SPEED = 100.0  # positions a second, while the mode changes
RELEASE_SPEED = 30.0  # positions a second: automatic release is slow
CURRENT_MOVING = 15
SCISSOR_MODE = 3
MAJOR_FAULTS = range(0x0D, 0x10)  # faults that only a reset clears
NO_CONTACT = np.full(4, np.inf)  # contacts, where there is nothing to touch


class GripperStage(IntEnum):
    """What gIMC tells."""

    RESET = 0
    ACTIVATING = 1
    CHANGING_MODE = 2
    READY = 3


class GripperFault(IntEnum):
    """What gFLT tells of its own accord; others come on demand."""

    NONE = 0
    WAITS_FOR_ACTIVATION = 5
    WAITS_FOR_MODE = 6
    NOT_ACTIVATED = 7
    RELEASING = 0x0B
    RELEASED = 0x0F


@dataclass(frozen=True, slots=True)
class GripperOutputs:
    """The output bytes, taken apart."""

    activate: bool
    mode: int
    go: bool
    release: bool
    request: int  # position as asked for, before any limit
    speed: float  # positions a second
    driven: tuple[bool, bool, bool, bool]  # the axes that the request moves


def decode_outputs(outputs: bytes) -> GripperOutputs:
    """Read the 16 output bytes."""
    action, mode = outputs[0], outputs[0] >> 1 & 3
    fingers = mode != SCISSOR_MODE
    return GripperOutputs(
        bool(action & 1),
        mode,
        bool(action & 8),
        bool(action & 16),
        outputs[3],
        speed_in_positions(outputs[4]),
        (fingers, fingers, fingers, not fingers),
    )


def speed_in_positions(speed: int) -> float:
    """Positions a second, for a speed byte."""
    mm_s = MIN_SPEED_MM_S + (MAX_SPEED_MM_S - MIN_SPEED_MM_S) * speed / 255
    return mm_s * 255 / STROKE_MM


def contact_positions(width_mm: float) -> Array:
    """Where fingers and scissor meet an object in their middle, (4,), positions."""
    return np.full(4, 255.0 * (1.0 - width_mm / STROKE_MM))


class GripperHand:
    """Fingers that go where the outputs say, and stop at what they touch.

    The activation takes so many s. The contacts (4,) are positions at which A, B, C and scissor
    meet the object while closing.
    """

    def __init__(self, activation: float, contacts: Array = NO_CONTACT) -> None:
        self.contacts = contacts
        self.on_demand = 0  # fault that stands until the next reset
        self._activation = activation
        self._now = 0.0
        self.position = OPEN_LIMIT + np.array([0.0, 0.0, 0.0, SCISSOR_POSITIONS[0]])
        self.restart()

    def restart(self) -> None:
        """Lose everything but the fingers' places, as after a loss of power."""
        self.outputs = bytes(N_BYTES)
        self._orders = decode_outputs(self.outputs)
        self.stage, self.fault = GripperStage.RESET, GripperFault.NONE
        self.on_demand = 0
        self._ready_at = 0.0
        self._mode = 0
        self._status = np.zeros(4, dtype=int)

    def obey(self, outputs: bytes, t: float) -> None:
        """Take the 16 output bytes as they are from t on."""
        self.go_on(t)
        self.outputs, self._orders = outputs, decode_outputs(outputs)
        if not self._orders.activate:
            self.stage, self.on_demand, self.fault = GripperStage.RESET, 0, GripperFault.NONE
        elif self.stage is GripperStage.RESET:
            self.stage, self._ready_at = GripperStage.ACTIVATING, t + self._activation
            self._mode = self._orders.mode
        self.go_on(t)

    def go_on(self, t: float) -> None:
        """Let time pass."""
        seconds, self._now = t - self._now, t
        self._update_stage(t)
        self._note_fault()
        halted = self.on_demand in MAJOR_FAULTS or self.fault is GripperFault.RELEASED
        if self.fault is GripperFault.RELEASING:
            reach = seconds * np.array([RELEASE_SPEED] * 3 + [0.0])
            self.position = move_towards(self.position, OPEN_LIMIT, reach)
        elif self.stage is GripperStage.ACTIVATING:
            # it closes and opens over the whole travel
            left = np.clip((self._ready_at - t) / self._activation, 0.0, 1.0)
            closed = 1.0 - abs(2.0 * left - 1.0)
            self.position[:3] = OPEN_LIMIT[:3] + closed * (CLOSED_LIMIT[:3] - OPEN_LIMIT[:3])
        elif self.stage is GripperStage.CHANGING_MODE:
            rest = self.position.copy()
            rest[3] = SCISSOR_POSITIONS[self._mode]
            self.position = move_towards(self.position, rest, SCISSOR_SPEED * seconds)
        elif self.stage is GripperStage.READY and self._orders.go and not halted:
            self._status = self._towards_request(seconds)

    def inputs(self) -> bytes:
        """Give the 16 input bytes as they are now."""
        orders = self._orders
        working = orders.go and self.stage is GripperStage.READY
        codes = self._status if working else np.zeros(4, dtype=int)
        status = (
            int(orders.activate)
            | orders.mode << 1
            | int(orders.go) << 3
            | self.stage << 4
            | self._overall(codes) << 6
        )
        each = sum(int(code) << 2 * axis for axis, code in enumerate(codes))
        answer = bytearray([status, each, self.on_demand or self.fault])
        for axis in range(4):
            current = CURRENT_MOVING if working and codes[axis] == 0 else 0
            answer += bytes([0 if axis else orders.request, round(self.position[axis]), current])
        return bytes(answer) + b"\0"

    def _update_stage(self, t: float) -> None:
        if self.stage is GripperStage.ACTIVATING and t >= self._ready_at:
            self.stage = GripperStage.READY
            self.position = OPEN_LIMIT.copy()
            self.position[3] = SCISSOR_POSITIONS[self._mode]
        if self.stage is GripperStage.READY and self._orders.mode != self._mode:
            self.stage, self._mode = GripperStage.CHANGING_MODE, self._orders.mode
        if (
            self.stage is GripperStage.CHANGING_MODE
            and self.position[3] == SCISSOR_POSITIONS[self._mode]
        ):
            self.stage = GripperStage.READY

    def _note_fault(self) -> None:
        orders = self._orders
        ordered = orders.go or orders.release
        if ordered and not orders.activate:
            self.fault = GripperFault.NOT_ACTIVATED
        elif ordered and self.stage is GripperStage.ACTIVATING:
            self.fault = GripperFault.WAITS_FOR_ACTIVATION
        elif orders.release and orders.activate:
            opened = bool(np.all(self.position[:3] <= OPEN_LIMIT[:3]))
            self.fault = GripperFault.RELEASED if opened else GripperFault.RELEASING
        elif orders.go and self.stage is GripperStage.CHANGING_MODE:
            self.fault = GripperFault.WAITS_FOR_MODE
        # these two last until a reset
        elif self.fault not in (GripperFault.RELEASING, GripperFault.RELEASED):
            self.fault = GripperFault.NONE

    def _towards_request(self, seconds: float) -> Array:
        """Move; give the axes' status: 0 moving, 2 contact while closing, 3 at the request."""
        orders, before = self._orders, self.position
        driven = np.array(orders.driven)
        goal = np.where(driven, np.clip(orders.request, OPEN_LIMIT, CLOSED_LIMIT), before)
        reachable = np.where(before <= self.contacts, np.minimum(goal, self.contacts), goal)
        self.position = move_towards(before, reachable, orders.speed * seconds)
        arrived = self.position == reachable
        return np.where(arrived, np.where(reachable < goal, 2, 3), 0)

    def _overall(self, codes: Array) -> int:
        """GSTA of the axes that are driven: 0 moving, 1 some stopped, 2 all stopped, 3 there."""
        codes = codes[np.array(self._orders.driven)]
        if not self._orders.go or np.any(codes == 0):
            return 0
        if np.all(codes == 3):
            return 3
        return 2 if np.all(codes == 2) else 1
