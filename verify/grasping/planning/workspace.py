"""Check where arm and hand may be: above the table, away from cameras, the grip point in its box.

Model: the arm is a chain of capsules between its joints, palm and fingers are a cylinder. A margin
is how much nearer something could come than it may; below zero it is too near. Between two postures
no point moves farther than travel = sum_j |dq_j| reach_j, so with margins m1 and m2 at the ends

    least margin between them >= (m1 + m2 - travel) / 2

A path is checked along its whole length by halving it until this bound is above -RESOLUTION.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import msgspec
import numpy as np

import robots
from robots import Arm, DhArm, RobotError
from robots.trajectory import JointLimits, JointPath, joint_limits, limit_violation, rest_motion
from robots.transforms import carry, invert
from verify.core.records import Array
from verify.core.rig import Camera, Rig
from verify.errors import InputError
from verify.grasping.cell import Cell
from verify.io.files import restated

RESOLUTION = 5e-4  # m: a way is certified to keep every clearance but for that much
N_FIRST_POSTURES = 9  # postures at which a path is checked first
MAX_HALVINGS = 14  # of a part of the path; a part of 2**-14 that is not certified is refused
LINKS = ("upper arm", "elbow", "forearm", "wrist")
BOX_NAME = "grip point in the workspace box"


@dataclass(frozen=True)
class Workspace:
    """An arm and its hand in their cell, and what they must keep away from; robot's base frame."""

    arm: DhArm
    cell: Cell
    cameras: Array  # (k, 3), m, optical centres
    limits: JointLimits  # of the joints, as the cell lets them move

    @cached_property
    def names(self) -> tuple[str, ...]:
        """What each margin is of, in words."""
        above = (*LINKS, "palm", "finger tips")
        beside = [
            f"{part} to camera {camera + 1}"
            for camera in range(len(self.cameras))
            for part in (*LINKS, "hand")
        ]
        return (*(f"{part} over the table" for part in above), *beside, BOX_NAME)

    def grip(self, q: Array) -> Array:
        """Where the grip point is, base_T_grip (..., 4, 4)."""
        return robots.forward(self.arm, q) @ self.cell.gripper.flange_T_grip

    def margins(self, q: Array) -> Array:
        """How much nearer each part could come to what it keeps away from, (m, names), m.

        By joint angles q (m, n), rad; below 0 it is too near, or outside.
        """
        table, hand = self.cell.table, self.cell.gripper
        radius, away = self.cell.moving.link_radius, self.cell.moving.camera_clearance
        frames = robots.link_frames(self.arm, q)
        # from the shoulder to the wrist (m, 3) each, and the flange
        *joints, flange = (frames[:, i, :3, 3] for i in (1, 2, 3, 4, -1))
        grip = frames[:, -1] @ hand.flange_T_grip
        axis = grip[:, :3, 2]
        tips = grip[:, :3, 3] + hand.tips * axis
        palm = grip[:, :3, 3] - (hand.finger_length - hand.tips) * axis
        links = [*pairwise(joints), (joints[-1], flange)]
        floor = table.height + table.clearance
        rim = hand.radius * np.hypot(axis[:, 0], axis[:, 1])  # a tilted disc's lower edge
        columns = [np.minimum(a[:, 2], b[:, 2]) - radius - floor for a, b in links]
        columns.append(np.minimum(flange[:, 2], palm[:, 2]) - rim - floor)
        columns.append(tips[:, 2] - rim - table.height - table.finger_clearance)
        for camera in self.cameras:
            columns += [_distance(camera, a, b) - radius - away for a, b in links]
            columns.append(_distance(camera, flange, tips) - hand.radius - away)
        point = grip[:, :3, 3]
        inside = np.minimum(point - self.cell.lower, self.cell.upper - point)
        columns.append(inside.min(axis=1))
        return np.stack(columns, axis=1)

    def trouble(self, margins: Array) -> str:
        """Say what is worst of margins (names,), in words; empty where none is below 0."""
        worst = int(np.argmin(margins))
        if margins[worst] >= -RESOLUTION:
            return ""
        what, by = self.names[worst], -1e3 * margins[worst]
        if what == BOX_NAME:
            return f"the grip point would be {by:.0f} mm outside the workspace box"
        part, _, from_what = what.replace(" over ", " to ").partition(" to ")
        return f"the {part} would come {by:.0f} mm too near to {from_what}"

    def limit_violation(self, q: Array) -> str:
        """Say which limits joint angles (n,), rad, at rest are beyond; empty if none."""
        return limit_violation(self.limits, rest_motion(q))

    def clear(self, q: Array) -> str:
        """Say what stands in the way through postures (m, n) one after the other; "" if nothing.

        In between the joints go straight from one to the next.
        """
        margins = self.margins(q)
        if len(q) > 1:
            travel = np.abs(np.diff(q, axis=0)) @ self.reach
            between = (margins[:-1] + margins[1:] - travel[:, None]) / 2
            margins = np.concatenate([margins, between])
        return self.trouble(margins[np.argmin(margins.min(axis=1))])

    def along(self, path: JointPath) -> str:
        """Say what stands in the way anywhere along a path, and where; empty if nothing."""
        fastest = float(path.bounds()[0] @ self.reach)  # m of any point, a unit of the way
        s = np.linspace(0.0, path.length, N_FIRST_POSTURES)
        margins = self.margins(path.q(s))
        for _ in range(MAX_HALVINGS + 1):
            low = margins.min(axis=1)
            if low.min() < -RESOLUTION:
                at = int(np.argmin(low))
                share = s[at] / path.length
                return f"{self.trouble(margins[at])}, after {share:.0%} of the way"
            between = (low[:-1] + low[1:] - fastest * np.diff(s)) / 2
            doubtful = between < -RESOLUTION
            if not doubtful.any():
                return ""
            middle = (s[:-1] + s[1:])[doubtful] / 2
            s = np.concatenate([s, middle])
            margins = np.concatenate([margins, self.margins(path.q(middle))])
            order = np.argsort(s)
            s, margins = s[order], margins[order]
        return "the path is too close to be certified clear"

    @cached_property
    def reach(self) -> Array:
        """The farthest that any point of arm and hand can be from each joint's axis, (n,), m."""
        hand = self.cell.gripper
        grip = float(np.linalg.norm(hand.flange_T_grip[:3, 3]))
        tool = grip + hand.finger_length + hand.radius
        lengths = np.hypot(self.arm.a, self.arm.d)
        beyond = np.cumsum(lengths[::-1])[::-1] - lengths
        # a joint's own d lies on its axis
        return np.asarray(np.abs(self.arm.a) + beyond + max(tool, self.cell.moving.link_radius))


