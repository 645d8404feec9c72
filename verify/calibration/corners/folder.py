"""Find the board in every pair of images of a folder, on all cores.

Where the stated board is not found, the refusal names the pattern that the images show.
"""

import os
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice

import cv2
import numpy as np

from verify.calibration.corners.find import find_board, find_other_board, is_ambiguous, to_grey
from verify.core.fiducials import Board, BoardPair, BoardView, dictionary
from verify.core.records import Image, Progress
from verify.errors import InputError
from verify.io.board.folder import BoardFolder, BoardImages

MAX_PAIRS = 3  # searched before another pattern is looked for
MIN_AGREEING = 2  # images that must show another pattern
MIN_MARKERS = 4  # in an image: one or two are found in anything
# One of each kind: the smaller ones of a kind are its first markers.
MARKER_DICTIONARIES = (
    "DICT_4X4_250", "DICT_5X5_250", "DICT_6X6_250", "DICT_7X7_250", "DICT_ARUCO_ORIGINAL",
    "DICT_APRILTAG_36H11",
)  # fmt: skip
QUEUE_PER_CORE = 2  # pairs a core that wait decoded: enough to keep it busy, few enough for memory


def find_boards(folder: BoardFolder, progress: Progress) -> list[BoardPair]:
    """Find the board in both pictures of every pair.

    Returns as many pairs as the folder has, then its pictures of one camera alone; a view in which
    no board was found is None. `progress` is called with pairs done and pairs in all.

    Raises:
        InputError: no board in any picture; says which other pattern is there instead.
    """
    pairs: list[BoardPair] = []
    for pair in _in_order(folder):
        pairs.append(pair)
        progress(len(pairs), len(folder))
        if len(pairs) == min(MAX_PAIRS, len(folder)) and not _any_found(pairs):
            refuse_another_pattern(folder)
    if not _any_found(pairs):
        remedy = "See that the whole board is in view, flat, sharp, evenly lit, with a white rim."
        expected = f"{board_text(folder.board)} are asked for"
        raise InputError(folder.folder, "no board was found in any picture", expected, remedy)
    _refuse_sideways(folder, pairs)
    for frame, side, image in folder.single_pictures():
        view, pan = find_board(image, folder.board), (folder.pan_left, folder.pan_right)
        views = (view, None) if side == "left" else (None, view)
        pairs.append(BoardPair(frame, float(pan[0][frame]), float(pan[1][frame]), *views))
    return pairs


