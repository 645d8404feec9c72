"""Exchange requests and answers with a MELFA controller, one at a time and without waiting.

R3 answers bear no number. After a missing answer the next one to arrive could be the late one: so
the line is closed and opened again. On a serial line late answers survive that, but they come in
order: what arrives before OPEN's own answer, which is like no other, is ignored.
"""

from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType

from verify.devices.melfa import protocol as r3
from verify.devices.melfa.protocol import AnswerBuffer, ControllerAnswer
from verify.devices.ports import ClockFunction, Port, PortLink
from verify.grasping.actuators.melfa.orders import MotionCommand, MotionSettings, Request
from verify.grasping.actuators.protocols import BackgroundOpener

# s, longer than others take: what the servo's power is switched by
SLOW_COMMAND_TIMEOUTS = MappingProxyType({"SRVON": 5.0, "SRVOFF": 5.0})


@dataclass(frozen=True, slots=True)
class Exchange:
    """What came of one request."""

    request: Request
    answer: ControllerAnswer | None  # None: none came in time, or one that is not understood
    t: float  # s, host's monotonic clock: midway between request and answer
    half_width: float  # s, to either side of that
    trouble: str = ""  # why there is no answer


class Dialogue:
    """The line to the controller."""

    def __init__(
        self, settings: MotionSettings, open_port: Callable[[], Port], now: ClockFunction
    ) -> None:
        self._settings, self._opening = settings, BackgroundOpener(open_port)
        self.link = PortLink(settings.port, self._opening, now)
        self._answers = AnswerBuffer()
        self._pending: Request | None = None
        self._sent_at = 0.0
        self._due = float("-inf")
        self.connection = 0  # how often the line was opened: OPEN has to be sent on each

    @property
    def free(self) -> bool:
        """Whether something can be sent now."""
        return self.link.connected and self._pending is None and self.link.now() >= self._due

    def send(self, request: Request) -> None:
        """Send a request; `step` returns its answer."""
        self._pending, self._sent_at = request, self.link.now()
        self._answers.clear()
        self.link.send(request.encoded(self._settings.terminator))

    def step(self) -> Exchange | None:
        """Take what has arrived; return what came of the request, once that is known."""
        chunk = self.link.receive(0.0)
        if not self.link.connected or self.link.connections != self.connection:
            self.connection = self.link.connections
            return self._abandoned(self.link.fault) if self._pending is not None else None
        if self._pending is None:
            return None  # what comes unasked is cleared away with the next request
        line = self._answers.feed(chunk, self.link.now())
        if line is not None:
            return self._parsed(line.data, line.t)
        timeout = max(self._settings.timeout, SLOW_COMMAND_TIMEOUTS.get(self._pending.name, 0.0))
        if self.link.now() - self._sent_at > timeout:
            return self._dropped("no answer")
        return None

    def urge(self) -> None:
        """Let the next request go without a pause: a stop does not wait."""
        self._due = float("-inf")

    def close(self) -> None:
        """Close the port."""
        self.link.close()
        self._opening.close()

    def _parsed(self, data: bytes, t: float) -> Exchange | None:
        answer = r3.parse_answer(data)
        if answer is None:
            if r3.PROCEDURAL.match(data):
                return self._dropped("it uses procedural RS-232; set its CPRC232 to 0")
            return self._dropped("its answer is not understood")
        request = self._pending
        assert request is not None
        if request.name == "OPEN" and answer.error is None:
            # what answers OPEN is neither empty, nor a position, nor a state
            identity = ";" in answer.data and not answer.data.startswith("J1;")
            if not identity or r3.parse_state(answer.data) is not None:
                return None
        if isinstance(request, MotionCommand) and answer.data:
            return self._dropped("its answer belongs to something else")
        self._pending, self._due = None, self.link.now() + self._settings.pause
        self.link.steady()
        return Exchange(request, answer, (self._sent_at + t) / 2, (t - self._sent_at) / 2)

    def _dropped(self, why: str) -> Exchange:
        exchange = self._abandoned(why)
        self.link.drop(why)
        return exchange

    def _abandoned(self, why: str) -> Exchange:
        request = self._pending
        assert request is not None
        self._pending = None
        self._answers.clear()
        return Exchange(request, None, self.link.now(), 0.0, why)
