"""What an emulated MELFA controller controls: an arm on its trajectory, servo, program, alarm."""

import numpy as np

from robots import DhArm, forward
from verify.devices.melfa_lines import ERRORS
from verify.emulators.melfa_moves import Moves
from verify.emulators.trajectory import Trajectory
from verify.records import Array

SERVO_TIME = 1.0  # s from SRVON to power
SERVO_LAG = 0.02  # s by which the arm follows its command
PULSES_PER_RADIAN = 2_000_000.0  # gears and encoders are not public
HAND_LEVER = 0.5  # m: makes a likely speed of the hand, of an arm without kinematics
DIFFERENCE = 0.01  # s
LEVEL = 2  # of the alarm: low
EMERGENCY_STOPS = range(40, 71)  # alarms that take the servo's power
BUSY = 5640
# emulated without effect on the arm: the answer is all that a client sees of them
ACCEPTED = frozenset({"SLOTINIT", "RSTPRG", "HNDON", "HNDOFF", "PRGLOAD", "HOT"})


class MelfaArm:
    """An arm whose program plays a trajectory; STOP holds it, RUN lets it go on.

    While the program does not run, EXEC moves it; RUN then leads it back to where the program was.

    Args:
        trajectory: how the arm moves while the program runs.
        joints: how many it has.
        limits: (joints, 2), rad, as PARMEJAR tells them.
        follows: whether JPOSF tells the "feedback" or the "command" (of the real one nobody says).
        arm: its kinematics, for straight lines; None: it refuses them.
        idle: no program runs and the servo is off, as at the start of a shift.
    """

    def __init__(
        self,
        trajectory: Trajectory,
        joints: int,
        limits: Array,
        follows: str = "feedback",
        arm: DhArm | None = None,
        idle: bool = False,
    ) -> None:
        self.alarm = 0
        self.right = False
        self._trajectory, self._joints, self._limits = trajectory, joints, limits
        self._lag = SERVO_LAG if follows == "feedback" else 0.0
        self._now = self._played = 0.0  # s
        self.running = not idle
        self._servo_at: float | None = None if idle else 0.0
        self._override = 100
        self._arm, self._moves = arm, Moves(limits, arm)
        self._off_program = False  # EXEC has moved it: it stands where the moves left it
        self._returning = False  # to where the program goes on

    @property
    def servo_on(self) -> bool:
        """Whether the servo has power."""
        return self._servo_at is not None and self._now >= self._servo_at

    def restart(self, t: float) -> None:
        """Lose right, servo and program, as after a loss of power; the arm stays where it is."""
        self.go_on(t)
        self.right, self.running, self._servo_at, self.alarm = False, False, None, 0
        self._moves.stop()

    def raise_alarm(self, number: int) -> None:
        """Have an alarm: a move stops, an emergency stop takes the servo's power, too."""
        self.alarm = number
        self._moves.stop()
        if number in EMERGENCY_STOPS:
            self._servo_at, self.running = None, False

    @property
    def moving(self) -> bool:
        """Whether the program runs, or a move by EXEC is under way."""
        return self.running or self._moves.moving

    def go_on(self, t: float) -> None:
        """Let time pass."""
        self._moves.go_on(t, self._override / 100)
        if self._returning and not self._moves.moving:
            self._returning, self._off_program = False, False
        elif self.running and not self._off_program:
            self._played += t - self._now
        self._now = t

    def joints(self, t: float, lag: float) -> Array:
        """Joint angles, (joints,), rad, told with a lag."""
        if self._off_program:
            return self._moves.at(t - lag)
        since = t - self._now if self.running else 0.0
        late = lag if self.running else 0.0
        return self._trajectory.at(max(self._played + since - late, 0.0))

    def told(self, name: str, argument: str, t: float, axes: int) -> str | None:
        """Data of a reading command; None if it is none."""
        match name:
            case "JPOSF" | "GJPOSF":
                return self._position(t, axes)
            case "PPOSF" | "GPPOSF":
                return f"X;400.00;Y;0.00;Z;500.00;A;180.00;B;0.00;C;180.00;;6,0;{self._tail(t)}"
            case "STATE":
                return f";0;{self._override};0;{self._run_status()};0;1;;;;;;;;;REP;START;1;1"
            case "DSTATE":
                return f"{self._run_status()};0;1"
            case "SRVENC":
                return self._pulses(t)
            case "SRVDRP":
                return ";".join(["0"] * 16)
            case "SRVSPD" | "EMISS":
                return ";".join(["0"] * 8)
            case "ETEMP":
                return ";".join(["35"] * 8 + ["41"] * 8)
            case "OVRD" if not argument:
                return str(self._override)
            case "ERROR":
                return f"{self.alarm};{LEVEL}" if self.alarm else ""
            case "ERRORMES":
                number = int(argument) if argument.isdigit() else 0
                return ERRORS.get(number, "no message").upper()
            case "PAR" if argument == "MEJAR":
                degrees = np.rad2deg(np.resize(self._limits, (8, 2))).ravel()
                return f"MEJAR;{','.join(f'{value:.2f}' for value in degrees)};16"
            case "STPSIG":
                return "00"
        return None

    def obey(self, name: str, argument: str, t: float) -> str | int:
        """Do what an order says: the answer's data, or the number of the error."""
        match name:
            case "CNTLON" | "CNTLOFF":
                self.right = name == "CNTLON"
            case "SRVON":
                self._servo_at = t + SERVO_TIME
            case "SRVOFF":
                self._servo_at = None
                self._halt()
            case "RUN":
                self._run(t)
            case "STOP" | "CSTOP":
                self._halt()
            case "EXEC":
                return self._execute(argument, t)
            case "OVRD":
                return self._set_override(argument)
            case "RSTALRM":
                self.alarm = 0
            case _ if name not in ACCEPTED:
                return 5990  # EXEC2=, MOVSP, JOG are not emulated
        return ""

    def _halt(self) -> None:
        self.running = self._returning = False
        self._moves.stop()

    def _run(self, t: float) -> None:
        self.running = True
        if self._off_program:
            self._returning = True
            self._moves.go_to(self._trajectory.at(self._played), self._moves.at(t), t)

    def _execute(self, instruction: str, t: float) -> str | int:
        if self.moving:
            return BUSY
        here = self.joints(t, 0.0)
        error = self._moves.carry_out(instruction, here, t)
        if self._moves.moving:
            self._off_program = True
        return error or ""

    def _set_override(self, argument: str) -> str | int:
        value = argument.removeprefix("=")
        if not self.right:
            return 6020
        if not value.isdigit() or not 1 <= int(value) <= 100:
            return 3110
        self._override = int(value)
        return ""

    def _position(self, t: float, axes: int) -> str:
        shown = np.zeros(axes)
        shown[: self._joints] = np.rad2deg(self.joints(t, self._lag))
        words = [f"J{axis};{angle:.2f}" for axis, angle in enumerate(shown, start=1)]
        return f"{';'.join(words)};;****,****;{self._tail(t)}"

    def _tail(self, t: float) -> str:
        """Override, the hand's speed, and which axes are at a limit."""
        now, before = self.joints(t, 0.0), self.joints(t, DIFFERENCE)
        if self._arm is not None and not np.array_equal(now, before):
            way = forward(self._arm, now)[:3, 3] - forward(self._arm, before)[:3, 3]
        else:
            way = (now - before) * HAND_LEVER
        speed = float(np.linalg.norm(way)) / DIFFERENCE * 1e3
        here = self.joints(t, self._lag)
        lower, upper = self._limits.T
        bits = [sum(1 << i for i in np.flatnonzero(at)) for at in (here >= upper, here <= lower)]
        return f"{self._override};{speed:.2f};{bits[0]:02X}{bits[1]:02X}0000"

    def _run_status(self) -> str:
        run = 0x01 | (0x20 if self.servo_on else 0) | (0x40 if self.moving else 0)
        stop = (0x00 if self.moving else 0x12) | (self.alarm in EMERGENCY_STOPS)
        return f"{run:02X}{stop:02X}{self.alarm}"

    def _pulses(self, t: float) -> str:
        words = []
        for axis in range(8):
            if axis < self._joints:
                feedback, command = (
                    round(float(self.joints(t, lag)[axis]) * PULSES_PER_RADIAN)
                    for lag in (SERVO_LAG, 0.0)
                )
            else:
                feedback = command = 0
            words += [str(feedback), str(feedback % 131072), "0", str(command)]
        return ";".join(words)
