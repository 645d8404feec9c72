"""What a MELFA controller answers, and where that leads."""

import numpy as np

from verify.devices import melfa_lines as r3
from verify.devices.controller_clock import Instant
from verify.devices.intake import AngleMap, Counts, Intake
from verify.devices.melfa_lines import Answer, Request
from verify.grab.melfa_motion_course import Course
from verify.grab.melfa_motion_lines import Order, parse_limits
from verify.grab.melfa_motion_progress import JPOSF, STATE
from verify.grab.melfa_motion_settings import MotionSettings, MoveLimits
from verify.grab.melfa_motion_talk import Told
from verify.grab.melfa_motion_words import refused
from verify.grab.motion_port import ENDED, MoverState
from verify.records import Array

STATE_EVERY = 0.5  # s
CHECK_LIMIT, POWER_LIMIT = 10.0, 10.0  # s
PERCENT = range(1, 101)  # that an override can be


class Answers:
    """Understands what a controller answers; keeps the arm's angles as it told them last.

    Args:
        settings: how the controller is reached.
        angles: from the controller's angles to the robot file's own.
        limits: what no move may pass.
        course: goes on, or ends, with what was answered.
    """

    def __init__(
        self, settings: MotionSettings, angles: AngleMap, limits: MoveLimits, course: Course
    ) -> None:
        self._settings, self._angles, self._limits = settings, angles, limits
        self._course = course
        self._intake = Intake(angles, Counts())
        self.q: Array | None = None  # (joints,), rad
        self.t: float | None = None  # s, when it stood there
        self.speed: float | None = None  # m/s, of the hand

    def take(self, told: Told) -> None:
        """Go on with an answer, or with there being none."""
        course, answer = self._course, told.answer
        giving_back = course.progress.giving_back
        if answer is None and course.state is MoverState.CONNECTING:
            course.progress.trouble = told.trouble  # the line may still be another's: tried again
        elif answer is None:
            course.fail(f"{told.request.name}: {told.trouble}")
        elif told.request.name == "OPEN":
            self._opened(answer)
        elif giving_back is not None:
            giving_back.take(told)
            if giving_back.over:
                course.given_back(giving_back)
        elif answer.error is not None:
            course.fail(refused(told.request.name, answer.error))
        elif answer.alarm and course.progress.right_asked:
            course.fail("an alarm has come up")
        else:
            self._understand(told, answer)

    def _opened(self, answer: Answer) -> None:
        course, wanted = self._course, self._settings.robot_type
        if answer.error is not None:
            course.fail(refused("OPEN", answer.error))
            return
        course.progress.opened_on, course.progress.trouble = course.talk.connection, ""
        told = answer.data.split(";")
        if wanted not in told:
            kinds = [part for part in told if part.startswith(("RV-", "RH-"))]
            course.fail(f"the robot is {', '.join(kinds) or 'unknown'}; {wanted} is expected")
        elif course.state is MoverState.CONNECTING:
            course.enter(MoverState.CHECKING, CHECK_LIMIT, STATE, Request("PAR", "MEJAR"), JPOSF)

    def _understand(self, told: Told, answer: Answer) -> None:
        progress = self._course.progress
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
                    self._course.fail("its joint limits are not understood")
        if asked_for and not progress.to_say:
            self._said_all()

    def _said_all(self) -> None:
        """Go to the next state, now that everything of this one was said and taken."""
        match self._course.state:
            case MoverState.CHECKING:
                self._course.progress.right_asked = True
                self._course.enter(MoverState.TAKING_CONTROLS, CHECK_LIMIT, Order("CNTLON"))
            case MoverState.TAKING_CONTROLS:
                override = Order("OVRD", f"={self._limits.override}")
                self._course.progress.override_set = True
                self._course.enter(MoverState.POWERING, POWER_LIMIT, override, Order("SRVON"))
            case MoverState.ORDERING:
                self._course.enter(MoverState.MOVING, self._settings.move_limit)
            case MoverState.STOPPING:
                self._course.progress.state_due = 0.0

    def _run_state(self, answer: Answer) -> None:
        state, progress = r3.parse_state(answer.data), self._course.progress
        if state is None:
            self._course.fail("its state is not understood")
            return
        progress.state_due, progress.still = self._course.now() + STATE_EVERY, not state.running
        wrong = progress.wrong(state, self._course.state)
        if wrong:
            self._course.fail(wrong)
        elif self._course.state is MoverState.POWERING and state.servo_on and not progress.to_say:
            self._course.enter(MoverState.READY, float("inf"))
        elif progress.arrival is not None:
            progress.arrival.running = state.running

    def _position(self, told: Told, answer: Answer) -> None:
        course, position = self._course, r3.parse_joints(answer.data, self._angles.joints)
        if position is None:
            course.fail("its position is not understood")
            return
        angles = np.deg2rad(position.joints_deg)
        readings = self._intake.take(Instant(told.t, 0), course.now(), told.half_width, angles)
        if not readings:
            return  # a leap that no arm makes: a digit was disturbed
        self.q, self.t, self.speed = readings[-1].q, told.t, position.speed
        if not course.progress.right_asked and position.override in PERCENT:
            course.progress.override_found = position.override
        if course.state not in ENDED and course.progress.right_asked:
            self._follow(position)

    def _follow(self, position: r3.Position) -> None:
        """See what a position means for what is being done."""
        course, progress = self._course, self._course.progress
        arrival = progress.arrival
        if position.speed > self._limits.hand_speed:
            course.fail(f"the hand goes at {position.speed:.3f} m/s")
        elif course.state is MoverState.STOPPING:
            if progress.still and position.speed == 0.0 and not progress.to_say:
                course.enter(MoverState.HELD, float("inf"))
        elif course.state is MoverState.MOVING and arrival is not None:
            arrival.see(position, course.now())
            if arrival.arrived:
                course.enter(MoverState.ARRIVED, float("inf"))
            elif arrival.stalled(course.now()):
                course.fail(f"the arm stands {arrival.off_deg:.2f} degrees from its target")
