"""Which state a MELFA controller's mover is in, its deadline, and the way out of it: give back."""

from collections import deque

from verify.devices.link import Now
from verify.devices.melfa_lines import Request
from verify.grab.melfa_motion_lines import Order
from verify.grab.melfa_motion_progress import Progress
from verify.grab.melfa_motion_release import GivingBack
from verify.grab.melfa_motion_talk import Talk
from verify.grab.motion_port import ENDED, MoverState

CLOSE = Request("CLOSE")
GIVE_BACK_LIMIT = 10.0  # s
GIVES_BACK = frozenset({MoverState.RELEASING, MoverState.FAILING})


class Course:
    """One taking of the controls, from the first word to the last.

    Args:
        talk: the line to the controller.
        client: what OPEN says who this is.
        now: the host's monotonic clock, s.
    """

    def __init__(self, talk: Talk, client: str, now: Now) -> None:
        self.state, self.reason = MoverState.OFF, ""
        self.progress = Progress()
        self.talk, self.now, self._client = talk, now, client

    def enter(self, state: MoverState, limit: float, *to_say: Request | Order) -> None:
        """Begin a state that may last for `limit`, s, and what there is to say in it."""
        self.state = state
        self.progress.until = self.now() + limit
        self.progress.to_say = deque(to_say)

    def next(self) -> Request | Order:
        """Choose what to say next."""
        progress = self.progress
        if progress.opened_on != self.talk.connection:
            return Request("OPEN", f"={self._client}")
        return progress.next(self.state, self.now())

    def watch(self) -> None:
        """Look at the clock, and whether the line is still that on which OPEN was said."""
        if self.state in ENDED:
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
        if self.state not in ENDED | GIVES_BACK:
            self._give_back(MoverState.RELEASING, "")

    def given_back(self, giving_back: GivingBack) -> None:
        """Come to the end: all was said, or its time is up."""
        alarm = giving_back.alarm_words()
        self._end([alarm] * bool(alarm) + giving_back.notes)

    def _give_back(self, state: MoverState, reason: str) -> None:
        self.state, self.reason = state, reason
        if self.progress.right_asked:
            progress = self.progress
            override = progress.override_found if progress.override_set else None
            progress.giving_back = GivingBack(self.now() + GIVE_BACK_LIMIT, override)
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