def make_workspace(arm: Arm, cell: Cell, cameras: Array) -> Workspace:
    """Put an arm into its cell; InputError: it has no closed form, or its file states no rates."""
    if not isinstance(arm, DhArm):
        expected = "an arm with a closed form is needed to grasp"
        raise InputError(f'robot "{arm.name}"', "is a URDF", expected, "Write its DH table.")
    with restated(RobotError):
        limits = joint_limits(arm, cell.moving.share)
    return Workspace(arm, cell, cameras, limits)


def workspace_with_cameras(arm: Arm, cell: Cell, rig: Rig, *, turning: bool) -> Workspace:
    """Put an arm into its cell, with the rig's cameras to keep away from.

    The optical centre of a turning camera goes round its base's axis: the arm keeps away from the
    whole circle, as it does from a point, by a clearance that is the circle's radius greater.

    Raises:
        InputError: see `make_workspace`.
    """
    circles = [
        _camera_circle(camera) if turning else (camera.rig_T_camera(camera.pan)[:3, 3], 0.0)
        for camera in (rig.left, rig.right)
    ]
    wider = cell.moving.camera_clearance + max(radius for _, radius in circles)
    moving = msgspec.structs.replace(cell.moving, camera_clearance=wider)
    kept = replace(cell, moving=moving)
    middles = np.array([middle for middle, _ in circles])
    return make_workspace(arm, kept, carry(invert(rig.rig_T_base), middles))


def _camera_circle(camera: Camera) -> tuple[Array, float]:
    """Where a turning camera's optical centre goes: the circle's middle, rig, m, and its radius."""
    from_axis, axis = camera.mount[:3, 3], camera.pan_axis
    along = float(axis @ from_axis)
    return camera.pan_center + along * axis, float(np.linalg.norm(from_axis - along * axis))


def _distance(point: Array, a: Array, b: Array) -> Array:
    """Distance (m,) of a point (3,) from segments a to b, (m, 3) each."""
    along = b - a
    squared = np.maximum((along * along).sum(axis=1), 1e-18)  # a segment may be a point
    share = np.clip(((point - a) * along).sum(axis=1) / squared, 0.0, 1.0)
    return np.asarray(np.linalg.norm(point - a - share[:, None] * along, axis=1))
