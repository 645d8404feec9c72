"""One Modbus RTU request at a time over a port that opens itself; nobody waits.

Frames, checks and messages are pymodbus's; its clients wait for their answers, and a control loop
cannot.
"""

from collections import Counter
from collections.abc import Callable
from typing import Final

from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerRTU
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU

from verify.devices.link import Link, Now
from verify.devices.ports import Port
from verify.grab.motion_port_opening import BackgroundOpening

REFRESH = 0.005  # s: the gripper's cycle; asked sooner it has nothing new to say
LONGEST = 512  # bytes: two of the longest frames; noise must not fill the memory
# exception code -> meaning, by the Modbus specification
EXCEPTIONS: Final = {1: "unknown function", 2: "no such register", 3: "value not allowed"}


class RefusedError(Exception):
    """The gripper answered with an exception."""

    def __init__(self, code: int) -> None:
        super().__init__(f"refused: {EXCEPTIONS.get(code, f'exception {code}')}")


class NoAnswerError(Exception):
    """The gripper did not answer, as often as it was asked."""


class ModbusLine:
    """Asks and takes the answer once it is there.

    Args:
        name: the port as the user wrote it, for sentences.
        open_port: opens it.
        slave: whom to ask.
        allowed: function codes that may be sent; others cannot be.
        timeout: s for an answer.
        tries: how often a request is sent before it is given up.
        now: the host's monotonic clock, s.
    """

    def __init__(
        self,
        name: str,
        open_port: Callable[[], Port],
        slave: int,
        allowed: frozenset[int],
        timeout: float,
        tries: int,
        now: Now,
    ) -> None:
        self.bad: Counter[str] = Counter()  # what was dropped: reason -> how often
        self._opening = BackgroundOpening(open_port)
        self.link = Link(name, self._opening, now)
        self._slave, self._allowed = slave, allowed
        self._timeout, self._tries = timeout, tries
        self._framer = FramerRTU(DecodePDU(is_server=False))
        self._pending: ModbusPDU | None = None
        self._buffer = b""
        self._sent_at = float("-inf")
        self._left = 0  # tries
        self._connection = 0

    @property
    def free(self) -> bool:
        """Whether a request can be sent now."""
        rested = self.link.now() - self._sent_at >= REFRESH
        return self._pending is None and self.link.connected and rested

    def ask(self, request: ModbusPDU) -> None:
        """Send a request; its answer comes from `step`.

        Raises:
            ValueError: a function that this line may not send.
        """
        if request.function_code not in self._allowed:
            raise ValueError(f"this line may not send function {request.function_code}")
        request.dev_id = self._slave
        self._pending, self._left = request, self._tries
        self._send()

    def step(self) -> ModbusPDU | None:
        """Take what has come: the answer to the request, once it is whole.

        Raises:
            NoAnswerError: none came, as often as it was asked.
            RefusedError: the gripper's answer was an exception.
        """
        chunk = self.link.receive(0.0)
        same = self.link.connected and self.link.connections == self._connection
        self._connection = self.link.connections
        if self._pending is None:
            self.bad["answer that nobody asked for"] += chunk is not None
            return None
        if not same:
            self.forget()
            raise NoAnswerError
        if chunk is not None:
            self._buffer = (self._buffer + chunk.data)[-LONGEST:]
        answer = self._answer()
        if answer is None:
            if self.link.now() - self._sent_at > self._timeout:
                self._again()
            return None
        self._pending, self._buffer = None, b""
        self.link.steady()
        if isinstance(answer, ExceptionResponse):
            raise RefusedError(answer.exception_code)
        return answer

    def forget(self) -> None:
        """Give up what was asked."""
        self._pending, self._buffer = None, b""

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
        """Decode what is there; None if that is no answer to what was asked."""
        assert self._pending is not None
        if not self._buffer:
            return None
        try:
            used, answer = self._framer.handleFrame(self._buffer, self._slave, 0)
        except (ModbusException, IndexError):
            self.bad["answer that is not understood"] += 1
            used, answer = len(self._buffer), None
        self._buffer = self._buffer[used:]
        if answer is None:
            return None
        if answer.function_code & 0x7F != self._pending.function_code:
            self.bad["answer that nobody asked for"] += 1
            return None
        return answer

    def _again(self) -> None:
        self.bad["request without an answer"] += 1
        if not self._left:
            self.forget()
            raise NoAnswerError
        self._send()
