"""A Mitsubishi MELFA controller that moves its arm: stop-and-go by EXEC over the R3 line protocol.

Sequence: BFP-A4288 section 4 (OPEN, CNTLON, SRVON, OVRD, EXEC moves, SRVOFF, CNTLOFF). Every answer
is checked. At any refusal, alarm, silence or lost line the arm is stopped and the controller given
back; no alarm is ever cleared here. The real-time control (MXT) is not used: it passes planner and
override by.
"""

import time
from collections import deque
from collections.abc import Callable
from functools import partial
from types import TracebackType

import numpy as np

from verify.devices import melfa_lines as r3
from verify.devices.controller_clock import Instant
from verify.devices.intake import AngleMap, Counts, Intake
from verify.devices.link import Now
from verify.devices.melfa_lines import Answer, Request
from verify.devices.ports import Port, open_port
from verify.grab.melfa_motion_arrival import Arrival
from verify.grab.melfa_motion_lines import Order, joint_move, line_move, parse_limits
from verify.grab.melfa_motion_progress import JPOSF, MOVES, STATE, Progress
from verify.grab.melfa_motion_release import GivingBack
from verify.grab.melfa_motion_settings import MotionSettings, MoveLimits, outside
from verify.grab.melfa_motion_talk import Talk, Told
from verify.grab.melfa_motion_words import refused
from verify.grab.motion_port import (
    ENDED,
    TAKES_MOVES,
    ExecuteRight,
    MotionRefusedError,
    MoverState,
    MoverStatus,
)
from verify.records import Array

CLOSE = Request("CLOSE")
STATE_EVERY = 0.5  # s
CONNECT_LIMIT, CHECK_LIMIT, POWER_LIMIT, STOP_LIMIT = 10.0, 10.0, 10.0, 5.0  # s
GIVE_BACK_LIMIT = 10.0  # s
PERCENT = range(1, 101)  # that an override can be
PAUSE = 0.005  # s, between the steps of `close`
GIVES_BACK = frozenset({MoverState.RELEASING, MoverState.FAILING})


