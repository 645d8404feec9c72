"""The straight line to an object: hand poses for a direction, and joint angles along the line."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

import robots
from robots import DhArm
from robots.transforms import difference, invert
from verify.grab.trajectory import Path
from verify.records import Array

FIRST_NODES, MOST_NODES = 9, 129  # of the spline through exact postures; doubled until it is true
OFF_LINE = 2e-5  # m: by so much the spline may leave the line midway between its nodes
OFF_TURN = 2e-4  # rad, likewise: 0.01°


def hand_poses(direction: Array, point: Array, turns: Array) -> Array:
    """Place the grip frame: z along the direction, turned about it.

    Args:
        direction: (3,), unit vector, base frame.
        point: (3,), m, base frame.
        turns: (k,), rad, about the direction; 0 has x nearest to the base's x (or y) axis.

    Returns:
        base_T_grip, (k, 4, 4).
    """
    base = np.eye(3)[0 if abs(direction[0]) < 0.9 else 1]
    x = base - (base @ direction) * direction
    x /= np.linalg.norm(x)
    y = np.cross(direction, x)
    poses = np.tile(np.eye(4), (len(turns), 1, 1))
    cosine, sine = np.cos(turns)[:, None], np.sin(turns)[:, None]
    poses[:, :3, 0] = cosine * x + sine * y
    poses[:, :3, 1] = cosine * y - sine * x
    poses[:, :3, 2] = direction
    poses[:, :3, 3] = point
    return poses


def turn_of(direction: Array, base_R_grip: Array) -> float:
    """Which turn of `hand_poses` comes nearest to a hand's rotation (3, 3), rad."""
    poses = hand_poses(direction, np.zeros(3), np.array([0.0]))[0, :3, :3]
    x = poses.T @ base_R_grip[:, 0]
    return float(np.arctan2(x[1], x[0]))


def flange_pose(base_T_grip: Array, flange_T_grip: Array) -> Array:
    """Where the flange is for a hand's pose, base_T_flange (..., 4, 4)."""
    found: Array = base_T_grip @ invert(flange_T_grip)
    return found


@dataclass(frozen=True, slots=True)
class Line:
    """A straight motion of the flange, its orientation kept."""

    start: Array  # base_T_flange, (4, 4)
    shift: Array  # (3,), m, base frame, from start to end

    @property
    def length(self) -> float:
        """In m."""
        return float(np.linalg.norm(self.shift))

    def poses(self, s: Array) -> Array:
        """base_T_flange, (m, 4, 4), s m along the line."""
        poses = np.tile(self.start, (len(s), 1, 1))
        poses[:, :3, 3] += s[:, None] * (self.shift / self.length)
        return poses


def along(arm: DhArm, line: Line, branch: int, q_start: Array) -> Path | str:
    """Find the joint angles that carry the flange along a straight line, in one branch.

    A quintic spline through exact postures; their number is doubled until the flange, midway
    between them, is within 0.02 mm and 0.01° of the line.

    Args:
        arm: with a closed form.
        line: where the flange goes.
        branch: which answer of `robots.inverse`, all along.
        q_start: (n,), rad, at the line's start: says which turn of each joint.

    Returns:
        The path, its way in m; or why there is none, in words.
    """
    nodes = FIRST_NODES
    while nodes <= MOST_NODES:
        s = np.linspace(0.0, line.length, nodes)
        q = robots.inverse(arm, line.poses(s), hold=q_start).q[:, branch]
        missing = np.isnan(q).any(axis=1)
        if missing.any():
            return f"out of reach {_left(line, s[int(np.argmax(missing))])}"
        q = np.unwrap(np.concatenate([q_start[None], q]), axis=0)[1:]
        spline = make_interp_spline(s, q, k=5)
        middle = (s[:-1] + s[1:]) / 2
        off = np.abs(difference(robots.forward(arm, spline(middle)), line.poses(middle)))
        worst = int(np.argmax((off / ([OFF_LINE] * 3 + [OFF_TURN] * 3)).max(axis=1)))
        if off[worst, :3].max() < OFF_LINE and off[worst, 3:].max() < OFF_TURN:
            return Path(spline, line.length)
        nodes = 2 * nodes - 1
    coupling = robots.coupled(arm, spline(middle[worst]))
    because = f" ({coupling.factor} singular)" if coupling else ""
    return f"the joints cannot follow the line {_left(line, middle[worst])}{because}"


def _left(line: Line, s: float) -> str:
    return f"{1e3 * (line.length - s):.0f} mm before the end of the line"
