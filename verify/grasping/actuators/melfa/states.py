"""Which state a MELFA controller's mover is in, its deadline, and the way out of it: give back.

Whether an arm has arrived: three signs at once, so that no single one is believed.

How a MELFA controller is given back: stop, servo off, override and right as before, and a look.

Each is tried even if the one before was refused; one that got no answer is said again on a new
connection, until the time is up. What could not be done is put in words.

What is known of a controller since its controls were asked for, and what follows from it.
"""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from verify.core.records import Array
from verify.devices.melfa import protocol as r3
from verify.devices.melfa.protocol import JointPosition, ReadCommand, RunState
from verify.devices.ports import ClockFunction
from verify.grasping.actuators.melfa.dialogue import Dialogue, Exchange
from verify.grasping.actuators.melfa.orders import MotionCommand, alarm_text
from verify.grasping.actuators.protocols import ACCEPTING_STATES, FINAL_STATES, MoverState

TOL_ARRIVAL_DEG = 0.05  # five of the controller's last digits
N_CONFIRMATIONS = 3  # in a row, standing there
STALL_TIMEOUT = 2.0  # s that it may stand elsewhere


@dataclass(slots=True)
class Arrival:
    """Follows one move."""

    target_deg: Array  # (joints,), the controller's own angles
    standing: int = 0  # readings in a row at the target, without speed
    running: bool = True  # as STATE last told
    stalled_since: float | None = None  # s: neither running nor at the target
    off_deg: float = float("inf")  # the worst joint's way that is left

    @property
    def arrived(self) -> bool:
        """Whether it stands at the target and the controller calls the move over."""
        return self.standing >= N_CONFIRMATIONS and not self.running

    @property
    def wants_state(self) -> bool:
        """Whether all that is missing is the controller's word that the move is over."""
        return self.running and self.standing > 0

    def see(self, position: JointPosition, t: float) -> None:
        """Take a position, told at t s."""
        gap = np.abs(np.array(position.joints_deg) - self.target_deg)
        self.off_deg = float(np.max(gap))
        stands = position.speed == 0.0
        self.standing = self.standing + 1 if stands and self.off_deg <= TOL_ARRIVAL_DEG else 0
        if self.standing or self.running or not stands:
            self.stalled_since = None
        elif self.stalled_since is None:
            self.stalled_since = t

    def stalled(self, t: float) -> bool:
        """Whether it has stood elsewhere for too long."""
        return self.stalled_since is not None and t - self.stalled_since > STALL_TIMEOUT


STATE, ERROR, JPOSF = ReadCommand("STATE"), ReadCommand("ERROR"), ReadCommand("JPOSF")
ORDER_NAMES = {
    "STOP": "stop",
    "SRVOFF": "servo off",
    "OVRD": "override put back",
    "CNTLOFF": "controls returned",
}


def release_orders(override: int | None) -> deque[ReadCommand | MotionCommand]:
    """Say what has to be said to give a controller back, in this order.

    Args:
        override: %, as it was before the controls were taken; None: it was not changed. It is put
            back once the servo has no power, while there still is a right to.
    """
    before: list[ReadCommand | MotionCommand] = []
    if override is not None:
        before = [MotionCommand("OVRD", f"={override}"), JPOSF]
    return deque(
        [
            MotionCommand("STOP"),
            ERROR,
            MotionCommand("SRVOFF"),
            *before,
            MotionCommand("CNTLOFF"),
            STATE,
        ]
    )


@dataclass(slots=True)
class Release:
    """Where the giving back stands."""

    until: float  # s, host's monotonic clock
    override: int | None = None  # %, to be put back; None: it was not changed
    to_say: deque[ReadCommand | MotionCommand] = field(init=False)
    notes: list[str] = field(default_factory=list)  # what went wrong with it
    alarm: int | None = None  # that stands
    alarm_text: str = ""  # the controller's own, of one that no list here holds
    found: r3.RunState | None = None  # what STATE told last

    def __post_init__(self) -> None:
        self.to_say = release_orders(self.override)

    @property
    def over(self) -> bool:
        """Whether all was said and answered."""
        return not self.to_say

    def take(self, told: Exchange) -> None:
        """Go on with an answer; without one the same is to be said again."""
        if told.answer is None or not self.to_say or told.request != self.to_say[0]:
            return
        request, answer = self.to_say.popleft(), told.answer
        if answer.error is not None:
            if request.name in ORDER_NAMES:
                meaning = r3.ERROR_MEANINGS.get(answer.error, "not known")
                said = f"{ORDER_NAMES[request.name]} was refused, error {answer.error}: {meaning}"
                self.notes.append(said)
        elif request.name == "ERROR":
            self.alarm = r3.parse_error(answer.data)
            if self.alarm is not None and self.alarm not in r3.ERROR_MEANINGS:
                self.to_say.appendleft(ReadCommand("ERRORMES", f"{self.alarm:04d}"))
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
        meaning = r3.ERROR_MEANINGS.get(self.alarm) or self.alarm_text or "not known"
        return f"alarm {self.alarm}: {meaning}"

    def give_up(self) -> None:
        """Note what was never answered."""
        unsaid = [
            ORDER_NAMES[request.name] for request in self.to_say if request.name in ORDER_NAMES
        ]
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


