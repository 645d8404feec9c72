"""How a board lies on paper: where the pattern stands, its black areas, the rulers beside it.

Millimetres throughout, x to the right and y down from the sheet's top left corner: this is a
door, to paper.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from verify import board_markers
from verify.board import Board
from verify.errors import InputError
from verify.records import Array
from verify.toml_file import did_you_mean

PAPERS_MM = {  # ISO 216, upright; smallest first
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "A2": (420.0, 594.0),
    "A1": (594.0, 841.0),
    "A0": (841.0, 1189.0),
}
EDGE_MM = 5.0  # few printers reach the paper's rim
RULER_MM = 8.0  # width of the strip that holds a ruler
TEXT_MM = 17.0  # height of the block of text
ARROW_MM = 16.0  # length of the strip that holds the mark for "up"
WHITE_MM = 5.0  # around the pattern at least; corner finders like a whole square

_MM = 1e-3  # m


@dataclass(frozen=True, slots=True)
class Layout:
    """A sheet of paper with the places of what is printed on it, mm."""

    paper: str
    page: tuple[float, float]  # width, height
    pattern: tuple[float, float, float, float]  # x, y, width, height
    white: float  # around the pattern, at the narrowest side
    across: tuple[float, float, float]  # ruler to the right: where its 0 is, and its length
    up: tuple[float, float, float]  # ruler upwards, likewise
    arrow: tuple[float, float]  # tip of the mark for "up"
    text: tuple[float, float, float]  # corner of the text block, and its length
    text_upwards: bool  # the text runs up the right side instead of along the bottom


def lay_out(board: Board, paper: str | None = None) -> Layout:
    """Place a board on paper.

    Args:
        board: what to print.
        paper: a key of `PAPERS_MM`; None: the smallest that holds it.

    Returns:
        The layout, upright or sideways, that leaves most white around the pattern.

    Raises:
        InputError: no such paper, or the board does not fit.
    """
    if paper is not None and paper.upper() not in PAPERS_MM:
        expected = f"known are {', '.join(PAPERS_MM)}"
        remedy = f"Choose one of them.{did_you_mean(paper.upper(), tuple(PAPERS_MM))}"
        raise InputError("--paper", f'"{paper}" is not known', expected, remedy)
    for name in PAPERS_MM if paper is None else (paper.upper(),):
        fitting = [layout for layout in _layouts(board, name) if layout.white >= WHITE_MM]
        if fitting:
            return max(fitting, key=lambda layout: layout.white)
    raise _too_large(board, (paper or "A0").upper())


def black(board: Board) -> Array:
    """Find the black areas, (n, 4): x, y, width, height, mm, from the pattern's own top left.

    They share edges but do not overlap. The square at the top left is black, as OpenCV has it.
    """
    square = board.square / _MM
    squares = [
        (column * square, row * square, square, square)
        for row in range(board.rows + 1)
        for column in range(board.columns + 1)
        if (row + column) % 2 == 0
    ]
    return np.array([*squares, *_marker_cells(board)])


def ticks(length: float) -> list[tuple[float, float]]:
    """List a ruler's ticks: how far along, and how long, mm; one a millimetre."""
    sizes = {0: 4.0, 5: 3.0}
    return [(float(at), sizes.get(at % 10, 2.0)) for at in range(int(length) + 1)]


def words(board: Board, layout: Layout) -> list[str]:
    """Say what the board is, how to print it and how to check the print."""
    columns, rows, square = board.columns, board.rows, board.square / _MM
    kind = "Checkerboard"
    if board.markers is not None and board.marker is not None:
        kind = f"ChArUco board ({board.markers}, markers of {board.marker / _MM:g} mm)"
    _, _, width, height = layout.pattern
    counts = f"{columns} × {rows} inner corners ({columns + 1} × {rows + 1} squares)"
    sizes = f"the pattern is {width:g} mm wide and {height:g} mm high; both rulers begin at 0."
    remedy = (
        "If the print is off by the same share both ways, write the square's true size into "
        "board.toml; if not, use another printer."
    )
    return [
        f"{kind}: {counts}, squares of {square:g} mm, {layout.paper}.",
        'Print at 100 % ("actual size"); do not fit to page.',
        f"Check with a steel rule: {sizes} {remedy}",
        "Glue it flat onto a stiff plate. In the pictures the arrow points up.",
    ]


