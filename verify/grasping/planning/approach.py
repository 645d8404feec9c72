"""Make the straight line to an object: hand poses of a direction, and joint angles along it."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

import robots
from robots import DhArm
from robots.trajectory import JointPath
from robots.transforms import difference, rotation_exp
from verify.core.records import Array, rigid_transform

MIN_NODES, MAX_NODES = 9, 129  # of the spline through exact postures; doubled until it is true
TOL_POSITION = 2e-5  # m: by so much the spline may leave the line midway between its nodes
TOL_ROTATION = 2e-4  # rad, likewise: 0.01°


def hand_poses(direction: Array, point: Array, turns: Array) -> Array:
    """Place the grip frame, base_T_grip (k, 4, 4): z along the direction, turned about it.

    Direction (3,), a unit vector, and point (3,), m, are in the base frame. The turns (k,), rad,
    are about the direction; 0 has x nearest to the base's x (or y) axis.
    """
    base = np.eye(3)[0 if abs(direction[0]) < 0.9 else 1]
    x = base - (base @ direction) * direction
    x /= np.linalg.norm(x)
    plain = np.column_stack([x, np.cross(direction, x), direction])
    return rigid_transform(plain @ rotation_exp(np.multiply.outer(turns, np.eye(3)[2])), point)


def nearest_turn(direction: Array, base_R_grip: Array) -> float:
    """Which turn of `hand_poses` comes nearest to a hand's rotation (3, 3), rad."""
    poses = hand_poses(direction, np.zeros(3), np.array([0.0]))[0, :3, :3]
    x = poses.T @ base_R_grip[:, 0]
    return float(np.arctan2(x[1], x[0]))


@dataclass(frozen=True, slots=True)
class ApproachLine:
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


def line_path(arm: DhArm, line: ApproachLine, branch: int, q_start: Array) -> JointPath | str:
    """Find the joint angles that carry the flange along a straight line, in one branch.

    A quintic spline through exact postures; their number is doubled until the flange, midway
    between them, is within 0.02 mm and 0.01° of the line. The branch of `robots.inverse` is the
    same all along; q_start (n,), rad, at the line's start, says which turn of each joint. Returns
    the path, its way in m; or why there is none, in words.
    """
    nodes = MIN_NODES
    while nodes <= MAX_NODES:
        s = np.linspace(0.0, line.length, nodes)
        q = robots.inverse(arm, line.poses(s), hold=q_start).q[:, branch]
        missing = np.isnan(q).any(axis=1)
        if missing.any():
            return f"out of reach {_remaining_text(line, s[int(np.argmax(missing))])}"
        q = np.unwrap(np.concatenate([q_start[None], q]), axis=0)[1:]
        spline = make_interp_spline(s, q, k=5)
        middle = (s[:-1] + s[1:]) / 2
        off = np.abs(difference(robots.forward(arm, spline(middle)), line.poses(middle)))
        worst = int(np.argmax((off / ([TOL_POSITION] * 3 + [TOL_ROTATION] * 3)).max(axis=1)))
        if off[worst, :3].max() < TOL_POSITION and off[worst, 3:].max() < TOL_ROTATION:
            return JointPath(spline, line.length)
        nodes = 2 * nodes - 1
    coupling = robots.coupled(arm, spline(middle[worst]))
    because = f" ({coupling.factor} singular)" if coupling else ""
    return f"the joints cannot follow the line {_remaining_text(line, middle[worst])}{because}"


def _remaining_text(line: ApproachLine, s: float) -> str:
    return f"{1e3 * (line.length - s):.0f} mm before the end of the line"
