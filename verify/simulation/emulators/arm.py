"""An emulated MELFA controller's arm: trajectory, servo, program, alarm, and moves by EXEC.

EXEC takes the subset of MELFA-BASIC that a client needs for moving: a joint variable is set, turned
into a pose (JTOP), and gone to by joint interpolation (MOV) or in a straight line (MVS).
"""

import re
from collections import deque
from dataclasses import dataclass

import numpy as np

from robots import DhArm, forward, nearest
from robots.transforms import rotation_exp, rotation_log
from verify.core.records import Array
from verify.devices.melfa.protocol import ERROR_MEANINGS
from verify.simulation.emulators.trajectory import EmulatedTrajectory

# rad/s, the arm's quickest joint speeds (RV-3SD); a joint beyond the sixth turns as the sixth
MAX_JOINT_SPEED = np.deg2rad([250.0, 187.0, 250.0, 412.0, 412.0, 660.0])
MAX_LINE_SPEED = 1.0  # m/s of the flange, at full override
ACCELERATION_TIME = 0.2  # s from rest to full speed
TIME_STEP = 0.002  # s
HISTORY_TIME = 0.2  # s of past, for encoders that lag
PATH_SPACING = 0.005  # m or rad of a straight line between two points that are solved
MAX_JOINT_STEP = 0.2  # rad between such points: more is another branch, or a singularity
ERROR_SYNTAX, ERROR_UNKNOWN_VARIABLE, ERROR_LIMIT = 4220, 4340, 2140
ERROR_TARGET_OUT_OF_REACH, ERROR_VIA_OUT_OF_REACH = 2602, 2603
_SET = re.compile(r"(J\w{1,7})\s*=\s*\(([-+0-9., ]+)\)")
_POSE = re.compile(r"(P\w{1,7})\s*=\s*JTOP\((J\w{1,7})\)", re.IGNORECASE)
_MOVE = re.compile(r"(MOV|MVS)\s+([JP]\w{1,7})")


@dataclass(frozen=True, slots=True)
class MovePath:
    """Where a move leads: joint angles over the share of the way that is gone."""

    share: Array  # (n,), 0 to 1
    q: Array  # (n, joints), rad
    rate: float  # shares a second, at full override

    def at(self, share: float) -> Array:
        """Joint angles, (joints,), rad."""
        return np.array([np.interp(share, self.share, column) for column in self.q.T])


class MoveExecution:
    """The arm as EXEC moves it within limits (joints, 2), rad; straight, if `arm` is there."""

    def __init__(self, limits: Array, arm: DhArm | None) -> None:
        self._limits, self._arm = limits, arm
        self._joint_variables: dict[str, Array] = {}
        self._pose_variables: dict[str, Array] = {}  # as the joint angles that they were made of
        self._path: MovePath | None = None
        self._gone = self._speed = 0.0  # share, shares a second
        self._braking = False
        self._past: deque[tuple[float, Array]] = deque()

    @property
    def moving(self) -> bool:
        """Whether a move is under way."""
        return self._path is not None

    def at(self, t: float) -> Array:
        """Joint angles at t, (joints,), rad, no longer ago than HISTORY_TIME."""
        times = [then for then, _ in self._past]
        q = np.array([there for _, there in self._past])
        return np.array([np.interp(t, times, column) for column in q.T])

    def carry_out(self, text: str, q: Array, t: float) -> int:
        """Do one instruction from where the arm stands; give the number of the error, or 0."""
        if match := _SET.fullmatch(text):
            return self._set(match[1], match[2])
        if match := _POSE.fullmatch(text):
            found = self._joint_variables.get(match[2])
            if found is None:
                return ERROR_UNKNOWN_VARIABLE
            self._pose_variables[match[1]] = found
            return 0
        if match := _MOVE.fullmatch(text):
            return self._go(match[1], match[2], q, t)
        return ERROR_SYNTAX

    def stop(self) -> None:
        """Brake."""
        self._braking = True

    def go_on(self, t: float, override: float) -> None:
        """Let time pass to t, s, at an override, share of full speed."""
        if self._path is None:
            return
        now = self._past[-1][0]
        while t - now > 1e-9:
            step = min(TIME_STEP, t - now)
            now += step
            self._past.append((now, self._one_tick(step, override)))
        while len(self._past) > 2 and self._past[1][0] < t - HISTORY_TIME:
            self._past.popleft()

    def _one_tick(self, step: float, override: float) -> Array:
        path = self._path
        if path is None:
            return self._past[-1][1]
        full = path.rate * override
        gain = full / ACCELERATION_TIME * step
        left = np.sqrt(2.0 * full / ACCELERATION_TIME * max(1.0 - self._gone, 0.0))
        wanted = 0.0 if self._braking else min(self._speed + gain, full, left)
        self._speed = max(wanted, self._speed - gain) if self._braking else wanted
        self._gone = min(self._gone + self._speed * step, 1.0)
        arrived = 1.0 - self._gone < 1e-6
        if arrived or (self._braking and self._speed <= 0.0):
            self._path = None
        return path.at(1.0 if arrived else self._gone)

    def _set(self, name: str, values: str) -> int:
        try:
            degrees = [float(word) for word in values.split(",")]
        except ValueError:
            return ERROR_SYNTAX
        if len(degrees) < len(self._limits):
            return ERROR_SYNTAX
        self._joint_variables[name] = np.deg2rad(degrees[: len(self._limits)])
        return 0

    def _go(self, how: str, name: str, q: Array, t: float) -> int:
        if how == "MVS" and name.startswith("J"):
            return ERROR_SYNTAX  # a straight line leads to a pose
        variables = self._joint_variables if name.startswith("J") else self._pose_variables
        target = variables.get(name)
        if target is None:
            return ERROR_UNKNOWN_VARIABLE
        if np.any(target < self._limits[:, 0]) or np.any(target > self._limits[:, 1]):
            return ERROR_LIMIT if name.startswith("J") else ERROR_TARGET_OUT_OF_REACH
        path = joint_path(q, target) if how == "MOV" else self._line(q, target)
        if path is None:
            return ERROR_VIA_OUT_OF_REACH
        self.begin(path, q, t)
        return 0

    def begin(self, path: MovePath, q: Array, t: float) -> None:
        """Begin a move from q, (joints,), rad."""
        self._path, self._gone, self._speed, self._braking = path, 0.0, 0.0, False
        self._past = deque([(t, q)])

    def _line(self, q: Array, target: Array) -> MovePath | None:
        """Solve a straight line of the flange, turning steadily, point by point."""
        if self._arm is None:
            return None
        begin, end = forward(self._arm, q), forward(self._arm, target)
        way = end[:3, 3] - begin[:3, 3]
        turn = rotation_log(begin[:3, :3].T @ end[:3, :3])
        length = max(float(np.linalg.norm(way)), float(np.linalg.norm(turn)))
        shares = np.linspace(0.0, 1.0, max(2, int(np.ceil(length / PATH_SPACING)) + 1))
        points = [q]
        for share in shares[1:].tolist():
            pose = begin.copy()
            pose[:3, 3] += share * way
            pose[:3, :3] = begin[:3, :3] @ rotation_exp(share * turn)
            found, reached = nearest(self._arm, pose, points[-1], limits=True)
            if not reached or np.max(np.abs(found - points[-1])) > MAX_JOINT_STEP:
                return None
            points.append(found)
        return MovePath(shares, np.array(points), MAX_LINE_SPEED / max(length, 1e-6))


