"""Aim with the hand measured above the object by the flange's LEDs, and the end point corrected.

Target and hand are measured by the same cameras: an error of the rig, of the base's registration or
of the arm's joints moves both, or is measured. Without LEDs in view the plan is made uncorrected,
and the reason is stated.
"""

from dataclasses import replace

import numpy as np

import robots
from robots.transforms import carry
from verify.core.records import Array, StereoPair
from verify.core.rig import Rig
from verify.devices.protocols import EncoderReading
from verify.grasping.control.aim import Aim
from verify.grasping.planning.object import GraspRefusal, base_covariance
from verify.grasping.planning.plan import GraspPlanner
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

NO_CORRECTION = "; nothing was corrected"


class ClosedLoopAim(Aim):
    """An aim that measures the hand before it plans, and corrects its end point.

    Args:
        setup: arm and cell.
        rig: the cameras, and the robot's place in the rig.
        watch: measures the flange.
    """

    def __init__(self, setup: GraspPlanner, rig: Rig, watch: FlangeWatch) -> None:
        super().__init__(setup, rig)
        self._watch = watch
        self._hand: OffsetMeasurement | None = None

    def update_target(self, observation: TargetObservation) -> None:
        """Take the target's measurement of one pair."""
        super().update_target(observation)
        self._attach_offset()

    def update_hand(self, pair: StereoPair | None, reading: EncoderReading | None) -> None:
        """Take the newest pictures and joint angles, for measuring the hand."""
        self._watch.update(pair, reading)

    def forget(self) -> None:
        """Drop the plan, and what was measured of the hand."""
        super().forget()
        self._watch.forget()
        self._hand = None

    def plan_now(self, now: float, q: Array) -> None:
        """Measure the hand first, then plan.

        Args:
            now: s.
            q: (n,), rad, where the arm stands, at rest.
        """
        if self._hand is None:
            gathered = self._watch.gather(now, q)
            if gathered is None:
                return
            self._hand = self._measured_offset(q, *gathered)
            self._attach_offset()
        super().plan_now(now, q)
        answer = None if self.planned is None else self.planned.answer
        no_way = isinstance(answer, GraspRefusal) and answer.kind in ("way", "reach")
        if self._hand.used and no_way:
            reason = "the way to the corrected place is not clear" + NO_CORRECTION
            self._hand = replace(self._hand, hand=None, reason=reason)
            self._attach_offset()
            self.planned = None
            super().plan_now(now, q)

    def _attach_offset(self) -> None:
        """State the hand's offset with the object, for the planner."""
        if self.target is not None:
            self.target = replace(self.target, thing=replace(self.target.thing, offset=self._hand))

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
        answers = robots.inverse(self._setup.arm, pose, hold=q).q
        away = np.abs(answers - q).max(axis=1)
        return q if np.isnan(away).all() else answers[int(np.nanargmin(away))]


def tool_offset_text(hand: ToolOffset) -> str:
    """State the hand's offset, and whether it was corrected."""
    length = float(np.linalg.norm(hand.off))
    u = np.sqrt(hand.off @ hand.covariance @ hand.off) / length if length > 0 else 0.0
    stood = f"the LEDs show the hand {1e3 * length:.2f} mm ± {2e3 * u:.2f} mm (k = 2) off"
    if hand.used:
        return f"{stood}, and its end point was corrected for it"
    return f"{stood}, more than the {1e3 * MAX_OFFSET:.0f} mm that are corrected" + NO_CORRECTION
