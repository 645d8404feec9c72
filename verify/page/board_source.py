"""What the taking of board pictures has to show, units at the door: degrees, metres, pixels."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from verify.board import Board, BoardView
from verify.live.board_goals import Coverage
from verify.live.board_state import BoardState
from verify.live.board_still import STILL_PX
from verify.live.board_taken import Standing
from verify.page.pictures import small_jpeg
from verify.records import Image

LONGEST_TEXT = 2000  # characters of a description


class BoardSource:
    """Reads a state; nothing waits for it.

    Args:
        state: of the taking.
        board: the pattern.
        description: what else the page says on top.
    """

    def __init__(self, state: BoardState, board: Board, description: str) -> None:
        self._state, self._board, self._description = state, board, description
        self._shown = 0
        self._told: dict[str, Any] = {}

    def hello(self) -> dict[str, Any]:
        """What never changes."""
        board = self._board
        pattern = f"{board.columns} x {board.rows} inner corners of {board.square * 1e3:g} mm"
        return {
            "mode": "calibrate",
            "title": "Calibration",
            "description": f"{self._description[:LONGEST_TEXT]}: {pattern}",
            "still_px": STILL_PX,
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
            "now": [_standing(s) for s in now.standings],
            "finished": now.finished,
        }
        news = [] if row == self._told else [row]
        self._told = row
        return news

    def state(self) -> dict[str, Any]:
        """What was covered, and what is missing."""
        now = self._state.snapshot()
        return {
            "goals": [
                {"name": goal.name, "reached": goal.reached, "words": goal.words}
                for goal in now.goals
            ],
            "coverage": [_coverage(c) for c in now.coverage],
            "devices": [
                {"name": line.name, "well": line.well, "sentence": line.sentence}
                for line in now.devices
            ],
        }

    def alarms(self) -> Sequence[dict[str, Any]]:
        """There are none."""
        return ()

    def pictures(self) -> Sequence[tuple[int, dict[str, Any], bytes]]:
        """The newest pair, if it was not given yet."""
        look = self._state.snapshot().look
        if look is None or look.number == self._shown:
            return ()
        self._shown = look.number
        return [
            (side, _found(image, view), small_jpeg(image))
            for side, (image, view) in enumerate(zip(look.images, look.views, strict=True))
        ]

    def metrics(self) -> str:
        """How many pairs there are, for Prometheus."""
        pairs = self._state.snapshot().pairs
        return f"# TYPE verify_board_pairs gauge\nverify_board_pairs {pairs}\n"


def _found(image: Image, view: BoardView | None) -> dict[str, Any]:
    height, width = image.shape[:2]
    corners = [] if view is None else np.round(view.centre, 1).tolist()
    return {"width": width, "height": height, "corners": corners}


def _coverage(covered: Coverage) -> dict[str, Any]:
    return {
        "cells": covered.cells.astype(int).tolist(),
        "standings": [_standing(s) for s in covered.standings],
    }


def _standing(standing: Standing) -> dict[str, float]:
    stance = standing.stance
    return {
        "about_horizontal_deg": round(float(np.rad2deg(stance.about_horizontal)), 1),
        "about_vertical_deg": round(float(np.rad2deg(stance.about_vertical)), 1),
        "distance_m": round(stance.distance, 3),
    }
