"""Parse what a MELFA controller answers, and change the state of its controls accordingly."""

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
    """Parses answers; keeps the arm's angles of the last one."""

    def __init__(
        self, settings: MotionSettings, angles: AngleMap, limits: MoveLimits, controls: Controls
    ) -> None:
        self._settings, self._angles, self._limits = settings, angles, limits
        self._controls = controls
        self._intake = ReadingIntake(angles, IntakeCounts())
        self.q: Array | None = None  # (joints,), rad
        self.t: float | None = None  # s, of these angles
        self.speed: float | None = None  # m/s, of the hand

    def take(self, exchange: Exchange) -> None:
        """Take an answer, or that there was none."""
        controls, answer, name = self._controls, exchange.answer, exchange.request.name
        if answer is None and controls.state is MoverState.CONNECTING:
            controls.trouble = exchange.trouble  # another client may hold the line: tried again
        elif answer is None:
            controls.fail(f"{name}: {exchange.trouble}")
        elif name == "OPEN":
            self._opened(answer)
        elif controls.giving_back is not None:
            controls.giving_back.take(exchange)
            if not controls.giving_back.requests:
                controls.end()
        elif answer.error is not None:
            controls.fail(refusal_text(name, answer.error))
        elif answer.alarm and controls.right_requested:
            controls.fail("an alarm has come up")
        else:
            self._accepted(exchange, answer)

    def _opened(self, answer: ControllerAnswer) -> None:
        controls, wanted = self._controls, self._settings.robot_type
        if answer.error is not None:
            controls.fail(refusal_text("OPEN", answer.error))
            return
        controls.opened_on, controls.trouble = controls.line.connection, ""
        identity = answer.data.split(";")
        if wanted not in identity:
            kinds = [part for part in identity if part.startswith(("RV-", "RH-"))]
            controls.fail(f"the robot is {', '.join(kinds) or 'unknown'}; {wanted} is expected")
        elif controls.state is MoverState.CONNECTING:
            limits = ReadCommand("PAR", "MEJAR")
            controls.enter(MoverState.CHECKING, CHECK_TIMEOUT, STATE, limits, JPOSF)

    def _accepted(self, exchange: Exchange, answer: ControllerAnswer) -> None:
        requests = self._controls.requests
        of_state = bool(requests) and exchange.request == requests[0]
        if of_state:
            requests.popleft()
        match exchange.request.name:
            case "STATE":
                self._run_state(answer)
            case "JPOSF":
                self._position(exchange, answer)
            case "PAR":
                self._controls.limits_deg = parse_limits(answer.data, self._angles.joints)
                if self._controls.limits_deg is None:
                    self._controls.fail("its joint limits are not understood")
        if of_state and not self._controls.requests:
            self._enter_next()

    def _enter_next(self) -> None:
        """Go to the next state, now that every request of this one was answered."""
        controls = self._controls
        match controls.state:
            case MoverState.CHECKING:
                controls.right_requested = True
                controls.enter(MoverState.TAKING_CONTROLS, CHECK_TIMEOUT, MotionCommand("CNTLON"))
            case MoverState.TAKING_CONTROLS:
                override = MotionCommand("OVRD", f"={self._limits.override}")
                controls.override_set = True
                controls.enter(MoverState.POWERING, POWER_TIMEOUT, override, MotionCommand("SRVON"))
            case MoverState.ORDERING:
                controls.enter(MoverState.MOVING, self._settings.move_limit)
            case MoverState.STOPPING:
                controls.state_due = 0.0

    def _run_state(self, answer: ControllerAnswer) -> None:
        state, controls = r3.parse_state(answer.data), self._controls
        if state is None:
            controls.fail("its state is not understood")
            return
        controls.state_due, controls.still = controls.now() + STATE_PERIOD, not state.running
        if problem := controls.state_problem(state):
            controls.fail(problem)
        elif controls.state is MoverState.POWERING and state.servo_on and not controls.requests:
            controls.enter(MoverState.READY, float("inf"))
        elif controls.arrival is not None:
            controls.arrival.running = state.running

    def _position(self, exchange: Exchange, answer: ControllerAnswer) -> None:
        controls, position = self._controls, r3.parse_joints(answer.data, self._angles.joints)
        if position is None:
            controls.fail("its position is not understood")
            return
        instant, angles = ControllerInstant(exchange.t, 0), np.deg2rad(position.joints_deg)
        readings = self._intake.take(instant, controls.now(), exchange.half_width, angles)
        if not readings:
            return  # a leap that no arm makes: a digit was disturbed
        self.q, self.t, self.speed = readings[-1].q, exchange.t, position.speed
        if not controls.right_requested and position.override in OVERRIDE_RANGE:
            controls.override_found = position.override
        if controls.state not in FINAL_STATES and controls.right_requested:
            self._follow(position)

    def _follow(self, position: r3.JointPosition) -> None:
        """Check the speed; end a stop or a move that is over."""
        controls, arrival = self._controls, self._controls.arrival
        if position.speed > self._limits.hand_speed:
            controls.fail(f"the hand goes at {position.speed:.3f} m/s")
        elif controls.state is MoverState.STOPPING:
            if controls.still and position.speed == 0.0 and not controls.requests:
                controls.enter(MoverState.HELD, float("inf"))
        elif controls.state is MoverState.MOVING and arrival is not None:
            arrival.update(position, controls.now())
            if arrival.arrived:
                controls.enter(MoverState.ARRIVED, float("inf"))
            elif arrival.stalled(controls.now()):
                controls.fail(f"the arm stands {arrival.off_deg:.2f} degrees from its target")
