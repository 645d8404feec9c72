"""Drive a Robotiq 3-finger gripper: activation, modes, opening, closing, and their outcome.

Whether something is gripped is read from the gripper's own object detection, never concluded from a
time. Every wait has a limit; past it, or at a fault, the fingers are stopped and the reason stated.
A write that failed is not repeated on another connection: the caller decides anew.
"""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

from pymodbus.pdu import ModbusPDU
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadHoldingRegistersResponse,
    WriteMultipleRegistersRequest,
    WriteMultipleRegistersResponse,
)

from verify.devices.ports import Port, open_port
from verify.grasping.actuators.gripper import modbus
from verify.grasping.actuators.protocols import (
    RESTING_STATES,
    ExecutePermission,
    GripperState,
    GripperStatus,
    MotionRefusedError,
)

# pymodbus's own complaints: the status states them
logging.getLogger("pymodbus.logging").addHandler(logging.NullHandler())
FUNCTIONS: Final = frozenset(
    {ReadHoldingRegistersRequest.function_code, WriteMultipleRegistersRequest.function_code}
)
N_CONFIRMATIONS = 3  # readings in a row that must agree before a motion is called over
STOP_TIMEOUT, CLOSE_TIMEOUT = 2.0, 1.0  # s
MAX_STATUS_AGE = 0.5  # s: what was read longer ago says nothing of now
CLOSE_PERIOD = 0.005  # s, between the steps of `close`
UNCHECKED_STATES = frozenset({GripperState.IDLE, GripperState.STOPPING, GripperState.FAILED})


@dataclass(slots=True)
class ActiveOrder:
    """The order that is being carried out."""

    until: float = float("inf")  # s
    written: bool = False  # the gripper has acknowledged it
    closing: bool = False
    resets: bool = False  # over when the activation is gone: until then, what is read is older
    agreed: int = 0  # readings in a row that call it over


