"""What the loop makes of the target: its place in the base, where to hover, and a plan.

What one cycle of the loop saw, ordered and read.
"""

from dataclasses import dataclass

import numpy as np

from verify.core.records import Array, StereoPair
from verify.core.rig import Rig
from verify.grasping.actuators.protocols import GripperStatus
from verify.grasping.control.states import GraspState
from verify.grasping.planning.object import GraspObject, GraspRefusal, object_from_target
from verify.grasping.planning.plan import (
    GraspPlan,
    GraspPlanner,
    HoverPlanner,
    JointGoal,
    plan_grasp,
)
from verify.grasping.tracking.target import TargetObservation


@dataclass(frozen=True, slots=True)
class TargetState:
    """The target in the robot's base."""

    thing: GraspObject
    velocity: Array  # (3,), m/s
    tracked: bool  # seen whole, now


@dataclass(frozen=True, slots=True)
class LoopCycle:
    """One turn of the loop; times on its clock, s."""

    t: float
    state: GraspState
    reason: str  # why it is in that state
    pair: StereoPair | None  # None: no new pictures
    seen: TargetObservation | None
    known: TargetState | None
    q: Array | None  # (n,), rad, read
    q_ordered: Array | None  # (n,), rad
    gripper: GripperStatus | None
    took: float  # s that the cycle worked, by the computer's own clock


REPLAN_PERIOD = 0.5  # s between two attempts to plan
MAX_TARGET_SHIFT = (
    1e-3  # m by which a planned target may be elsewhere by now, or it is planned anew
)
DEADBAND = 4e-3  # rad: a still target's noise moves no joint


@dataclass(frozen=True, slots=True)
class PlanAttempt:
    """A plan, or why there is none, and for which target."""

    t: float  # s
    thing: GraspObject
    answer: GraspPlan | GraspRefusal


class Aim:
    """Keeps what is known and planned of the target.

    Args:
        setup: arm and cell.
        rig: the cameras, and the robot's place in the rig.
    """

    def __init__(self, setup: GraspPlanner, rig: Rig) -> None:
        self._setup, self._rig = setup, rig
        self._hover = HoverPlanner(setup)
        self._goal: JointGoal | None = None
        self._asked = -np.inf
        self.known: TargetState | None = None
        self.planned: PlanAttempt | None = None
        self.unreachable = ""

    @property
    def plan(self) -> GraspPlan | None:
        """The plan for where the target stands now."""
        if self.planned is None or isinstance(self.planned.answer, GraspRefusal):
            return None
        return self.planned.answer

    def see(self, seen: TargetObservation) -> None:
        """Take in what a pair says."""
        self.known = None
        if np.isfinite(seen.centre).all():
            thing = object_from_target(seen, self._rig, self._setup.cell.approach.direction)
            velocity = self._rig.rig_T_base[:3, :3].T @ seen.velocity
            self.known = TargetState(thing, velocity, seen.status == "tracked")

    def hover(self, now: float, q: Array, *, still: bool) -> JointGoal | None:
        """Say where the joints should be to stand above the target; None where it cannot be told.

        Args:
            now: s.
            q: (n,), rad, ordered last.
            still: the target stands still.
        """
        if self.known is None or (self.unreachable and now - self._asked < REPLAN_PERIOD):
            return self._goal
        self._asked = now
        velocity = np.zeros(3) if still else self.known.velocity
        goal = self._hover.goal(self.known.thing.position, velocity, q)
        if isinstance(goal, GraspRefusal):
            self.unreachable, self._goal = goal.reason, None
            return None
        if not self._refused:
            self.unreachable = ""
        stays = still and self._goal is not None and np.abs(goal.q - self._goal.q).max() < DEADBAND
        if stays and self._goal is not None:
            goal = JointGoal(self._goal.q, np.zeros_like(goal.q))
        self._goal = goal
        return goal

    def plan_now(self, now: float, q: Array) -> None:
        """Plan for a target that stands still, unless there is a plan for where it stands.

        Args:
            now: s.
            q: (n,), rad, where the arm stands, at rest.
        """
        if self.known is None or not self.known.tracked:
            return
        if self.planned is not None:
            moved = np.linalg.norm(self.known.thing.position - self.planned.thing.position)
            if now - self.planned.t < REPLAN_PERIOD or (
                self.plan is not None and moved < MAX_TARGET_SHIFT
            ):
                return
        answer = plan_grasp(self._setup, self.known.thing, q)
        self.planned = PlanAttempt(now, self.known.thing, answer)
        self.unreachable = answer.reason if isinstance(answer, GraspRefusal) else ""

    def forget(self) -> None:
        """Let the plan go: the target, or the arm, is on its way."""
        self.planned = None

    def moved_off(self) -> str:
        """Say whether the target has left the place that the grasp was planned for."""
        if self.plan is None or self.planned is None or self.known is None:
            return ""
        if not self.known.tracked:
            return ""
        aside = self.known.thing.position - self.planned.thing.position
        moved, room = float(np.linalg.norm(aside)), self.plan.margin.across / 2
        if moved < room:
            return ""
        return f"the target has moved {1e3 * moved:.0f} mm away from where it was to be grasped"

    @property
    def _refused(self) -> bool:
        return self.planned is not None and isinstance(self.planned.answer, GraspRefusal)
