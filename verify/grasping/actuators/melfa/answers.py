"""What a MELFA controller answers, and where that leads."""

import numpy as np

from verify.core.records import Array
from verify.devices.encoders.intake import AngleMap, ControllerInstant, IntakeCounts, ReadingIntake
from verify.devices.melfa import protocol as r3
from verify.devices.melfa.protocol import ControllerAnswer, ReadCommand
from verify.grasping.actuators.melfa.dialogue import Exchange
from verify.grasping.actuators.melfa.orders import (
    MotionCommand,
    MotionSettings,
    MoveLimits,
    parse_limits,
    refusal_text,
)
from verify.grasping.actuators.melfa.states import JPOSF, STATE, Controls
from verify.grasping.actuators.protocols import FINAL_STATES, MoverState

STATE_PERIOD = 0.5  # s
CHECK_TIMEOUT, POWER_TIMEOUT = 10.0, 10.0  # s
OVERRIDE_RANGE = range(1, 101)  # that an override can be


class AnswerParser:
    """Understands what a controller answers; keeps the arm's angles as it told them last.

    Args:
        settings: how the controller is reached.
        angles: from the controller's angles to the robot file's own.
        limits: what no move may pass.
        course: goes on, or ends, with what was answered.
    """

    def __init__(
        self, settings: MotionSettings, angles: AngleMap, limits: MoveLimits, course: Controls
    ) -> None:
        self._settings, self._angles, self._limits = settings, angles, limits
        self._course = course
        self._intake = ReadingIntake(angles, IntakeCounts())
        self.q: Array | None = None  # (joints,), rad
        self.t: float | None = None  # s, when it stood there
        self.speed: float | None = None  # m/s, of the hand

    def take(self, told: Exchange) -> None:
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
            course.fail(refusal_text(told.request.name, answer.error))
        elif answer.alarm and course.progress.right_asked:
            course.fail("an alarm has come up")
        else:
            self._understand(told, answer)

    def _opened(self, answer: ControllerAnswer) -> None:
        course, wanted = self._course, self._settings.robot_type
        if answer.error is not None:
            course.fail(refusal_text("OPEN", answer.error))
            return
        course.progress.opened_on, course.progress.trouble = course.talk.connection, ""
        told = answer.data.split(";")
        if wanted not in told:
            kinds = [part for part in told if part.startswith(("RV-", "RH-"))]
            course.fail(f"the robot is {', '.join(kinds) or 'unknown'}; {wanted} is expected")
        elif course.state is MoverState.CONNECTING:
            course.enter(
                MoverState.CHECKING, CHECK_TIMEOUT, STATE, ReadCommand("PAR", "MEJAR"), JPOSF
            )

    def _understand(self, told: Exchange, answer: ControllerAnswer) -> None:
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
                self._course.enter(
                    MoverState.TAKING_CONTROLS, CHECK_TIMEOUT, MotionCommand("CNTLON")
                )
            case MoverState.TAKING_CONTROLS:
                override = MotionCommand("OVRD", f"={self._limits.override}")
                self._course.progress.override_set = True
                self._course.enter(
                    MoverState.POWERING, POWER_TIMEOUT, override, MotionCommand("SRVON")
                )
            case MoverState.ORDERING:
                self._course.enter(MoverState.MOVING, self._settings.move_limit)
            case MoverState.STOPPING:
                self._course.progress.state_due = 0.0

    def _run_state(self, answer: ControllerAnswer) -> None:
        state, progress = r3.parse_state(answer.data), self._course.progress
        if state is None:
            self._course.fail("its state is not understood")
            return
        progress.state_due, progress.still = self._course.now() + STATE_PERIOD, not state.running
        wrong = progress.wrong(state, self._course.state)
        if wrong:
            self._course.fail(wrong)
        elif self._course.state is MoverState.POWERING and state.servo_on and not progress.to_say:
            self._course.enter(MoverState.READY, float("inf"))
        elif progress.arrival is not None:
            progress.arrival.running = state.running

    def _position(self, told: Exchange, answer: ControllerAnswer) -> None:
        course, position = self._course, r3.parse_joints(answer.data, self._angles.joints)
        if position is None:
            course.fail("its position is not understood")
            return
        angles = np.deg2rad(position.joints_deg)
        readings = self._intake.take(
            ControllerInstant(told.t, 0), course.now(), told.half_width, angles
        )
        if not readings:
            return  # a leap that no arm makes: a digit was disturbed
        self.q, self.t, self.speed = readings[-1].q, told.t, position.speed
        if not course.progress.right_asked and position.override in OVERRIDE_RANGE:
            course.progress.override_found = position.override
        if course.state not in FINAL_STATES and course.progress.right_asked:
            self._follow(position)

    def _follow(self, position: r3.JointPosition) -> None:
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
