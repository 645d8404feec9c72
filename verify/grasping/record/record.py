"""Keeps a grab: the cameras' session, the film, the tables and the report's results."""

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd

from reports import Results
from verify.core.records import Array, Image
from verify.core.version import __version__
from verify.devices.protocols import EncoderReading
from verify.grasping.control.aim import Aim, LoopCycle
from verify.grasping.control.run import GraspOutcome
from verify.grasping.control.states import GraspState
from verify.grasping.planning.object import GraspRefusal
from verify.grasping.planning.plan import GraspPlan
from verify.grasping.planning.workspace import Workspace
from verify.grasping.record.rows import (
    cycle_row,
    margin_fields,
    plan_table,
    state_changes_table,
    tool_offset_fields,
    tool_offset_table,
)
from verify.grasping.record.video import Mp4Writer
from verify.live.recording.matroska import picture_format
from verify.live.recording.session import SessionFacts, SessionWriter

JPEG_QUALITY = 92  # of pictures that no camera has compressed: a third of what lossless takes
READING_HALF_WIDTH = 5e-4  # s within which joints are read
RAISED_STATES = frozenset(
    {GraspState.LIFTING, GraspState.LIFTED}
)  # in which the object should be with the hand
PICTURED_STATES = (
    GraspState.FOLLOWING,
    GraspState.CLOSING,
    GraspState.LIFTED,
)  # of which the report shows a picture
VIDEO_FILE, SESSION_FOLDER = "grab.mp4", "session"


@dataclass(frozen=True, slots=True)
class GraspContext:
    """What the report says beside what was seen."""

    robot: str
    target: str  # in the user's words
    cell: str  # "simulated", or the station
    execute: bool
    started: datetime
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class _LiftCheck:
    """The object, seen while the hand goes up with it: did it come along?"""

    from_grip: float  # m, of its middle from the grip point
    expanded: float  # m, of that, k = 2, in the worst direction
    raised: float  # m that the hand had come up by then


class GraspRecord:
    """Sees every cycle of a grab, and keeps it.

    Args:
        folder: an empty one, for the film and the session.
        facts: what the session's session.toml says.
        workspace: for the grip point's way.
        told: what else the report says.
        rate: Hz, cycles.
    """

    def __init__(
        self,
        folder: Path,
        facts: SessionFacts,
        workspace: Workspace,
        told: GraspContext,
        rate: float,
    ) -> None:
        self._folder, self._facts, self._workspace, self._told = folder, facts, workspace, told
        self._rows: list[dict[str, Any]] = []
        self._shown: dict[GraspState, Image] = {}
        self._last: Image | None = None
        self._part: SessionWriter | None = None
        self._gripped: Array | None = None  # (3,), m, the grip point when the lift began
        self._sight: _LiftCheck | None = None  # the last since then
        self._film = Mp4Writer(folder / VIDEO_FILE, rate)

    def see(self, cycle: LoopCycle) -> None:
        """Keep a cycle.

        Raises:
            OSError: the system refuses it.
        """
        self._rows.append(cycle_row(cycle, self._workspace))
        self._look_whether_it_comes_along(cycle)
        picture = self._film.add(cycle)
        self._last = picture
        if cycle.state not in self._shown and cycle.pair is not None:
            self._shown[cycle.state] = picture
        if cycle.pair is not None:
            raws = (_jpeg(cycle.pair.left), _jpeg(cycle.pair.right))
            if self._part is None:
                kinds = (
                    picture_format(cycle.pair.left, raws[0]),
                    picture_format(cycle.pair.right, raws[1]),
                )
                place = self._folder / SESSION_FOLDER
                self._part = SessionWriter(place, self._facts, self._told.started, kinds)
            self._part.add_pair(cycle.pair, raws)
        if cycle.q is not None and self._part is not None:
            self._part.add_reading(EncoderReading(cycle.t, cycle.t, READING_HALF_WIDTH, 0, cycle.q))

    def close(self) -> None:
        """Close film and session: whole from here on.

        Raises:
            OSError, InputError: the system refuses it.
        """
        self._film.close()
        if self._part is not None:
            self._part.close()

    def results(self, outcome: GraspOutcome, aim: Aim) -> Results:
        """Make what the report is made of."""
        plan = None if aim.planned is None else aim.planned.answer
        good = plan if isinstance(plan, GraspPlan) else None
        hand = None if aim.planned is None else aim.planned.thing.offset
        summary: dict[str, Any] = {
            "kind": "grab",
            "tool": {"name": "verify", "version": __version__},
            "robot": self._told.robot,
            "cell": self._told.cell,
            "target": self._told.target,
            "execute": self._told.execute,
            "started": self._told.started.isoformat(timespec="seconds"),
            "state": outcome.state.value,
            "reason": outcome.reason,
            "released": outcome.released,
            "stopped_by_operator": outcome.stopped,
            "cycles": outcome.cycles,
            **_lift_check_fields(self._sight),
            "plan": None if good is None else _plan_fields(good),
            "refusal": _refusal_fields(plan) if isinstance(plan, GraspRefusal) else None,
            "hand": None if hand is None else tool_offset_fields(hand, self._workspace),
            "film": VIDEO_FILE,
            "session": SESSION_FOLDER,
            "warnings": list(self._told.warnings),
        }
        tables = {
            "cycles": pd.DataFrame(self._rows),
            "passages": state_changes_table(outcome.passages),
            "plan": plan_table(good, self._workspace),
            "hand": tool_offset_table(hand, self._workspace),
        }
        return Results(summary, {}, tables, self._images())

    def _look_whether_it_comes_along(self, cycle: LoopCycle) -> None:
        if (
            cycle.state is GraspState.APPROACHING
        ):  # another try: what was seen of the last one is past
            self._gripped = self._sight = None
        if cycle.state not in RAISED_STATES or cycle.q is None:
            return
        grip = self._workspace.grip(cycle.q)[:3, 3]
        if self._gripped is None:
            self._gripped = grip
        raised = float(np.linalg.norm(grip - self._gripped))
        self._sight = _lift_check(cycle, self._workspace, grip, raised) or self._sight

    def _images(self) -> dict[str, bytes]:
        chosen = [self._shown[state] for state in PICTURED_STATES if state in self._shown]
        if not chosen and self._last is not None:
            chosen = [self._last]
        if not chosen:
            return {}
        return {"pictures": cv2.imencode(".png", np.vstack(chosen))[1].tobytes()}


