"""Charts on paper: SVG whose words stay words, the same bytes every time.

Panels have one size. What stands around them (numbers, names, titles) takes as much of the figure
as the letters are wide and high.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from reports.document import charts
from reports.document.charts import Chart, Mark, Panel, Path
from reports.format.drawing import Drawing, dash_of, line_width
from reports.format.lettering import printable, text_height, text_width
from reports.format.marks import DOT, Frame, draw_marks, draw_shades
from reports.format.scales import Scale, extent, scale

LINE_WIDTH_PT = 481.7  # 170 mm, what A4 leaves between the margins of the report
POINTS = 72.0  # pt an inch
SIZE, TICK_SIZE = 7.0, 6.5  # pt: letters of names and titles; of numbers and legends
TICK, GAP = 2.5, 3.0  # pt: length of a tick; between a word and what it belongs to
EDGE = 2.2  # pt, free around the figure and each panel
AXIS_WIDTH, GRID_WIDTH = 0.5, 0.4
BELOW_IN = 0.25  # of the figure's height, for the numbers and the name of the last row's axes
LEGEND_ROW = 11.0  # pt
SIGN, SIGN_GAP, LEGEND_GAP = 11.7, 5.2, 9.1  # pt: of the legend, a sign, before its word, behind
RING_WIDTH = 0.9  # pt
UNIT = Scale((0.0, 1.0), ())
HALF_SIGN = 2.3  # pt, half the height of an area's
MAX_LEGEND_COLUMNS = 6
LOW_STRIP_IN = 0.8  # a row lower than this has room for few numbers
PITCH_PT = 19.5  # of numbers along x, at least
PATH_HEIGHT_IN = 3.3  # of paths in space


@dataclass(frozen=True)
class Around:
    """What a panel needs on each side of its frame, pt."""

    left: float
    right: float
    above: float
    below: float


def svg(chart: Chart | Path) -> bytes:
    """Draw a chart as SVG; the same chart gives the same bytes."""
    from reports.format import space

    width = LINE_WIDTH_PT * relative_width(chart)
    if isinstance(chart, Path):
        drawing = Drawing(width, PATH_HEIGHT_IN * POINTS)
        space.draw_path(drawing, chart)
        return drawing.svg()
    legend = charts.legend(chart)
    rows = -(-len(chart.panels) // chart.columns)  # rounded up
    drawing = Drawing(width, (rows * chart.row_height + BELOW_IN) * POINTS)
    top = draw_legend(drawing, [(printable(name), mark) for name, mark in legend.items()])
    drawing.height += top
    _draw_panels(drawing, chart, rows, top)
    return drawing.svg()


def relative_width(chart: Chart | Path) -> float:
    """Tell what share of the line width a chart takes."""
    if isinstance(chart, Path):
        return 1.0 if chart.from_above else 0.72
    return chart.width


def _draw_panels(drawing: Drawing, chart: Chart, rows: int, top: float) -> None:
    """Place the panels below the legend, all of one size, and draw them."""
    columns = chart.columns
    shown = [index + columns >= len(chart.panels) for index in range(len(chart.panels))]
    shown = [last or not chart.shared_x for last in shown]
    cell = np.array([drawing.width / columns, (drawing.height - top) / rows])
    shared = extent(chart.panels, 0) if chart.shared_x else None
    few = chart.row_height < LOW_STRIP_IN
    scales = [panel_scales(panel, cell[0], few, shared) for panel in chart.panels]
    around = [
        panel_around(panel, *both, cell[0], numbers=own)
        for panel, both, own in zip(chart.panels, scales, shown, strict=True)
    ]
    of_column = [around[column::columns] for column in range(columns)]
    of_row = [around[row * columns : (row + 1) * columns] for row in range(rows)]
    left = np.array([max((a.left for a in own), default=0.0) for own in of_column])
    right = np.array([max((a.right for a in own), default=0.0) for own in of_column])
    above = np.array([max(a.above for a in own) for own in of_row])
    below = np.array([max(a.below for a in own) for own in of_row])
    wide = (drawing.width - left.sum() - right.sum()) / columns
    high = (drawing.height - top - above.sum() - below.sum()) / rows
    for index, panel in enumerate(chart.panels):
        row, column = divmod(index, columns)
        x = left[: column + 1].sum() + right[:column].sum() + column * wide
        y = top + above[: row + 1].sum() + below[:row].sum() + row * high
        frame = fitted(panel, Frame(x, y, x + wide, y + high, *scales[index]))
        name = x - left[column] + EDGE + text_height(panel.y_label, SIZE) / 2
        draw_panel(drawing, frame, panel, name + frame.left - x, numbers=shown[index])


def panel_scales(
    panel: Panel, width: float, few: bool, shared: tuple[float, float] | None = None
) -> tuple[Scale, Scale]:
    """Make both axes of a panel that is at most so wide; `few` numbers on y; `shared` range of x.

    Numbers that would touch on x are thinned.
    """
    ends = panel.x_range or shared or extent([panel], 0)
    most = 5 if panel.equal else int(np.clip(width / PITCH_PT, 1, 9))
    x = scale(ends, most, panel.x_ticks)
    while not panel.x_ticks and most > 1 and _crowded(x, 0.8 * width):
        most -= 1
        x = scale(ends, most, ())
    return x, scale(panel.y_range or extent([panel], 1), 3 if few else 5, panel.y_ticks)


def _crowded(x: Scale, width: float) -> bool:
    places = [float(x.place(at, 0.0, width)) for at, _ in x.visible()]
    widths = [text_width(word, TICK_SIZE) for _, word in x.visible()]
    room = np.abs(np.diff(places))
    needed = [(a + b) / 2 + GAP for a, b in pairwise(widths)]
    return bool(len(room) and (room < needed).any())


def panel_around(panel: Panel, x: Scale, y: Scale, width: float, *, numbers: bool) -> Around:
    """Find the room that a panel needs around its frame; `numbers`: x has some."""
    tick = TICK + GAP
    words = [printable(word) for _, word in y.visible()]
    left = EDGE + tick + max((text_width(word, TICK_SIZE) for word in words), default=0.0)
    left += text_height(panel.y_label, SIZE) + GAP if panel.y_label else 0.0
    right, below = 2 * EDGE, EDGE
    if numbers:
        inner = 0.85 * width
        for at, word in x.visible():
            half, place = text_width(printable(word), TICK_SIZE) / 2, float(x.place(at, 0, inner))
            right = max(right, half - (inner - place) + EDGE)
            left = max(left, half - place + EDGE)
        lines = [text_height(printable(word), TICK_SIZE) for _, word in x.visible()]
        below += tick + max(lines, default=0.0)
        below += TICK_SIZE if x.power and not panel.x_label else 0.0
    if panel.x_label:
        below += GAP + text_height(panel.x_label, SIZE)
    above = EDGE + (GAP + text_height(panel.title, SIZE) if panel.title else TICK_SIZE / 2)
    return Around(left, right, above + (TICK_SIZE if y.power else 0.0), below)


def fitted(panel: Panel, frame: Frame) -> Frame:
    """Shrink a frame about its middle, where one unit must be as long on x as on y."""
    if not panel.equal:
        return frame
    across, up = (abs(s.ends[1] - s.ends[0]) for s in (frame.x, frame.y))
    unit = min((frame.right - frame.left) / across, (frame.bottom - frame.top) / up)
    x, y = (frame.left + frame.right) / 2, (frame.top + frame.bottom) / 2
    half = unit * across / 2, unit * up / 2
    return Frame(x - half[0], y - half[1], x + half[0], y + half[1], frame.x, frame.y)


def draw_panel(
    drawing: Drawing, frame: Frame, panel: Panel, name_x: float, *, numbers: bool = True
) -> None:
    """Draw a panel in its frame; the name of y is centred on `name_x`; `numbers`: x has some."""
    x, y = frame.x.visible(), frame.y.visible()
    across = [float(frame.across(at)) for at, _ in x]
    up = [float(frame.up(at)) for at, _ in y]
    left, top, right, bottom = frame.left, frame.top, frame.right, frame.bottom
    if not any(isinstance(mark, charts.Cells) for mark in panel.marks):
        upright = [np.array([[at, top], [at, bottom]]) for at in across]
        level = [np.array([[left, at], [right, at]]) for at in up]
        drawing.lines([*upright, *level], "grid", GRID_WIDTH)
    draw_marks(drawing, frame, panel.marks)
    axes = [np.array([[left, top], [left, bottom], [right, bottom]])]
    axes += [np.array([[at, bottom], [at, bottom + TICK]]) for at in across]
    axes += [np.array([[left - TICK, at], [left, at]]) for at in up]
    drawing.lines(axes, "muted", AXIS_WIDTH)
    for at, (_, word) in zip(up, y, strict=True):
        drawing.text(left - TICK - GAP, at, printable(word), TICK_SIZE, anchor="end")
    lower = bottom + TICK + GAP
    if numbers:
        words = [printable(word) for _, word in x]
        for at, word in zip(across, words, strict=True):
            drawing.text(at, lower + text_height(word, TICK_SIZE) / 2, word, TICK_SIZE)
        lower += max((text_height(word, TICK_SIZE) for word in words), default=0.0)
    if panel.x_label:
        middle = lower + GAP + text_height(panel.x_label, SIZE) / 2
        drawing.text((left + right) / 2, middle, panel.x_label, SIZE)
    if panel.y_label:
        drawing.turned(name_x, (top + bottom) / 2, panel.y_label, SIZE)
    _powers_and_title(drawing, frame, panel, lower if numbers else bottom)


def _powers_and_title(drawing: Drawing, frame: Frame, panel: Panel, lower: float) -> None:
    above = frame.top - GAP - text_height(panel.title, SIZE) / 2
    if frame.y.power:
        drawing.text(frame.left, frame.top - TICK_SIZE / 2, frame.y.power, TICK_SIZE, anchor="end")
    if frame.x.power:
        drawing.text(frame.right, lower + TICK_SIZE, frame.x.power, TICK_SIZE, anchor="end")
    if panel.title:
        drawing.text(frame.left, above - (TICK_SIZE if frame.y.power else 0.0), panel.title, SIZE,
                     anchor="start")  # fmt: skip


def _legend_rows(words: list[str], width: float) -> list[list[float]]:
    """Share a legend's words out in rows; each has where its words begin, pt."""
    taken = [SIGN + SIGN_GAP + text_width(word, TICK_SIZE) + LEGEND_GAP for word in words]
    for columns in range(min(MAX_LEGEND_COLUMNS, len(words)), 0, -1):
        wide = [max(taken[column::columns]) for column in range(columns)]
        if sum(wide) <= width or columns == 1:
            starts = [EDGE + sum(wide[:column]) for column in range(columns)]
            return [starts[: len(words) - i] for i in range(0, len(words), columns)]
    return []


