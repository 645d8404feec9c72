"""Requests and orders to a MELFA controller, one at a time, and their answers; nobody waits.

R3 answers bear no number. After an answer that did not come, the next one to arrive could be that:
so then the line is closed and opened again. On a serial line late answers survive that; but they
come in order, so what arrives before OPEN's own answer, which looks like no other, is passed by.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType

from verify.devices.melfa import protocol as r3
from verify.devices.melfa.protocol import AnswerBuffer, ControllerAnswer, ReadCommand
from verify.devices.ports import ClockFunction, Port, PortLink
from verify.grasping.actuators.melfa.orders import MotionCommand
from verify.grasping.actuators.protocols import BackgroundOpener

# s, longer than others take: what the servo's power is switched by
SLOW_COMMAND_TIMEOUTS = MappingProxyType({"SRVON": 5.0, "SRVOFF": 5.0})


@dataclass(frozen=True, slots=True)
class Exchange:
    """What came of one request."""

    request: ReadCommand | MotionCommand
    answer: ControllerAnswer | None  # None: none came in time, or one that is not understood
    t: float  # s, host's monotonic clock: midway between request and answer
    half_width: float  # s, to either side of that
    trouble: str = ""  # why there is no answer


class Dialogue:
    """The line to the controller.

    Args:
        name: the port as the user wrote it, for sentences.
        open_port: opens it.
        terminator: what ends a request.
        pause: s, from an answer to the next request.
        timeout: s for an answer.
        now: the host's monotonic clock, s.
    """

    def __init__(
        self,
        name: str,
        open_port: Callable[[], Port],
        terminator: bytes,
        pause: float,
        timeout: float,
        now: ClockFunction = time.monotonic,
    ) -> None:
        self._opening = BackgroundOpener(open_port)
        self.link = PortLink(name, self._opening, now)
        self._terminator, self._pause, self._timeout = terminator, pause, timeout
        self._answers = AnswerBuffer()
        self._pending: ReadCommand | MotionCommand | None = None
        self._sent_at = 0.0
        self._due = float("-inf")
        self._connection = 0

    @property
    def free(self) -> bool:
        """Whether something can be sent now."""
        rested = self.link.now() >= self._due
        return self.link.connected and self._pending is None and rested

    @property
    def connection(self) -> int:
        """How often the line was opened: OPEN has to be said on each."""
        return self._connection

    def send(self, request: ReadCommand | MotionCommand) -> None:
        """Send it; what comes of it `step` gives."""
        self._pending, self._sent_at = request, self.link.now()
        self._answers.clear()
        self.link.send(request.encoded(self._terminator))

    def step(self) -> Exchange | None:
        """Go on with what has arrived; give what came of the request, once that is known."""
        chunk = self.link.receive(0.0)
        if not self.link.connected or self.link.connections != self._connection:
            self._connection = self.link.connections
            return self._given_up(self.link.fault) if self._pending is not None else None
        if self._pending is None:
            return None  # what comes unasked is cleared away with the next request
        line = self._answers.feed(chunk, self.link.now())
        if line is not None:
            return self._understood(line.data, line.t)
        patience = max(self._timeout, SLOW_COMMAND_TIMEOUTS.get(self._pending.name, 0.0))
        if self.link.now() - self._sent_at > patience:
            return self._dropped("no answer")
        return None

    def urge(self) -> None:
        """Let the next request go without a pause: a stop does not wait."""
        self._due = float("-inf")

    def close(self) -> None:
        """Close the port."""
        self.link.close()
        self._opening.close()

    def _understood(self, data: bytes, t: float) -> Exchange | None:
        answer = r3.parse_answer(data)
        if answer is None:
            if r3.PROCEDURAL.match(data):
                return self._dropped("it uses procedural RS-232; set its CPRC232 to 0")
            return self._dropped("its answer is not understood")
        request = self._pending
        assert request is not None
        if request.name == "OPEN" and answer.error is None and not is_open_answer(answer.data):
            return None
        if isinstance(request, MotionCommand) and answer.data:
            return self._dropped("its answer belongs to something else")
        self._pending, self._due = None, self.link.now() + self._pause
        self.link.steady()
        return Exchange(request, answer, (self._sent_at + t) / 2, (t - self._sent_at) / 2)

    def _dropped(self, why: str) -> Exchange:
        told = self._given_up(why)
        self.link.drop(why)
        return told

    def _given_up(self, why: str) -> Exchange:
        request = self._pending
        assert request is not None
        self._pending = None
        self._answers.clear()
        return Exchange(request, None, self.link.now(), 0.0, why)


def is_open_answer(data: str) -> bool:
    """Whether this answers OPEN: it is neither empty, nor a state, nor a position."""
    return ";" in data and not data.startswith("J1;") and r3.parse_state(data) is None
