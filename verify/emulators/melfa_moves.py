"""How an emulated MELFA arm moves by EXEC: variables, joint and straight moves, a stop.

The subset of MELFA-BASIC that a client needs for moving: a joint variable is set, turned into a
pose (JTOP), and gone to by joint interpolation (MOV) or in a straight line (MVS).
"""

import re
from collections import deque
from dataclasses import dataclass

import numpy as np

from robots import DhArm, forward, nearest
from robots.transforms import rotation_exp, rotation_log
from verify.records import Array

# rad/s, the arm's quickest joint speeds (RV-3SD); a joint beyond the sixth turns as the sixth
FASTEST = np.deg2rad([250.0, 187.0, 250.0, 412.0, 412.0, 660.0])
FASTEST_LINE = 1.0  # m/s of the flange, at full override
SPEEDING_UP = 0.2  # s from rest to full speed
TICK = 0.002  # s
KEPT = 0.2  # s of past, for encoders that lag
SPACING = 0.005  # m or rad of a straight line between two points that are solved
LARGEST_LEAP = 0.2  # rad between such points: more is another branch, or a singularity
SYNTAX, UNKNOWN_VARIABLE, LIMIT, TARGET_OUT_OF_REACH, VIA_OUT_OF_REACH = (
    4220,
    4340,
    2140,
    2602,
    2603,
)
_SET = re.compile(r"(J\w{1,7})\s*=\s*\(([-+0-9., ]+)\)")
_POSE = re.compile(r"(P\w{1,7})\s*=\s*JTOP\((J\w{1,7})\)", re.IGNORECASE)
_MOVE = re.compile(r"(MOV|MVS)\s+([JP]\w{1,7})")


@dataclass(frozen=True, slots=True)
class Path:
    """Where a move leads: joint angles over the share of the way that is gone."""

    share: Array  # (n,), 0 to 1
    q: Array  # (n, joints), rad
    rate: float  # shares a second, at full override

    def at(self, share: float) -> Array:
        """Joint angles, (joints,), rad."""
        return np.array([np.interp(share, self.share, column) for column in self.q.T])


class Moves:
    """The arm as EXEC moves it.

    Args:
        limits: (joints, 2), rad.
        arm: its kinematics; None: it knows no straight line.
    """

    def __init__(self, limits: Array, arm: DhArm | None) -> None:
        self._limits, self._arm = limits, arm
        self._joint_variables: dict[str, Array] = {}
        self._pose_variables: dict[str, Array] = {}  # as the joint angles that they were made of
        self._path: Path | None = None
        self._gone = self._speed = 0.0  # share, shares a second
        self._braking = False
        self._past: deque[tuple[float, Array]] = deque()

    @property
    def moving(self) -> bool:
        """Whether a move is under way."""
        return self._path is not None

    def at(self, t: float) -> Array:
        """Joint angles at t, (joints,), rad, no longer ago than KEPT."""
        times = [then for then, _ in self._past]
        q = np.array([there for _, there in self._past])
        return np.array([np.interp(t, times, column) for column in q.T])

    def place(self, q: Array, t: float) -> None:
        """Stand still at q from t on."""
        self._path = None
        self._past = deque([(t, q)])

    def carry_out(self, text: str, q: Array, t: float) -> int:
        """Do one instruction from where the arm stands; give the number of the error, or 0."""
        if match := _SET.fullmatch(text):
            return self._set(match[1], match[2])
        if match := _POSE.fullmatch(text):
            found = self._joint_variables.get(match[2])
            if found is None:
                return UNKNOWN_VARIABLE
            self._pose_variables[match[1]] = found
            return 0
        if match := _MOVE.fullmatch(text):
            return self._go(match[1], match[2], q, t)
        return SYNTAX

    def go_to(self, target: Array, q: Array, t: float) -> None:
        """Begin a joint-interpolated move from q."""
        self._begin(joint_path(q, target), q, t)

    def stop(self) -> None:
        """Brake."""
        self._braking = True

    def go_on(self, t: float, override: float) -> None:
        """Let time pass.

        Args:
            t: s, now.
            override: share of full speed.
        """
        if self._path is None:
            return
        now = self._past[-1][0]
        while t - now > 1e-9:
            step = min(TICK, t - now)
            now += step
            self._past.append((now, self._one_tick(step, override)))
        while len(self._past) > 2 and self._past[1][0] < t - KEPT:
            self._past.popleft()

    def _one_tick(self, step: float, override: float) -> Array:
        path = self._path
        if path is None:
            return self._past[-1][1]
        full = path.rate * override
        gain = full / SPEEDING_UP * step
        left = np.sqrt(2.0 * full / SPEEDING_UP * max(1.0 - self._gone, 0.0))
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
            return SYNTAX
        if len(degrees) < len(self._limits):
            return SYNTAX
        self._joint_variables[name] = np.deg2rad(degrees[: len(self._limits)])
        return 0

    def _go(self, how: str, name: str, q: Array, t: float) -> int:
        if how == "MVS" and name.startswith("J"):
            return SYNTAX  # a straight line leads to a pose
        known = self._joint_variables if name.startswith("J") else self._pose_variables
        target = known.get(name)
        if target is None:
            return UNKNOWN_VARIABLE
        if np.any(target < self._limits[:, 0]) or np.any(target > self._limits[:, 1]):
            return LIMIT if name.startswith("J") else TARGET_OUT_OF_REACH
        path = joint_path(q, target) if how == "MOV" else self._line(q, target)
        if path is None:
            return VIA_OUT_OF_REACH
        self._begin(path, q, t)
        return 0

    def _begin(self, path: Path, q: Array, t: float) -> None:
        self._path, self._gone, self._speed, self._braking = path, 0.0, 0.0, False
        self._past = deque([(t, q)])

    def _line(self, q: Array, target: Array) -> Path | None:
        """Solve a straight line of the flange, turning steadily, point by point."""
        if self._arm is None:
            return None
        begin, end = forward(self._arm, q), forward(self._arm, target)
        way = end[:3, 3] - begin[:3, 3]
        turn = rotation_log(begin[:3, :3].T @ end[:3, :3])
        length = max(float(np.linalg.norm(way)), float(np.linalg.norm(turn)))
        shares = np.linspace(0.0, 1.0, max(2, int(np.ceil(length / SPACING)) + 1))
        points = [q]
        for share in shares[1:].tolist():
            pose = begin.copy()
            pose[:3, 3] += share * way
            pose[:3, :3] = begin[:3, :3] @ rotation_exp(share * turn)
            found, reached = nearest(self._arm, pose, points[-1], limits=True)
            if not reached or np.max(np.abs(found - points[-1])) > LARGEST_LEAP:
                return None
            points.append(found)
        return Path(shares, np.array(points), FASTEST_LINE / max(length, 1e-6))


def joint_path(q: Array, target: Array) -> Path:
    """All joints begin and end together; the one with the longest way goes as fast as it can."""
    fastest = np.concatenate([FASTEST, np.full(2, FASTEST[-1])])[: len(q)]
    slowest = float(np.max(np.abs(target - q) / fastest))
    return Path(np.array([0.0, 1.0]), np.array([q, target]), 1.0 / max(slowest, 1e-3))
