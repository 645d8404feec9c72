"""Move the arm of a Mitsubishi MELFA controller, one move at a time, by EXEC over the R3 protocol.

Sequence: BFP-A4288 section 4 (OPEN, CNTLON, SRVON, OVRD, EXEC moves, SRVOFF, CNTLOFF). Every answer
is checked. At any refusal, alarm, silence or lost line the arm is stopped and the controller given
back; no alarm is ever cleared. The real-time control (MXT) is not used: it bypasses planner and
override.
"""

import time
from collections.abc import Callable
from functools import partial

import numpy as np

from verify.core.records import Array
from verify.devices.encoders.intake import AngleMap
from verify.devices.ports import Port, open_port
from verify.grasping.actuators.melfa import orders
from verify.grasping.actuators.melfa.answers import AnswerParser
from verify.grasping.actuators.melfa.dialogue import Dialogue
from verify.grasping.actuators.melfa.states import MOVING_STATES, Arrival, Controls
from verify.grasping.actuators.protocols import (
    ACCEPTING_STATES,
    FINAL_STATES,
    ExecutePermission,
    MotionRefusedError,
    MoverState,
    MoverStatus,
)

CONNECT_TIMEOUT, STOP_TIMEOUT = 10.0, 5.0  # s
CLOSE_PERIOD = 0.005  # s, between the steps of `close`


class MelfaMover:
    """Moves an arm."""

    def __init__(
        self,
        settings: orders.MotionSettings,
        angles: AngleMap,
        limits: orders.MoveLimits,
        permission: ExecutePermission,
        port: Callable[[], Port] | None = None,
    ) -> None:
        if not isinstance(permission, ExecutePermission):
            raise TypeError("an arm moves only with the operator's permission")
        self._settings, self._angles, self._limits = settings, angles, limits
        self._open_port = port or partial(open_port, settings.port, settings.line)
        self._reset()

    def take_controls(self) -> None:
        """Connect, check, take the right and power the servo. See `Mover.take_controls`."""
        if self._controls.state not in FINAL_STATES:
            raise MotionRefusedError(f"the arm is {self._controls.state.value} already")
        self._controls.line.close()
        self._reset()
        self._controls.enter(MoverState.CONNECTING, CONNECT_TIMEOUT)

    def move(self, q: Array, *, on_line: bool = False) -> None:
        """Go to joint angles by joint interpolation, or on a straight line. See `Mover.move`."""
        controls, q_now = self._controls, self._answers.q
        if controls.state not in ACCEPTING_STATES:
            why = f": {controls.reason}" if controls.reason else ""
            raise MotionRefusedError(
                f"the arm takes no move now, it is {controls.state.value}{why}"
            )
        own = controls.limits_deg
        assert q_now is not None
        assert own is not None  # both were read before the controls were taken
        target_deg = np.rad2deg(self._angles.sign * (q - self._angles.offset))
        refusal = orders.refusal_reason(self._limits, own, q_now, q, target_deg)
        if refusal:
            raise MotionRefusedError(refusal)
        controls.arrival = Arrival(target_deg)
        worded = orders.move_commands(target_deg, on_line=on_line)
        controls.enter(MoverState.ORDERING, self._settings.move_limit, *worded)

    def hold(self) -> None:
        """Stop where it is and keep the controls. See `Mover.hold`."""
        controls = self._controls
        if controls.state in ACCEPTING_STATES | MOVING_STATES:
            controls.still = False
            controls.enter(MoverState.STOPPING, STOP_TIMEOUT, orders.MotionCommand("STOP"))
            controls.line.urge()

    def release(self) -> None:
        """Stop, take the servo's power, give the controls back. See `Mover.release`."""
        self._controls.release()

    def step(self) -> MoverStatus:
        """Go on with what has arrived; never waits for the controller."""
        controls = self._controls
        if controls.state not in FINAL_STATES:
            exchange = controls.line.step()
            if exchange is not None:
                self._answers.take(exchange)
            controls.watch()
            if controls.line.free and controls.state not in FINAL_STATES:
                controls.line.send(controls.next())
        return self._status()

    def close(self) -> None:
        """Release, waiting for at most RELEASE_TIMEOUT, and close the line. Never raises."""
        self.release()
        while self._controls.state not in FINAL_STATES:
            self.step()
            time.sleep(CLOSE_PERIOD)
        self._controls.line.close()

    def _reset(self) -> None:
        settings, now = self._settings, time.monotonic
        self._controls = Controls(Dialogue(settings, self._open_port, now), settings.client, now)
        self._answers = AnswerParser(settings, self._angles, self._limits, self._controls)

    def _status(self) -> MoverStatus:
        controls, read = self._controls, self._answers
        reason = controls.reason
        if controls.state is MoverState.CONNECTING and not controls.line.link.connected:
            reason = controls.line.link.fault
        text = f"{self._settings.port}: {reason}" if reason else ""
        back = controls.giving_back
        given_back = controls.state in FINAL_STATES and not (back and back.notes)
        return MoverStatus(controls.state, text, read.q, read.t, read.speed, given_back)
