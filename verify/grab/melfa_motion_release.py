"""How a MELFA controller is given back: stop, servo off, override and right as before, and a look.

Each is tried even if the one before was refused; one that got no answer is said again on a new
connection, until the time is up. What could not be done is put in words.
"""

from collections import deque
from dataclasses import dataclass, field

from verify.devices import melfa_lines as r3
from verify.devices.melfa_lines import Request
from verify.grab.melfa_motion_lines import Order
from verify.grab.melfa_motion_talk import Told

STATE, ERROR, JPOSF = Request("STATE"), Request("ERROR"), Request("JPOSF")
WORDS = {
    "STOP": "stop",
    "SRVOFF": "servo off",
    "OVRD": "override put back",
    "CNTLOFF": "controls returned",
}


def standing_orders(override: int | None) -> deque[Request | Order]:
    """Say what has to be said to give a controller back, in this order.

    Args:
        override: %, as it was before the controls were taken; None: it was not changed. It is put
            back once the servo has no power, while there still is a right to.
    """
    before: list[Request | Order] = []
    if override is not None:
        before = [Order("OVRD", f"={override}"), JPOSF]
    return deque([Order("STOP"), ERROR, Order("SRVOFF"), *before, Order("CNTLOFF"), STATE])


@dataclass(slots=True)
class GivingBack:
    """Where the giving back stands."""

    until: float  # s, host's monotonic clock
    override: int | None = None  # %, to be put back; None: it was not changed
    to_say: deque[Request | Order] = field(init=False)
    notes: list[str] = field(default_factory=list)  # what went wrong with it
    alarm: int | None = None  # that stands
    alarm_text: str = ""  # the controller's own, of one that no list here holds
    found: r3.RunState | None = None  # what STATE told last

    def __post_init__(self) -> None:
        self.to_say = standing_orders(self.override)

    @property
    def over(self) -> bool:
        """Whether all was said and answered."""
        return not self.to_say

    def take(self, told: Told) -> None:
        """Go on with an answer; without one the same is to be said again."""
        if told.answer is None or not self.to_say or told.request != self.to_say[0]:
            return
        request, answer = self.to_say.popleft(), told.answer
        if answer.error is not None:
            if request.name in WORDS:
                meaning = r3.ERRORS.get(answer.error, "not known")
                said = f"{WORDS[request.name]} was refused, error {answer.error}: {meaning}"
                self.notes.append(said)
        elif request.name == "ERROR":
            self.alarm = r3.parse_error(answer.data)
            if self.alarm is not None and self.alarm not in r3.ERRORS:
                self.to_say.appendleft(Request("ERRORMES", f"{self.alarm:04d}"))
        elif request.name == "ERRORMES":
            self.alarm_text = answer.data.strip(" ;")
        elif request.name == "JPOSF":
            self._look_at_override(answer.data)
        elif request.name == "STATE":
            self._look(answer.data)

    def alarm_words(self) -> str:
        """Word the alarm that stands; empty if there is none."""
        if self.alarm is None:
            return ""
        meaning = r3.ERRORS.get(self.alarm) or self.alarm_text or "not known"
        return f"alarm {self.alarm}: {meaning}"

    def give_up(self) -> None:
        """Note what was never answered."""
        unsaid = [WORDS[request.name] for request in self.to_say if request.name in WORDS]
        if unsaid:
            said = f"could not be told: {', '.join(unsaid)}. Use the emergency stop if it moves"
            self.notes.append(said)
        elif self.found is None:
            self.notes.append("nobody knows whether it stands still without power: look")
        else:
            self.notes.append("it still moves" if self.found.running else "the servo is still on")
        self.to_say.clear()

    def _look_at_override(self, data: str) -> None:
        """Believe that it is back when the controller shows it."""
        position = r3.parse_joints(data, 1)
        if position is None:
            self.notes.append("nobody knows whether the override is as before: look")
        elif position.override != self.override:
            self.notes.append(f"the override is {position.override} %, it was {self.override} %")

    def _look(self, data: str) -> None:
        """Ask again until the servo is off and nothing runs."""
        self.found = r3.parse_state(data)
        if self.found is None or self.found.servo_on or self.found.running:
            self.to_say.append(STATE)
