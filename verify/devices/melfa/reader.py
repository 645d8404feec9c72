"""A Mitsubishi MELFA controller (CRnD-700, CR75x, CR800) read over TCP or RS-232, never commanded.

One function sends requests, and only a `ReadCommand`, which can hold nothing but a reading command.
The controller sends no time: a reading is stamped midway between request and answer, and half that
span is its uncertainty.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

from verify.devices.encoders.intake import AngleMap, ControllerInstant, PortDriver, ReadingIntake
from verify.devices.melfa import protocol as r3
from verify.devices.ports import READ_TIMEOUT, SerialLine, link_to
from verify.devices.protocols import DeviceState, EncoderReading

REQUEST_PAUSE = 0.1  # s, by the maker, while a program runs (BFP-A4288, 3.3.3)
MAX_ROUND_TRIP_RATIO = 3.0  # times the median round trip: the answer was delayed
MIN_ROUND_TRIPS = 5  # round trips before their median is used
MAX_ROUND_TRIPS = 500  # round trips
TIMEOUT_FACTOR = 3  # times the time-out, for a STATE that shows whether late answers are under way
REFUSAL_DELAY = 1.0  # s, from a refusal to the next request
STATE, JPOSF, CLOSE = r3.ReadCommand("STATE"), r3.ReadCommand("JPOSF"), r3.ReadCommand("CLOSE")
DEFAULT_MELFA_LINE = SerialLine(9600, 8, "E", 2)


@dataclass(frozen=True, slots=True)
class MelfaSettings:
    """How a MELFA controller is reached."""

    port: str  # tcp:HOST:10001, or a serial device
    line: SerialLine = DEFAULT_MELFA_LINE
    terminator: bytes = b"\r"  # CR LF, NUL and none are in use too
    pause: float = REQUEST_PAUSE  # s, from an answer to the next request
    timeout: float = 1.0  # s
    client: str = "verify"  # letters and digits
    robot_type: str | None = None  # e.g. RV-3SD: another one gives a warning
    state_every: float = 2.0  # s: how often to ask whether the program runs


@dataclass(slots=True)
class ConnectionState:
    """The state of the exchange since the line was opened."""

    pending: r3.ReadCommand | None = None  # sent, not answered
    sent_at: float = 0.0  # s
    due: float = float("-inf")  # s: when the next request may be sent
    state_due: float = float("-inf")
    opened: bool = False
    in_step: bool = False  # until each STATE was answered, late answers may be under way
    states_out: int = 0  # STATEs sent and not answered
    alarm_stands: bool = False
    alarm_read: bool = False  # ERROR was answered
    alarm: int | None = None  # its number
    missing_text: int | None = None  # number of an error whose text is to be read
    identity_note: str = ""


class MelfaEncoders(PortDriver):
    """Joint readings by JPOSF."""

    def __init__(self, settings: MelfaSettings, angles: AngleMap) -> None:
        super().__init__(link_to(settings.port, settings.line))
        self.round_trips: deque[float] = deque(maxlen=MAX_ROUND_TRIPS)  # s, of JPOSF
        self._settings, self._joints = settings, angles.joints
        self._intake = ReadingIntake(angles, self.counts)
        self._answers = r3.AnswerBuffer()
        self._pause = settings.pause
        self._open = r3.ReadCommand("OPEN", f"={settings.client}")
        self._texts = dict(r3.ERROR_MEANINGS)
        self._connection = 0
        self._talk = ConnectionState()

    def read(self) -> list[EncoderReading]:
        """Give what has arrived since the last call: one reading or none.

        Waits for at most 20 ms on an open line.
        """
        if self._talk.pending is None:
            self._between_requests()
            return []
        line = self._answers.feed(None, self.link.now())
        if line is None:
            chunk = self.link.receive(READ_TIMEOUT)
            if not self._same_connection():
                return []
            line = self._answers.feed(chunk, self.link.now())
        if line is None:
            self._give_up_if_late()
            return []
        return self._take(line)

    def state(self) -> DeviceState:
        """Describe the controller."""
        raised = self._pause > self._settings.pause
        pause_note = f"the pause is back at {self._pause * 1e3:.0f} ms" if raised else ""
        notes = self._alarm_note(), self._talk.identity_note, pause_note
        self._remark = "; ".join(filter(None, notes))
        return super().state()

    def close(self) -> None:
        """Send CLOSE, if the line is up, and close the port."""
        if self.link.connected:
            self._send(CLOSE)
        super().close()

    def _send(self, request: r3.ReadCommand) -> None:
        """Send a request. Nothing else in this program writes to the controller."""
        self._talk.sent_at = self.link.now()
        if self.link.send(request.encoded(self._settings.terminator)):
            self._talk.pending = request
            self._talk.states_out += request.name == "STATE"

    def _same_connection(self) -> bool:
        same = self.link.connected and self.link.connections == self._connection
        if not same:
            self._talk, self._fault, self._running = ConnectionState(), "", None
            self._answers.clear()
            self._connection = self.link.connections
        return same

    def _between_requests(self) -> None:
        """Wait out the pause, then send the next request; a stray answer puts us out of step."""
        chunk = self.link.receive(max(0.0, min(READ_TIMEOUT, self._talk.due - self.link.now())))
        if not self._same_connection():
            chunk = None
        stray = chunk is not None and chunk.data.strip(b"\r\n\0")
        if stray or not self._answers.empty:
            self._drop("unrequested answer")
            self._talk.in_step = False
        self._answers.clear()
        now = self.link.now()
        if self.link.connected and now >= self._talk.due:
            self._send(self._next_request(now))

    def _next_request(self, now: float) -> r3.ReadCommand:
        if not self._talk.opened:
            return self._open
        if not self._talk.in_step or now >= self._talk.state_due:
            return STATE
        if self._talk.alarm_stands and not self._talk.alarm_read:
            return r3.ReadCommand("ERROR")
        if self._talk.missing_text is not None:
            return r3.ReadCommand("ERRORMES", f"{self._talk.missing_text:04d}")
        return JPOSF

    def _give_up_if_late(self) -> None:
        waited = self.link.now() - self._talk.sent_at
        if waited <= self._settings.timeout:
            return
        if self._talk.pending != STATE or self._talk.in_step:
            self._drop("request without an answer")
            self._out_of_step()
        elif waited > TIMEOUT_FACTOR * self._settings.timeout:
            self._drop("line given up and opened again")
            self.link.drop("no answer")

    def _out_of_step(self) -> None:
        """Send STATE before the next JPOSF: what is still under way comes before its answer.

        A late answer taken for that to the next request would bear a false time. The controller
        answers in order, so once every STATE is answered nothing is under way.
        """
        self._talk.pending, self._talk.in_step = None, False
        self._answers.clear()
        self._talk.due = self.link.now() + self._pause

    def _take(self, line: r3.ReceivedAnswer) -> list[EncoderReading]:
        request, answer = self._talk.pending, r3.parse_answer(line.data)
        if r3.PROCEDURAL.match(line.data):
            self._fault = "the controller uses procedural RS-232; set its CPRC232 to 0"
        state = r3.parse_state(answer.data) if answer is not None else None
        self._talk.states_out -= state is not None
        if request is None or answer is None:
            if self._talk.in_step:
                self._out_of_step()
            return self._drop("answer that is not understood")
        if self._is_earlier(request, answer):
            return []
        self._talk.pending = None
        self._talk.due = self.link.now() + self._pause
        self._talk.alarm_stands = answer.alarm
        if not answer.alarm:
            self._talk.alarm, self._talk.alarm_read = None, False
        if answer.error is not None:
            self._refused(request, answer.error)
            return []
        return self._understand(request, answer, line)

    def _is_earlier(self, request: r3.ReadCommand, answer: r3.ControllerAnswer) -> bool:
        """Whether this may be a late answer to an earlier request; then ours is yet to come."""
        if answer.error is not None:
            return False
        if request.name == "OPEN":
            position = r3.parse_joints(answer.data, self._joints)
            return position is not None or r3.parse_state(answer.data) is not None
        return request.name == "STATE" and not self._talk.in_step and self._talk.states_out > 0

    def _understand(
        self, request: r3.ReadCommand, answer: r3.ControllerAnswer, line: r3.ReceivedAnswer
    ) -> list[EncoderReading]:
        match request.name:
            case "JPOSF":
                return self._position(answer, line)
            case "OPEN":
                self._talk.opened = True
                kind = next((f for f in answer.data.split(";") if f.startswith("RV-")), "")
                stated = self._settings.robot_type
                if stated and kind and kind != stated:
                    self._talk.identity_note = f"the robot is {kind}; the station says {stated}"
            case "STATE":
                self._run_state(answer)
            case "ERROR":
                self._talk.alarm_read = True
                self._talk.alarm = r3.parse_error(answer.data)
                if self._talk.alarm is not None and self._talk.alarm not in self._texts:
                    self._talk.missing_text = self._talk.alarm
            case "ERRORMES":
                self._set_text(answer.data.strip(" ;") or "no text")
        return []

    def _set_text(self, text: str) -> None:
        """Set the text of the error whose text was missing."""
        if self._talk.missing_text is not None:
            self._texts[self._talk.missing_text] = text
            self._talk.missing_text = None

    def _position(
        self, answer: r3.ControllerAnswer, line: r3.ReceivedAnswer
    ) -> list[EncoderReading]:
        position = r3.parse_joints(answer.data, self._joints)
        if position is None:
            self._out_of_step()
            return self._drop("position that is not understood")
        self._fault = ""
        trip = line.t - self._talk.sent_at
        enough = len(self.round_trips) >= MIN_ROUND_TRIPS
        usual = float(np.median(self.round_trips)) if enough else trip
        self.round_trips.append(trip)
        if trip > MAX_ROUND_TRIP_RATIO * usual:
            self._pause = max(self._pause, REQUEST_PAUSE)
            return self._drop("answer that took too long")
        self.link.steady()
        middle = ControllerInstant((self._talk.sent_at + line.t) / 2, 0)
        return self._intake.take(middle, line.t, trip / 2, np.deg2rad(position.joints_deg))

    def _refused(self, request: r3.ReadCommand, error: int) -> None:
        meaning = self._texts.get(error)
        if meaning is None:
            self._talk.missing_text = error
        self._drop(f"refusal with error {error}")
        self._fault = f"{request.name} refused, error {error}: {meaning or 'not known'}"
        self._talk.due = self.link.now() + REFUSAL_DELAY
        if 6000 <= error < 7000:  # the line's own errors: perhaps we ask too fast
            self._pause = max(self._pause, REQUEST_PAUSE)
            self._talk.opened = self._talk.in_step = False
        if request.name == "ERRORMES":
            self._set_text("not in the manual")

    def _run_state(self, answer: r3.ControllerAnswer) -> None:
        state = r3.parse_state(answer.data)
        if state is None:
            self._drop("state that is not understood")
            self._out_of_step()
            return
        self._talk.state_due = self.link.now() + self._settings.state_every
        self._talk.in_step = True
        self._running = state.running

    def _alarm_note(self) -> str:
        number = self._talk.alarm
        if not self._talk.alarm_stands:
            return ""
        if number is None:
            return "an alarm is active"
        return f"alarm {number} is active: {self._texts.get(number, 'not known')}"