def middle_pair(folder: BoardFolder, frames: Sequence[int]) -> BoardImages:
    """Read the images of the middle one of some pairs again, for a report."""
    paired = sorted(f for f in frames if f < len(folder))
    wanted = paired[len(paired) // 2]
    return next(p for p in folder.pairs() if p.frame == wanted)


def _any_found(pairs: Sequence[BoardPair]) -> bool:
    return any(pair.left is not None or pair.right is not None for pair in pairs)


def _in_order(folder: BoardFolder) -> Iterator[BoardPair]:
    """Search on all cores (OpenCV leaves Python alone meanwhile), hand over in order."""
    workers = os.cpu_count() or 1
    with ThreadPoolExecutor(workers) as pool:
        waiting: deque[tuple[BoardImages, list[Future[BoardView | None]]]] = deque()
        pictures = folder.pairs()

        def load(count: int) -> None:
            for p in islice(pictures, count):
                views = [
                    pool.submit(find_board, image, folder.board) for image in (p.left, p.right)
                ]
                waiting.append((p, views))

        load(workers * QUEUE_PER_CORE)
        while waiting:
            p, views = waiting.popleft()
            yield BoardPair(p.frame, p.pan_left, p.pan_right, *(view.result() for view in views))
            load(1)


def _refuse_sideways(folder: BoardFolder, pairs: Sequence[BoardPair]) -> None:
    """Raise InputError for a board on its side, unless its colours determine the first corner."""
    board = folder.board
    if not is_ambiguous(board):
        return
    views = [view for pair in pairs for view in (pair.left, pair.right) if view is not None]
    lying = sum(_rows_run_down(view, board.columns) for view in views)
    if 2 * lying > len(views):
        found = f"{board.columns} corners run down most pictures, {board.rows} across"
        expected = f"{board_text(board)} are stated, along x and along y"
        remedy = "Swap the two numbers, or hold the board upright."
        raise InputError(folder.folder, found, expected, remedy)


def _rows_run_down(view: BoardView, columns: int) -> bool:
    """Whether a view's rows of corners run down the image rather than across."""
    beside = (np.diff(view.corner) == 1) & (view.corner[:-1] % columns != columns - 1)
    x, y = np.abs(np.diff(view.centre, axis=0)[beside].sum(axis=0))
    return bool(y > x)


def refuse_another_pattern(folder: BoardFolder) -> None:
    """Refuse pictures of another board, once two of the first ones agree on which.

    Raises:
        InputError: the pictures show other corner counts, markers where a plain board is stated,
            no markers or others where a ChArUco board is.
    """
    board = folder.board
    pictures = [p for pair in islice(folder.pairs(), MAX_PAIRS) for p in (pair.left, pair.right)]
    shown = board.markers is not None and _shows(pictures, board.markers)
    # markers first: to search a picture of them for plain boards of any counts takes long
    agreed = (name for name in MARKER_DICTIONARIES if _shows(pictures, name))
    kind = None if shown else next(agreed, None)
    charuco = f"board.toml says ChArUco, with markers of {board.markers}"
    if kind is not None and board.markers is not None:
        found = f"the pictures show markers as in {kind}"
        raise InputError(folder.folder, found, charuco, "Correct markers in board.toml.")
    if kind is not None:
        raise InputError(
            folder.folder,
            f"the pictures show a board with markers, as in {kind}",
            f"a plain one of {board_text(board)} is asked for",
            "Use the board.toml that `verify board --charuco` wrote, or add markers and marker_mm.",
        )
    counts = _counts(pictures, board)
    if counts is not None and board.markers is not None and not shown:
        raise InputError(
            folder.folder,
            "no marker was found in the pictures, which show a plain board of "
            f"{_corners_text(counts)}",
            charuco,
            "Delete markers and marker_mm from board.toml, or take pictures of the ChArUco board.",
        )
    if counts is not None and counts != (board.columns, board.rows):
        found = f"the pictures show {_corners_text(counts)}"
        remedy = "Correct inner_corners in board.toml, or give --corners."
        raise InputError(folder.folder, found, f"{board_text(board)} are asked for", remedy)


def board_text(board: Board) -> str:
    """Describe the board that is searched for."""
    corners = _corners_text((board.columns, board.rows))
    return corners if board.markers is None else f"{corners} with markers of {board.markers}"


def _corners_text(counts: tuple[int, int]) -> str:
    return f"{counts[0]} x {counts[1]} inner corners"


def _counts(pictures: Sequence[Image], board: Board) -> tuple[int, int] | None:
    """Corner counts of a plain chessboard on which pictures agree."""
    votes: Counter[tuple[int, int]] = Counter()
    for picture in pictures:
        counts = find_other_board(picture, board)
        votes[counts or (0, 0)] += 1
        if counts is not None and votes[counts] >= MIN_AGREEING:
            return counts
    return None


def _shows(pictures: Sequence[Image], markers: str) -> bool:
    """Whether pictures show markers of a dictionary."""
    detector = cv2.aruco.ArucoDetector(dictionary(markers))
    showing = 0
    for picture in pictures:
        _, numbers, _ = detector.detectMarkers(to_grey(picture))
        showing += numbers is not None and len(set(numbers.ravel().tolist())) >= MIN_MARKERS
        if showing >= MIN_AGREEING:
            return True
    return False
