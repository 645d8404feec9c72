"""Pictures in which the stated board was not found: which pattern they show instead."""

from collections import Counter
from collections.abc import Sequence
from itertools import islice

import cv2

from verify.board import Board
from verify.board_folder import BoardFolder
from verify.board_markers import dictionary
from verify.calibration.find import grey_of, seen_instead
from verify.errors import InputError
from verify.records import Image

LOOKED_AT = 3  # pairs
AGREEING = 2  # pictures that must show it
FEWEST_MARKERS = 4  # in a picture: one or two are seen in anything
# One of each kind: the smaller ones of a kind are its first markers.
KINDS = (
    "DICT_4X4_250",
    "DICT_5X5_250",
    "DICT_6X6_250",
    "DICT_7X7_250",
    "DICT_ARUCO_ORIGINAL",
    "DICT_APRILTAG_36H11",
)


def refuse_another_pattern(folder: BoardFolder) -> None:
    """Refuse pictures of another board, once two of the first ones agree on which.

    Raises:
        InputError: the pictures show other corner counts, markers where a plain board is stated,
            no markers or others where a ChArUco board is.
    """
    board = folder.board
    pictures = [p for pair in islice(folder.pairs(), LOOKED_AT) for p in (pair.left, pair.right)]
    if board.markers is not None and not _shows(pictures, board.markers):
        _refuse_without_its_markers(folder, pictures, board.markers)
    # markers first: to search a picture of them for plain boards of any counts takes long
    if board.markers is None and (kind := _kind(pictures)) is not None:
        raise InputError(
            folder.folder,
            f"the pictures show a board with markers, as in {kind}",
            f"a plain one of {asked(board)} is asked for",
            "Use the board.toml that `verify board --charuco` wrote, or add markers and marker_mm.",
        )
    counts = _counts(pictures, board)
    if counts is not None and counts != (board.columns, board.rows):
        found = f"the pictures show {_by(counts)}"
        remedy = "Mend inner_corners in board.toml, or give --corners."
        raise InputError(folder.folder, found, f"{asked(board)} are asked for", remedy)


def asked(board: Board) -> str:
    """Say which board is looked for."""
    corners = _by((board.columns, board.rows))
    return corners if board.markers is None else f"{corners} with markers of {board.markers}"


def _by(counts: tuple[int, int]) -> str:
    return f"{counts[0]} x {counts[1]} inner corners"


def _refuse_without_its_markers(
    folder: BoardFolder, pictures: Sequence[Image], markers: str
) -> None:
    """Refuse where none of the stated markers is seen but another board is."""
    kind = _kind(pictures)
    expected = f"board.toml says ChArUco, with markers of {markers}"
    if kind is not None:
        found = f"the pictures show markers as in {kind}"
        raise InputError(folder.folder, found, expected, "Mend markers in board.toml.")
    counts = _counts(pictures, folder.board)
    if counts is not None:
        raise InputError(
            folder.folder,
            f"no marker was found in the pictures, which show a plain board of {_by(counts)}",
            expected,
            "Delete markers and marker_mm from board.toml, or take pictures of the ChArUco board.",
        )


def _counts(pictures: Sequence[Image], board: Board) -> tuple[int, int] | None:
    """Corner counts of a plain chessboard on which pictures agree."""
    seen: Counter[tuple[int, int]] = Counter()
    for picture in pictures:
        counts = seen_instead(picture, board)
        if counts is None:
            continue
        seen[counts] += 1
        if seen[counts] >= AGREEING:
            return counts
    return None


def _kind(pictures: Sequence[Image]) -> str | None:
    """The kind of markers on which pictures agree."""
    return next((kind for kind in KINDS if _shows(pictures, kind)), None)


def _shows(pictures: Sequence[Image], markers: str) -> bool:
    """Whether pictures show markers of a dictionary."""
    detector = cv2.aruco.ArucoDetector(dictionary(markers))
    showing = 0
    for picture in pictures:
        _, numbers, _ = detector.detectMarkers(grey_of(picture))
        showing += numbers is not None and len(set(numbers.ravel().tolist())) >= FEWEST_MARKERS
        if showing >= AGREEING:
            return True
    return False
