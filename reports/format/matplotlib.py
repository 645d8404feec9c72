"""Charts on paper: matplotlib figures, saved as SVG with the same bytes every time."""

import io
from collections.abc import Iterable
from functools import cache
from pathlib import Path as File
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import findfont
from matplotlib.ft2font import FT2Font
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from reports.document import charts
from reports.document.charts import Chart, Mark, Panel, Path, isolated_points, pieces
from reports.results import one_line

LINE_WIDTH_IN = 6.69  # 170 mm, what A4 leaves between the margins of the report
MAX_LABEL_LETTERS = 34  # letters of a user's word beside a plot; longer ones would push it aside
LEGEND_IN = 0.2  # height of a row of the legend
LEGEND_LINE_LETTERS = 118  # letters of the legend's size in a line
LEGEND_SIGN_LETTERS = 7  # what the sign before a legend's word and the gap behind it take
STYLE = File(__file__).with_name("style.mplstyle")
# luminance of a cell below which white letters are read better than black ones
MAX_DARK_LUMINANCE = 0.36
LINE_STYLES: dict[str, tuple[float, tuple[float, ...]]] = {
    "dash": (0, (4, 2)),
    "dot": (0, (1.2, 1.6)),
}
VIEW_DEG = (24.0, -58.0)  # elevation and azimuth from which a path in space is seen
MAX_AXIS_STEPS = 5  # between the numbers of the longest axis
MAX_ZOOM = 1.0  # zoom: beyond it the labels on both sides are cut
# of a box's diagonal, upwards in the picture at zoom 1: more cuts those below
MAX_BOX_HEIGHT = 0.78
LINE_WIDTHS = {"error": 0.6, "resolved": 1.1, "encoder": 0.9, "vector": 0.35}


def svg(chart: Chart | Path) -> bytes:
    """Draw a chart as SVG; the same chart gives the same bytes."""
    with mpl.rc_context(fname=STYLE):
        buffer = io.BytesIO()
        figure(chart).savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def figure(chart: Chart | Path) -> Figure:
    """Draw a chart."""
    with mpl.rc_context(fname=STYLE):
        return _draw_path(chart) if isinstance(chart, Path) else _draw_panels(chart)


def relative_width(chart: Chart | Path) -> float:
    """Tell what share of the line width a chart takes."""
    return 0.72 if isinstance(chart, Path) else chart.width


def printable(text: str) -> str:
    """A user's word shortened, letters that the font lacks replaced; line breaks are kept."""
    return "\n".join(_printable_line(line) for line in text.split("\n"))


def _printable_line(text: str) -> str:
    text = one_line(text)
    if len(text) > MAX_LABEL_LETTERS:
        text = text[: MAX_LABEL_LETTERS - 1] + "…"
    return "".join(c if ord(c) in _font_characters() else "\ufffd" for c in text)


@cache
def _font_characters() -> frozenset[int]:
    return frozenset(FT2Font(findfont("DejaVu Sans")).get_charmap())


def _colour(role: str) -> str:
    return charts.PALETTE[role][0]