def joint_path(q: Array, target: Array) -> MovePath:
    """All joints begin and end together; the one with the longest way goes as fast as it can."""
    fastest = np.concatenate([MAX_JOINT_SPEED, np.full(2, MAX_JOINT_SPEED[-1])])[: len(q)]
    slowest = float(np.max(np.abs(target - q) / fastest))
    return MovePath(np.array([0.0, 1.0]), np.array([q, target]), 1.0 / max(slowest, 1e-3))


SERVO_TIME = 1.0  # s from SRVON to power
SERVO_LAG = 0.02  # s by which the arm follows its command
HAND_LEVER = 0.5  # m: makes a likely speed of the hand, of an arm without kinematics
DIFFERENCE = 0.01  # s
LEVEL = 2  # of the alarm: low
EMERGENCY_STOPS = range(40, 71)  # alarms that take the servo's power
BUSY = 5640


class MelfaArm:
    """An arm whose program plays a trajectory; STOP holds it, RUN lets it go on.

    While the program does not run, EXEC moves it; RUN then leads it back to where the program was.
    The limits (joints, 2), rad, are those that PARMEJAR tells. JPOSF `follows` the "feedback" or
    the "command" (of the real one nobody says). Without an `arm` it refuses straight lines. `idle`:
    no program runs and the servo is off, as at the start of a shift.
    """

    def __init__(
        self,
        trajectory: EmulatedTrajectory,
        limits: Array,
        follows: str = "feedback",
        arm: DhArm | None = None,
        idle: bool = False,
    ) -> None:
        self.alarm = 0
        self.right = False
        self._trajectory, self._limits = trajectory, limits
        self._lag = SERVO_LAG if follows == "feedback" else 0.0
        self._now = self._played = 0.0  # s
        self.running = not idle
        self._servo_at: float | None = None if idle else 0.0
        self._override = 100
        self._arm, self._moves = arm, MoveExecution(limits, arm)
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
        return self._trajectory(max(self._played + since - late, 0.0))

    def obey(self, name: str, argument: str, t: float, axes: int = 6) -> str | int:
        """Do what a command says: its answer's data (JPOSF tells so many axes), or the error."""
        match name:
            case "JPOSF":
                return self._position(t, axes)
            case "STATE":
                return f";0;{self._override};0;{self._run_status()};0;1;;;;;;;;;REP;START;1;1"
            case "OVRD" if not argument:
                return str(self._override)
            case "ERROR":
                return f"{self.alarm};{LEVEL}" if self.alarm else ""
            case "ERRORMES":
                number = int(argument) if argument.isdigit() else 0
                return ERROR_MEANINGS.get(number, "no message").upper()
            case "PAR" if argument == "MEJAR":
                degrees = np.rad2deg(np.resize(self._limits, (8, 2))).ravel()
                return f"MEJAR;{','.join(f'{value:.2f}' for value in degrees)};16"
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
            case _:
                return 5990  # what no driver asks for is not emulated
        return ""

    def _halt(self) -> None:
        self.running = self._returning = False
        self._moves.stop()

    def _run(self, t: float) -> None:
        self.running = True
        if self._off_program:
            self._returning = True
            q = self._moves.at(t)
            self._moves.begin(joint_path(q, self._trajectory(self._played)), q, t)

    def _execute(self, instruction: str, t: float) -> str | int:
        if self.moving:
            return BUSY
        error = self._moves.carry_out(instruction, self.joints(t, 0.0), t)
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
        shown[: len(self._limits)] = np.rad2deg(self.joints(t, self._lag))
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
