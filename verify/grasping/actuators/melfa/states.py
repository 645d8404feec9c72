"""Follow one taking of a MELFA controller's controls: its states, deadlines, arrival, and release.

A release stops the arm, takes the servo's power, puts override and operation right back, and checks
the result. Each order is sent even if the one before was refused; one without an answer is sent
again on a new connection, until the time is up. What could not be done is stated in words.
"""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from verify.core.records import Array
from verify.devices.melfa import protocol as r3
from verify.devices.melfa.protocol import JointPosition, ReadCommand, RunState
from verify.devices.ports import ClockFunction
from verify.grasping.actuators.melfa.dialogue import Dialogue, Exchange
from verify.grasping.actuators.melfa.orders import MotionCommand, Request, alarm_text, refusal_text
from verify.grasping.actuators.protocols import ACCEPTING_STATES, FINAL_STATES, MoverState

TOL_ARRIVAL_DEG = 0.05  # five of the controller's last digits
N_CONFIRMATIONS = 3  # positions in a row, at rest at the target
STALL_TIMEOUT = 2.0  # s at rest elsewhere
RELEASE_TIMEOUT = 10.0  # s
STATE, ERROR, JPOSF = ReadCommand("STATE"), ReadCommand("ERROR"), ReadCommand("JPOSF")
ORDER_NAMES = {
    "STOP": "stop",
    "SRVOFF": "servo off",
    "OVRD": "override put back",
    "CNTLOFF": "controls returned",
}
MOVING_STATES = frozenset({MoverState.ORDERING, MoverState.MOVING})
STANDING_STATES = ACCEPTING_STATES | {MoverState.STOPPING}
RELEASING_STATES = frozenset({MoverState.RELEASING, MoverState.FAILING})


@dataclass(slots=True)
class Arrival:
    """Whether one move has ended, by three signs at once: position, speed, and the run state."""

    target_deg: Array  # (joints,), the controller's own angles
    standing: int = 0  # positions in a row at the target, without speed
    running: bool = True  # by the last STATE
    stalled_since: float | None = None  # s: neither running nor at the target
    off_deg: float = float("inf")  # what is left to go, of the worst joint

    @property
    def arrived(self) -> bool:
        """Whether it stands at the target and the controller calls the move over."""
        return self.standing >= N_CONFIRMATIONS and not self.running

    def update(self, position: JointPosition, t: float) -> None:
        """Take a position of t s."""
        self.off_deg = float(np.max(np.abs(np.array(position.joints_deg) - self.target_deg)))
        stands = position.speed == 0.0
        self.standing = self.standing + 1 if stands and self.off_deg <= TOL_ARRIVAL_DEG else 0
        if self.standing or self.running or not stands:
            self.stalled_since = None
        elif self.stalled_since is None:
            self.stalled_since = t

    def stalled(self, t: float) -> bool:
        """Whether it has stood elsewhere for too long."""
        return self.stalled_since is not None and t - self.stalled_since > STALL_TIMEOUT


@dataclass(slots=True)
class Release:
    """How far the controller is given back."""

    until: float  # s, host's monotonic clock
    override: int | None = None  # %, to be put back; None: it was not changed
    requests: deque[Request] = field(init=False)  # not answered yet
    notes: list[str] = field(default_factory=list)  # what went wrong with it
    alarm: int | None = None  # that stands
    alarm_message: str = ""  # the controller's own, of an alarm without a meaning in our list
    run_state: RunState | None = None  # the last

    def __post_init__(self) -> None:
        back: list[Request] = []
        if self.override is not None:  # once the servo has no power, while there is a right to
            back = [MotionCommand("OVRD", f"={self.override}"), JPOSF]
        stop, off, end = (MotionCommand(name) for name in ("STOP", "SRVOFF", "CNTLOFF"))
        self.requests = deque([stop, ERROR, off, *back, end, STATE])

    def take(self, exchange: Exchange) -> None:
        """Take an answer; without one the same request stays the next."""
        request, answer = exchange.request, exchange.answer
        if answer is None or not self.requests or request != self.requests[0]:
            return
        self.requests.popleft()
        if answer.error is not None:
            if request.name in ORDER_NAMES:
                self.notes.append(refusal_text(ORDER_NAMES[request.name], answer.error))
        elif request.name == "ERROR":
            self.alarm = r3.parse_error(answer.data)
            if self.alarm is not None and self.alarm not in r3.ERROR_MEANINGS:
                self.requests.appendleft(ReadCommand("ERRORMES", f"{self.alarm:04d}"))
        elif request.name == "ERRORMES":
            self.alarm_message = answer.data.strip(" ;")
        elif request.name == "JPOSF":
            self._check_override(answer.data)
        elif request.name == "STATE":
            self.run_state = state = r3.parse_state(answer.data)
            if state is None or state.servo_on or state.running:
                self.requests.append(STATE)

    def give_up(self) -> None:
        """Note what was never answered."""
        left = [ORDER_NAMES[r.name] for r in self.requests if r.name in ORDER_NAMES]
        if left:
            orders = ", ".join(left)
            note = f"the controller did not answer: {orders}. Use the emergency stop if it moves"
        elif self.run_state is None:
            note = "it is unknown whether it stands still without power: look"
        else:
            note = "it still moves" if self.run_state.running else "the servo is still on"
        self.notes.append(note)
        self.requests.clear()

    def report(self) -> list[str]:
        """The alarm that stands, and what went wrong, in words."""
        if self.alarm is None:
            return self.notes
        meaning = r3.ERROR_MEANINGS.get(self.alarm) or self.alarm_message or "not known"
        return [f"alarm {self.alarm}: {meaning}", *self.notes]

    def _check_override(self, data: str) -> None:
        position = r3.parse_joints(data, 1)
        if position is None:
            self.notes.append("it is unknown whether the override was restored: look")
        elif position.override != self.override:
            self.notes.append(f"the override is {position.override} %, it was {self.override} %")