MOVING_STATES = frozenset({MoverState.ORDERING, MoverState.MOVING})
STANDING_STATES = ACCEPTING_STATES | {MoverState.STOPPING}


@dataclass(slots=True)
class ControlProgress:
    """What is known since the controls were asked for."""

    to_say: deque[ReadCommand | MotionCommand] = field(default_factory=deque)
    until: float = float("inf")  # s: how long this state may last
    opened_on: int = 0  # the connection on which OPEN was answered
    trouble: str = ""  # why OPEN got no answer
    right_asked: bool = False  # from here on there is something to give back
    state_due: float = 0.0  # s
    limits_deg: Array | None = None  # (joints, 2), the controller's own
    override_found: int | None = None  # %, before the controls were taken
    override_set: bool = False  # another was ordered: the one found is to be put back
    arrival: Arrival | None = None
    still: bool = False  # STATE says that nothing runs
    giving_back: Release | None = None

    def next(self, doing: MoverState, now: float) -> ReadCommand | MotionCommand:
        """Choose what to say next to a controller that was opened.

        Args:
            doing: the mover's state.
            now: s.
        """
        if self.giving_back is not None:
            return self.giving_back.to_say[0]
        if self.to_say:
            return self.to_say[0]
        if doing is MoverState.POWERING or now >= self.state_due:
            return STATE
        if doing is MoverState.MOVING and self.arrival is not None and self.arrival.wants_state:
            return STATE
        return JPOSF

    def wrong(self, state: RunState, doing: MoverState) -> str:
        """Say what speaks against going on in what STATE told; empty where nothing does.

        Args:
            state: the answer.
            doing: the mover's state.
        """
        if alarm := alarm_text(state):
            return alarm
        if state.running and doing not in MOVING_STATES | {MoverState.STOPPING}:
            return "a program runs on the controller; stop it there"
        if not state.servo_on and doing in STANDING_STATES | MOVING_STATES:
            return "the servo has lost its power"
        return ""


CLOSE = ReadCommand("CLOSE")
RELEASE_TIMEOUT = 10.0  # s
RELEASING_STATES = frozenset({MoverState.RELEASING, MoverState.FAILING})


class Controls:
    """One taking of the controls, from the first word to the last.

    Args:
        talk: the line to the controller.
        client: what OPEN says who this is.
        now: the host's monotonic clock, s.
    """

    def __init__(self, talk: Dialogue, client: str, now: ClockFunction) -> None:
        self.state, self.reason = MoverState.OFF, ""
        self.progress = ControlProgress()
        self.talk, self.now, self._client = talk, now, client

    def enter(self, state: MoverState, limit: float, *to_say: ReadCommand | MotionCommand) -> None:
        """Begin a state that may last for `limit`, s, and what there is to say in it."""
        self.state = state
        self.progress.until = self.now() + limit
        self.progress.to_say = deque(to_say)

    def next(self) -> ReadCommand | MotionCommand:
        """Choose what to say next."""
        progress = self.progress
        if progress.opened_on != self.talk.connection:
            return ReadCommand("OPEN", f"={self._client}")
        return progress.next(self.state, self.now())

    def watch(self) -> None:
        """Look at the clock, and whether the line is still that on which OPEN was said."""
        if self.state in FINAL_STATES:
            return
        giving_back, progress = self.progress.giving_back, self.progress
        if giving_back is not None:
            if self.now() > giving_back.until:
                giving_back.give_up()
                self.given_back(giving_back)
        elif progress.opened_on and progress.opened_on != self.talk.link.connections:
            self.fail("the line was opened anew")
        elif progress.opened_on and not self.talk.link.connected:
            self.fail(self.talk.link.fault)
        elif self.now() > progress.until:
            why = progress.trouble if self.talk.link.connected else self.talk.link.fault
            self.fail(f"{self.state.value} takes too long" + (f"; {why}" if why else ""))

    def fail(self, reason: str) -> None:
        """Stop and give back; what goes wrong while giving back is noted there."""
        giving_back = self.progress.giving_back
        if giving_back is None:
            self._give_back(MoverState.FAILING, reason)
        elif self.state is MoverState.RELEASING and reason:
            self.state, self.reason = MoverState.FAILING, f"while releasing: {reason}"

    def release(self) -> None:
        """Give the controls back, unless that is done or under way."""
        if self.state not in FINAL_STATES | RELEASING_STATES:
            self._give_back(MoverState.RELEASING, "")

    def given_back(self, giving_back: Release) -> None:
        """Come to the end: all was said, or its time is up."""
        alarm = giving_back.alarm_words()
        self._end([alarm] * bool(alarm) + giving_back.notes)

    def _give_back(self, state: MoverState, reason: str) -> None:
        self.state, self.reason = state, reason
        if self.progress.right_asked:
            progress = self.progress
            override = progress.override_found if progress.override_set else None
            progress.giving_back = Release(self.now() + RELEASE_TIMEOUT, override)
            self.talk.urge()
        else:
            self._end([])

    def _end(self, notes: list[str]) -> None:
        self.reason = "; ".join(part for part in (self.reason, *notes) if part)
        clean = self.state is MoverState.RELEASING and not notes
        self.state = MoverState.RELEASED if clean else MoverState.FAILED
        self.talk.urge()
        if self.talk.free:
            self.talk.send(CLOSE)
        self.talk.close()
