"""Read a Robotiq 3-finger gripper on Modbus RTU: this class can send nothing but function 3.

`gripper.GripperDriver`, which moves it, is not made without an `ExecutePermission`.
"""

import logging
import time
from collections.abc import Callable
from functools import partial
from typing import Final

from pymodbus.pdu import ModbusPDU
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadHoldingRegistersResponse,
)

from verify.devices.ports import ClockFunction, Port, open_port
from verify.grasping.actuators.gripper.modbus import (
    CLOSED_POSITION,
    FIRST_INPUT,
    N_INPUTS,
    GripperInputs,
    GripperRefusedError,
    GripperSettings,
    ModbusLine,
    NoAnswerError,
    fault_text,
    parse_inputs,
)
from verify.grasping.actuators.protocols import GripperState, GripperStatus

READ_FUNCTIONS: Final = frozenset({ReadHoldingRegistersRequest.function_code})
# its complaints reach the user through `step`
logging.getLogger("pymodbus.logging").addHandler(logging.NullHandler())


class GripperReader:
    """Reads a gripper; cannot move it.

    Args:
        settings: how it is reached.
        port: opens the port instead of the settings' address.
        now: the host's monotonic clock, s.
    """

    functions = READ_FUNCTIONS

    def __init__(
        self,
        settings: GripperSettings,
        port: Callable[[], Port] | None = None,
        now: ClockFunction = time.monotonic,
    ) -> None:
        self._settings, self._now = settings, now
        self._line = ModbusLine(
            settings, port or partial(open_port, settings.port, settings.line), self.functions, now
        )
        self._inputs: GripperInputs | None = None
        self._t: float | None = None
        self._trouble = "nothing was read yet"

    def step(self) -> GripperStatus:
        """Go on with what has arrived; never waits for the gripper."""
        try:
            answer = self._line.step()
        except NoAnswerError:
            self._note_trouble(f"no answer: {self._line_words()}")
        except GripperRefusedError as refused:
            self._note_trouble(str(refused))
        else:
            if answer is not None:
                self._take(answer)
        if self._t is not None and not self._line.link.connected:
            self._note_trouble(self._line_words())
        if self._line.free:
            self._line.ask(self._next_request())
        return self._status()

    def close(self) -> None:
        """Close the line; the gripper goes on as it is."""
        self._line.close()

    def _next_request(self) -> ModbusPDU:
        return ReadHoldingRegistersRequest(address=FIRST_INPUT, count=N_INPUTS)

    def _take(self, answer: ModbusPDU) -> None:
        if not isinstance(answer, ReadHoldingRegistersResponse):
            return
        inputs = parse_inputs(answer.registers)
        if inputs is None:
            self._line.bad["answer that is not understood"] += 1
            return
        self._inputs, self._t, self._trouble = inputs, self._now(), ""
        self._judge(inputs)

    def _judge(self, inputs: GripperInputs) -> None:
        """Draw conclusions from a reading: a reader has none to draw."""

    def _note_trouble(self, reason: str) -> None:
        self._trouble = reason

    def _line_words(self) -> str:
        if not self._line.link.connected:
            return f"not connected: {self._line.link.fault}"
        return f"slave {self._settings.slave} is silent; has it power?"

    def _state(self) -> tuple[GripperState, str]:
        inputs = self._inputs
        return GripperState.IDLE, "" if inputs is None else fault_text(inputs.fault)

    def _status(self) -> GripperStatus:
        state, reason = self._state()
        trouble = self._trouble
        if self._t is None and not self._line.link.connected:
            trouble = self._line_words()
        text = "; ".join(dict.fromkeys(part for part in (reason, trouble) if part))
        inputs = self._inputs
        opening = None
        if inputs is not None:
            opening = self._settings.stroke * (1.0 - inputs.position / CLOSED_POSITION)
        return GripperStatus(
            state,
            f"{self._settings.port}: {text}" if text else "",
            opening,
            0 if inputs is None else inputs.contacts,
            self._t,
            None if self._t is None else self._now() - self._t,
        )