def _layouts(board: Board, paper: str) -> Iterator[Layout]:
    """Try the sheet upright and sideways, the text at the bottom and at the side."""
    short, long = PAPERS_MM[paper]
    for page in ((short, long), (long, short)):
        for text_upwards in (False, True):
            yield _layout(board, paper, page, text_upwards)


def _layout(board: Board, paper: str, page: tuple[float, float], text_upwards: bool) -> Layout:
    square = board.square / _MM
    width, height = (board.columns + 1) * square, (board.rows + 1) * square
    left, bottom = EDGE_MM + RULER_MM, EDGE_MM + RULER_MM
    right = EDGE_MM + TEXT_MM if text_upwards else 0.0
    bottom += 0.0 if text_upwards else TEXT_MM
    white = (page[0] - left - right - width) / 2, (page[1] - bottom - height) / 2
    ruler_y = page[1] - bottom
    across = _tens(page[0] - right - left - EDGE_MM)
    up = _tens(ruler_y - EDGE_MM - ARROW_MM)
    return Layout(
        paper=paper,
        page=page,
        pattern=(left + white[0], white[1], width, height),
        white=min(white),
        across=(left, ruler_y, across),
        up=(left, ruler_y, up),
        arrow=(EDGE_MM + RULER_MM / 2, EDGE_MM),
        text=(page[0] - EDGE_MM - TEXT_MM, EDGE_MM, page[1] - 2 * EDGE_MM)
        if text_upwards
        else (EDGE_MM, page[1] - EDGE_MM - TEXT_MM, page[0] - 2 * EDGE_MM),
        text_upwards=text_upwards,
    )


def _tens(length: float) -> float:
    return 10.0 * (length // 10)


def _marker_cells(board: Board) -> Iterator[tuple[float, float, float, float]]:
    """Find the black cells of the markers, neighbours in a row joined."""
    if board.markers is None or board.marker is None:
        return
    drawn = board_markers.charuco(board)
    size = board_markers.dictionary(board.markers).markerSize + 2  # its black border is a cell wide
    cell = board.marker / _MM / size
    for corners, number in zip(drawn.getObjPoints(), np.ravel(drawn.getIds()), strict=True):
        x, y = np.asarray(corners)[0, :2] / _MM
        image = board_markers.dictionary(board.markers).generateImageMarker(int(number), size)
        for row, bits in enumerate(np.asarray(image) == 0):
            edges = np.flatnonzero(np.diff(np.concatenate([[False], bits, [False]])))
            for first, last in edges.reshape(-1, 2):
                yield x + first * cell, y + row * cell, (last - first) * cell, cell


def _too_large(board: Board, paper: str) -> InputError:
    """Say what would fit instead."""
    columns, rows, square = board.columns, board.rows, board.square / _MM
    found = f"{columns} x {rows} corners of {square:g} mm do not fit on {paper}"
    largest = max(
        min((page[0] - strips[0]) / (columns + 1), (page[1] - strips[1]) / (rows + 1))
        for page in (PAPERS_MM[paper], PAPERS_MM[paper][::-1])
        for strips in (_strips(False), _strips(True))
    )
    expected = f"the largest squares that would are {np.floor(largest * 10) / 10:g} mm"
    larger = [
        name
        for name in PAPERS_MM
        if any(layout.white >= WHITE_MM for layout in _layouts(board, name))
    ]
    remedy = f"Choose smaller squares or --paper {larger[0]}." if larger else ""
    return InputError("--paper", found, expected, remedy or "Choose smaller squares.")


def _strips(text_upwards: bool) -> tuple[float, float]:
    """Add up what the pattern cannot have of the sheet's width and height, mm."""
    beside = EDGE_MM + RULER_MM + 2 * WHITE_MM
    if text_upwards:
        return beside + EDGE_MM + TEXT_MM, beside
    return beside, beside + TEXT_MM
