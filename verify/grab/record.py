"""Keeps a grab: the cameras' session, the film, the tables and the report's results."""

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd

from reports import Results
from verify import __version__
from verify.devices import EncoderReading
from verify.grab.loop_record import Cycle
from verify.grab.loop_target import Aim
from verify.grab.plan import Plan
from verify.grab.plan_margin import Refusal
from verify.grab.record_rows import (
    hand_fields,
    hand_table,
    margin_fields,
    passages_table,
    plan_table,
    row,
)
from verify.grab.record_video import Film
from verify.grab.run import Outcome
from verify.grab.states import State
from verify.grab.workspace import Workspace
from verify.recording.part import Facts, Part
from verify.recording.pictures import kind_of
from verify.records import Image

JPEG_QUALITY = 92  # of pictures that no camera has compressed: a third of what lossless takes
HALF_WIDTH = 5e-4  # s within which joints are read
SHOWN = (State.FOLLOWING, State.CLOSING, State.LIFTED)  # of which the report shows a picture
FILM, SESSION = "grab.mp4", "session"


@dataclass(frozen=True, slots=True)
class Told:
    """What the report says beside what was seen."""

    robot: str
    target: str  # in the user's words
    cell: str  # "simulated", or the station
    execute: bool
    started: datetime
    warnings: tuple[str, ...] = ()


class GrabRecord:
    """Sees every cycle of a grab, and keeps it.

    Args:
        folder: an empty one, for the film and the session.
        facts: what the session's session.toml says.
        workspace: for the grip point's way.
        told: what else the report says.
        rate: Hz, cycles.
    """

    def __init__(
        self, folder: Path, facts: Facts, workspace: Workspace, told: Told, rate: float
    ) -> None:
        self._folder, self._facts, self._workspace, self._told = folder, facts, workspace, told
        self._rows: list[dict[str, Any]] = []
        self._shown: dict[State, Image] = {}
        self._last: Image | None = None
        self._part: Part | None = None
        self._seen_from_grip: float | None = None  # mm
        self._film = Film(folder / FILM, rate)

    def see(self, cycle: Cycle) -> None:
        """Keep a cycle.

        Raises:
            OSError: the system refuses it.
        """
        self._rows.append(row(cycle, self._workspace))
        self._seen_from_grip = _from_grip(cycle, self._workspace)
        picture = self._film.add(cycle)
        self._last = picture
        if cycle.state not in self._shown and cycle.pair is not None:
            self._shown[cycle.state] = picture
        if cycle.pair is not None:
            raws = (_jpeg(cycle.pair.left), _jpeg(cycle.pair.right))
            if self._part is None:
                kinds = (kind_of(cycle.pair.left, raws[0]), kind_of(cycle.pair.right, raws[1]))
                place = self._folder / SESSION
                self._part = Part(place, self._facts, self._told.started, kinds)
            self._part.add_pair(cycle.pair, raws)
        if cycle.q is not None and self._part is not None:
            self._part.add_reading(EncoderReading(cycle.t, cycle.t, HALF_WIDTH, 0, cycle.q))

    def close(self) -> None:
        """Close film and session: whole from here on.

        Raises:
            OSError, InputError: the system refuses it.
        """
        self._film.close()
        if self._part is not None:
            self._part.close()

    def results(self, outcome: Outcome, aim: Aim) -> Results:
        """Make what the report is made of."""
        plan = None if aim.planned is None else aim.planned.answer
        good = plan if isinstance(plan, Plan) else None
        hand = None if aim.planned is None else aim.planned.thing.seen
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
            "seen_from_grip_mm": self._seen_from_grip,
            "plan": None if good is None else _plan_fields(good),
            "refusal": _refusal_fields(plan) if isinstance(plan, Refusal) else None,
            "hand": None if hand is None else hand_fields(hand, self._workspace),
            "film": FILM,
            "session": SESSION,
            "warnings": list(self._told.warnings),
        }
        tables = {
            "cycles": pd.DataFrame(self._rows),
            "passages": passages_table(outcome.passages),
            "plan": plan_table(good, self._workspace),
            "hand": hand_table(hand, self._workspace),
        }
        return Results(summary, {}, tables, self._images())

    def _images(self) -> dict[str, bytes]:
        chosen = [self._shown[state] for state in SHOWN if state in self._shown]
        if not chosen and self._last is not None:
            chosen = [self._last]
        if not chosen:
            return {}
        return {"pictures": cv2.imencode(".png", np.vstack(chosen))[1].tobytes()}


def _from_grip(cycle: Cycle, workspace: Workspace) -> float | None:
    """How far from the grip point the cameras see the target, mm; None where they do not."""
    if cycle.q is None or cycle.known is None or cycle.seen is None:
        return None
    if not np.isfinite(cycle.seen.measured).all():
        return None
    grip = workspace.grip(cycle.q)[:3, 3]
    seen = cycle.known.thing.seen
    if seen is not None and seen.hand is not None:  # the hand is there, whatever its encoders say
        grip = grip + seen.hand.off
    return float(1e3 * np.linalg.norm(cycle.known.thing.position - grip))


def _jpeg(image: Image) -> bytes:
    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1])


def _plan_fields(plan: Plan) -> dict[str, Any]:
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


def _refusal_fields(refusal: Refusal) -> dict[str, Any]:
    rejected = [{"branch": name, "reason": said} for name, said in refusal.branches]
    return {"kind": refusal.kind, "reason": refusal.reason, "rejected": rejected}
