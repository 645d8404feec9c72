"""Record a grasp: the cameras' session, the film, the tables and the report's results."""

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd

from reports import Results
from verify.core.records import Array, Image, StereoPair
from verify.core.version import __version__
from verify.devices.protocols import CapturedPair, EncoderReading
from verify.grasping.control.aim import Aim, LoopCycle
from verify.grasping.control.run import GraspOutcome
from verify.grasping.control.states import GraspState
from verify.grasping.planning.object import GraspRefusal
from verify.grasping.planning.plan import GraspPlan
from verify.grasping.planning.workspace import Workspace
from verify.grasping.record import rows
from verify.grasping.record.video import Mp4Writer
from verify.live.recording.session import SessionFacts, SessionWriter

JPEG_QUALITY = 92  # of pictures that no camera has compressed: a third of what lossless takes
READING_HALF_WIDTH = 5e-4  # s within which joints are read
# states in which the object should be with the hand
RAISED_STATES = frozenset({GraspState.LIFTING, GraspState.LIFTED})
# states of which the report shows a picture: the object seen, and the grasp
PICTURED_STATES = (GraspState.FOLLOWING, GraspState.CLOSING)
# of the object measured while the hand goes up: its middle's distance from the grip point, that
# distance's uncertainty (k = 2, worst direction), and how far the hand had come up by then
LIFT_FIELDS = ("seen_from_grip_mm", "seen_from_grip_expanded_uncertainty_mm", "seen_raised_mm")
VIDEO_FILE, SESSION_FOLDER = "grab.mp4", "session"


@dataclass(frozen=True, slots=True)
class GraspContext:
    """What the report states beside the measurements."""

    robot: str
    target: str  # as the user named it
    cell: str  # "simulated", or the station
    execute: bool
    started: datetime
    warnings: tuple[str, ...] = ()


class GraspRecord:
    """Records every cycle of a grasp."""

    def __init__(
        self,
        folder: Path,
        facts: SessionFacts,
        workspace: Workspace,
        context: GraspContext,
        rate: float,
    ) -> None:
        self._folder, self._facts, self._workspace = folder, facts, workspace
        self._context = context
        self._rows: list[dict[str, Any]] = []
        self._shown: dict[GraspState, Image] = {}
        self._last: Image | None = None
        self._session: SessionWriter | None = None
        self._gripped: Array | None = None  # (3,), m, the grip point when the lift began
        self._lift_check: dict[str, float] | None = None  # the last since then
        self._film = Mp4Writer(folder / VIDEO_FILE, rate)

    def add(self, cycle: LoopCycle) -> None:
        """Record a cycle.

        Raises:
            OSError: the system refuses it.
        """
        self._rows.append(rows.cycle_row(cycle, self._workspace))
        self._check_lift(cycle)
        self._last = self._film.add(cycle)
        if cycle.pair is not None:
            self._shown.setdefault(cycle.state, self._last)
            pair = _compressed(cycle.pair)
            if self._session is None:
                place = self._folder / SESSION_FOLDER
                self._session = SessionWriter(place, self._facts, self._context.started, pair)
            self._session.add_pair(pair)
        if cycle.q is not None and self._session is not None:
            self._session.add_reading(
                EncoderReading(cycle.t, cycle.t, READING_HALF_WIDTH, 0, cycle.q)
            )

    def close(self) -> None:
        """Close film and session: whole from here on.

        Raises:
            OSError, InputError: the system refuses it.
        """
        self._film.close()
        if self._session is not None:
            self._session.close()

    def results(self, outcome: GraspOutcome, aim: Aim) -> Results:
        """Make what the report is made of."""
        plan = None if aim.planned is None else aim.planned.answer
        good = plan if isinstance(plan, GraspPlan) else None
        hand = None if aim.planned is None else aim.planned.thing.offset
        summary: dict[str, Any] = {
            "kind": "grab",
            "tool": {"name": "verify", "version": __version__},
            "robot": self._context.robot,
            "cell": self._context.cell,
            "target": self._context.target,
            "execute": self._context.execute,
            "started": self._context.started.isoformat(timespec="seconds"),
            "state": outcome.state.value,
            "reason": outcome.reason,
            "released": outcome.released,
            "stopped_by_operator": outcome.stopped,
            "cycles": outcome.cycles,
            **(self._lift_check or dict.fromkeys(LIFT_FIELDS)),
            "plan": None if good is None else rows.plan_fields(good),
            "refusal": rows.plan_fields(plan) if isinstance(plan, GraspRefusal) else None,
            "hand": None if hand is None else rows.tool_offset_fields(hand, self._workspace),
            "film": VIDEO_FILE,
            "session": SESSION_FOLDER,
            "warnings": list(self._context.warnings),
        }
        tables = {
            "cycles": pd.DataFrame(self._rows),
            "passages": rows.state_changes_table(outcome.passages),
            "plan": rows.plan_table(good, self._workspace),
            "hand": rows.tool_offset_table(hand, self._workspace),
        }
        return Results(summary, {}, tables, self._images())

    def _check_lift(self, cycle: LoopCycle) -> None:
        if cycle.state is GraspState.APPROACHING:  # another try
            self._gripped = self._lift_check = None
        if cycle.state not in RAISED_STATES or cycle.q is None:
            return
        grip = self._workspace.grip(cycle.q)[:3, 3]
        if self._gripped is None:
            self._gripped = grip
        raised = float(np.linalg.norm(grip - self._gripped))
        self._lift_check = _lift_check(cycle, self._workspace, grip, raised) or self._lift_check

    def _images(self) -> dict[str, bytes]:
        chosen = [self._shown[state] for state in PICTURED_STATES if state in self._shown]
        if not chosen and self._last is not None:
            chosen = [self._last]
        if not chosen:
            return {}
        return {"pictures": cv2.imencode(".png", np.vstack(chosen))[1].tobytes()}


def _lift_check(
    cycle: LoopCycle, workspace: Workspace, grip: Array, raised: float
) -> dict[str, float] | None:
    """Measure the object against the grip point; None where both cameras do not see it."""
    target, observation = cycle.target, cycle.observation
    if target is None or observation is None or not np.isfinite(observation.measured).all():
        return None
    thing = target.thing
    spread = thing.covariance
    if thing.hand is not None:  # the hand is there, whatever the encoders say
        grip, spread = grip + thing.hand.off, spread + thing.hand.covariance
    else:
        spread = spread + np.eye(3) * workspace.cell.accuracy.robot**2
    worst = float(np.sqrt(np.linalg.eigvalsh(spread)[-1]))
    lengths = (float(np.linalg.norm(thing.position - grip)), 2 * worst, raised)
    return {field: 1e3 * length for field, length in zip(LIFT_FIELDS, lengths, strict=True)}


def _compressed(pair: StereoPair) -> CapturedPair:
    times = (pair.frame, pair.t_left, pair.t_right, pair.pan_left, pair.pan_right)
    raws = _jpeg(pair.left), _jpeg(pair.right)
    return CapturedPair(*times, pair.left, pair.right, pair.lossy, *raws)


def _jpeg(image: Image) -> bytes:
    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1])
