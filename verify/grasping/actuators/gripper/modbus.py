"""Exchange Modbus RTU requests with a Robotiq 3-finger gripper without waiting; its registers.

Frames, checks and messages are pymodbus's; its clients wait for answers, which a control loop
cannot. Registers: Robotiq 3-Finger Adaptive Robot Gripper Instruction Manual, sections 4.4 and 4.5;
two bytes a register, the first in the high half.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerRTU
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU

from verify.devices.ports import DEFAULT_LINE, ClockFunction, Port, PortLink, SerialLine
from verify.grasping.actuators.protocols import BackgroundOpener

REQUEST_PERIOD = 0.005  # s: the gripper's cycle; a sooner request reads nothing new
MAX_BUFFER_BYTES = 512  # bytes: two of the longest frames; noise must not fill the memory
# exception code -> meaning, by the Modbus specification
EXCEPTION_MEANINGS: Final = {1: "unknown function", 2: "no such register", 3: "value not allowed"}


@dataclass(frozen=True, slots=True)
class GripperSettings:
    """How a gripper is reached, and how fast and hard it moves."""

    port: str  # tcp:HOST:PORT of a serial device server, or a serial device
    line: SerialLine = DEFAULT_LINE
    slave: int = 9
    stroke: float = 0.155  # m between the fingers when open; the position is taken as linear in it
    speed: int = 128  # 0 to 255, about 22 to 110 mm/s
    force: int = 0  # 0 to 255, about 15 to 60 N
    fingers_needed: int = 2  # stopped by something, before it counts as gripped
    timeout: float = 0.2  # s for an answer
    tries: int = 3
    activation_limit: float = 30.0  # s; less was too little for some
    move_limit: float = 15.0  # s; the whole stroke at the least speed takes 7 s


class GripperRefusedError(Exception):
    """The gripper answered with an exception."""

    def __init__(self, code: int) -> None:
        super().__init__(f"refused: {EXCEPTION_MEANINGS.get(code, f'exception {code}')}")


class NoAnswerError(Exception):
    """The gripper did not answer any of the tries."""


class ModbusLine:
    """Asks and takes the answer once it is there."""

    def __init__(
        self,
        settings: GripperSettings,
        open_port: Callable[[], Port],
        allowed: frozenset[int],
        now: ClockFunction,
    ) -> None:
        self.bad: Counter[str] = Counter()  # what was dropped: reason -> how often
        self._opening = BackgroundOpener(open_port)
        self.link = PortLink(settings.port, self._opening, now)
        self._settings, self._allowed = settings, allowed
        self._framer = FramerRTU(DecodePDU(is_server=False))
        self._pending: ModbusPDU | None = None
        self._buffer = b""
        self._sent_at = float("-inf")
        self._left = 0  # tries
        self._connection = 0

    @property
    def free(self) -> bool:
        """Whether a request can be sent now."""
        rested = self.link.now() - self._sent_at >= REQUEST_PERIOD
        return self._pending is None and self.link.connected and rested

    def ask(self, request: ModbusPDU) -> None:
        """Send a request; its answer comes from `step`.

        Raises:
            ValueError: a function that this line may not send.
        """
        if request.function_code not in self._allowed:
            raise ValueError(f"this line may not send function {request.function_code}")
        request.dev_id = self._settings.slave
        self._pending, self._left = request, self._settings.tries
        self._send()

    def step(self) -> ModbusPDU | None:
        """Take what has come: the answer to the request, once it is whole.

        Raises:
            NoAnswerError: none came in all tries.
            GripperRefusedError: the gripper's answer was an exception.
        """
        chunk = self.link.receive(0.0)
        same = self.link.connected and self.link.connections == self._connection
        self._connection = self.link.connections
        if self._pending is None:
            self.bad["unrequested answer"] += chunk is not None
            return None
        if not same:
            self._pending, self._buffer = None, b""
            raise NoAnswerError
        if chunk is not None:
            self._buffer = (self._buffer + chunk.data)[-MAX_BUFFER_BYTES:]
        answer = self._answer()
        if answer is None:
            if self.link.now() - self._sent_at > self._settings.timeout:
                self._again()
            return None
        self._pending, self._buffer = None, b""
        self.link.steady()
        if isinstance(answer, ExceptionResponse):
            raise GripperRefusedError(answer.exception_code)
        return answer

    def close(self) -> None:
        """Close the port."""
        self.link.close()
        self._opening.close()

    def _send(self) -> None:
        assert self._pending is not None
        self._buffer = b""
        self._left -= 1
        self._sent_at = self.link.now()
        self.link.send(self._framer.buildFrame(self._pending))

    def _answer(self) -> ModbusPDU | None:
        """Decode the buffer; None if it is no answer to the request."""
        assert self._pending is not None
        if not self._buffer:
            return None
        try:
            used, answer = self._framer.handleFrame(self._buffer, self._settings.slave, 0)
        except (ModbusException, IndexError):
            self.bad["answer that is not understood"] += 1
            used, answer = len(self._buffer), None
        self._buffer = self._buffer[used:]
        if answer is None or answer.function_code & 0x7F == self._pending.function_code:
            return answer
        self.bad["unrequested answer"] += 1
        return None

    def _again(self) -> None:
        self.bad["request without an answer"] += 1
        if not self._left:
            self._pending, self._buffer = None, b""
            raise NoAnswerError
        self._send()


FIRST_OUTPUT, FIRST_INPUT = 1000, 2000  # first registers, as they stand on the wire
N_INPUTS = 8
CLOSED_POSITION = 255  # position byte; 0 is open


class GripMode(IntEnum):
    """How the fingers stand to each other, by rMOD and gMOD."""

    BASIC = 0
    PINCH = 1
    WIDE = 2
    SCISSOR = 3


RESET_OUTPUTS: Final = (0, 0, 0)  # clears faults and the activation
# gFLT -> meaning
FAULT_MEANINGS: Final[Mapping[int, str]] = {
    0x05: "it waits for its activation to end",
    0x06: "it waits for its mode to change",
    0x07: "it is not activated",
    0x09: "its communication chip is not ready",
    0x0A: "the fingers stand in the scissor axis's way",
    0x0B: "automatic release is under way",
    0x0D: "the activation has failed: is something between the fingers?",
    0x0E: "the fingers have been in the scissor axis's way for too long",
    0x0F: "automatic release has ended: it must be reset and activated",
}
MIN_LASTING_FAULT = 0x09  # lesser ones are gone when what they wait for has happened


class ActivationStatus(IntEnum):
    """What gIMC tells."""

    RESET = 0
    ACTIVATING = 1
    CHANGING_MODE = 2
    READY = 3


class FingerStatus(IntEnum):
    """What gDTA to gDTS tell of a finger, or of the scissor axis."""

    MOVING = 0
    CONTACT_OPENING = 1
    CONTACT_CLOSING = 2
    THERE = 3


@dataclass(frozen=True, slots=True)
class GripperCommand:
    """What is ordered of all fingers together; the activation bit is always set.

    Any write without that bit would reset the gripper and let go of what it has.
    """

    mode: GripMode = GripMode.BASIC
    go: bool = False
    position: int = 0  # 0 open to 255 closed
    speed: int = 0  # 0 to 255
    force: int = 0  # 0 to 255

    def registers(self) -> list[int]:
        """Word it for registers 1000 to 1002."""
        action = 1 | self.mode << 1 | int(self.go) << 3
        return [action << 8, self.position, self.speed << 8 | self.force]


@dataclass(frozen=True, slots=True)
class GripperInputs:
    """What the gripper tells."""

    active: bool
    mode: GripMode
    go: bool
    activation: ActivationStatus
    fault: int  # gFLT, 0 none
    moving: bool  # gSTA 0: at least one of them is on its way
    axes: tuple[FingerStatus, ...]  # those that the mode moves: three fingers, or the scissor axis
    echo: int  # of the position that is being gone to
    position: int  # of the axis that is open widest

    @property
    def contacts(self) -> int:
        """How many of the axes something stopped while closing."""
        return self.axes.count(FingerStatus.CONTACT_CLOSING)


def parse_inputs(registers: Sequence[int]) -> GripperInputs | None:
    """Read registers 2000 to 2007; None if that is not how many there are."""
    if len(registers) != N_INPUTS:
        return None
    data = b"".join(register.to_bytes(2, "big") for register in registers)
    status, each, mode = data[0], data[1], GripMode(data[0] >> 1 & 3)
    moved = (3,) if mode is GripMode.SCISSOR else (0, 1, 2)
    return GripperInputs(
        bool(status & 1),
        mode,
        bool(status & 8),
        ActivationStatus(status >> 4 & 3),
        data[2],
        status >> 6 == 0,
        tuple(FingerStatus(each >> 2 * axis & 3) for axis in moved),
        data[3],
        min(data[4 + 3 * axis] for axis in moved),
    )


def fault_text(fault: int) -> str:
    """Say what a fault means; empty where there is none."""
    if not fault:
        return ""
    return f"fault {fault:#04x}: {FAULT_MEANINGS.get(fault, 'not in the manual')}"
