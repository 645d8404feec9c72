"""Keep the target's place in the base, the goal above it, and the grasp planned for it.

`LoopCycle` is what one cycle of the loop measured, ordered and read.
"""

from dataclasses import dataclass

import numpy as np

from verify.core.records import Array, StereoPair
from verify.core.rig import Rig
from verify.devices.protocols import EncoderReading
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

REPLAN_PERIOD = 0.5  # s between two attempts to plan
MAX_TARGET_SHIFT = 1e-3  # m; a target that moved farther is planned for anew
DEADBAND = 4e-3  # rad: a still target's noise moves no joint


@dataclass(frozen=True, slots=True)
class TargetState:
    """The target in the robot's base."""

    thing: GraspObject
    velocity: Array  # (3,), m/s
    tracked: bool  # wholly in view of both cameras, now


@dataclass(frozen=True, slots=True)
class LoopCycle:
    """One cycle of the loop; times on its clock, s."""

    t: float
    state: GraspState
    reason: str  # why it is in that state
    pair: StereoPair | None  # None: no new pictures
    observation: TargetObservation | None  # of that pair
    target: TargetState | None
    q: Array | None  # (n,), rad, read
    q_ordered: Array | None  # (n,), rad
    gripper: GripperStatus | None
    took: float  # s that the cycle worked, by the computer's own clock


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
        self._planned_at = -np.inf  # s, of the last goal
        self.target: TargetState | None = None
        self.planned: PlanAttempt | None = None
        self.unreachable = ""

    @property
    def plan(self) -> GraspPlan | None:
        """The plan for where the target stands now."""
        answer = None if self.planned is None else self.planned.answer
        return answer if isinstance(answer, GraspPlan) else None

    def update_target(self, observation: TargetObservation) -> None:
        """Take the target's measurement of one pair."""
        self.target = None
        if np.isfinite(observation.centre).all():
            direction = self._setup.cell.approach.direction
            thing = object_from_target(observation, self._rig, direction)
            velocity = self._rig.rig_T_base[:3, :3].T @ observation.velocity
            self.target = TargetState(thing, velocity, observation.status == "tracked")

    def update_hand(self, pair: StereoPair | None, reading: EncoderReading | None) -> None:
        """Take the newest pictures and joint angles; this aim does not measure the hand."""

    def hover(self, now: float, q: Array, *, still: bool) -> JointGoal | None:
        """Find where the joints should be to stand above the target; None where it is not known.

        Args:
            now: s.
            q: (n,), rad, ordered last.
            still: the target stands still.
        """
        if self.target is None or (self.unreachable and now - self._planned_at < REPLAN_PERIOD):
            return self._goal
        self._planned_at = now
        velocity = np.zeros(3) if still else self.target.velocity
        goal = self._hover.goal(self.target.thing.position, velocity, q)
        if isinstance(goal, GraspRefusal):
            self.unreachable, self._goal = goal.reason, None
            return None
        if self.planned is None or self.plan is not None:
            self.unreachable = ""
        last = self._goal
        if still and last is not None and np.abs(goal.q - last.q).max() < DEADBAND:
            goal = JointGoal(last.q, np.zeros_like(goal.q))
        self._goal = goal
        return goal

    def plan_now(self, now: float, q: Array) -> None:
        """Plan for a target that stands still, unless there is a plan for where it stands.

        Args:
            now: s.
            q: (n,), rad, where the arm stands, at rest.
        """
        if self.target is None or not self.target.tracked:
            return
        thing = self.target.thing
        if self.planned is not None:
            moved = np.linalg.norm(thing.position - self.planned.thing.position)
            if now - self.planned.t < REPLAN_PERIOD or (
                self.plan is not None and moved < MAX_TARGET_SHIFT
            ):
                return
        answer = plan_grasp(self._setup, thing, q)
        self.planned = PlanAttempt(now, thing, answer)
        self.unreachable = answer.reason if isinstance(answer, GraspRefusal) else ""

    def forget(self) -> None:
        """Drop the plan: the target, or the arm, moves."""
        self.planned = None

    def target_shift(self) -> str:
        """Say that the target has left the place that the grasp was planned for; else ""."""
        if self.plan is None or self.planned is None or self.target is None:
            return ""
        shift = self.target.thing.position - self.planned.thing.position
        moved = float(np.linalg.norm(shift))
        if not self.target.tracked or moved < self.plan.margin.across / 2:
            return ""
        return f"the target has moved {1e3 * moved:.0f} mm away from where it was to be grasped"
