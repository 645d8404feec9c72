"""Above a moving target: the joint angles that keep the hand there, target by target."""

from dataclasses import dataclass

import numpy as np

import robots
from robots.limits import near_within
from verify.grab.approach import flange_pose, hand_poses
from verify.grab.branches import SINGULAR, Posture, postures, smallest_singular_value
from verify.grab.limits import at_rest, violation
from verify.grab.plan import Planner
from verify.grab.plan_margin import Refusal, grip_point
from verify.records import Array


@dataclass(frozen=True, slots=True)
class Goal:
    """Where the joints should be now, and how the goal moves."""

    q: Array  # (n,), rad
    velocity: Array  # (n,), rad/s


class Hover:
    """Keeps one branch and one turn of the hand as long as they serve, then looks for others.

    Args:
        setup: arm and cell.
    """

    def __init__(self, setup: Planner) -> None:
        self._setup = setup
        self._posture: Posture | None = None

    def goal(self, point: Array, velocity: Array, q_now: Array) -> Goal | Refusal:
        """Say where the joints should be for the hand to stand above a point.

        Args:
            point: (3,), m, base frame, the target's middle.
            velocity: (3,), m/s, of the target.
            q_now: (n,), rad, ordered last.
        """
        if not (np.isfinite(point).all() and np.isfinite(velocity).all()):
            return Refusal("unknown", "the target's place is not known")
        grip, _ = grip_point(point, self._setup.cell)  # above where the line down will begin
        q = None if self._posture is None else self._same(self._posture, grip, q_now)
        if q is None:
            good, reasons = postures(self._setup.workspace, self._setup.limits, grip, q_now)
            if not good:
                self._posture = None
                said = next(iter(reasons.values()))
                return Refusal("reach", f"no posture stands above the target: {said}")
            self._posture, q = good[0], good[0].q_above
        twist = np.concatenate([velocity, np.zeros(3)])
        return Goal(q, np.linalg.solve(robots.jacobian(self._setup.arm, q), twist))

    def _same(self, posture: Posture, grip: Array, q_now: Array) -> Array | None:
        """The same branch and turn above another grip point; None where they do not serve."""
        setup, approach = self._setup, self._setup.cell.approach
        above = grip - approach.height * approach.direction
        pose = hand_poses(approach.direction, above, np.array([posture.turn]))
        flange = flange_pose(pose, setup.cell.gripper.flange_T_grip)[0]
        answers = robots.inverse(setup.arm, flange, hold=q_now).q
        q = near_within(setup.arm, answers[posture.branch], q_now)
        if not np.isfinite(q).all() or violation(setup.limits, at_rest(q)):
            return None
        if smallest_singular_value(setup.arm, q) < SINGULAR or setup.workspace.clear(q[None]):
            return None
        return q
