"""Plan a grasp from a target's place: posture, paths and timing, or why there is none.

`HoverPlanner` finds the joint angles that keep the hand above a moving target.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

import robots
from robots import trajectory
from robots.inverse import near_within
from robots.transforms import invert
from verify.core.records import Array
from verify.grasping.planning import postures
from verify.grasping.planning.approach import ApproachLine, hand_poses, line_path
from verify.grasping.planning.object import (
    GraspObject,
    GraspRefusal,
    GripMargin,
    grip_margin,
    grip_point,
)
from verify.grasping.planning.workspace import Workspace

MAX_SLOWDOWN = 4.0  # times slower than the cell asks; more is needed beside a singularity only
TOL_SAME_POSTURE = 0.15  # rad: no other branch and no other turn of the hand is so near
MAX_POSTURES = 40  # postures whose paths are checked, best first: all branches, some turns of each


@dataclass(frozen=True)
class GraspPlan:
    """A grasp: over to the object, down to it, and back up."""

    posture: postures.Posture
    margin: GripMargin
    # to above the object; several where the way leads through home
    over: tuple[trajectory.Trajectory, ...]
    down: trajectory.Trajectory
    up: trajectory.Trajectory
    slowed: float  # how many times slower than the cell asks, for the joints' limits
    rejected: dict[str, str]  # each branch that is not taken, and why


def plan_grasp(setup: Workspace, thing: GraspObject, q_now: Array) -> GraspPlan | GraspRefusal:
    """Plan a grasp by an arm that rests at q_now, (n,), rad."""
    margin = grip_margin(thing, setup.cell)
    if isinstance(margin, GraspRefusal):
        return margin
    if problem := setup.limit_violation(q_now) or setup.clear(q_now[None]):
        return GraspRefusal("way", f"the arm cannot begin where it stands: {problem}")
    good, reasons = postures.find_postures(setup, margin.grip, q_now)
    if thing.hand is not None and thing.hand.used:  # a correction holds where it was measured
        good = [p for p in good if np.abs(p.q_above - q_now).max() < TOL_SAME_POSTURE]
    ways: dict[int, str] = {}  # why not, of branches that could stand there
    for posture in good[:MAX_POSTURES]:
        found = _grasp_motion(setup, posture, q_now)
        if not isinstance(found, str):
            over, down, slowed = found
            rejected = _rejection_reasons(good, {**ways, **reasons}, posture)
            return GraspPlan(posture, margin, over, down, down.back(), slowed, rejected)
        ways.setdefault(posture.branch, found)
    rejections = tuple(
        (postures.branch_name(branch), problem) for branch, problem in {**ways, **reasons}.items()
    )
    if not rejections:
        return GraspRefusal("reach", "the posture in which the hand was measured does not reach it")
    name, why = rejections[0]
    problem = f"no posture of the arm can grasp it; what comes nearest ({name}): {why}"
    return GraspRefusal("way" if ways else "reach", problem, rejections)


def _grasp_motion(
    setup: Workspace, posture: postures.Posture, q_now: Array
) -> tuple[tuple[trajectory.Trajectory, ...], trajectory.Trajectory, float] | str:
    """The transfer, the line down, and how much slower it is, in one posture; or why not."""
    found = _descent(setup, posture)
    if isinstance(found, str):
        return found
    there = transfer_motion(setup, q_now, posture.q_above)
    return there if isinstance(there, str) else (there, *found)


def _descent(
    setup: Workspace, posture: postures.Posture
) -> tuple[trajectory.Trajectory, float] | str:
    """The line down, checked along its whole length, and how much slower it is; or why not."""
    wanted = setup.cell.approach
    flange = robots.forward(setup.arm, posture.q_above)
    line = ApproachLine(flange, wanted.height * wanted.direction)
    path = line_path(setup.arm, line, posture.branch, posture.q_above)
    if isinstance(path, str):
        return path
    for q in path.range():
        if problem := setup.limit_violation(q):
            return f"on the line down {problem}"
    rates = trajectory.PathLimits(wanted.speed, wanted.acceleration, wanted.jerk)
    slowed = trajectory.required_slowdown(path, setup.limits, rates)
    if slowed > MAX_SLOWDOWN:
        joint = int(np.argmax(path.bounds()[0] / setup.limits.speed)) + 1
        fast = f"at {1e3 * wanted.speed:g} mm/s joint {joint} races"
        return f"on the line down {fast}, {slowed:.0f} times beyond its limits"
    if problem := setup.along(path):
        return f"on the line down {problem}"
    return trajectory.time_path(path, setup.limits, rates), max(slowed, 1.0)


def transfer_motion(
    setup: Workspace, q_now: Array, q_above: Array
) -> tuple[trajectory.Trajectory, ...] | str:
    """Go straight in joint angles, (n,) rad, to above the object, or through home.

    Returns the ways one after the other, checked all along; or what stands in them.
    """
    ways = [[q_now, q_above]]
    if setup.cell.moving.home is not None:
        ways.append([q_now, setup.cell.moving.home, q_above])
    problem = ""
    for way in ways:
        paths = [trajectory.joint_path(a, b) for a, b in pairwise(way)]
        trouble = next((t for path in paths if (t := setup.along(path))), "")
        if not trouble:
            return tuple(trajectory.time_path(path, setup.limits) for path in paths)
        problem = problem or f"on the way over {trouble}"
    return problem


def _rejection_reasons(
    good: list[postures.Posture], reasons: dict[int, str], taken: postures.Posture
) -> dict[str, str]:
    """Why each other branch is not taken, in words."""
    rejections = dict(reasons)
    for posture in good:
        if posture.branch != taken.branch:
            worse = f"it is feasible, but scores {posture.score:.2g} against {taken.score:.2g}"
            rejections.setdefault(posture.branch, worse)
    rejections.pop(taken.branch, None)
    return {postures.branch_name(branch): rejections[branch] for branch in sorted(rejections)}


@dataclass(frozen=True, slots=True)
class JointGoal:
    """Where the joints should be now, and how the goal moves."""

    q: Array  # (n,), rad
    velocity: Array  # (n,), rad/s


class HoverPlanner:
    """Keeps one branch and one turn of the hand as long as possible, then searches for others."""

    def __init__(self, setup: Workspace) -> None:
        self._setup = setup
        self._posture: postures.Posture | None = None

    def goal(self, point: Array, velocity: Array, q_now: Array) -> JointGoal | GraspRefusal:
        """Say where the joints should be for the hand to stand above the target's middle.

        It is at a point (3,), m, and moves at (3,), m/s, base frame; q_now (n,), rad: ordered last.
        """
        if not (np.isfinite(point).all() and np.isfinite(velocity).all()):
            return GraspRefusal("unknown", "the target's place is not known")
        grip, _ = grip_point(point, self._setup.cell)  # above where the line down will begin
        q = None if self._posture is None else self._same(self._posture, grip, q_now)
        if q is None:
            good, reasons = postures.find_postures(self._setup, grip, q_now)
            if not good:
                self._posture = None
                problem = next(iter(reasons.values()))
                return GraspRefusal("reach", f"no posture stands above the target: {problem}")
            self._posture, q = good[0], good[0].q_above
        twist = np.concatenate([velocity, np.zeros(3)])
        return JointGoal(q, np.linalg.solve(robots.jacobian(self._setup.arm, q), twist))

    def _same(self, posture: postures.Posture, grip: Array, q_now: Array) -> Array | None:
        """The same branch and turn above another grip point; None where they do not serve."""
        setup, approach = self._setup, self._setup.cell.approach
        above = grip - approach.height * approach.direction
        pose = hand_poses(approach.direction, above, np.array([posture.turn]))
        flange = pose[0] @ invert(setup.cell.gripper.flange_T_grip)
        answers = robots.inverse(setup.arm, flange, hold=q_now).q
        q = near_within(setup.arm, answers[posture.branch], q_now)
        if not np.isfinite(q).all() or setup.limit_violation(q):
            return None
        singular = postures.smallest_singular_value(setup.arm, q) < postures.MIN_SINGULAR_VALUE
        return None if singular or setup.clear(q[None]) else q
