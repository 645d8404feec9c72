"""A Robotiq 3-finger gripper on Modbus RTU: framing, checks, registers; `hand` is the rest.

Written apart from the library that the driver uses, so that the two check each other. A request
ends where its length says, or, where that cannot be known, at a silence. Asked who made it
(function 43/14, Modbus specification 6.21), it says what no maker's gripper does: an emulator.
"""

from collections import Counter
from dataclasses import dataclass

from verify.core.records import Array
from verify.simulation.emulators.hand import N_BYTES, NO_CONTACT, GripperHand
from verify.simulation.emulators.server import EmulatorEngine, TimedMessage

SLAVE = 9
FIRST_OUTPUT, FIRST_INPUT = 1000, 2000  # first registers, as they stand on the wire
N_REGISTERS = N_BYTES // 2
MAX_READ, MAX_WRITE = 125, 121  # registers a request, by the Modbus specification
READ, READ_INPUT, WRITE_ONE, WRITE, READ_WRITE, IDENTIFY = 3, 4, 6, 16, 23, 43
DEVICE = 14  # the kind of interface behind function 43
# vendor, product code and revision, all that the basic stream of an identification holds
IDENTITY = (b"verify", b"emulated gripper", b"1")
BASIC = 1  # the stream, and the conformity that goes with it
ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = 1, 2, 3
FRAME_TIMEOUT = 0.005  # s without a byte: what has come is all there is
MAX_FAULT = 0x0F  # of gFLT, which has four bits
MIN_FRAME = 4  # bytes: slave, function, check


@dataclass(frozen=True, slots=True)
class GripperOptions:
    """What kind of gripper it is."""

    activation: float = 3.0  # s
    contacts: Array | None = None  # (4,), positions where A, B, C and scissor meet an object
    latency: float = 0.002  # s from request to answer
    cycle: float = 0.005  # s until an order is taken up and echoed: 200 a second, by the manual
    exceptions: bool = True  # grippers of 2014 answer a wrong request with silence


