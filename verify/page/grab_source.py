"""What a grab has to show, units at the door: millimetres, degrees, pixels, seconds.

The loop shows each turn with `see`; the feed's thread reads what was shown last. Nothing here can
order anything: no driver that moves is imported, and the loop is only looked at.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from verify.grab.plan import Plan, Planner
from verify.grab.plan_facts import facts
from verify.grab.plan_margin import Refusal
from verify.grab.states import MOVING
from verify.grab.states_machine import Passage
from verify.page.grab_fields import (
    degrees,
    device_lines,
    found_fields,
    grab_lacks,
    known_fields,
    seen_fields,
)
from verify.page.pictures import small_jpeg
from verify.page.run_source import cameras_placed
from verify.page.skeleton import joint_origins, millimetres
from verify.rig import Rig

if TYPE_CHECKING:  # types alone: what they come from can move an arm
    from verify.grab.loop import Loop
    from verify.grab.loop_record import Cycle

LONGEST_TEXT = 2000  # characters of a description
PASSAGES = 12  # shown, the newest
WAY = 24  # points of a planned way
SILENT = 1.0  # s without a turn of the loop, and the page says so


@dataclass(frozen=True, slots=True)
class GrabFacts:
    """What never changes."""

    robot: str
    description: str
    setup: Planner
    rig: Rig
    execute: bool
    duration: float  # s, the longest it may take


@dataclass(frozen=True, slots=True)
class Shown:
    """One turn of the loop, as it was when it ended."""

    at: float  # s, this computer's monotonic clock
    cycle: "Cycle"
    passages: tuple[Passage, ...]
    planned: Plan | Refusal | None
    lacks: str | None  # for the grab; empty: it may be ordered; None: it is no order in this state
    may_choose: bool
    fresh: bool  # the pictures
    lines: tuple[tuple[str, bool, str], ...]  # devices: name, well, in words


class GrabSource:
    """Keeps the newest turn; nothing waits for it.

    Args:
        told: what never changes.
    """

    def __init__(self, told: GrabFacts) -> None:
        self._told = told
        self._shown: Shown | None = None
        self._pictured: Cycle | None = None  # the newest with pictures
        self._began: float | None = None
        self._answers = 0
        self._answer = ""
        self._stops = 0
        self._finished = ""
        self._row: dict[str, Any] = {}
        self._frame: int | None = None
        self._drawn: tuple[Plan, dict[str, Any]] | None = None

    # by the loop

    def see(self, cycle: "Cycle", loop: "Loop", stops: int) -> None:
        """Take in a turn of the loop; called between two of them.

        Args:
            cycle: what it saw and ordered.
            loop: looked at, no more.
            stops: how many stops of the page's the loop has taken.
        """
        machine, planned = loop.machine, loop.aim.planned
        self._began = cycle.t if self._began is None else self._began
        self._stops = stops
        if cycle.pair is not None:
            self._pictured = cycle
        said = device_lines(cycle, loop, self._told.setup.cell.watch)
        self._shown = Shown(
            time.monotonic(),
            cycle,
            tuple(machine.log),
            None if planned is None else planned.answer,
            grab_lacks(machine),
            loop.may_choose,
            said[0][1],
            said,
        )

    def answer(self, words: str) -> None:
        """Say what became of a request."""
        self._answer, self._answers = words, self._answers + 1

    def end(self, words: str) -> None:
        """Say how it ended."""
        self._finished = words

    # by the page

    def hello(self) -> dict[str, Any]:
        """What never changes."""
        told = self._told
        return {
            "mode": "grab",
            "title": told.robot,
            "description": told.description[:LONGEST_TEXT],
            "execute": told.execute,
            "duration_s": told.duration,
            "cameras": cameras_placed(told.rig, None),
        }

    def rows(self) -> list[dict[str, Any]]:
        """How it stands now, if that is news."""
        shown = self._shown
        if shown is None:
            return []
        row = {
            **self._of_state(shown),
            **seen_fields(
                None if self._pictured is None else self._pictured.seen, fresh=shown.fresh
            ),
            **known_fields(shown.cycle),
            "q_deg": degrees(shown.cycle.q),
            "scene": self._scene(shown.cycle),
            "stops": self._stops,
            "answers": self._answers,
            "answer": self._answer,
            "finished": self._finished,
        }
        news = [] if row == self._row else [row]
        self._row = row
        return news

    def state(self) -> dict[str, Any]:
        """The plan, the last passages, the devices; and whether the loop still turns."""
        shown = self._shown
        if shown is None:
            return {"plan": None, "way": None, "passages": [], "devices": [], "silent_s": 0.0}
        silent = 0.0 if self._finished else time.monotonic() - shown.at
        return {
            "plan": None if shown.planned is None else facts(shown.planned),
            "way": self._way(shown.planned),
            "passages": [self._passage(p) for p in shown.passages[: -PASSAGES - 1 : -1]],
            "devices": [{"name": n, "well": well, "sentence": s} for n, well, s in shown.lines],
            "silent_s": round(silent, 1) if silent > SILENT else 0.0,
        }

    def alarms(self) -> Sequence[dict[str, Any]]:
        """There are none: what is wrong is a state."""
        return ()

    def pictures(self) -> Sequence[tuple[int, dict[str, Any], bytes]]:
        """The newest pair, if it was not given yet."""
        cycle = self._pictured
        if cycle is None or cycle.pair is None or cycle.pair.frame == self._frame:
            return ()
        pair = cycle.pair
        self._frame = pair.frame
        return [
            (side, found_fields(cycle, side, self._told.rig), small_jpeg(image))
            for side, image in enumerate((pair.left, pair.right))
        ]

    def metrics(self) -> str:
        """State and target, for Prometheus."""
        shown = self._shown
        if shown is None:
            return ""
        seen = None if self._pictured is None else self._pictured.seen
        quality = 0.0 if seen is None else seen.quality
        return (
            "# TYPE verify_grab_state gauge\n"
            f'verify_grab_state{{state="{shown.cycle.state.value}"}} 1\n'
            "# TYPE verify_grab_target_quality_ratio gauge\n"
            f"verify_grab_target_quality_ratio {quality:.4f}\n"
        )

    def _of_state(self, shown: Shown) -> dict[str, Any]:
        cycle = shown.cycle
        return {
            "elapsed_s": round(cycle.t - (self._began or 0.0), 1),
            "state": cycle.state.value,
            "reason": cycle.reason,
            "moving": cycle.state in MOVING,
            "passages": len(shown.passages),
            "grab_lacks": shown.lacks,
            "may_choose": shown.may_choose,
        }

    def _passage(self, passage: Passage) -> dict[str, Any]:
        return {
            "elapsed_s": round(passage.t - (self._began or 0.0), 2),
            "state": passage.target.value,
            "event": passage.event.value,
            "reason": passage.reason,
        }

    def _scene(self, cycle: "Cycle") -> dict[str, Any]:
        """Arm as read, the target, and the cameras as they stood for the pictures shown."""
        pair = None if self._pictured is None else self._pictured.pair
        scene: dict[str, Any] = {"cameras": cameras_placed(self._told.rig, pair)}
        if cycle.q is not None:
            scene["arm_mm"] = millimetres(joint_origins(self._told.setup.arm, cycle.q))
        if cycle.known is not None:
            scene["target_mm"] = millimetres(cycle.known.thing.position[None])[0]
        return scene

    def _way(self, planned: Plan | Refusal | None) -> dict[str, Any] | None:
        """The arm at the object, and the grip point's way there; drawn once a plan."""
        if not isinstance(planned, Plan):
            return None
        if self._drawn is None or self._drawn[0] is not planned:
            setup = self._told.setup
            turns = np.concatenate(
                [way.sampled(way.duration / WAY)[1].q for way in (*planned.over, planned.down)]
            )
            drawn = {
                "arm_mm": millimetres(joint_origins(setup.arm, planned.posture.q_grip)),
                "grip_mm": millimetres(setup.workspace.grip(turns)[:, :3, 3]),
            }
            self._drawn = planned, drawn
        return self._drawn[1]
