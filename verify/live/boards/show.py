"""The state of taking board pictures, in a terminal and for the page (degrees, metres, pixels)."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from verify.core.fiducials import Board, BoardView
from verify.live.boards.goals import BoardGoal, BoardPlacement, CameraCoverage
from verify.live.boards.view import MAX_MOTION_PX
from verify.live.outputs.terminal import render_devices
from verify.live.snapshot import MAX_TEXT_LENGTH, PairLook, SharedSnapshot, SnapshotPageSource
from verify.live.state import DeviceStatus

SEARCHING = "searching"  # nothing to take
REPEATED = "alike"  # it would repeat a pair; by hand it can be taken
MOVING = "moving"  # likewise
READY = "ready"  # taken by itself


@dataclass(frozen=True, slots=True)
class BoardDetection(PairLook):
    """The newest pair and what was found in it."""

    views: tuple[BoardView | None, BoardView | None]


@dataclass(frozen=True, slots=True)
class BoardSnapshot:
    """Everything that there is to say, at one moment."""

    pairs: int = 0
    status: str = SEARCHING
    words: str = "waiting for the cameras"
    motion: float | None = None  # px
    last: str = ""  # what became of the last pair that was taken or asked for
    goals: tuple[BoardGoal, ...] = ()
    coverage: tuple[CameraCoverage, ...] = ()  # left, right
    placements: tuple[BoardPlacement, ...] = ()  # of the board now, on either side; () if not seen
    devices: tuple[DeviceStatus, ...] = ()
    finished: bool = False
    look: BoardDetection | None = None


BoardState = SharedSnapshot[BoardSnapshot]


SHADES = " ░▒▓█"  # of a cell with no corner, with some, with many
MANY_CORNERS = 12  # corners in a cell
STYLES = {READY: "bold green", MOVING: "yellow"}


def render_snapshot(now: BoardSnapshot, help_: str) -> RenderableType:
    """Lay a snapshot out."""
    goals = Table(box=None, show_header=False, pad_edge=False)
    for goal in now.goals:
        mark = Text("●", style="green") if goal.reached else Text("○", style="yellow")
        goals.add_row(mark, goal.name, Text(goal.words, style="dim" if goal.reached else ""))
    maps = Table("left", "right", box=None, pad_edge=False)  # both images, a sign for each cell
    maps.add_row(*map(_coverage_map, now.coverage))
    devices = render_devices(now.devices)
    words = Text(now.words, style=STYLES.get(now.status, "cyan"))
    last, keys = Text(now.last, style="dim"), Text(help_, style="dim")
    return Group(maps, goals, devices, last, words, keys)


def _coverage_map(covered: CameraCoverage) -> Text:
    last = len(SHADES) - 1
    lines = [
        "".join(2 * SHADES[min(-(-int(n) * last // MANY_CORNERS), last)] for n in row)
        for row in covered.cells
    ]
    return Text("\n".join(lines), style="green on grey23")


class BoardPageSource(SnapshotPageSource[BoardSnapshot]):
    """Reads a state; nothing waits for it."""

    def __init__(self, state: BoardState, board: Board, description: str) -> None:
        super().__init__(state)
        self._board, self._description = board, description

    def hello(self) -> dict[str, Any]:
        """What never changes."""
        board = self._board
        pattern = f"{board.columns} x {board.rows} inner corners of {board.square * 1e3:g} mm"
        return {
            "mode": "calibrate",
            "title": "Calibration",
            "description": f"{self._description[:MAX_TEXT_LENGTH]}: {pattern}",
            "still_px": MAX_MOTION_PX,
        }

    def rows(self) -> list[dict[str, Any]]:
        """How the board stands now, if that is news."""
        now = self._state.snapshot()
        row = {
            "status": now.status,
            "words": now.words,
            "motion_px": None if now.motion is None else round(float(now.motion), 2),
            "pairs": now.pairs,
            "last": now.last,
            "now": [_placement(s) for s in now.placements],
            "finished": now.finished,
        }
        return self.news(row)

    def state(self) -> dict[str, Any]:
        """What was covered, and what is missing."""
        now = self._state.snapshot()
        return {
            "goals": [asdict(goal) for goal in now.goals],
            "coverage": [
                {
                    "cells": c.cells.astype(int).tolist(),
                    "placements": [*map(_placement, c.placements)],
                }
                for c in now.coverage
            ],
            "devices": [asdict(line) for line in now.devices],
        }

    def pictures(self) -> Sequence[tuple[int, dict[str, Any], bytes]]:
        """The newest pair, if it was not given yet."""
        look = self._state.snapshot().look
        return self.new_pictures(
            look,
            () if look is None else look.views,
            lambda view: {"corners": [] if view is None else np.round(view.centre, 1).tolist()},
        )

    def metrics(self) -> str:
        """How many pairs there are, for Prometheus."""
        pairs = self._state.snapshot().pairs
        return f"# TYPE verify_board_pairs gauge\nverify_board_pairs {pairs}\n"


def _placement(placement: BoardPlacement) -> dict[str, float]:
    orientation = placement.orientation
    return {
        "about_horizontal_deg": round(float(np.rad2deg(orientation.about_horizontal)), 1),
        "about_vertical_deg": round(float(np.rad2deg(orientation.about_vertical)), 1),
        "distance_m": round(orientation.distance, 3),
    }
