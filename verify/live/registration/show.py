"""The state of recording a motion, in a terminal and for the page."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from verify.core.records import Array
from verify.live.outputs.terminal import render_devices
from verify.live.registration.goals import RegistrationGoal
from verify.live.snapshot import MAX_TEXT_LENGTH, PairLook, SharedSnapshot, SnapshotPageSource
from verify.live.state import DeviceStatus


@dataclass(frozen=True, slots=True)
class SpotDetection(PairLook):
    """A pair and the spots found in it."""

    centres: tuple[Array, Array]  # (m, 2) each, px
    leds: int  # that both cameras may have seen


@dataclass(frozen=True, slots=True)
class RecordingSnapshot:
    """Everything that there is to say, at one moment."""

    pairs: int = 0
    readings: int = 0
    dropped: Mapping[str, int] = field(default_factory=dict)
    goals: tuple[RegistrationGoal, ...] = ()
    devices: tuple[DeviceStatus, ...] = ()
    recording: str = ""
    finished: bool = False
    look: SpotDetection | None = None


RecordingState = SharedSnapshot[RecordingSnapshot]


BAR_WIDTH = 20  # characters
TITLE = "What `verify calibrate register` still needs"
COMPLETE = "The motion has all that `verify calibrate register` needs"


def title(goals: Sequence[RegistrationGoal]) -> str:
    """Head of the bars: whether anything is missing."""
    return COMPLETE if goals and all(goal.reached for goal in goals) else TITLE


def bar(goal: RegistrationGoal) -> str:
    """Draw how far a goal is, in characters."""
    full = int(goal.share * BAR_WIDTH)
    return "█" * full + "░" * (BAR_WIDTH - full)


def goal_fields(goal: RegistrationGoal) -> dict[str, Any]:
    """Write a goal as JSON has it."""
    return {
        "name": goal.name,
        "value": round(goal.value, 1),
        "target": goal.target,
        "unit": goal.unit.strip(),
        "share": round(goal.share, 3),
        "reached": goal.reached,
        "words": goal.words,
    }


def render_recording(now: RecordingSnapshot) -> RenderableType:
    """Lay a snapshot out."""
    goals = Table(box=None, show_header=False, pad_edge=False)
    for goal in now.goals:
        style = "green" if goal.reached else "yellow"
        words = Text(goal.words, style="dim" if goal.reached else "")
        goals.add_row(goal.name, Text(bar(goal), style=style), words)
    text = f"\n{now.pairs} pairs, {now.readings} readings"
    if now.look is not None:
        left, right = map(len, now.look.centres)
        text += f"; spots: {left} left, {right} right"
    if now.dropped:
        text += "; dropped " + ", ".join(f"{reason} ({n})" for reason, n in now.dropped.items())
    keys = Text("Ctrl-C: finish", style="dim")
    devices = render_devices(now.devices, now.recording)
    return Group(
        Text(title(now.goals), style="bold"), goals, Text(text, style="dim"), devices, keys
    )


class RecordingPageSource(SnapshotPageSource[RecordingSnapshot]):
    """Reads a recording's state; nothing waits for it."""

    def __init__(
        self, state: RecordingState, robot: str, description: str, duration: float | None
    ) -> None:
        super().__init__(state)
        self._robot, self._description = robot, description
        self._ends = None if duration is None else round(time.time() + duration, 1)

    def hello(self) -> dict[str, Any]:
        """What never changes."""
        return {
            "mode": "record",
            "title": f"Recording of {self._robot}",
            "description": self._description[:MAX_TEXT_LENGTH],
            "ends_s": self._ends,
        }

    def rows(self) -> list[dict[str, Any]]:
        """How far the goals are, if that is news."""
        now = self._state.snapshot()
        row = {
            "title": title(now.goals),
            "goals": [goal_fields(goal) for goal in now.goals],
            "finished": now.finished,
        }
        return self.news(row)

    def state(self) -> dict[str, Any]:
        """How everything is."""
        now = self._state.snapshot()
        return {
            "pairs": now.pairs,
            "readings": now.readings,
            "dropped": dict(now.dropped),
            "recording": now.recording,
            "devices": [asdict(line) for line in now.devices],
        }

    def pictures(self) -> Sequence[tuple[int, dict[str, Any], bytes]]:
        """The newest pair in which spots were looked for, if it was not given yet."""
        look = self._state.snapshot().look
        centres = () if look is None else look.centres
        return self.new_pictures(look, centres, lambda c: {"spots": np.round(c, 1).tolist()})

    def metrics(self) -> str:
        """Counts for Prometheus."""
        now = self._state.snapshot()
        return (
            f"# TYPE verify_recorded_pairs gauge\nverify_recorded_pairs {now.pairs}\n"
            f"# TYPE verify_recorded_readings gauge\nverify_recorded_readings {now.readings}\n"
        )
