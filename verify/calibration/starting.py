"""The pairs that a calibration rests on, and where its adjustment begins."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from verify.board import Board, BoardPair, BoardView
from verify.calibration import bases, initial, refusals
from verify.calibration.gauge import FIXED
from verify.calibration.parameters import SIDES, State
from verify.calibration.relation import relate

FEWEST_CORNERS = 6  # twelve coordinates for the six of a pose: below that a view says little
FLAT = 0.5  # squares, second extent of the corners seen: on one line they fix no pose


@dataclass(frozen=True, slots=True)
class Starting:
    """What the adjustment begins with."""

    pairs: tuple[BoardPair, ...]  # those that are used, with the views that are
    state: State
    bases: tuple[str, str]
    notes: tuple[str, ...]  # what was left out and why


def gather(pairs: Sequence[BoardPair], board: Board, image_size: tuple[int, int]) -> Starting:
    """Choose the pairs to be used and find start values.

    Raises:
        InputError: as `boards.calibrate` says, but for boards that leave a lens open.
    """
    usable, notes = _sorted_out([_usable(p, board) for p in pairs], board)
    _counted(usable)
    lenses = [initial.rough_lens(_views(usable, side), board, image_size) for side in (0, 1)]
    readings = np.array([[p.pan_left, p.pan_right] for p in usable])
    kinds = bases.turned(readings)
    relation = relate(lenses[0].poses, lenses[1].poses, board, readings, kinds)
    frames = [p.frame for p in usable]
    refusals.half_turned(relation, [lens.poses for lens in lenses], frames)
    both = sum(p.left is not None and p.right is not None for p in usable)
    refusals.inconsistent(relation, both, kinds != (FIXED, FIXED), four_fold=board.four_fold)
    refusals.swapped(relation)
    strangers = sorted(set(relation.strangers) - set(relation.quarter_turned))
    if strangers:
        named = refusals.listed([frames[i] for i in strangers])
        notes.append(f"{named} left out: the cameras stand otherwise there than in the others.")
    if relation.quarter_turned:
        named = refusals.listed([frames[i] for i in relation.quarter_turned])
        notes.append(
            f"{named} left out: one camera numbers the board's corners a quarter turn from the "
            "other, which a square board of even counts cannot tell; hold it upright."
        )
    places = [
        i
        for i, pair in enumerate(usable)
        if i not in relation.strangers and not (pair.left is None and pair.right is None)
    ]
    kept = tuple(usable[i] for i in places)
    _counted(kept)
    state = initial.start(lenses, relation, readings, places, kinds)
    return Starting(kept, state, kinds, tuple(notes))


def _views(pairs: Sequence[BoardPair], side: int) -> dict[int, BoardView]:
    return {i: v for i, p in enumerate(pairs) if (v := (p.left, p.right)[side]) is not None}


def _sorted_out(pairs: list[BoardPair], board: Board) -> tuple[list[BoardPair], list[str]]:
    """Drop the views in which something else was taken for the board, and say so."""
    notes = []
    for side, name in enumerate(SIDES):
        out = initial.foreign(_views(pairs, side), board)
        for i in out:
            pairs[i] = replace(pairs[i], left=None) if side == 0 else replace(pairs[i], right=None)
        if out:
            named = refusals.listed([pairs[i].frame for i in out])
            notes.append(
                f"{name} camera: {named} left out, as what was found there is no picture of the "
                "board."
            )
    return pairs, notes


def _usable(pair: BoardPair, board: Board) -> BoardPair:
    return replace(pair, left=usable_view(pair.left, board), right=usable_view(pair.right, board))


def usable_view(view: BoardView | None, board: Board) -> BoardView | None:
    """Take a view whose corners fix a board's pose; None: too few of them, or all on one line."""
    if view is None or len(view) < FEWEST_CORNERS:
        return None
    points = board.points[view.corner, :2]
    extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return view if extent[1] > FLAT * board.square else None


def _counted(pairs: Sequence[BoardPair]) -> None:
    refusals.unseen(
        left=sum(p.left is not None for p in pairs),
        right=sum(p.right is not None for p in pairs),
        both=sum(p.left is not None and p.right is not None for p in pairs),
        pairs=len(pairs),
    )
