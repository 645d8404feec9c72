"""A Mitsubishi MELFA controller (CRnD-700, CR75x, CR800) read over TCP or RS-232, never commanded.

One function sends requests, and only a `ReadCommand`, which can hold nothing but a reading command.
The controller sends no time: a reading is stamped midway between request and answer, and half that
span is its uncertainty.
"""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from verify.devices.encoders.intake import AngleMap, ControllerInstant, IntakeCounts, ReadingIntake
from verify.devices.melfa import protocol as r3
from verify.devices.melfa.protocol import (
    AnswerBuffer,
    ControllerAnswer,
    ReadCommand,
    ReceivedAnswer,
)
from verify.devices.ports import READ_TIMEOUT, ClockFunction, Port, PortLink, SerialLine, open_port
from verify.devices.protocols import DeviceState, EncoderReading

REQUEST_PAUSE = 0.1  # s, by the maker, while a program runs (BFP-A4288, 3.3.3)
MAX_ROUND_TRIP_RATIO = 3.0  # times the median round trip: the answer was delayed
MIN_ROUND_TRIPS = 5  # round trips before there is a median to speak of
MAX_ROUND_TRIPS = 500  # round trips
TIMEOUT_FACTOR = 3  # times the time-out, for a STATE that tells whether late answers are under way
REFUSAL_DELAY = 1.0  # s: a controller that refuses is not pestered
STATE, JPOSF, CLOSE = ReadCommand("STATE"), ReadCommand("JPOSF"), ReadCommand("CLOSE")
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
    robot_type: str | None = None  # e.g. RV-3SD: another one is warned of
    state_every: float = 2.0  # s: how often to ask whether the program runs


@dataclass(slots=True)
class ConnectionState:
    """What is known since the line was opened."""

    pending: ReadCommand | None = None  # sent, not answered
    sent_at: float = 0.0  # s
    due: float = float("-inf")  # s: when the next request may be sent
    state_due: float = float("-inf")
    opened: bool = False
    in_step: bool = False  # until each STATE was answered, late answers may be under way
    states_out: int = 0  # STATEs sent and not answered
    program_running: bool | None = None
    alarm_stands: bool = False
    alarm_asked: bool = False
    alarm: int | None = None  # its number, if ERROR has told
    untold: int | None = None  # number whose text is to be asked for
    complaint: str = ""
    identity_note: str = ""


