"""What is known of a controller since its controls were asked for, and what follows from it."""

from collections import deque
from dataclasses import dataclass, field

from verify.devices.melfa_lines import Request, RunState
from verify.grab.melfa_motion_arrival import Arrival
from verify.grab.melfa_motion_lines import Order
from verify.grab.melfa_motion_release import GivingBack
from verify.grab.melfa_motion_words import standing_alarm
from verify.grab.motion_port import TAKES_MOVES, MoverState
from verify.records import Array

STATE, JPOSF = Request("STATE"), Request("JPOSF")
MOVES = frozenset({MoverState.ORDERING, MoverState.MOVING})
STANDS = TAKES_MOVES | {MoverState.STOPPING}


@dataclass(slots=True)
class Progress:
    """What is known since the controls were asked for."""

    to_say: deque[Request | Order] = field(default_factory=deque)
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
    giving_back: GivingBack | None = None

    def next(self, doing: MoverState, now: float) -> Request | Order:
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
        if alarm := standing_alarm(state):
            return alarm
        if state.running and doing not in MOVES | {MoverState.STOPPING}:
            return "a program runs on the controller; stop it there"
        if not state.servo_on and doing in STANDS | MOVES:
            return "the servo has lost its power"
        return ""
