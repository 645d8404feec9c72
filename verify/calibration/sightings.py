"""Pictures of a board to its corners: every pair of a folder, on all cores."""

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice

from verify.board import BoardPair, BoardView
from verify.board_folder import BoardFolder, BoardImages
from verify.calibration.find import find_board, seen_instead
from verify.errors import InputError

AHEAD = 2  # pairs a core that wait decoded: enough to keep it busy, few enough for memory
ASKED = 3  # pairs that are searched for another pattern before the search is given up

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
    if all(pair.left is None and pair.right is None for pair in pairs):
        raise _nothing_found(folder)
    return pairs


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
            images, left, right = waiting.popleft()
            yield BoardPair(
                images.frame, images.pan_left, images.pan_right, left.result(), right.result()
            )
            load(1)


def _nothing_found(folder: BoardFolder) -> InputError:
    board = folder.board
    expected = f"{board.columns} x {board.rows} inner corners are asked for"
    for images in islice(folder.pairs(), ASKED):
        for picture in (images.left, images.right):
            counts = seen_instead(picture, board)
            if counts is not None:
                found = f"the pictures show {counts[0]} x {counts[1]} inner corners"
                remedy = "Mend inner_corners in board.toml, or give --corners."
                return InputError(folder.folder, found, expected, remedy)
    remedy = "See that the whole board is in view, flat, sharp and evenly lit, with a white rim."
    return InputError(folder.folder, "no board was found in any picture", expected, remedy)


def show_pair(folder: BoardFolder, frames: Sequence[int]) -> BoardImages:
    """Take the middle one of some pairs' pictures again, for a report."""
    wanted = sorted(frames)[len(frames) // 2]
    return next(p for p in folder.pairs() if p.frame == wanted)
