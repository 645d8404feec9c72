"""From a target's place to a grasp: which posture, which ways, and when; or why not."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

import robots
from robots import Arm, DhArm
from verify.errors import InputError
from verify.grab.approach import Line, along
from verify.grab.branches import Posture, branch_name, postures
from verify.grab.cell_file import Cell
from verify.grab.limits import JointLimits, at_rest, joint_limits, violation
from verify.grab.plan_margin import Margin, Refusal, grip_margin
from verify.grab.plan_target import Thing
from verify.grab.trajectory import Rates, Trajectory, between, slowing, timed
from verify.grab.workspace import Workspace
from verify.records import Array

SLOWEST = 4.0  # times slower than asked for: a line that needs more runs past a singularity
SAME_POSTURE = 0.15  # rad: no other branch and no other turn of the hand is so near
TRIED = 40  # postures whose ways are looked at, best first: all branches, some turns of each


@dataclass(frozen=True)
class Planner:
    """An arm in its cell; says how to grasp, and moves nothing."""

    workspace: Workspace
    limits: JointLimits

    @property
    def arm(self) -> DhArm:
        """The arm."""
        return self.workspace.arm

    @property
    def cell(self) -> Cell:
        """The cell."""
        return self.workspace.cell


@dataclass(frozen=True)
class Plan:
    """A grasp: over to the object, down to it, and back up."""

    posture: Posture
    margin: Margin
    over: tuple[Trajectory, ...]  # to above the object; several where the way leads through home
    down: Trajectory
    up: Trajectory
    slowed: float  # by so much the line is slower than the cell asks, for the joints' sake
    rejected: dict[str, str]  # each branch that is not taken, and why


def planner(arm: Arm, cell: Cell, cameras: Array) -> Planner:
    """Put an arm into its cell.

    Args:
        arm: its file states speed, acceleration and jerk.
        cell: from grab.toml.
        cameras: (k, 3), m, their optical centres in the robot's base.

    Raises:
        InputError: the arm has no closed form, or its file states no rates.
    """
    if not isinstance(arm, DhArm):
        expected = "an arm with a closed form is needed to grasp"
        raise InputError(f'robot "{arm.name}"', "is a URDF", expected, "Write its DH table.")
    return Planner(Workspace(arm, cell, cameras), joint_limits(arm, cell.moving.share))


def plan(setup: Planner, thing: Thing, q_now: Array) -> Plan | Refusal:
    """Plan a grasp.

    Args:
        setup: arm and cell.
        thing: what to grasp.
        q_now: (n,), rad, where the arm stands, at rest.
    """
    margin = grip_margin(thing, setup.cell)
    if isinstance(margin, Refusal):
        return margin
    if said := violation(setup.limits, at_rest(q_now)) or setup.workspace.clear(q_now[None]):
        return Refusal("way", f"the arm cannot begin where it stands: {said}")
    good, reasons = postures(setup.workspace, setup.limits, margin.grip, q_now)
    if thing.seen is not None and thing.seen.used:  # a correction holds where it was measured
        good = [p for p in good if np.abs(p.q_above - q_now).max() < SAME_POSTURE]
    ways: dict[int, str] = {}  # why not, of branches that could stand there
    for posture in good[:TRIED]:
        found = _ways(setup, posture, q_now)
        if not isinstance(found, str):
            over, down, slowed = found
            rejected = _rejected(good, {**ways, **reasons}, posture)
            return Plan(posture, margin, over, down, down.returning(), slowed, rejected)
        ways.setdefault(posture.branch, found)
    told = tuple((branch_name(branch), said) for branch, said in {**ways, **reasons}.items())
    if not told:
        return Refusal("reach", "the posture in which the hand was seen does not reach it")
    said = "no posture of the arm can grasp it; what comes nearest ({}): {}".format(*told[0])
    return Refusal("way" if ways else "reach", said, told)


def _ways(
    setup: Planner, posture: Posture, q_now: Array
) -> tuple[tuple[Trajectory, ...], Trajectory, float] | str:
    """Both ways of a grasp in one posture; or what is wrong with them."""
    approach = setup.cell.approach
    shift = approach.height * approach.direction
    found = line(setup, posture.branch, posture.q_above, shift, "on the line down")
    if isinstance(found, str):
        return found
    there = over(setup, q_now, posture.q_above)
    return there if isinstance(there, str) else (there, *found)


def line(
    setup: Planner, branch: int, q_start: Array, shift: Array, where: str = "on the line"
) -> tuple[Trajectory, float] | str:
    """Move the hand straight, its orientation kept; looked at along its whole length.

    Args:
        setup: arm and cell.
        branch: of the inverse, in which the arm stands and stays.
        q_start: (n,), rad, where the line begins, at rest.
        shift: (3,), m, base frame, to its end.
        where: how a reason begins.

    Returns:
        The motion, and by how much it is slower than the cell asks; or why there is none.
    """
    path = along(setup.arm, Line(robots.forward(setup.arm, q_start), shift), branch, q_start)
    if isinstance(path, str):
        return path
    for q in path.range():
        if said := violation(setup.limits, at_rest(q)):
            return f"{where} {said}"
    asked = setup.cell.approach
    rates = Rates(asked.speed, asked.acceleration, asked.jerk)
    slowed = slowing(path, setup.limits, rates)
    if slowed > SLOWEST:
        joint = int(np.argmax(path.bounds()[0] / setup.limits.speed)) + 1
        fast = f"at {1e3 * asked.speed:g} mm/s joint {joint} races"
        return f"{where} {fast}, {slowed:.0f} times beyond its limits"
    if said := setup.workspace.along(path):
        return f"{where} {said}"
    return timed(path, setup.limits, rates), max(slowed, 1.0)


def over(setup: Planner, q_now: Array, q_above: Array) -> tuple[Trajectory, ...] | str:
    """Go straight in joint angles to above the object, or through home; checked all along.

    Args:
        setup: arm and cell.
        q_now: (n,), rad, where the arm stands, at rest.
        q_above: (n,), rad, where it goes.

    Returns:
        The ways one after the other; or what stands in them.
    """
    ways = [[q_now, q_above]]
    if setup.cell.moving.home is not None:
        ways.append([q_now, setup.cell.moving.home, q_above])
    said = ""
    for way in ways:
        paths = [between(a, b) for a, b in pairwise(way)]
        trouble = next((t for path in paths if (t := setup.workspace.along(path))), "")
        if not trouble:
            return tuple(timed(path, setup.limits) for path in paths)
        said = said or f"on the way over {trouble}"
    return said


def _rejected(good: list[Posture], reasons: dict[int, str], taken: Posture) -> dict[str, str]:
    """Why each other branch is not taken, in words."""
    told = dict(reasons)
    for posture in good:
        if posture.branch != taken.branch:
            worse = f"it would do, but scores {posture.score:.2g} against {taken.score:.2g}"
            told.setdefault(posture.branch, worse)
    told.pop(taken.branch, None)
    return {branch_name(branch): told[branch] for branch in sorted(told)}