def _draw_panels(chart: Chart) -> Figure:
    rows = -(-len(chart.panels) // chart.columns)
    legend = _legend(chart)
    columns = _legend_columns(legend)
    lines = -(-len(legend) // columns)  # rounded up
    height = rows * chart.row_height + 0.25 + LEGEND_IN * lines
    figure = Figure(figsize=(LINE_WIDTH_IN * chart.width, height))
    grid = figure.subplots(rows, chart.columns, sharex=chart.shared_x, squeeze=False)
    for axes, panel in zip(grid.ravel(), chart.panels, strict=False):
        _draw_panel(axes, panel)
        if not panel.y_ticks:
            ticks = 3 if chart.row_height < 0.8 else 5  # inches: more would touch in a low strip
            axes.yaxis.set_major_locator(MaxNLocator(nbins=ticks, steps=[1, 2, 2.5, 5, 10]))
    figure.align_ylabels()
    if legend:
        handles = [_legend_handle(mark) for mark in legend.values()]
        names = [printable(name) for name in legend]
        figure.legend(handles, names, loc="outside upper left", ncols=columns, borderaxespad=0.1)
    return figure


def _legend(chart: Chart) -> dict[str, Mark]:
    found: dict[str, Mark] = {}
    for panel in chart.panels:
        for mark in panel.marks:
            if name := getattr(mark, "name", ""):
                found.setdefault(name, mark)
    return found


def _legend_columns(names: Iterable[str]) -> int:
    widest = max((len(printable(name)) for name in names), default=0) + LEGEND_SIGN_LETTERS
    return max(1, min(6, LEGEND_LINE_LETTERS // widest))


def _legend_handle(mark: Mark) -> Artist:
    colour = _colour(getattr(mark, "role", "ink"))
    if isinstance(mark, charts.Band | charts.Bars):
        return Patch(facecolor=colour)
    if isinstance(mark, charts.Points):
        return Line2D([], [], color=colour, marker="o", linestyle="")
    return Line2D([], [], color=colour, linestyle=_line_style(getattr(mark, "role", "ink")))


def _line_style(role: str) -> tuple[float, tuple[float, ...]] | Literal["-"]:
    return LINE_STYLES.get(charts.DASHES.get(role, ""), "-")


def _draw_panel(axes: Axes, panel: Panel) -> None:
    for mark in panel.marks:
        _draw_mark(axes, mark)
    axes.set_ylabel(panel.y_label)
    axes.set_xlabel(panel.x_label)
    if panel.title:
        axes.set_title(panel.title)
    if panel.x_ticks:
        axes.set_xticks([x for x, _ in panel.x_ticks], [printable(t) for _, t in panel.x_ticks])
    if panel.y_ticks:
        axes.set_yticks([y for y, _ in panel.y_ticks], [printable(t) for _, t in panel.y_ticks])
    if panel.x_range:
        axes.set_xlim(*panel.x_range)
    if panel.y_range:
        axes.set_ylim(*panel.y_range)
    if panel.equal:
        axes.set_aspect("equal")
        if not panel.x_ticks:
            axes.xaxis.set_major_locator(MaxNLocator(nbins=5, steps=[1, 2, 2.5, 5, 10]))
    if any(isinstance(mark, charts.Cells) for mark in panel.marks):
        axes.grid(visible=False)


def _draw_mark(axes: Axes, mark: Mark) -> None:
    if isinstance(mark, charts.Line):
        _draw_line(axes, mark)
    elif isinstance(mark, charts.Band):
        for piece in pieces(mark.x):
            x, low, high = mark.x[piece], mark.low[piece], mark.high[piece]
            if len(x) > 1:
                axes.fill_between(x, low, high, color=_colour(mark.role), linewidth=0)
            else:
                axes.vlines(x, low, high, color=_colour(mark.role), linewidth=1.5)
    elif isinstance(mark, charts.Level):
        draw = axes.axvline if mark.upright else axes.axhline
        draw(mark.value, color=_colour(mark.role), linestyle=_line_style(mark.role), linewidth=0.9)
    elif isinstance(mark, charts.Points):
        axes.plot(
            mark.x,
            mark.y,
            linestyle="",
            color=_colour(mark.role),
            marker="o",
            markersize=1.6 * mark.size,
            markeredgewidth=0.0,
            alpha=0.55,
        )
    elif isinstance(mark, charts.Runs):
        spans = np.stack([mark.starts, mark.ends - mark.starts], axis=1).tolist()
        colour = _colour(mark.role)
        axes.broken_barh(
            spans, (mark.row - 0.3, 0.6), facecolor=colour, edgecolor=colour, linewidth=0.3
        )
    elif isinstance(mark, charts.Cells):
        _draw_cells(axes, mark)
    elif isinstance(mark, charts.Bars):
        axes.bar(
            mark.x, mark.heights, mark.width, bottom=mark.below, color=_colour(mark.role),
            edgecolor="white", linewidth=0.3,
        )  # fmt: skip
    else:
        axes.text(mark.x, mark.y, mark.text, ha="center", va="bottom", fontsize=6)


def _draw_line(axes: Axes, line: charts.Line) -> None:
    colour = _colour(line.role)
    axes.plot(
        line.x,
        line.y,
        color=colour,
        linestyle=_line_style(line.role),
        linewidth=LINE_WIDTHS.get(line.role, 0.8),
    )
    alone = isolated_points(line.x, line.y)
    if alone.any():
        axes.plot(line.x[alone], line.y[alone], linestyle="", marker="o", color=colour)


def _draw_cells(axes: Axes, cells: charts.Cells) -> None:
    scale = mpl.colors.LinearSegmentedColormap.from_list(
        "report", [(share, _colour(role)) for share, role in cells.scale]
    )
    axes.pcolormesh(
        cells.x, cells.y, cells.values, cmap=scale, vmin=cells.low, vmax=cells.high,
        rasterized=cells.values.size > 200,  # thousands of vector cells would only be slow
    )  # fmt: skip
    extent = max(cells.high - cells.low, 1e-12)  # no division by zero for a flat matrix
    for row, line in enumerate(cells.text):
        for column_, text in enumerate(line):
            behind = scale((cells.values[row, column_] - cells.low) / extent)
            axes.text(
                cells.x[column_], cells.y[row], text, ha="center", va="center", fontsize=6.5,
                color=_colour("paper" if _luminance(behind) < MAX_DARK_LUMINANCE else "ink"),
            )  # fmt: skip


def _luminance(colour: tuple[float, float, float, float]) -> float:
    """Relative luminance of an sRGB colour; source: WCAG 2.2."""
    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4
                        for c in colour[:3])  # fmt: skip
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def _draw_path(path: Path) -> Figure:
    figure = Figure(figsize=(LINE_WIDTH_IN * 0.72, 3.3))
    figure.set_layout_engine("none")  # constrained layout leaves a wide margin around space axes
    axes: Any = figure.add_axes((0.02, 0.14, 0.92, 0.86), projection="3d")
    for points, role, name in path.lines:
        x, y, z = points.T
        axes.plot(x, y, z, color=_colour(role), linestyle=_line_style(role), label=name)
        alone = isolated_points(x, y)
        if alone.any():
            axes.plot(x[alone], y[alone], z[alone], linestyle="", marker="o", color=_colour(role))
    sides = [high - low for low, high in path.ranges]
    for axis, label, ends, side in zip("xyz", path.labels, path.ranges, sides, strict=True):
        getattr(axes, f"set_{axis}label")(label)
        getattr(axes, f"set_{axis}lim")(*ends)
        steps = max(
            2, round(MAX_AXIS_STEPS * side / max(sides))
        )  # a short side has no room for more
        getattr(axes, f"{axis}axis").set_major_locator(MaxNLocator(nbins=steps))
    axes.set_box_aspect(sides, zoom=_zoom(sides))
    elevation, azimuth = VIEW_DEG
    axes.view_init(elev=elevation, azim=azimuth)
    axes.legend(loc="upper left")
    return figure


def _zoom(sides: list[float]) -> float:
    """How near a box is seen: all have one diagonal, and a high one would lose its labels."""
    elevation, azimuth = np.deg2rad(VIEW_DEG)
    level = np.sin(elevation) * np.abs([np.cos(azimuth), np.sin(azimuth)])
    height = float(np.dot(sides, [*level, np.cos(elevation)]) / np.linalg.norm(sides))
    return min(MAX_ZOOM, MAX_BOX_HEIGHT / height)
