"""Keep the target's place in the base, the goal above it, and the grasp planned for it.

Where the hand is watched, it is measured above the object by the flange's LEDs, and the end point
is corrected: target and hand are measured by the same cameras, so an error of the rig, of the
base's registration or of the arm's joints moves both, or is measured. Without LEDs in view the plan
is made uncorrected, and the reason is stated.
"""

from dataclasses import dataclass, replace

import numpy as np

import robots
from robots.transforms import carry
from verify.core.records import Array, StereoPair
from verify.core.rig import Rig
from verify.devices.protocols import EncoderReading
from verify.grasping.actuators.protocols import GripperStatus
from verify.grasping.control.states import GraspState
from verify.grasping.planning.object import (
    GraspObject,
    GraspRefusal,
    base_covariance,
    object_from_target,
)
from verify.grasping.planning.plan import GraspPlan, HoverPlanner, JointGoal, plan_grasp
from verify.grasping.planning.workspace import Workspace
from verify.grasping.tool_offset.offset import (
    MAX_OFFSET,
    FlangeMeasurement,
    OffsetMeasurement,
    ToolOffset,
    average_sights,
    tool_offset,
)
from verify.grasping.tool_offset.watch import FlangeWatch
from verify.grasping.tracking.target import TargetObservation

REPLAN_PERIOD = 0.5  # s between two attempts to plan
MAX_TARGET_SHIFT = 1e-3  # m; a target that moved farther is planned for anew
DEADBAND = 4e-3  # rad: a still target's noise moves no joint
NO_CORRECTION = "; nothing was corrected"


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
    """Keeps what is known and planned of the target; no watch: nothing is corrected."""

    def __init__(self, setup: Workspace, rig: Rig, watch: FlangeWatch | None = None) -> None:
        self._setup, self._rig, self._watch = setup, rig, watch
        self._hand: OffsetMeasurement | None = None
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
            thing = object_from_target(observation, self._rig, self._setup.cell.approach.direction)
            thing = replace(thing, offset=self._hand)
            velocity = self._rig.rig_T_base[:3, :3].T @ observation.velocity
            self.target = TargetState(thing, velocity, observation.status == "tracked")

    def update_hand(self, pair: StereoPair | None, reading: EncoderReading | None) -> None:
        """Take the newest pictures and joint angles, for measuring the hand."""
        if self._watch is not None:
            self._watch.update(pair, reading)

    def hover(self, now: float, q: Array, *, still: bool) -> JointGoal | None:
        """Find where the joints should be to stand above the target; None where it is not known.

        Ordered last were joint angles q, (n,), rad; now is in s.
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
        """Measure the hand where it is watched; then plan from rest at q, (n,), rad."""
        if self._watch is not None and self._hand is None:
            gathered = self._watch.gather(now, q)
            if gathered is None:
                return
            self._set_hand(self._measured_offset(q, *gathered))
        self._plan(now, q)
        answer = None if self.planned is None else self.planned.answer
        no_way = isinstance(answer, GraspRefusal) and answer.kind in ("way", "reach")
        if self._hand is not None and self._hand.used and no_way:
            reason = "the path to the corrected place is not clear" + NO_CORRECTION
            self._set_hand(replace(self._hand, hand=None, reason=reason))
            self.planned = None
            self._plan(now, q)

    def _plan(self, now: float, q: Array) -> None:
        """Plan, unless there is a plan for where the target stands."""
        if self.target is None or not self.target.tracked:
            return
        thing = self.target.thing
        if self.planned is not None:
            moved = np.linalg.norm(thing.position - self.planned.thing.position)
            kept = self.plan is not None and moved < MAX_TARGET_SHIFT
            if kept or now - self.planned.t < REPLAN_PERIOD:
                return
        answer = plan_grasp(self._setup, thing, q)
        self.planned = PlanAttempt(now, thing, answer)
        self.unreachable = answer.reason if isinstance(answer, GraspRefusal) else ""

    def forget(self) -> None:
        """Drop the plan and what was measured of the hand: the target, or the arm, moves."""
        self.planned = self._hand = None
        if self._watch is not None:
            self._watch.forget()

    def target_shift(self) -> str:
        """Say that the target has left the place that the grasp was planned for; else ""."""
        if self.plan is None or self.planned is None or self.target is None:
            return ""
        moved = float(np.linalg.norm(self.target.thing.position - self.planned.thing.position))
        if not self.target.tracked or moved < self.plan.margin.across / 2:
            return ""
        return f"the target has moved {1e3 * moved:.0f} mm away from where it was to be grasped"

    def _set_hand(self, hand: OffsetMeasurement) -> None:
        """Keep the hand's offset, and state it with the object, for the planner."""
        self._hand = hand
        if self.target is not None:
            self.target = replace(self.target, thing=replace(self.target.thing, offset=hand))

    def _measured_offset(
        self, q: Array, sights: tuple[FlangeMeasurement, ...], read: Array | None
    ) -> OffsetMeasurement:
        arm, rig_T_base = self._setup.arm, self._rig.rig_T_base
        ordered = robots.forward(arm, q)
        if read is None:
            return OffsetMeasurement("the arm did not stand" + NO_CORRECTION, sights, ordered)
        stood = robots.forward(arm, read)
        found = average_sights(sights, ordered)
        if isinstance(found, str):
            return OffsetMeasurement(found + NO_CORRECTION, sights, ordered, stood)
        rig_R_base = rig_T_base[:3, :3]
        place = carry(rig_T_base, ordered[:3, 3])
        base = rig_R_base.T @ base_covariance(self._rig, place) @ rig_R_base
        hand = tool_offset(found, arm, self._setup.cell, base, q, self._end(q))
        return OffsetMeasurement(tool_offset_text(hand), sights, ordered, stood, found.pose, hand)

    def _end(self, q: Array) -> Array:
        """Where the line down from here ends, (n,), rad; where there is none, here."""
        approach = self._setup.cell.approach
        pose = robots.forward(self._setup.arm, q)
        pose[:3, 3] += approach.height * approach.direction
        end, reached = robots.nearest(self._setup.arm, pose, q)
        return end if reached else q


def tool_offset_text(hand: ToolOffset) -> str:
    """State the hand's offset, and whether it was corrected."""
    length = float(np.linalg.norm(hand.off))
    u = np.sqrt(hand.off @ hand.covariance @ hand.off) / length if length > 0 else 0.0
    stood = f"the LEDs show the hand {1e3 * length:.2f} mm ± {2e3 * u:.2f} mm (k = 2) off"
    if hand.used:
        return f"{stood}, and its end point was corrected for it"
    return f"{stood}, more than the {1e3 * MAX_OFFSET:.0f} mm that are corrected" + NO_CORRECTION