def draw_legend(drawing: Drawing, entries: list[tuple[str, Mark]]) -> float:
    """Draw signs and words at the top; give the height that they take, pt."""
    rows = _legend_rows([word for word, _ in entries], drawing.width)
    places = [(x, row) for row, starts in enumerate(rows) for x in starts]
    for (x, row), (word, mark) in zip(places, entries, strict=True):
        y = (row + 0.5) * LEGEND_ROW
        role = getattr(mark, "role", "ink")
        sign = np.array([[x, y], [x + SIGN, y]])
        if isinstance(mark, charts.Band | charts.Bars):
            corners = np.array([[x, -1], [x + SIGN, -1], [x + SIGN, 1], [x, 1]])
            drawing.areas([corners * (1, HALF_SIGN) + (0, y)], role)
        elif isinstance(mark, charts.Cells):
            draw_shades(drawing, mark, Frame(x, y - HALF_SIGN, x + SIGN, y + HALF_SIGN, UNIT, UNIT))
        elif isinstance(mark, charts.Points) and role in charts.HOLLOW:
            drawing.rings(sign.mean(axis=0, keepdims=True), role, HALF_SIGN, RING_WIDTH)
        elif isinstance(mark, charts.Points):
            drawing.dots(sign.mean(axis=0, keepdims=True), role, DOT)
        else:
            drawing.lines([sign], role, line_width(""), dash_of(role))
        drawing.text(x + SIGN + SIGN_GAP, y, word, TICK_SIZE, anchor="start")
    return LEGEND_ROW * len(rows)
