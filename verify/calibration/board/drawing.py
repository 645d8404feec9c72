"""Print a board: its layout on paper, its black areas and rulers, and the sheet as PDF and PNG.

Millimetres throughout, x to the right and y down from the sheet's top left corner. The sheet is set
by typst; every coordinate is the layout's own.
"""

import io
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
import typst
from PIL import Image

from verify.core import fiducials
from verify.core.fiducials import Board
from verify.core.records import Array
from verify.errors import InputError
from verify.io.toml import MM, did_you_mean

PAPERS_MM = {  # ISO 216, upright; smallest first
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "A2": (420.0, 594.0),
    "A1": (594.0, 841.0),
    "A0": (841.0, 1189.0),
}
PAGE_MARGIN_MM = 5.0  # few printers reach the paper's rim
RULER_MM = 8.0  # width of the strip that holds a ruler
TEXT_MM = 17.0  # height of the block of text
ARROW_MM = 16.0  # length of the strip that holds the mark for "up"
QUIET_ZONE_MM = 5.0  # around the pattern at least; corner finders like a whole square
# px/mm of the PNG: whole, so that pHYs states it exactly; 36 megapixels at most
PX_PER_MM = {"A4": 12, "A3": 12, "A2": 12, "A1": 8, "A0": 6}
MM_PER_INCH = 25.4


@dataclass(frozen=True, slots=True)
class PageLayout:
    """A sheet of paper with the places of what is printed on it, mm."""

    paper: str
    page: tuple[float, float]  # width, height
    pattern: tuple[float, float, float, float]  # x, y, width, height
    white: float  # around the pattern, at the narrowest side
    across: tuple[float, float, float]  # ruler to the right: where its 0 is, and its length
    up: tuple[float, float, float]  # ruler upwards: where its 0 is, and its length
    arrow: tuple[float, float]  # tip of the mark for "up"
    text: tuple[float, float, float]  # corner of the text block, and its length
    text_upwards: bool  # the text runs up the right side instead of along the bottom


def lay_out(board: Board, paper: str | None = None) -> PageLayout:
    """Place a board on paper, a key of `PAPERS_MM`; None: the smallest that holds it.

    Returns the layout, upright or sideways, that leaves most white around the pattern.

    Raises:
        InputError: no such paper, or the board does not fit.
    """
    if paper is not None and paper.upper() not in PAPERS_MM:
        expected = f"known are {', '.join(PAPERS_MM)}"
        remedy = f"Choose one of them.{did_you_mean(paper.upper(), tuple(PAPERS_MM))}"
        raise InputError("--paper", f'"{paper}" is not known', expected, remedy)
    for name in PAPERS_MM if paper is None else (paper.upper(),):
        fitting = _fitting_layouts(board, name)
        if fitting:
            return max(fitting, key=lambda layout: layout.white)
    raise _size_refusal(board, (paper or "A0").upper())


def black_areas(board: Board) -> Array:
    """Find the black areas, (n, 4): x, y, width, height, mm, from the pattern's own top left.

    They share edges but do not overlap. The square at the top left is black, as OpenCV has it.
    """
    square = board.square / MM
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


def print_instructions(board: Board, layout: PageLayout) -> list[str]:
    """Describe the board, how to print it and how to check the print."""
    columns, rows, square = board.columns, board.rows, board.square / MM
    kind = "Checkerboard"
    if board.markers is not None and board.marker is not None:
        kind = f"ChArUco board ({board.markers}, markers of {board.marker / MM:g} mm)"
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


def _fitting_layouts(board: Board, paper: str) -> list[PageLayout]:
    """Lay the sheet out upright and sideways, the text at the bottom and at the side."""
    pages = PAPERS_MM[paper], PAPERS_MM[paper][::-1]
    layouts = [_layout(board, paper, page, upwards) for page in pages for upwards in (False, True)]
    return [layout for layout in layouts if layout.white >= QUIET_ZONE_MM]


def _strips(text_upwards: bool) -> tuple[float, float, float]:
    """Widths of the strips left of the pattern, right of it and below it, mm."""
    ruler = PAGE_MARGIN_MM + RULER_MM
    if text_upwards:
        return ruler, PAGE_MARGIN_MM + TEXT_MM, ruler
    return ruler, 0.0, ruler + TEXT_MM


