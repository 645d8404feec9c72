"""The marks of a panel on paper: each drawn within a frame, whose axes say where."""

import base64
import io
from dataclasses import dataclass, replace
from functools import singledispatch

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from reports.document import charts
from reports.document.charts import Array, Indices, Mark, isolated_points, pieces
from reports.format.drawing import Drawing, dash_of, line_width, paint
from reports.format.scales import HALF_RUN, Scale, edges

NOTE_SIZE, CELL_SIZE = 6.0, 6.5  # pt
MAX_VECTOR_CELLS = 200  # more are a picture: thousands of rectangles would only be slow
SHADES = 12  # of a scale in the legend
PICTURE_SCALE = 4.0  # its dots per pt
DOT = 1.75  # pt, radius of a point of a line that has no neighbour
FRONT = {charts.Line: 1, charts.Level: 1, charts.Points: 1, charts.Note: 2}  # areas lie behind


@dataclass(frozen=True)
class Frame:
    """A panel's axes and the rectangle that they span, pt; y points down."""

    left: float
    top: float
    right: float
    bottom: float
    x: Scale
    y: Scale

    def places(self, x: float | Array, y: float | Array) -> Array:
        """Points (n, 2) on paper of values (n,)."""
        across, up = self.across(x), self.up(y)
        return np.stack(np.broadcast_arrays(across, up), axis=-1).reshape(-1, 2)

    def across(self, x: float | Array) -> Array:
        """Where values of x lie."""
        return self.x.place(x, self.left, self.right)

    def up(self, y: float | Array) -> Array:
        """Where values of y lie."""
        return self.y.place(y, self.bottom, self.top)


def draw_marks(drawing: Drawing, frame: Frame, marks: tuple[Mark, ...]) -> None:
    """Draw a panel's marks: areas, then lines and points, clipped; then words, which are not."""
    drawing.clip(frame.left, frame.top, frame.right, frame.bottom)
    for mark in sorted(marks, key=lambda mark: FRONT.get(type(mark), 0)):
        if not isinstance(mark, charts.Note):
            _draw(mark, drawing, frame)
    drawing.unclip()
    for mark in marks:
        if isinstance(mark, charts.Note):
            place = frame.places(mark.x, mark.y)[0]
            drawing.text(place[0], place[1] - NOTE_SIZE * 0.6, mark.text, NOTE_SIZE)
        elif isinstance(mark, charts.Cells):
            _letters(mark, drawing, frame)


@singledispatch
def _draw(mark: Mark, _drawing: Drawing, _frame: Frame) -> None:
    raise TypeError(mark)


@_draw.register
def _line(mark: charts.Line, drawing: Drawing, frame: Frame) -> None:
    places = frame.places(mark.x, mark.y)
    parts = [places[piece] for piece in pieces(mark.x + mark.y)]
    dash, width = dash_of(mark.role), line_width(mark.role)
    joined = [part for part in parts if len(part) > 1]
    drawing.lines(joined, mark.role, width, dash, "butt" if dash else "round")
    drawing.dots(places[isolated_points(mark.x, mark.y)], mark.role, DOT)


@_draw.register
def _band(mark: charts.Band, drawing: Drawing, frame: Frame) -> None:
    low, high = frame.places(mark.x, mark.low), frame.places(mark.x, mark.high)
    parts = pieces(mark.x)
    long = [part for part in parts if part.stop - part.start > 1]
    drawing.areas([np.concatenate([low[p], high[p][::-1]]) for p in long], mark.role)
    bars = [np.concatenate([low[p], high[p]]) for p in parts if p.stop - p.start == 1]
    drawing.lines(bars, mark.role, 1.5)


@_draw.register
def _level(mark: charts.Level, drawing: Drawing, frame: Frame) -> None:
    if mark.upright:
        x, y = np.full(2, frame.across(mark.value)), np.array([frame.bottom, frame.top])
    else:
        x, y = np.array([frame.left, frame.right]), np.full(2, frame.up(mark.value))
    drawing.lines([np.stack([x, y], axis=1)], mark.role, 0.9, dash_of(mark.role))


@_draw.register
def _points(mark: charts.Points, drawing: Drawing, frame: Frame) -> None:
    places = frame.places(mark.x, mark.y)
    known = np.isfinite(places).all(axis=1)
    drawing.dots(places[known], mark.role, 0.8 * mark.size, 0.55)