class RequestRefusedError(Exception):
    """A request that the gripper answers with an exception code."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class GripperEngine(EmulatorEngine):
    """The gripper behind its line."""

    def __init__(self, options: GripperOptions) -> None:
        self.log: list[bytes] = []  # every request that was whole, without slave and check
        self.dropped: Counter[str] = Counter()  # requests that got no answer: why -> how often
        contacts = NO_CONTACT if options.contacts is None else options.contacts
        self.hand = GripperHand(options.activation, contacts)
        self._options = options
        self._buffer, self._received_at = b"", 0.0
        self._outputs = bytes(N_BYTES)
        self._due: float | None = None  # s: when the hand takes the outputs up

    def greet(self, t: float) -> None:  # noqa: ARG002  a bus has no callers
        """Forget half a request."""
        self._buffer = b""

    def reset(self, t: float) -> None:
        """Lose power and have it back."""
        self.hand.go_on(t)
        self.hand.restart()
        self._outputs, self._due, self._buffer = bytes(N_BYTES), None, b""

    def afflict(self, fault: str, value: float) -> None:
        """Have a fault (gFLT) until the next reset."""
        if fault == "alarm":
            self.hand.on_demand = int(value)

    def step(self, t: float, received: bytes) -> list[TimedMessage]:
        """Move the hand on; answer what has come."""
        if self._due is not None and t >= self._due:
            self.hand.obey(self._outputs, self._due)
            self._due = None
        self.hand.go_on(t)
        if received:
            self._buffer, self._received_at = self._buffer + received, t
        frame = self._frame(t)
        answer = self._answer(frame, t) if frame else b""
        return [TimedMessage(t + self._options.latency, answer)] if answer else []

    def _frame(self, t: float) -> bytes:
        """Take a whole request from the buffer; what fails the check goes at the next silence."""
        size = request_size(self._buffer)
        if size is not None and len(self._buffer) >= size and has_valid_crc(self._buffer[:size]):
            frame, self._buffer = self._buffer[:size], self._buffer[size:]
            return frame
        if not self._buffer or t - self._received_at <= FRAME_TIMEOUT:
            return b""
        frame, self._buffer = self._buffer, b""
        if len(frame) >= MIN_FRAME and has_valid_crc(frame):
            return frame  # of a function whose length is not known here
        self.dropped["wrong check, or cut short"] += 1
        return b""

    def _answer(self, frame: bytes, t: float) -> bytes:
        if frame[0] != SLAVE:
            self.dropped["other slave"] += 1
            return b""
        body = frame[1:-2]
        self.log.append(body)
        try:
            return add_crc(bytes([SLAVE, body[0]]) + self._carry_out(body, t))
        except RequestRefusedError as refused:
            if not self._options.exceptions:
                self.dropped["refused"] += 1
                return b""
            return add_crc(bytes([SLAVE, body[0] | 0x80, refused.code]))

    def _carry_out(self, body: bytes, t: float) -> bytes:
        """Do what a request asks; give what follows the function code in its answer."""
        match body[0]:
            case 3 | 4:
                return self._read(body[1:5])
            case 6:
                self._write(body[1:3] + b"\0\1", body[3:5], t)
                return body[1:5]
            case 16:
                self._write(body[1:5], body[6:], t)
                return body[1:5]
            case 23:
                self._write(body[5:9], body[10:], t)
                return self._read(body[1:5])
            case 43:
                return _identification_reply(body[1:])
        raise RequestRefusedError(ILLEGAL_FUNCTION)

    def _read(self, span: bytes) -> bytes:
        address, count = address_and_count(span)
        if not 1 <= count <= MAX_READ:
            raise RequestRefusedError(ILLEGAL_VALUE)
        first = FIRST_INPUT if address >= FIRST_INPUT else FIRST_OUTPUT
        block = self.hand.inputs() if first == FIRST_INPUT else self._outputs
        begin, end = address - first, address - first + count
        if begin < 0 or end > N_REGISTERS:
            raise RequestRefusedError(ILLEGAL_ADDRESS)
        return bytes([2 * count]) + block[2 * begin : 2 * end]

    def _write(self, span: bytes, data: bytes, t: float) -> None:
        address, count = address_and_count(span)
        if not 1 <= count <= MAX_WRITE or len(data) != 2 * count:
            raise RequestRefusedError(ILLEGAL_VALUE)
        begin = 2 * (address - FIRST_OUTPUT)
        if begin < 0 or address + count > FIRST_OUTPUT + N_REGISTERS:
            raise RequestRefusedError(ILLEGAL_ADDRESS)
        self._outputs = self._outputs[:begin] + data + self._outputs[begin + len(data) :]
        self._due = t + self._options.cycle


def _identification_reply(request: bytes) -> bytes:
    """Say what it is: MEI type, stream, conformity, nothing more to follow, three objects.

    Raises:
        RequestRefusedError: another stream is asked for.
    """
    if request[:2] != bytes([DEVICE, BASIC]):
        raise RequestRefusedError(ILLEGAL_VALUE)
    objects = [bytes([number, len(text)]) + text for number, text in enumerate(IDENTITY)]
    return bytes([DEVICE, BASIC, BASIC, 0, 0, len(objects)]) + b"".join(objects)


def request_size(data: bytes) -> int | None:
    """Bytes that a request has by its function and count; None where that is not known (yet)."""
    function = data[1] if len(data) > 1 else None
    if function in (READ, READ_INPUT, WRITE_ONE):
        return 8
    if function == IDENTIFY:
        return 7
    count_at = {WRITE: 6, READ_WRITE: 10}.get(function or 0)
    if count_at is None or len(data) <= count_at:
        return None
    return count_at + 1 + data[count_at] + 2


def crc16(data: bytes) -> bytes:
    """CRC-16 of Modbus (polynomial 0x8005 reflected, start 0xFFFF), low byte first."""
    register = 0xFFFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = register >> 1 ^ (0xA001 if register & 1 else 0)
    return register.to_bytes(2, "little")


def has_valid_crc(frame: bytes) -> bool:
    """Whether a frame's check is right."""
    return crc16(frame[:-2]) == frame[-2:]


def add_crc(body: bytes) -> bytes:
    """Put the check behind slave, function and data."""
    return body + crc16(body)


def address_and_count(span: bytes) -> tuple[int, int]:
    """Take address and count, 16 bits each, high byte first; RequestRefusedError: not whole."""
    if len(span) != 4:
        raise RequestRefusedError(ILLEGAL_VALUE)
    return int.from_bytes(span[:2], "big"), int.from_bytes(span[2:], "big")
