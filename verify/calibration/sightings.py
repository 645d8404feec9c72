"""Pictures of a board to its corners: every pair of a folder, on all cores."""

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice

import numpy as np

from verify.board import BoardPair, BoardView
from verify.board_folder import BoardFolder, BoardImages
from verify.calibration.find import ambiguous, find_board
from verify.calibration.other_pattern import LOOKED_AT, asked, refuse_another_pattern
from verify.errors import InputError

AHEAD = 2  # pairs a core that wait decoded: enough to keep it busy, few enough for memory

Progress = Callable[[int, int], None]


def see_boards(folder: BoardFolder, progress: Progress) -> list[BoardPair]:
    """Find the board in both pictures of every pair.

    Args:
        folder: the opened pictures.
        progress: called with pairs done and pairs in all.

    Returns:
        As many pairs as the folder has; a view in which no board was found is None.

    Raises:
        InputError: no board in any picture; says which other pattern is there instead.
    """
    pairs: list[BoardPair] = []
    for pair in _in_order(folder):
        pairs.append(pair)
        progress(len(pairs), len(folder))
        if len(pairs) == min(LOOKED_AT, len(folder)) and not _any_found(pairs):
            refuse_another_pattern(folder)
    if not _any_found(pairs):
        remedy = "See that the whole board is in view, flat, sharp, evenly lit, with a white rim."
        expected = f"{asked(folder.board)} are asked for"
        raise InputError(folder.folder, "no board was found in any picture", expected, remedy)
    _refuse_lying(folder, pairs)
    return pairs


def _any_found(pairs: Sequence[BoardPair]) -> bool:
    return any(pair.left is not None or pair.right is not None for pair in pairs)


def _in_order(folder: BoardFolder) -> Iterator[BoardPair]:
    """Search on all cores (OpenCV leaves Python alone meanwhile), hand over in order."""
    workers = os.cpu_count() or 1
    with ThreadPoolExecutor(workers) as pool:
        waiting: deque[tuple[BoardImages, Future[BoardView | None], Future[BoardView | None]]]
        waiting = deque()
        pictures = folder.pairs()

        def load(count: int) -> None:
            for p in islice(pictures, count):
                views = [
                    pool.submit(find_board, image, folder.board) for image in (p.left, p.right)
                ]
                waiting.append((p, views[0], views[1]))

        load(workers * AHEAD)
        while waiting:
            p, left, right = waiting.popleft()
            yield BoardPair(p.frame, p.pan_left, p.pan_right, left.result(), right.result())
            load(1)


def _refuse_lying(folder: BoardFolder, pairs: Sequence[BoardPair]) -> None:
    """Refuse a board held on its side whose colours do not tell which corner is the first.

    Raises:
        InputError: its columns run down most of the pictures.
    """
    board = folder.board
    if not ambiguous(board):
        return
    views = [view for pair in pairs for view in (pair.left, pair.right) if view is not None]
    lying = sum(_runs_down(view, board.columns) for view in views)
    if 2 * lying > len(views):
        found = f"{board.columns} corners run down most pictures, {board.rows} across"
        expected = f"{asked(board)} are stated, along x and along y"
        remedy = "Swap the two numbers, or hold the board upright."
        raise InputError(folder.folder, found, expected, remedy)


def _runs_down(view: BoardView, columns: int) -> bool:
    """Whether a view's rows of corners run down the image rather than across."""
    beside = (np.diff(view.corner) == 1) & (view.corner[:-1] % columns != columns - 1)
    x, y = np.abs(np.diff(view.centre, axis=0)[beside].sum(axis=0))
    return bool(y > x)


def show_pair(folder: BoardFolder, frames: Sequence[int]) -> BoardImages:
    """Take the middle one of some pairs' pictures again, for a report."""
    wanted = sorted(frames)[len(frames) // 2]
    return next(p for p in folder.pairs() if p.frame == wanted)