def _lift_check(
    cycle: LoopCycle, workspace: Workspace, grip: Array, raised: float
) -> _LiftCheck | None:
    """How far from the grip point both cameras see the object now; None where they do not."""
    target, observation = cycle.target, cycle.observation
    if target is None or observation is None or not np.isfinite(observation.measured).all():
        return None
    thing = target.thing
    spread = thing.covariance
    if thing.offset is not None and thing.offset.hand is not None:
        hand = thing.offset.hand  # the hand is there, whatever its encoders say
        grip, spread = grip + hand.off, spread + hand.covariance
    else:
        spread = spread + np.eye(3) * workspace.cell.accuracy.robot**2
    worst = float(np.sqrt(np.linalg.eigvalsh(spread)[-1]))
    return _LiftCheck(float(np.linalg.norm(thing.position - grip)), 2 * worst, raised)


def _lift_check_fields(sight: _LiftCheck | None) -> dict[str, float | None]:
    return {
        "seen_from_grip_mm": None if sight is None else 1e3 * sight.from_grip,
        "seen_from_grip_expanded_uncertainty_mm": None if sight is None else 1e3 * sight.expanded,
        "seen_raised_mm": None if sight is None else 1e3 * sight.raised,
    }


def _jpeg(image: Image) -> bytes:
    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1])


def _plan_fields(plan: GraspPlan) -> dict[str, Any]:
    posture = plan.posture
    return {
        "branch": posture.name,
        "score": posture.score,
        "parts": {
            "limits": posture.limits,
            "dexterity": posture.dexterity,
            "nearness": posture.nearness,
            "clearance": posture.clearance,
        },
        "q_above_deg": np.degrees(posture.q_above).tolist(),
        "q_grip_deg": np.degrees(posture.q_grip).tolist(),
        "grip_mm": (1e3 * plan.margin.grip).tolist(),
        "margin": margin_fields(plan.margin),
        "slowed": plan.slowed,
        "duration_s": sum(w.duration for w in (*plan.over, plan.down, plan.up)),
        "rejected": [{"branch": name, "reason": said} for name, said in plan.rejected.items()],
    }


def _refusal_fields(refusal: GraspRefusal) -> dict[str, Any]:
    rejected = [{"branch": name, "reason": said} for name, said in refusal.branches]
    return {"kind": refusal.kind, "reason": refusal.reason, "rejected": rejected}