def _layout(board: Board, paper: str, page: tuple[float, float], text_upwards: bool) -> PageLayout:
    square = board.square / MM
    width, height = (board.columns + 1) * square, (board.rows + 1) * square
    left, right, bottom = _strips(text_upwards)
    white = (page[0] - left - right - width) / 2, (page[1] - bottom - height) / 2
    ruler_y = page[1] - bottom
    across = 10.0 * ((page[0] - right - left - PAGE_MARGIN_MM) // 10)
    up = 10.0 * ((ruler_y - PAGE_MARGIN_MM - ARROW_MM) // 10)
    return PageLayout(
        paper=paper,
        page=page,
        pattern=(left + white[0], white[1], width, height),
        white=min(white),
        across=(left, ruler_y, across),
        up=(left, ruler_y, up),
        arrow=(PAGE_MARGIN_MM + RULER_MM / 2, PAGE_MARGIN_MM),
        text=(page[0] - PAGE_MARGIN_MM - TEXT_MM, PAGE_MARGIN_MM, page[1] - 2 * PAGE_MARGIN_MM)
        if text_upwards
        else (PAGE_MARGIN_MM, page[1] - PAGE_MARGIN_MM - TEXT_MM, page[0] - 2 * PAGE_MARGIN_MM),
        text_upwards=text_upwards,
    )


def _marker_cells(board: Board) -> Iterator[tuple[float, float, float, float]]:
    """Find the black cells of the markers, neighbours in a row joined."""
    if board.markers is None or board.marker is None:
        return
    drawn = fiducials.charuco_board(board)
    size = fiducials.dictionary(board.markers).markerSize + 2  # its black border is a cell wide
    cell = board.marker / MM / size
    for corners, number in zip(drawn.getObjPoints(), np.ravel(drawn.getIds()), strict=True):
        x, y = np.asarray(corners)[0, :2] / MM
        image = fiducials.dictionary(board.markers).generateImageMarker(int(number), size)
        for row, bits in enumerate(np.asarray(image) == 0):
            edges = np.flatnonzero(np.diff(np.concatenate([[False], bits, [False]])))
            for first, last in edges.reshape(-1, 2):
                yield x + first * cell, y + row * cell, (last - first) * cell, cell


def _size_refusal(board: Board, paper: str) -> InputError:
    """Refuse a board that does not fit, naming the squares and the paper that would."""
    columns, rows, square = board.columns, board.rows, board.square / MM
    found = f"{columns} x {rows} corners of {square:g} mm do not fit on {paper}"
    largest = 0.0
    for text_upwards in (False, True):
        left, right, bottom = _strips(text_upwards)
        for width, height in (PAPERS_MM[paper], PAPERS_MM[paper][::-1]):
            across = (width - (left + right + 2 * QUIET_ZONE_MM)) / (columns + 1)
            down = (height - (bottom + 2 * QUIET_ZONE_MM)) / (rows + 1)
            largest = max(largest, min(across, down))
    expected = f"the largest squares that would are {np.floor(largest * 10) / 10:g} mm"
    larger = [name for name in PAPERS_MM if _fitting_layouts(board, name)]
    remedy = f" or --paper {larger[0]}" if larger else ""
    return InputError("--paper", found, expected, f"Choose smaller squares{remedy}.")


_SHEET = Path(__file__).with_name("sheet.typ")
_compile = cast("Callable[..., bytes]", typst.compile)  # its types leave out files in memory


def pdf(board: Board, layout: PageLayout) -> bytes:
    """Draw the sheet as PDF, all of it vectors; the same board gives the same bytes."""
    return _typeset(board, layout, format="pdf", timestamp=0)


def png(board: Board, layout: PageLayout) -> bytes:
    """Draw the sheet as a grey PNG that states its resolution, so that it prints true to scale."""
    scale = PX_PER_MM[layout.paper]
    drawn = _typeset(board, layout, format="png", ppi=scale * MM_PER_INCH)
    image = cv2.imdecode(np.frombuffer(drawn, dtype=np.uint8), cv2.IMREAD_GRAYSCALE)
    encoded = io.BytesIO()
    Image.fromarray(np.asarray(image)).save(encoded, "png", dpi=(scale * MM_PER_INCH,) * 2)
    return encoded.getvalue()


def _typeset(board: Board, layout: PageLayout, **options: Any) -> bytes:
    shown = json.dumps(_sheet(board, layout)).encode()
    files = {"main.typ": _SHEET.read_bytes(), "sheet.json": shown}
    return _compile(files, ignore_system_fonts=True, **options)


def _sheet(board: Board, layout: PageLayout) -> dict[str, Any]:
    """Gather what the sheet shows, in mm."""
    areas = black_areas(board) + np.array([*layout.pattern[:2], 0.0, 0.0])
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    x, y = layout.arrow
    arrow = [[x, y], [x + 3, y + 5], [x + 1, y + 5], [x + 1, y + 9], [x - 1, y + 9]]
    arrow += [[x - 1, y + 5], [x - 3, y + 5]]
    lines, labels = _rulers(layout)
    return {
        "page": layout.page,
        "black": [*(areas[:, None, :2] + corners * areas[:, None, 2:]).tolist(), arrow],
        "lines": lines,
        "labels": [*labels, (x, y + 11, "up")],
        "text": layout.text,
        "strip": TEXT_MM,
        "upwards": layout.text_upwards,
        "words": print_instructions(board, layout),
    }


def _rulers(layout: PageLayout) -> tuple[list[Any], list[Any]]:
    """Draw both rulers from their common 0: one to the right, one up."""
    x, y, length = layout.across
    lines = [((x, y), (x + length, y))]
    lines += [((x + at, y), (x + at, y + long)) for at, long in ticks(length)]
    labels = [(x + at, y + RULER_MM - 2.2, f"{at:g}") for at in np.arange(10, length + 1, 10)]
    x, foot, length = layout.up
    lines += [((x, foot - length), (x, foot))]
    lines += [((x, foot - at), (x - long, foot - at)) for at, long in ticks(length)]
    labels += [(x - RULER_MM + 1.8, foot - at, f"{at:g}") for at in np.arange(10, length + 1, 10)]
    return lines, [*labels, (x - 4, foot + 2.5, "0 mm")]