class Controls:
    """One taking of the controls, from the first request to the last."""

    def __init__(self, line: Dialogue, client: str, now: ClockFunction) -> None:
        self.line, self.now, self._client = line, now, client
        self.state, self.reason = MoverState.OFF, ""
        self.requests: deque[Request] = deque()  # of this state, not answered yet
        self.until = float("inf")  # s: how long this state may last
        self.opened_on = 0  # the connection on which OPEN was answered
        self.trouble = ""  # why OPEN got no answer
        self.right_requested = False  # from here on there is something to give back
        self.state_due = 0.0  # s: when STATE is asked next
        self.limits_deg: Array | None = None  # (joints, 2), the controller's own
        self.override_found: int | None = None  # %, before the controls were taken
        self.override_set = False  # another was ordered: the one found is to be put back
        self.arrival: Arrival | None = None
        self.still = False  # by STATE nothing runs
        self.giving_back: Release | None = None

    def enter(self, state: MoverState, limit: float, *requests: Request) -> None:
        """Begin a state that may last for `limit`, s, and the requests that it sends."""
        self.state, self.until, self.requests = state, self.now() + limit, deque(requests)

    def next(self) -> Request:
        """Choose the next request."""
        if self.opened_on != self.line.connection:
            return ReadCommand("OPEN", f"={self._client}")
        waiting = self.requests if self.giving_back is None else self.giving_back.requests
        if waiting:
            return waiting[0]
        if self.state is MoverState.POWERING or self.now() >= self.state_due:
            return STATE
        # is all that is missing the controller's word that the move is over?
        at_target = self.arrival is not None and self.arrival.running and self.arrival.standing > 0
        return STATE if self.state is MoverState.MOVING and at_target else JPOSF

    def state_problem(self, state: RunState) -> str:
        """Say what in an answer to STATE forbids to go on; empty where nothing does."""
        if alarm := alarm_text(state):
            return alarm
        if state.running and self.state not in MOVING_STATES | {MoverState.STOPPING}:
            return "a program runs on the controller; stop it there"
        if not state.servo_on and self.state in STANDING_STATES | MOVING_STATES:
            return "the servo has lost its power"
        return ""

    def watch(self) -> None:
        """Check the deadline, and whether the line is still that on which OPEN was sent."""
        if self.state in FINAL_STATES:
            return
        link = self.line.link
        if self.giving_back is not None:
            if self.now() > self.giving_back.until:
                self.giving_back.give_up()
                self.end()
        elif self.opened_on and self.opened_on != link.connections:
            self.fail("the connection was opened again")
        elif self.opened_on and not link.connected:
            self.fail(link.fault)
        elif self.now() > self.until:
            why = self.trouble if link.connected else link.fault
            self.fail(f"{self.state.value} takes too long" + (f"; {why}" if why else ""))

    def fail(self, reason: str) -> None:
        """Stop and give back; what goes wrong while giving back is noted there."""
        if self.giving_back is None:
            self._give_back(MoverState.FAILING, reason)
        elif self.state is MoverState.RELEASING and reason:
            self.state, self.reason = MoverState.FAILING, f"while releasing: {reason}"

    def release(self) -> None:
        """Give the controls back, unless that is done or under way."""
        if self.state not in FINAL_STATES | RELEASING_STATES:
            self._give_back(MoverState.RELEASING, "")

    def end(self) -> None:
        """Close the line: all was sent and answered, or the time is up."""
        notes = [] if self.giving_back is None else self.giving_back.report()
        self.reason = "; ".join(part for part in (self.reason, *notes) if part)
        clean = self.state is MoverState.RELEASING and not notes
        self.state = MoverState.RELEASED if clean else MoverState.FAILED
        self.line.urge()
        if self.line.free:
            self.line.send(ReadCommand("CLOSE"))
        self.line.close()

    def _give_back(self, state: MoverState, reason: str) -> None:
        self.state, self.reason = state, reason
        if not self.right_requested:
            self.end()
            return
        override = self.override_found if self.override_set else None
        self.giving_back = Release(self.now() + RELEASE_TIMEOUT, override)
        self.line.urge()