@_draw.register
def _runs(mark: charts.Runs, drawing: Drawing, frame: Frame) -> None:
    rows = np.array([mark.row - HALF_RUN, mark.row + HALF_RUN])
    boxes = [_box(frame, np.array(ends), rows) for ends in zip(mark.starts, mark.ends, strict=True)]
    drawing.areas(boxes, mark.role, f'{paint("stroke", mark.role)} stroke-width="0.3"')


@_draw.register
def _bars(mark: charts.Bars, drawing: Drawing, frame: Frame) -> None:
    half = np.array([-0.5, 0.5]) * mark.width
    boxes = [
        _box(frame, x + half, np.array([below, below + height]))
        for x, below, height in zip(mark.x, mark.below, mark.heights, strict=True)
        if np.isfinite(x + below + height)
    ]
    drawing.areas(boxes, mark.role, 'stroke="#ffffff" stroke-width="0.3"')


@_draw.register
def _cells(mark: charts.Cells, drawing: Drawing, frame: Frame) -> None:
    x, y = edges(mark.x), edges(mark.y)
    known = np.isfinite(mark.values)  # the others are clear
    colours = np.round(np.dstack([charts.cell_colours(mark, 0), 255 * known])).astype(np.uint8)
    if mark.values.size > MAX_VECTOR_CELLS:
        drawing.parts.append(_picture(frame, colours, x, y))
        return
    for row, column in zip(*np.nonzero(known), strict=True):
        outline = _box(frame, x[column : column + 2], y[row : row + 2])
        (left, top), (right, bottom) = outline.min(axis=0), outline.max(axis=0)
        drawing.parts.append(
            f'<rect x="{left:.2f}" y="{top:.2f}" width="{right - left:.2f}" '
            f'height="{bottom - top:.2f}" fill="#{bytes(colours[row, column, :3]).hex()}"/>'
        )


def draw_shades(drawing: Drawing, mark: charts.Cells, frame: Frame) -> None:
    """Fill a frame of 0 to 1 with the colours of a scale, low to high."""
    shares = (np.arange(SHADES) + 0.5) / SHADES
    shades = replace(
        mark, values=mark.low + shares[None] * (mark.high - mark.low), x=shares, y=np.array([0.5])
    )
    _cells(shades, drawing, frame)


def _picture(frame: Frame, colours: NDArray[np.uint8], x: Array, y: Array) -> str:
    """Draw many cells as a picture in the frame: each of its dots has the colour of its cell."""
    (left, top), (right, bottom) = (
        ends(_box(frame, x[[0, -1]], y[[0, -1]]), axis=0) for ends in (np.min, np.max)
    )
    dots = [max(int(PICTURE_SCALE * length), 1) for length in (right - left, bottom - top)]
    across, up = (np.arange(n) + 0.5 for n in dots)
    columns = _cells_at(frame.across(x), left + across / dots[0] * (right - left))
    rows = _cells_at(frame.up(y), top + up / dots[1] * (bottom - top))
    buffer = io.BytesIO()
    Image.fromarray(colours[rows][:, columns]).save(buffer, "PNG")
    content = base64.b64encode(buffer.getvalue()).decode()
    return (
        f'<image x="{left:.2f}" y="{top:.2f}" width="{right - left:.2f}" '
        f'height="{bottom - top:.2f}" preserveAspectRatio="none" '
        f'href="data:image/png;base64,{content}"/>'
    )


def _cells_at(borders: Array, places: Array) -> Indices:
    """Which cell lies at each place; the borders rise or fall."""
    falls = borders[0] > borders[-1]
    found = np.searchsorted(borders[::-1] if falls else borders, places) - 1
    found = np.clip(found, 0, len(borders) - 2)
    return len(borders) - 2 - found if falls else found


def _letters(mark: charts.Cells, drawing: Drawing, frame: Frame) -> None:
    roles = charts.letter_roles(mark, 0)
    for row, line in enumerate(mark.text):
        for column, text in enumerate(line):
            x, y = frame.places(mark.x[column], mark.y[row])[0]
            drawing.text(x, y, text, CELL_SIZE, roles[row][column])


def _box(frame: Frame, x: Array, y: Array) -> Array:
    """The outline (4, 2) of a rectangle from its two ends on both axes."""
    return frame.places(x[[0, 1, 1, 0]], y[[0, 0, 1, 1]])
