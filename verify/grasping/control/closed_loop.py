"""The end point under the cameras' own eyes: the arm is measured above the object, then corrected.

Target and hand are seen by the same cameras: what the rig, the base's registration or the arm's
joints are off moves both, or is seen. Without LEDs in sight it goes on as ever, and says so.
"""

from dataclasses import replace

import numpy as np

import robots
from robots.transforms import carry
from verify.core.records import Array, StereoPair
from verify.core.rig import Rig
from verify.grasping.control.aim import Aim
from verify.grasping.control.run import PairSource
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


class MonitoredSource:
    """Pictures that the flange's watch sees too.

    Args:
        source: of the pictures.
        watch: sees each pair before the loop does.
    """

    def __init__(self, source: PairSource, watch: FlangeWatch) -> None:
        self._source, self._watch = source, watch

    def pair(self) -> StereoPair | None:
        """Give the newest pictures. See `PairSource.pair`."""
        return self._watch.see(self._source.pair())

    def wait(self) -> None:
        """Let time pass. See `PairSource.wait`."""
        self._source.wait()


class ClosedLoopAim(Aim):
    """An aim that looks at the hand before it plans, and corrects where it sends it.

    Args:
        setup: arm and cell.
        rig: the cameras, and the robot's place in the rig.
        watch: measures the flange.
    """

    def __init__(self, setup: GraspPlanner, rig: Rig, watch: FlangeWatch) -> None:
        super().__init__(setup, rig)
        self._watch = watch
        self._hand: OffsetMeasurement | None = None

    def see(self, seen: TargetObservation) -> None:
        """Take in what a pair says. See `Aim.see`."""
        super().see(seen)
        self._tell()

    def forget(self) -> None:
        """Let the plan go, and what was seen of the hand. See `Aim.forget`."""
        super().forget()
        self._watch.forget()
        self._hand = None

    def plan_now(self, now: float, q: Array) -> None:
        """Look at the hand first, then plan. See `Aim.plan_now`.

        Args:
            now: s.
            q: (n,), rad, where the arm stands, at rest.
        """
        if self._hand is None:
            gathered = self._watch.gather(now, q)
            if gathered is None:
                return
            self._hand = self._concluded(q, *gathered)
            self._tell()
        super().plan_now(now, q)
        if self._hand.used and self.planned is not None and self._no_way(self.planned.answer):
            said = "the way to the corrected place is not clear"
            self._hand = replace(self._hand, hand=None, reason=said + NO_CORRECTION)
            self._tell()
            self.planned = None
            super().plan_now(now, q)

    @staticmethod
    def _no_way(answer: object) -> bool:
        return isinstance(answer, GraspRefusal) and answer.kind in ("way", "reach")

    def _tell(self) -> None:
        """Let whoever plans know of the hand."""
        if self.known is not None:
            self.known = replace(self.known, thing=replace(self.known.thing, seen=self._hand))

    def _concluded(
        self, q: Array, sights: tuple[FlangeMeasurement, ...], read: Array | None
    ) -> OffsetMeasurement:
        arm = self._setup.arm
        told = robots.forward(arm, q)
        stood = None if read is None else robots.forward(arm, read)
        if read is None:
            return OffsetMeasurement(
                "the arm did not stand" + NO_CORRECTION, sights, told, None, None, None
            )
        found = average_sights(sights, told)
        if isinstance(found, str):
            return OffsetMeasurement(found + NO_CORRECTION, sights, told, stood, None, None)
        rig_R_base = self._rig.rig_T_base[:3, :3]
        place = carry(self._rig.rig_T_base, told[:3, 3])
        base = rig_R_base.T @ base_covariance(self._rig, place) @ rig_R_base
        hand = tool_offset(found, arm, self._setup.cell, base, q, self._end(q))
        return OffsetMeasurement(tool_offset_text(hand), sights, told, stood, found.pose, hand)

    def _end(self, q: Array) -> Array:
        """Where the line down from here ends, (n,), rad; where there is none, here."""
        approach = self._setup.cell.approach
        pose = robots.forward(self._setup.arm, q)
        pose[:3, 3] += approach.height * approach.direction
        answers = robots.inverse(self._setup.arm, pose, hold=q).q
        away = np.abs(answers - q).max(axis=1)
        return q if np.isnan(away).all() else answers[int(np.nanargmin(away))]


def tool_offset_text(hand: ToolOffset) -> str:
    """Word what was seen of the hand, and what came of it."""
    length = float(np.linalg.norm(hand.off))
    u = np.sqrt(hand.off @ hand.covariance @ hand.off) / length if length > 0 else 0.0
    stood = f"the LEDs show the hand {1e3 * length:.2f} mm ± {2e3 * u:.2f} mm (k = 2) off"
    if hand.used:
        return f"{stood}, and its end point was corrected for it"
    return f"{stood}, more than the {1e3 * MAX_OFFSET:.0f} mm that are corrected" + NO_CORRECTION