class MelfaEncoders:
    """Joint readings by JPOSF.

    Args:
        settings: how the controller is reached.
        angles: from the controller's angles to the robot file's own.
        port: opens the port instead of the settings' address.
        now: the host's monotonic clock, s.
    """

    def __init__(
        self,
        settings: MelfaSettings,
        angles: AngleMap,
        port: Callable[[], Port] | None = None,
        now: ClockFunction = time.monotonic,
    ) -> None:
        opens = port or partial(open_port, settings.port, settings.line)
        self.round_trips: deque[float] = deque(maxlen=MAX_ROUND_TRIPS)  # s, of JPOSF
        self._settings, self._joints = settings, angles.joints
        self._link = PortLink(settings.port, opens, now)
        self._counts = IntakeCounts()
        self._intake = ReadingIntake(angles, self._counts)
        self._answers = AnswerBuffer()
        self._pause = settings.pause
        self._open = ReadCommand("OPEN", f"={settings.client}")
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
        line = self._answers.feed(None, self._link.now())
        if line is None:
            chunk = self._link.receive(READ_TIMEOUT)
            if not self._same_connection():
                return []
            line = self._answers.feed(chunk, self._link.now())
        if line is None:
            self._give_up_if_late()
            return []
        return self._take(line)

    def state(self) -> DeviceState:
        """Say how the controller is."""
        notes = [self._alarm_words(), self._talk.identity_note, self._pause_note()]
        note = "; ".join(part for part in notes if part)
        return self._counts.state(
            self._link, self._talk.complaint, note, self._talk.program_running
        )

    def close(self) -> None:
        """Say CLOSE, if the line is up, and close the port."""
        if self._link.connected:
            self._send(CLOSE)
        self._link.close()

    def _send(self, request: ReadCommand) -> None:
        """Send a request. Nothing else in this program writes to the controller."""
        self._talk.sent_at = self._link.now()
        if self._link.send(request.encoded(self._settings.terminator)):
            self._talk.pending = request
            self._talk.states_out += request.name == "STATE"

    def _same_connection(self) -> bool:
        same = self._link.connected and self._link.connections == self._connection
        if not same:
            self._talk = ConnectionState()
            self._answers.clear()
            self._connection = self._link.connections
        return same

    def _between_requests(self) -> None:
        """Wait out the pause; what comes unasked puts us out of step. Then ask."""
        rest = max(0.0, min(READ_TIMEOUT, self._talk.due - self._link.now()))
        chunk = self._link.receive(rest)
        if not self._same_connection():
            chunk = None
        stray = chunk is not None and chunk.data.strip(b"\r\n\0")
        if stray or not self._answers.empty:
            self._counts.bad["answer that nobody asked for"] += 1
            self._talk.in_step = False
        self._answers.clear()
        now = self._link.now()
        if self._link.connected and now >= self._talk.due:
            self._send(self._next_request(now))

    def _next_request(self, now: float) -> ReadCommand:
        if not self._talk.opened:
            return self._open
        if not self._talk.in_step or now >= self._talk.state_due:
            return STATE
        if self._talk.alarm_stands and not self._talk.alarm_asked:
            return ReadCommand("ERROR")
        if self._talk.untold is not None:
            return ReadCommand("ERRORMES", f"{self._talk.untold:04d}")
        return JPOSF

    def _give_up_if_late(self) -> None:
        waited = self._link.now() - self._talk.sent_at
        if waited <= self._settings.timeout:
            return
        if self._talk.pending != STATE or self._talk.in_step:
            self._counts.bad["request without an answer"] += 1
            self._out_of_step()
        elif waited > TIMEOUT_FACTOR * self._settings.timeout:
            self._counts.bad["line given up and opened again"] += 1
            self._link.drop("no answer")

    def _out_of_step(self) -> None:
        """Ask STATE before the next JPOSF: what is still under way comes before its answer.

        A late answer taken for that to the next request would bear a false time. The controller
        answers in order, so once every STATE is answered nothing is under way.
        """
        self._talk.pending, self._talk.in_step = None, False
        self._answers.clear()
        self._talk.due = self._link.now() + self._pause

    def _take(self, line: ReceivedAnswer) -> list[EncoderReading]:
        request, answer = self._talk.pending, r3.parse_answer(line.data)
        if r3.PROCEDURAL.match(line.data):
            self._talk.complaint = "the controller uses procedural RS-232; set its CPRC232 to 0"
        state = r3.parse_state(answer.data) if answer is not None else None
        self._talk.states_out -= state is not None
        if request is None or answer is None:
            self._counts.bad["answer that is not understood"] += 1
            if self._talk.in_step:
                self._out_of_step()
            return []
        if self._is_earlier(request, answer):
            return []
        self._talk.pending = None
        self._talk.due = self._link.now() + self._pause
        self._note_alarm(answer)
        if answer.error is not None:
            self._refused(request, answer.error)
            return []
        return self._understand(request, answer, line)

    def _is_earlier(self, request: ReadCommand, answer: ControllerAnswer) -> bool:
        """Whether this may be a late answer to an earlier request; then ours is yet to come."""
        if answer.error is not None:
            return False
        if request.name == "OPEN":
            position = r3.parse_joints(answer.data, self._joints)
            return position is not None or r3.parse_state(answer.data) is not None
        return request.name == "STATE" and not self._talk.in_step and self._talk.states_out > 0

    def _understand(
        self, request: ReadCommand, answer: ControllerAnswer, line: ReceivedAnswer
    ) -> list[EncoderReading]:
        match request.name:
            case "JPOSF":
                return self._position(answer, line)
            case "OPEN":
                self._talk.opened = True
                self._identify(answer.data.split(";"))
            case "STATE":
                self._run_state(answer)
            case "ERROR":
                self._talk.alarm_asked = True
                self._talk.alarm = r3.parse_error(answer.data)
                if self._talk.alarm is not None and self._talk.alarm not in self._texts:
                    self._talk.untold = self._talk.alarm
            case "ERRORMES" if self._talk.untold is not None:
                self._texts[self._talk.untold] = answer.data.strip(" ;") or "no text"
                self._talk.untold = None
        return []

    def _position(self, answer: ControllerAnswer, line: ReceivedAnswer) -> list[EncoderReading]:
        position = r3.parse_joints(answer.data, self._joints)
        if position is None:
            self._counts.bad["position that is not understood"] += 1
            self._out_of_step()
            return []
        self._talk.complaint = ""
        trip = line.t - self._talk.sent_at
        usual = (
            float(np.median(self.round_trips)) if len(self.round_trips) >= MIN_ROUND_TRIPS else trip
        )
        self.round_trips.append(trip)
        if trip > MAX_ROUND_TRIP_RATIO * usual:
            self._counts.bad["answer that took too long"] += 1
            self._pause = max(self._pause, REQUEST_PAUSE)
            return []
        self._link.steady()
        middle = ControllerInstant((self._talk.sent_at + line.t) / 2, 0)
        return self._intake.take(middle, line.t, trip / 2, np.deg2rad(position.joints_deg))

    def _refused(self, request: ReadCommand, error: int) -> None:
        meaning = self._texts.get(error)
        if meaning is None:
            self._talk.untold = error
        self._counts.bad[f"refusal with error {error}"] += 1
        self._talk.complaint = f"{request.name} refused, error {error}: {meaning or 'not known'}"
        self._talk.due = self._link.now() + REFUSAL_DELAY
        if 6000 <= error < 7000:  # the line's own errors: perhaps we ask too fast
            self._pause = max(self._pause, REQUEST_PAUSE)
            self._talk.opened = self._talk.in_step = False
        if request.name == "ERRORMES" and self._talk.untold is not None:
            self._texts[self._talk.untold] = "not in the manual"
            self._talk.untold = None

    def _identify(self, fields: list[str]) -> None:
        kind, wanted = next((f for f in fields if f.startswith("RV-")), ""), self._settings
        if wanted.robot_type and kind and kind != wanted.robot_type:
            self._talk.identity_note = f"the robot is {kind}; the station says {wanted.robot_type}"

    def _run_state(self, answer: ControllerAnswer) -> None:
        state = r3.parse_state(answer.data)
        if state is None:
            self._counts.bad["state that is not understood"] += 1
            self._out_of_step()
            return
        self._talk.state_due = self._link.now() + self._settings.state_every
        self._talk.in_step = True
        self._talk.program_running = state.running

    def _note_alarm(self, answer: ControllerAnswer) -> None:
        self._talk.alarm_stands = answer.alarm
        if not answer.alarm:
            self._talk.alarm, self._talk.alarm_asked = None, False

    def _alarm_words(self) -> str:
        number = self._talk.alarm
        if not self._talk.alarm_stands:
            return ""
        if number is None:
            return "an alarm is standing"
        return f"alarm {number} is standing: {self._texts.get(number, 'not known')}"

    def _pause_note(self) -> str:
        raised = self._pause > self._settings.pause
        return f"the pause is back at {self._pause * 1e3:.0f} ms" if raised else ""