class GripperDriver:
    """Reads a gripper and moves it."""

    def __init__(
        self,
        settings: modbus.GripperSettings,
        permission: ExecutePermission,
        port: Callable[[], Port] | None = None,
    ) -> None:
        if not isinstance(permission, ExecutePermission):
            raise TypeError("a gripper moves only with the operator's permission")
        self._settings, self._now = settings, time.monotonic
        opening = port or partial(open_port, settings.port, settings.line)
        self._line = modbus.ModbusLine(settings, opening, FUNCTIONS, self._now)
        self._inputs: modbus.GripperInputs | None = None  # the last
        self._t: float | None = None  # s, of these
        self._trouble = "nothing was read yet"
        self._phase, self._reason = GripperState.IDLE, ""
        self._action = modbus.GripperCommand(speed=settings.speed, force=settings.force)
        self._to_write: list[int] | None = None
        self._active = ActiveOrder()
        self._answered_on = 0  # the connection of the last answer

    def activate(self) -> None:
        """Make it ready: every finger moves over its full travel. See `Gripper.activate`."""
        if self._phase not in (GripperState.FAILED, GripperState.IDLE):
            self._require_rest("be activated")
        self._action = replace(self._action, go=False)
        limit = self._settings.activation_limit
        self._begin(GripperState.ACTIVATING, self._action.registers(), limit)

    def go_to(self, opening: float, *, closing: bool) -> None:
        """Open or close the fingers; only closing may something stop them. See `Gripper.go_to`."""
        self._require_rest("close" if closing else "open")
        if not 0.0 <= opening <= self._settings.stroke:
            requested, widest = opening * 1e3, self._settings.stroke * 1e3
            raise MotionRefusedError(f"{requested:.1f} mm is not within its 0 to {widest:.0f} mm")
        position = round(modbus.CLOSED_POSITION * (1.0 - opening / self._settings.stroke))
        self._action = replace(self._action, go=True, position=position)
        self._begin(GripperState.MOVING, self._action.registers(), self._settings.move_limit)
        self._active.closing = closing

    def step(self) -> GripperStatus:
        """Go on with what has arrived; never waits for the gripper."""
        self._check_deadline()
        try:
            answer = self._line.step()
        except modbus.NoAnswerError:
            self._note_trouble(f"no answer: {self._line_fault()}")
        except modbus.GripperRefusedError as refused:
            self._note_trouble(str(refused))
        else:
            if answer is not None:
                self._take(answer)
        if self._t is not None and not self._line.link.connected:
            self._note_trouble(self._line_fault())
        if self._line.free:
            self._line.ask(self._next_request())
        return self._status()

    def stop(self) -> None:
        """Stop the fingers; an activation under way can only be ended by a reset.

        What is gripped stays gripped, and a gripper that failed and is well again is ready again.
        """
        inputs = self._inputs
        if self._phase is GripperState.GRIPPED:
            return
        if self._phase is GripperState.ACTIVATING:
            self._begin(GripperState.STOPPING, list(modbus.RESET_OUTPUTS), STOP_TIMEOUT)
            self._active.resets = True
        elif self._phase is not GripperState.IDLE and inputs is not None and inputs.active:
            self._action = replace(self._action, go=False)
            self._begin(GripperState.STOPPING, self._action.registers(), STOP_TIMEOUT)

    def close(self) -> None:
        """Stop the fingers, leave the gripper active, close the line. Never raises."""
        end = self._now() + CLOSE_TIMEOUT
        self.stop()
        while self._phase is GripperState.STOPPING and self._now() < end:
            self.step()
            time.sleep(CLOSE_PERIOD)
        self._line.close()

    def _require_rest(self, what: str) -> None:
        if self._phase not in RESTING_STATES:
            why = f": {self._reason}" if self._reason else ""
            raise MotionRefusedError(
                f"the gripper cannot {what} now, it is {self._phase.value}{why}"
            )

    def _begin(self, state: GripperState, registers: list[int], limit: float) -> None:
        self._phase, self._reason = state, ""
        self._to_write = registers
        self._active = ActiveOrder(self._now() + limit)

    def _next_request(self) -> ModbusPDU:
        if self._to_write is None or not self._may_write(self._to_write):
            return ReadHoldingRegistersRequest(address=modbus.FIRST_INPUT, count=modbus.N_INPUTS)
        registers, self._to_write = self._to_write, None
        return WriteMultipleRegistersRequest(address=modbus.FIRST_OUTPUT, registers=registers)

    def _may_write(self, registers: list[int]) -> bool:
        """Whether this write cannot activate a gripper that has lost its activation unnoticed.

        Every write but a reset carries the activation bit. A gripper that was without power would
        take it as an order to activate itself, and move.
        """
        if self._phase is GripperState.ACTIVATING or registers == list(modbus.RESET_OUTPUTS):
            return True
        inputs, here = self._inputs, self._answered_on == self._line.link.connections
        fresh = self._t is not None and self._now() - self._t < MAX_STATUS_AGE
        return inputs is not None and inputs.active and here and fresh

    def _take(self, answer: ModbusPDU) -> None:
        if isinstance(answer, WriteMultipleRegistersResponse):
            self._active.written = True
        self._answered_on = self._line.link.connections
        if not isinstance(answer, ReadHoldingRegistersResponse):
            return
        inputs = modbus.parse_inputs(answer.registers)
        if inputs is None:
            self._line.bad["answer that is not understood"] += 1
            return
        self._inputs, self._t, self._trouble = inputs, self._now(), ""
        self._judge(inputs)

    def _status(self) -> GripperStatus:
        trouble = self._trouble
        if self._t is None and not self._line.link.connected:
            trouble = self._line_fault()
        text = "; ".join(dict.fromkeys(part for part in (self._reason, trouble) if part))
        opening = None
        if self._inputs is not None:
            opening = self._settings.stroke * (1.0 - self._inputs.position / modbus.CLOSED_POSITION)
        reason = f"{self._settings.port}: {text}" if text else ""
        return GripperStatus(self._phase, reason, opening, self._t)

    def _line_fault(self) -> str:
        if not self._line.link.connected:
            return f"not connected: {self._line.link.fault}"
        return f"slave {self._settings.slave} is silent; has it power?"

    def _check_deadline(self) -> None:
        if self._now() <= self._active.until:
            return
        if not self._line.link.connected:
            why = self._line_fault()
        else:
            why = "" if self._inputs is None else modbus.fault_text(self._inputs.fault)
        activating = self._phase is GripperState.ACTIVATING
        self._fail(f"{self._phase.value} takes too long" + (f"; {why}" if why else ""))
        if activating:
            self._to_write = list(modbus.RESET_OUTPUTS)  # nothing else ends it

    def _note_trouble(self, reason: str) -> None:
        self._trouble = reason
        if self._phase is not GripperState.IDLE:
            self._fail(reason)

    def _judge(self, inputs: modbus.GripperInputs) -> None:
        """Change the state by a reading."""
        if self._phase is GripperState.IDLE:
            ready = inputs.active and inputs.activation is modbus.ActivationStatus.READY
            if ready and inputs.fault < modbus.MIN_LASTING_FAULT:  # it was activated before
                self._action = replace(self._action, mode=inputs.mode)
                self._rest(GripperState.READY)
        current = self._phase is GripperState.IDLE or self._active.written
        if self._broken(inputs) or not current:
            return  # the reading is older than the order
        match self._phase:
            case GripperState.ACTIVATING if inputs.activation is modbus.ActivationStatus.READY:
                self._rest(GripperState.READY)
            case GripperState.STOPPING if not inputs.active:
                self._rest(GripperState.IDLE)
            case GripperState.STOPPING if not (inputs.go or self._active.resets):
                self._rest(GripperState.READY)
            case GripperState.MOVING:
                self._follow(inputs)
            case GripperState.GRIPPED if not self._holds(inputs):
                self._phase, self._reason = GripperState.LOST, "the gripped object is lost"

    def _broken(self, inputs: modbus.GripperInputs) -> bool:
        """Whether a fault, or a lost activation, ends what is being done."""
        if self._phase in UNCHECKED_STATES:
            return False
        if inputs.fault >= modbus.MIN_LASTING_FAULT:
            self._fail(modbus.fault_text(inputs.fault))
        elif not inputs.active and self._phase is not GripperState.ACTIVATING:
            self._fail("it has lost its activation; was it without power?")
        return self._phase is GripperState.FAILED

    def _follow(self, inputs: modbus.GripperInputs) -> None:
        """End the motion that was ordered, once it is over."""
        ours = inputs.go and inputs.echo == self._action.position
        over = ours and not inputs.moving and modbus.FingerStatus.MOVING not in inputs.axes
        self._active.agreed = self._active.agreed + 1 if over else 0
        if self._active.agreed < N_CONFIRMATIONS:
            return
        stopped = sum(axis is not modbus.FingerStatus.THERE for axis in inputs.axes)
        reason = f"something stopped {stopped} of {len(inputs.axes)} fingers"
        if not stopped:
            self._rest(GripperState.REACHED)
        elif not self._active.closing:
            self._fail(f"{reason} while opening")
        elif self._holds(inputs):
            self._rest(GripperState.GRIPPED)
        else:
            self._rest(GripperState.UNSURE)
            self._reason = reason

    def _holds(self, inputs: modbus.GripperInputs) -> bool:
        """Whether something stopped as many fingers as a grip needs; the scissor axis is one."""
        return inputs.contacts >= min(self._settings.fingers_needed, len(inputs.axes))

    def _rest(self, state: GripperState) -> None:
        self._phase, self._reason = state, ""
        self._active = ActiveOrder(written=True)

    def _fail(self, reason: str) -> None:
        """Fail for a reason; stop the fingers if they were moving."""
        if self._phase is GripperState.FAILED:
            return
        under_way = self._phase is GripperState.MOVING
        self._phase, self._reason, self._active = GripperState.FAILED, reason, ActiveOrder()
        self._to_write = None
        if under_way:  # with the line gone it must wait: the fingers go to where they were ordered
            self._action = replace(self._action, go=False)
            self._to_write = self._action.registers()
