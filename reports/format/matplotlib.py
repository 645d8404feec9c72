"""Charts for a user of Python: the figures of the report as matplotlib draws them."""

from collections.abc import Iterable
from pathlib import Path as File
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from reports.document import charts
from reports.document.charts import Chart, Mark, Panel, Path, isolated_points, pieces
from reports.format.drawing import line_width
from reports.format.lettering import printable
from reports.format.svg import relative_width

LINE_WIDTH_IN = 6.69  # 170 mm, what A4 leaves between the margins of the report
LEGEND_IN = 0.2  # height of a row of the legend
LEGEND_LINE_LETTERS = 118  # letters of the legend's size in a line
LEGEND_SIGN_LETTERS = 7  # what the sign before a legend's word and the gap behind it take
STYLE = File(__file__).with_name("style.mplstyle")
LINE_STYLES: dict[str, tuple[float, tuple[float, ...]]] = {
    "dash": (0, (4, 2)),
    "dot": (0, (1.2, 1.6)),
}
PATH_HEIGHT_IN = 3.3  # of paths in space
VIEW_DEG = (24.0, -58.0)  # elevation and azimuth from which a path in space is seen
MAX_AXIS_STEPS = 5  # between the numbers of the longest axis
MAX_ZOOM = 1.0  # zoom: beyond it the labels on both sides are cut
# of a box's diagonal, upwards in the picture at zoom 1: more cuts those below
MAX_BOX_HEIGHT = 0.78


def figure(chart: Chart | Path) -> Figure:
    """Draw a chart."""
    with mpl.rc_context(fname=STYLE):
        return _draw_path(chart) if isinstance(chart, Path) else _draw_panels(chart)


def _colour(role: str) -> str:
    return charts.PALETTE[role][0]


def _draw_panels(chart: Chart) -> Figure:
    rows = -(-len(chart.panels) // chart.columns)
    legend = {n: m for n, m in charts.legend(chart).items() if not isinstance(m, charts.Cells)}
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
        linewidth=line_width(line.role),
    )
    alone = isolated_points(line.x, line.y)
    if alone.any():
        axes.plot(line.x[alone], line.y[alone], linestyle="", marker="o", color=colour)


def _draw_cells(axes: Axes, cells: charts.Cells) -> None:
    scale = mpl.colors.LinearSegmentedColormap.from_list(
        "report", [(share, _colour(role)) for share, role in cells.scale]
    )
    mesh = axes.pcolormesh(
        cells.x, cells.y, cells.values, cmap=scale, vmin=cells.low, vmax=cells.high,
        rasterized=cells.values.size > 200,  # thousands of vector cells would only be slow
    )  # fmt: skip
    if cells.name and axes.figure is not None:
        axes.figure.colorbar(mesh, ax=axes, shrink=0.6)
    roles = charts.letter_roles(cells, 0)
    for row, line in enumerate(cells.text):
        for column_, text in enumerate(line):
            axes.text(
                cells.x[column_], cells.y[row], text, ha="center", va="center", fontsize=6.5,
                color=_colour(roles[row][column_]),
            )  # fmt: skip


def _draw_path(path: Path) -> Figure:
    share = relative_width(path)
    figure = Figure(figsize=(LINE_WIDTH_IN * share, PATH_HEIGHT_IN))
    figure.set_layout_engine("none")  # constrained layout leaves a wide margin around space axes
    place = (-0.02, 0.08, 0.56, 0.86) if path.from_above else (0.02, 0.14, 0.92, 0.86)
    axes: Any = figure.add_axes(place, projection="3d")
    for points, role, name in path.lines:
        _draw_course(axes, points, role, name)
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
    if path.from_above:
        _draw_from_above(figure, path)
        handles, names = axes.get_legend_handles_labels()
        columns = _legend_columns(names)
        figure.legend(handles, names, loc="upper left", ncols=columns, borderaxespad=0.1)
    else:
        axes.legend(loc="upper left")
    return figure


def _draw_course(axes: Any, points: charts.Array, role: str, name: str) -> None:
    """Draw a line in space or, with (n, 2) points, in a plane; a single point as a dot."""
    style = {"color": _colour(role), "linestyle": _line_style(role), "linewidth": 1.2}
    if len(points) == 1:
        style |= {"marker": "o", "linestyle": "", "markersize": 4.0}
    if role in charts.HOLLOW:
        style |= {"markerfacecolor": "none", "markersize": 6.5}
    axes.plot(*points.T, label=name, **style)
    alone = isolated_points(points[:, 0], points[:, 1])
    if alone.any() and len(points) > 1:
        axes.plot(*points[alone].T, linestyle="", marker="o", color=_colour(role))


def _draw_from_above(figure: Figure, path: Path) -> None:
    axes = figure.add_axes((0.67, 0.14, 0.32, 0.72))
    for points, role, name in path.lines:
        _draw_course(axes, points[:, :2], role, name)
    axes.set_xlabel(path.labels[0])
    axes.set_ylabel(path.labels[1])
    axes.set_xlim(*path.ranges[0])
    axes.set_ylim(*path.ranges[1])
    axes.set_aspect("equal")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(nbins=4, steps=[1, 2, 2.5, 5, 10]))


def _zoom(sides: list[float]) -> float:
    """How near a box is seen: all have one diagonal, and a high one would lose its labels."""
    elevation, azimuth = np.deg2rad(VIEW_DEG)
    level = np.sin(elevation) * np.abs([np.cos(azimuth), np.sin(azimuth)])
    height = float(np.dot(sides, [*level, np.cos(elevation)]) / np.linalg.norm(sides))
    return min(MAX_ZOOM, MAX_BOX_HEIGHT / height)
