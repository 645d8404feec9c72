"""A board's sheet as PDF and PNG, set by typst; every coordinate is the layout's own."""

import json
import struct
import zlib
from collections.abc import Callable
from typing import Any, cast

import cv2
import numpy as np
import typst

from verify.board import Board
from verify.board_drawing import RULER_MM, TEXT_MM, Layout, black, ticks, words

RESOLUTION = {  # px/mm of the PNG: whole, so that pHYs states it exactly; 36 megapixels at most
    "A4": 12,
    "A3": 12,
    "A2": 12,
    "A1": 8,
    "A0": 6,
}
MM_PER_INCH = 25.4

_SHEET = """
#let data = json("sheet.json")
#let at(point) = point.map(v => v * 1mm)
#set page(width: data.page.at(0) * 1mm, height: data.page.at(1) * 1mm, margin: 0mm)
#set text(font: "Libertinus Serif", size: if data.text.at(2) > 300 { 10pt } else { 7.5pt },
  fallback: false)
#set par(leading: 0.45em, spacing: 0.45em)
#let put(x, y, body) = place(top + left, dx: x * 1mm, dy: y * 1mm, body)
// One path for all that is black: areas that share an edge leave no hair line between them.
#put(0, 0, curve(fill: black, ..data.black.map(polygon => (
  curve.move(at(polygon.first())),
  ..polygon.slice(1).map(p => curve.line(at(p))),
  curve.close(mode: "straight"))).flatten()))
#put(0, 0, curve(stroke: 0.1mm + black, ..data.lines.map(line => (
  curve.move(at(line.at(0))), curve.line(at(line.at(1))))).flatten()))
#for l in data.labels {
  put(l.at(0) - 5, l.at(1) - 1.5, box(width: 10mm, height: 3mm, align(center + horizon,
    text(size: 6pt, l.at(2)))))
}
#let said = box(width: data.text.at(2) * 1mm, height: data.strip * 1mm, inset: (top: 1mm),
  for line in data.words { par(line) })
#put(data.text.at(0), data.text.at(1),
  if data.upwards { rotate(-90deg, reflow: true, said) } else { said })
"""
_compile = cast("Callable[..., bytes]", typst.compile)  # its types leave out files in memory


def pdf(board: Board, layout: Layout) -> bytes:
    """Draw the sheet as PDF, all of it vectors; the same board gives the same bytes."""
    return _typeset(board, layout, format="pdf", timestamp=0)


def png(board: Board, layout: Layout) -> bytes:
    """Draw the sheet as a grey PNG that states its resolution, so that it prints true to scale."""
    scale = RESOLUTION[layout.paper]
    drawn = _typeset(board, layout, format="png", ppi=scale * MM_PER_INCH)
    image = cv2.imdecode(np.frombuffer(drawn, dtype=np.uint8), cv2.IMREAD_GRAYSCALE)
    return _with_resolution(cv2.imencode(".png", np.asarray(image))[1].tobytes(), 1000 * scale)


def _typeset(board: Board, layout: Layout, **options: Any) -> bytes:
    files = {"main.typ": _SHEET.encode(), "sheet.json": json.dumps(_sheet(board, layout)).encode()}
    return _compile(files, ignore_system_fonts=True, **options)


def _sheet(board: Board, layout: Layout) -> dict[str, Any]:
    """Gather what the sheet shows, in mm."""
    areas = black(board) + np.array([*layout.pattern[:2], 0.0, 0.0])
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    x, y = layout.arrow
    arrow = [[x, y], [x + 3, y + 5], [x + 1, y + 5], [x + 1, y + 9], [x - 1, y + 9]]
    arrow += [[x - 1, y + 5], [x - 3, y + 5]]
    lines, labels = _rulers(layout)
    return {
        "page": layout.page,
        "black": [
            *(areas[:, None, :2] + corners * areas[:, None, 2:]).tolist(),
            arrow,
        ],
        "lines": lines,
        "labels": [*labels, (x, y + 11, "up")],
        "text": layout.text,
        "strip": TEXT_MM,
        "upwards": layout.text_upwards,
        "words": words(board, layout),
    }


def _rulers(layout: Layout) -> tuple[list[Any], list[Any]]:
    """Draw both rulers from their common 0: one to the right, one up."""
    x, y, length = layout.across
    lines = [((x, y), (x + length, y))]
    lines += [((x + at, y), (x + at, y + long)) for at, long in ticks(length)]
    labels = [(x + at, y + RULER_MM - 2.2, f"{at:g}") for at in np.arange(10, length + 1, 10)]
    x, foot, length = layout.up
    top = foot - length
    lines += [((x, top), (x, foot))]
    lines += [((x, foot - at), (x - long, foot - at)) for at, long in ticks(length)]
    labels += [(x - RULER_MM + 1.8, foot - at, f"{at:g}") for at in np.arange(10, length + 1, 10)]
    return lines, [*labels, (x - 4, foot + 2.5, "0 mm")]


def _with_resolution(encoded: bytes, per_metre: int) -> bytes:
    """Put a pHYs chunk behind the header of a PNG.

    Source: W3C, Portable Network Graphics, third edition, sections 5.3 and 11.3.4.3.
    """
    body = b"pHYs" + struct.pack(">IIB", per_metre, per_metre, 1)  # 1: the unit is the metre
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    header = 8 + 25  # bytes: signature, IHDR
    return encoded[:header] + chunk + encoded[header:]