class MelfaMover:
    """Moves an arm.

    Args:
        settings: how the controller is reached.
        angles: from the controller's angles to the robot file's own.
        limits: what no move may pass.
        right: the operator's order that it may move.
        port: opens the port instead of the settings' address.
        now: the host's monotonic clock, s.
    """

    def __init__(
        self,
        settings: MotionSettings,
        angles: AngleMap,
        limits: MoveLimits,
        right: ExecuteRight,
        port: Callable[[], Port] | None = None,
        now: Now = time.monotonic,
    ) -> None:
        if not isinstance(right, ExecuteRight):
            raise TypeError("an arm that moves needs the operator's right")
        self._settings, self._angles, self._limits, self._now = settings, angles, limits, now
        self._opens = port or partial(open_port, settings.port, settings.line)
        self._state, self._reason = MoverState.OFF, ""
        self._q: Array | None = None
        self._t: float | None = None
        self._speed: float | None = None
        self._begin_anew()

    def __enter__(self) -> "MelfaMover":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def take_controls(self) -> None:
        """Connect, check, take the right and power the servo. See `Mover.take_controls`."""
        if self._state not in ENDED:
            raise MotionRefusedError(f"the arm is {self._state.value} already")
        self._talk.close()
        self._begin_anew()
        self._q = self._t = self._speed = None
        self._enter(MoverState.CONNECTING, CONNECT_LIMIT)

    def move_joints(self, q: Array) -> None:
        """Go to joint angles by joint interpolation. See `Mover.move_joints`."""
        self._move(joint_move, q)

    def move_line(self, q: Array) -> None:
        """Go to joint angles with the hand on a straight line. See `Mover.move_line`."""
        self._move(line_move, q)

    def hold(self) -> None:
        """Stop where it is and keep the controls. See `Mover.hold`."""
        if self._state in TAKES_MOVES | MOVES:
            self._progress.still = False
            self._enter(MoverState.STOPPING, STOP_LIMIT, Order("STOP"))
            self._talk.urge()

    def release(self) -> None:
        """Stop, take the servo's power, give the controls back. See `Mover.release`."""
        if self._state not in ENDED | GIVES_BACK:
            self._give_back(MoverState.RELEASING, "")

    def step(self) -> MoverStatus:
        """Go on with what has arrived; never waits for the controller."""
        if self._state not in ENDED:
            told = self._talk.step()
            if told is not None:
                self._take(told)
            self._watch()
            if self._talk.free and self._state not in ENDED:
                self._talk.send(self._next())
        return self._status()

    def close(self) -> None:
        """Release, waiting for at most GIVE_BACK_LIMIT, and close the line. Never raises."""
        self.release()
        while self._state not in ENDED:
            self.step()
            time.sleep(PAUSE)
        self._talk.close()

    def _begin_anew(self) -> None:
        settings = self._settings
        self._talk = Talk(
            settings.port,
            self._opens,
            settings.terminator,
            settings.pause,
            settings.timeout,
            self._now,
        )
        self._progress = Progress()
        self._intake = Intake(self._angles, Counts())

    def _enter(self, state: MoverState, limit: float, *to_say: Request | Order) -> None:
        self._state = state
        self._progress.until = self._now() + limit
        self._progress.to_say = deque(to_say)

    def _move(self, worded: Callable[[Array, int], list[Order]], q: Array) -> None:
        if self._state not in TAKES_MOVES:
            said = f": {self._reason}" if self._reason else ""
            raise MotionRefusedError(f"the arm takes no move now, it is {self._state.value}{said}")
        own = self._progress.limits_deg
        assert self._q is not None
        assert own is not None  # both were asked for before the controls were taken
        target_deg = np.rad2deg(self._angles.sign * (q - self._angles.offset))
        refusal = outside(self._limits, own, self._q, q, target_deg)
        if refusal:
            raise MotionRefusedError(refusal)
        orders = worded(target_deg, self._settings.slot)
        self._progress.arrival = Arrival(target_deg)
        self._enter(MoverState.ORDERING, self._settings.move_limit, *orders)

    # what to say

    def _next(self) -> Request | Order:
        progress = self._progress
        if progress.opened_on != self._talk.connection:
            return Request("OPEN", f"={self._settings.client}")
        return progress.next(self._state, self._now())

    # what was answered

    def _take(self, told: Told) -> None:
        giving_back = self._progress.giving_back
        if told.answer is None and self._state is MoverState.CONNECTING:
            self._progress.trouble = told.trouble  # the line may still be another's: tried again
        elif told.answer is None:
            self._fail(f"{told.request.name}: {told.trouble}")
        elif told.request.name == "OPEN":
            self._opened(told.answer)
        elif giving_back is not None:
            giving_back.take(told)
            if giving_back.over:
                self._given_back(giving_back)
        elif told.answer.error is not None:
            self._fail(refused(told.request.name, told.answer.error))
        elif told.answer.alarm and self._progress.right_asked:
            self._fail("an alarm has come up")
        else:
            self._understand(told, told.answer)

    def _opened(self, answer: Answer) -> None:
        if answer.error is not None:
            self._fail(refused("OPEN", answer.error))
            return
        self._progress.opened_on, self._progress.trouble = self._talk.connection, ""
        told, wanted = answer.data.split(";"), self._settings.robot_type
        if wanted not in told:
            kinds = [part for part in told if part.startswith(("RV-", "RH-"))]
            self._fail(f"the robot is {', '.join(kinds) or 'unknown'}; {wanted} is expected")
        elif self._state is MoverState.CONNECTING:
            self._enter(MoverState.CHECKING, CHECK_LIMIT, STATE, Request("PAR", "MEJAR"), JPOSF)

    def _understand(self, told: Told, answer: Answer) -> None:
        progress = self._progress
        asked_for = bool(progress.to_say) and told.request == progress.to_say[0]
        if asked_for:
            progress.to_say.popleft()
        match told.request.name:
            case "STATE":
                self._run_state(answer)
            case "JPOSF":
                self._position(told, answer)
            case "PAR":
                progress.limits_deg = parse_limits(answer.data, self._angles.joints)
                if progress.limits_deg is None:
                    self._fail("its joint limits are not understood")
        if asked_for and not progress.to_say:
            self._said_all()

    def _said_all(self) -> None:
        """Go to the next state, now that everything of this one was said and taken."""
        match self._state:
            case MoverState.CHECKING:
                self._progress.right_asked = True
                self._enter(MoverState.TAKING_CONTROLS, CHECK_LIMIT, Order("CNTLON"))
            case MoverState.TAKING_CONTROLS:
                override = Order("OVRD", f"={self._limits.override}")
                self._progress.override_set = True
                self._enter(MoverState.POWERING, POWER_LIMIT, override, Order("SRVON"))
            case MoverState.ORDERING:
                self._enter(MoverState.MOVING, self._settings.move_limit)
            case MoverState.STOPPING:
                self._progress.state_due = 0.0

    def _run_state(self, answer: Answer) -> None:
        state, progress = r3.parse_state(answer.data), self._progress
        if state is None:
            self._fail("its state is not understood")
            return
        progress.state_due, progress.still = self._now() + STATE_EVERY, not state.running
        wrong = progress.wrong(state, self._state)
        if wrong:
            self._fail(wrong)
        elif self._state is MoverState.POWERING and state.servo_on and not progress.to_say:
            self._enter(MoverState.READY, float("inf"))
        elif progress.arrival is not None:
            progress.arrival.running = state.running

    def _position(self, told: Told, answer: Answer) -> None:
        position = r3.parse_joints(answer.data, self._angles.joints)
        if position is None:
            self._fail("its position is not understood")
            return
        angles = np.deg2rad(position.joints_deg)
        readings = self._intake.take(Instant(told.t, 0), self._now(), told.half_width, angles)
        if not readings:
            return  # a leap that no arm makes: a digit was disturbed
        self._q, self._t, self._speed = readings[-1].q, told.t, position.speed
        if not self._progress.right_asked and position.override in PERCENT:
            self._progress.override_found = position.override
        if self._state not in ENDED and self._progress.right_asked:
            self._follow(position)

    def _follow(self, position: r3.Position) -> None:
        """See what a position means for what is being done."""
        arrival = self._progress.arrival
        if position.speed > self._limits.hand_speed:
            self._fail(f"the hand goes at {position.speed:.3f} m/s")
        elif self._state is MoverState.STOPPING:
            if self._progress.still and position.speed == 0.0 and not self._progress.to_say:
                self._enter(MoverState.HELD, float("inf"))
        elif self._state is MoverState.MOVING and arrival is not None:
            arrival.see(position, self._now())
            if arrival.arrived:
                self._enter(MoverState.ARRIVED, float("inf"))
            elif arrival.stalled(self._now()):
                self._fail(f"the arm stands {arrival.off_deg:.2f} degrees from its target")

    # what goes wrong, and the way out

    def _watch(self) -> None:
        """Look at the clock, and whether the line is still that on which OPEN was said."""
        if self._state in ENDED:
            return
        giving_back, progress = self._progress.giving_back, self._progress
        if giving_back is not None:
            if self._now() > giving_back.until:
                giving_back.give_up()
                self._given_back(giving_back)
        elif progress.opened_on and progress.opened_on != self._talk.link.connections:
            self._fail("the line was opened anew")
        elif progress.opened_on and not self._talk.link.connected:
            self._fail(self._talk.link.fault)
        elif self._now() > progress.until:
            why = progress.trouble if self._talk.link.connected else self._talk.link.fault
            self._fail(f"{self._state.value} takes too long" + (f"; {why}" if why else ""))

    def _fail(self, reason: str) -> None:
        """Stop and give back; what goes wrong while giving back is noted there."""
        giving_back = self._progress.giving_back
        if giving_back is None:
            self._give_back(MoverState.FAILING, reason)
        elif self._state is MoverState.RELEASING and reason:
            self._state, self._reason = MoverState.FAILING, f"while releasing: {reason}"

    def _give_back(self, state: MoverState, reason: str) -> None:
        self._state, self._reason = state, reason
        if self._progress.right_asked:
            progress = self._progress
            override = progress.override_found if progress.override_set else None
            progress.giving_back = GivingBack(self._now() + GIVE_BACK_LIMIT, override)
            self._talk.urge()
        else:
            self._end([])

    def _given_back(self, giving_back: GivingBack) -> None:
        alarm = giving_back.alarm_words()
        self._end([alarm] * bool(alarm) + giving_back.notes)

    def _end(self, notes: list[str]) -> None:
        self._reason = "; ".join(part for part in (self._reason, *notes) if part)
        clean = self._state is MoverState.RELEASING and not notes
        self._state = MoverState.RELEASED if clean else MoverState.FAILED
        self._talk.urge()
        if self._talk.free:
            self._talk.send(CLOSE)
        self._talk.close()

    def _status(self) -> MoverStatus:
        age = None if self._t is None else self._now() - self._t
        reason = self._reason
        if self._state is MoverState.CONNECTING and not self._talk.link.connected:
            reason = self._talk.link.fault
        said = f"{self._settings.port}: {reason}" if reason else ""
        return MoverStatus(self._state, said, self._q, self._t, age, self._speed)
