"""Charts on the screen: plotly figures as plain dicts, coloured by role.

A colour stands as `role:NAME`; the page puts in the light or the dark one, and changes them
when the reader's scheme changes. Numbers travel as base64 float arrays, a third of the text.
"""

import base64
import html
import math
from typing import Any

import numpy as np

from reports.document import charts
from reports.document.charts import Array, Chart, Mark, Panel, Path, isolated_points, pieces
from reports.format.scales import coverage, numbered, widened
from reports.results import one_line

PIXELS_PER_INCH = 150  # of a chart's height: strips on a screen want more room than on paper
PRINTED_PIXELS_PER_INCH = 92  # on paper, where the PDF's pages are the measure
GAP_PX = 40  # between rows of panels that have labels of their own
STRIP_GAP_PX = 14  # between strips that share their time axis
TITLE_GAP_PX = 18  # more, where a panel has a title
LABEL_GAP_PX = 16  # more, where a label stands above a title
TOP_PX, BOTTOM_PX = 34, 44  # for the legend and for the label of the time axis
LEGEND_ROW_PX, NARROW_NAMES = 29, 2  # more for each row of it; names of a row on a narrow screen
MAX_BOX_DIAGONAL = 1.2  # diagonal of a box, its longest side 1, that the nearest view holds
MAX_STEPS = 5  # between the numbers of the longest axis in space
CORNERS = {"x": 0.05, "y": 0.05, "z": 0.13}  # of an axis in space, free of numbers
MARKER_PX, RING_PX = 7, 12  # a point that stands for itself; a ring about one


def specification(chart: Chart | Path) -> dict[str, Any]:
    """Give plotly's data and its layouts: wide, for a screen too narrow for columns, printed.

    Charts of one `time` zoom together.
    """
    if isinstance(chart, Path):
        return _path(chart)
    data: list[dict[str, Any]] = []
    shown: set[str] = set()
    for index, panel in enumerate(chart.panels):
        for mark in panel.marks:
            traces = _traces(mark, panel, chart)
            for trace in traces:
                trace |= {"xaxis": f"x{_suffix(index)}", "yaxis": f"y{_suffix(index)}"}
                trace["showlegend"] = trace.get("name", "") not in shown | {""}
                shown.add(trace.get("name", ""))
            data += traces
    layouts = {
        "layout": _layout(chart, chart.columns),
        "narrow": _layout(chart, 1),
        "printed": _layout(chart, chart.columns, PRINTED_PIXELS_PER_INCH),
    }
    for layout in layouts.values():
        layout["showlegend"] = bool(shown - {""})
    more = LEGEND_ROW_PX * max(math.ceil(len(shown - {""}) / NARROW_NAMES) - 1, 0)
    layouts["narrow"]["margin"]["t"] += more
    layouts["narrow"]["height"] += more
    time = chart.panels[-1].x_label if chart.shared_x else ""
    return {"data": data, **layouts, "width": chart.width, "time": time}


def colour(role: str) -> str:
    """Name a colour for the page to put in; `one|other`: one on light, the other on dark."""
    return f"role:{role}"


def escape_label(words: str) -> str:
    """Make a user's words safe for plotly, which reads some HTML in its labels."""
    return "<br>".join(html.escape(one_line(line), quote=False) for line in words.split("\n"))


def _suffix(index: int) -> str:
    return "" if index == 0 else str(index + 1)


def _floats(values: Array, kind: str = "f4") -> dict[str, str]:
    raw = np.ascontiguousarray(values, dtype=f"<{kind}").tobytes()
    return {"dtype": kind, "bdata": base64.b64encode(raw).decode()}


def _traces(mark: Mark, panel: Panel, chart: Chart) -> list[dict[str, Any]]:
    if isinstance(mark, charts.Line):
        return _line(mark, panel)
    if isinstance(mark, charts.Band):
        return _band(mark)
    if isinstance(mark, charts.Points):
        return [
            _scatter(mark.x, mark.y, "markers", mark.name)
            | {"marker": {"color": colour(mark.role), "size": 4 * mark.size, "opacity": 0.6}}
            | _hover(panel)
        ]
    if isinstance(mark, charts.Runs):
        return [_runs(mark)]
    if isinstance(mark, charts.Cells):
        return [_cells(mark), *_letters(mark)]
    if isinstance(mark, charts.Bars):
        return [_bars(mark, panel)]
    if isinstance(mark, charts.Level):
        return _level(mark, panel, chart)
    return [
        _scatter(np.array([mark.x]), np.array([mark.y]), "text")
        | {"text": [escape_label(mark.text)], "textfont": {"size": 11}, "hoverinfo": "skip"}
    ]


def _scatter(x: Array, y: Array, mode: str, name: str = "") -> dict[str, Any]:
    return {
        "type": "scatter",
        "mode": mode,
        "name": escape_label(name),
        "legendgroup": escape_label(name),
        "x": _floats(x, "f8"),
        "y": _floats(y),
    }


def _hover(panel: Panel) -> dict[str, Any]:
    space = "" if panel.unit in ("", "°") else " "
    return {"hovertemplate": f"%{{x:.4~f}}: %{{y:.4~f}}{space}{panel.unit}"}


def _line(line: charts.Line, panel: Panel) -> list[dict[str, Any]]:
    style = {
        "color": colour(line.role),
        "width": charts.STROKES.get(line.role, charts.STROKE),
        "dash": charts.DASHES.get(line.role, "solid"),
    }
    traces = [
        _scatter(line.x, line.y, "lines", line.name)
        | {"line": style, "connectgaps": False}
        | _hover(panel)
    ]
    alone = isolated_points(line.x, line.y)
    if alone.any():
        dots = _scatter(line.x[alone], line.y[alone], "markers", line.name)
        traces.append(dots | {"marker": {"color": colour(line.role), "size": 5}} | _hover(panel))
    return traces


def _band(band: charts.Band) -> list[dict[str, Any]]:
    """Draw closed outlines, one a piece, parted by NaN; a piece of one point is a thin bar."""
    outlines_x: list[Array] = []
    outlines_y: list[Array] = []
    gap = np.array([np.nan])
    for piece in pieces(band.x):
        x, low, high = band.x[piece], band.low[piece], band.high[piece]
        outlines_x += [x, x[::-1], x[:1], gap]
        outlines_y += [low, high[::-1], low[:1], gap]
    if not outlines_x:
        return []
    trace = _scatter(np.concatenate(outlines_x), np.concatenate(outlines_y), "lines", band.name)
    style = {"color": colour(band.role), "width": 0}
    if all(piece.stop - piece.start == 1 for piece in pieces(band.x)):
        style["width"] = 2
    return [
        trace
        | {"fill": "toself", "fillcolor": colour(band.role), "line": style, "hoverinfo": "skip"}
    ]


def _level(level: charts.Level, panel: Panel, chart: Chart) -> list[dict[str, Any]]:
    """Draw a level as a line of two points, right across the panel or as far as its marks go."""
    given = panel.y_range if level.upright else panel.x_range
    alike = chart.panels if chart.shared_x and not level.upright else (panel,)
    valid = np.concatenate(coverage(alike, int(level.upright)))
    ends = np.array([valid.min(), valid.max()] if len(valid) else [0.0, 1.0])
    ends = np.array(given) if given else ends
    if ends[0] == ends[1]:
        ends = ends + np.array([-0.5, 0.5])
    fixed = np.full(2, level.value)
    x, y = (fixed, ends) if level.upright else (ends, fixed)
    style = {"color": colour(level.role), "width": 1.4}
    style["dash"] = charts.DASHES.get(level.role, "solid")
    return [_scatter(x, y, "lines", level.name) | {"line": style, "hoverinfo": "skip"}]


def _runs(runs: charts.Runs) -> dict[str, Any]:
    gap = np.full(len(runs.starts), np.nan)
    x = np.stack([runs.starts, runs.ends, gap], axis=1).ravel()
    y = np.where(np.isfinite(x), float(runs.row), np.nan)
    style = {"color": colour(runs.role), "width": 12}
    hover = {"hovertemplate": "%{x:.3~f} s<extra></extra>"}
    return _scatter(x, y, "lines") | {"line": style} | hover


def _cells(cells: charts.Cells) -> dict[str, Any]:
    return {
        "type": "heatmap",
        "x": _floats(cells.x),
        "y": _floats(cells.y),
        "z": [[float(v) if np.isfinite(v) else None for v in line] for line in cells.values],
        "zmin": cells.low,
        "zmax": cells.high,
        "colorscale": [[share, colour(role)] for share, role in cells.scale],
        "showscale": bool(cells.name),
        "colorbar": {"thickness": 12, "outlinewidth": 0},
        "hoverinfo": "skip",
    }


def _letters(cells: charts.Cells) -> list[dict[str, Any]]:
    """Write the text of cells in the colour that has more contrast there, by day and by night."""
    if not cells.text:
        return []
    x, y = np.meshgrid(cells.x, cells.y)
    roles = zip(*(np.ravel(charts.letter_roles(cells, scheme)) for scheme in (0, 1)), strict=True)
    colours = [colour(f"{day}|{night}") for day, night in roles]
    words = [escape_label(text) for line in cells.text for text in line]
    style = {"text": words, "textfont": {"color": colours}, "hoverinfo": "skip"}
    return [_scatter(x.ravel(), y.ravel(), "text") | style]


def _bars(bars: charts.Bars, panel: Panel) -> dict[str, Any]:
    return {
        "type": "bar",
        "name": escape_label(bars.name),
        "legendgroup": escape_label(bars.name),
        "x": _floats(bars.x),
        "y": _floats(bars.heights),
        "width": bars.width,
        "marker": {"color": colour(bars.role), "line": {"width": 0}},
        "hovertemplate": f"%{{y:.3~g}} {panel.unit}",
    }


def _layout(chart: Chart, columns: int, px_per_inch: int = PIXELS_PER_INCH) -> dict[str, Any]:
    rows = -(-len(chart.panels) // columns)
    titled = any(panel.title for panel in chart.panels)
    row = chart.row_height * px_per_inch
    gap = STRIP_GAP_PX if chart.shared_x and columns == chart.columns else GAP_PX
    gap += TITLE_GAP_PX * titled + (
        GAP_PX if any(p.equal and p.x_label for p in chart.panels) else 0
    )
    if titled and any(p.x_label for p in chart.panels) and not chart.shared_x:
        gap += LABEL_GAP_PX
    plot = rows * row + (rows - 1) * gap
    above = TOP_PX + TITLE_GAP_PX * titled
    layout: dict[str, Any] = {
        "height": round(plot + above + BOTTOM_PX),
        "margin": {"l": 62, "r": 12, "t": above, "b": BOTTOM_PX},
        "barmode": "stack",
        "hovermode": "closest",
        "annotations": [],
    }
    between = 0.1 * (columns > 1)
    span = (1 - between * (columns - 1)) / columns
    for index, panel in enumerate(chart.panels):
        line, place = divmod(index, columns)
        top = 1 - line * (row + gap) / plot
        domain = [max(top - row / plot, 0.0), top]
        left = place * (span + between)
        last = index + columns >= len(chart.panels)
        label = panel.x_label or (chart.panels[-1].x_label if last and chart.shared_x else "")
        _axes(layout, index, panel, [left, left + span], domain)
        if chart.shared_x:
            if index:
                layout[f"xaxis{_suffix(index)}"]["matches"] = "x"
            layout[f"xaxis{_suffix(index)}"]["showticklabels"] = last
            label = label if last else ""
        layout[f"xaxis{_suffix(index)}"]["title"] = {"text": escape_label(label), "standoff": 6}
        if panel.title:
            layout["annotations"].append(
                {
                    "text": escape_label(panel.title), "x": left, "y": top, "xref": "paper",
                    "yref": "paper", "xanchor": "left", "yanchor": "bottom", "showarrow": False,
                }
            )  # fmt: skip
    return layout


def _axes(
    layout: dict[str, Any], index: int, panel: Panel, across: list[float], up: list[float]
) -> None:
    suffix = _suffix(index)
    x: dict[str, Any] = {"domain": across, "anchor": f"y{suffix}", "zeroline": False}
    y: dict[str, Any] = {"domain": up, "anchor": f"x{suffix}", "zeroline": False}
    y["title"] = {"text": escape_label(panel.y_label), "standoff": 4}
    for axis, ends, ticks in ((x, panel.x_range, panel.x_ticks), (y, panel.y_range, panel.y_ticks)):
        if ends:
            axis["range"] = list(ends)
        if ticks:
            axis["tickvals"] = [place for place, _ in ticks]
            axis["ticktext"] = [escape_label(word) for _, word in ticks]
            axis["showgrid"] = False
            axis["automargin"] = True
    if panel.equal:
        y |= {"scaleanchor": f"x{suffix}", "constrain": "domain"}
        x |= {"constrain": "domain", "constraintoward": "left"}
    layout[f"xaxis{suffix}"], layout[f"yaxis{suffix}"] = x, y


def _path(path: Path) -> dict[str, Any]:
    data = [_line_in_space(*line) for line in path.lines]
    longest = max(high - low for low, high in path.ranges)
    sides = [(high - low) / longest for low, high in path.ranges]
    away = max(
        float(np.linalg.norm(sides)) / MAX_BOX_DIAGONAL, 1.0
    )  # a cube needs more room than a plate
    scene: dict[str, Any] = {
        "aspectmode": "manual",
        "aspectratio": dict(zip("xyz", sides, strict=True)),
        "camera": {"eye": {"x": 0.95 * away, "y": -1.3 * away, "z": 0.7 * away}},
        "dragmode": "orbit",
    }
    for axis, label, ends, side in zip("xyz", path.labels, path.ranges, sides, strict=True):
        scene[f"{axis}axis"] = {
            "title": {"text": label},
            "range": list(ends),
            **_ticks(ends, side, CORNERS[axis]),
        }
    layout = {
        "height": 520,
        "margin": {"l": 0, "r": 0, "t": TOP_PX, "b": 0},
        "scene": scene,
        "showlegend": True,
    }
    far = {axis: 1.35 * place for axis, place in scene["camera"]["eye"].items()}
    narrow = layout | {"height": 400, "scene": scene | {"camera": {"eye": far}}}
    printed = layout | {"height": 320, "scene": narrow["scene"]}
    if path.from_above:
        data += [_line_from_above(*line) for line in path.lines]
        layout = _beside(layout, path)
        printed = _beside(printed, path)
        narrow = _beside(narrow, path, below=True)
    return {
        "data": data, "layout": layout, "narrow": narrow, "printed": printed, "width": 1.0,
        "time": "",
    }  # fmt: skip


def _ticks(ends: tuple[float, float], side: float, corner: float) -> dict[str, Any]:
    """The numbers of an axis in space; none near a corner, where those of two axes would meet."""
    steps = max(2, round(MAX_STEPS * side))  # a short side has no room for more
    made = numbered(widened(ends), steps)
    far = [tick for tick in made.ticks
           if corner < made.place(tick[0], 0.0, 1.0) < 1 - corner]  # fmt: skip
    if made.power:
        return {"nticks": steps}
    shown = far or made.visible()
    return {"tickvals": [at for at, _ in shown], "ticktext": [word for _, word in shown]}


def _line_in_space(points: Array, role: str, name: str) -> dict[str, Any]:
    trace: dict[str, Any] = {
        "type": "scatter3d",
        "mode": _mode(points),
        "name": escape_label(name),
        "legendgroup": escape_label(name),
        "line": {"color": colour(role), "width": 4, "dash": charts.DASHES.get(role, "solid")},
        "marker": {"color": colour(role), "size": 5 if len(points) == 1 else 2} | _ring(role, 9),
        "hovertemplate": "%{x:.2f}, %{y:.2f}, %{z:.2f} mm",
    }
    return trace | {axis: _floats(points[:, i]) for i, axis in enumerate("xyz")}


def _ring(role: str, size: int) -> dict[str, Any]:
    return {"symbol": "circle-open", "size": size} if role in charts.HOLLOW else {}


def _mode(points: Array) -> str:
    """Say how plotly draws (n, 3) points: a single one, or one without a neighbour, as a dot."""
    if len(points) == 1:
        return "markers"
    return "lines+markers" if isolated_points(points[:, 0], points[:, 1]).any() else "lines"


def _line_from_above(points: Array, role: str, name: str) -> dict[str, Any]:
    """Draw x and y of a line in space; its name stands in the legend already."""
    trace = _scatter(points[:, 0], points[:, 1], _mode(points), name)
    style = {"color": colour(role), "width": 2.5, "dash": charts.DASHES.get(role, "solid")}
    marker = {"color": colour(role), "size": MARKER_PX if len(points) == 1 else 3}
    marker |= _ring(role, RING_PX)
    hover = {"hovertemplate": "%{x:.2f}, %{y:.2f} mm"}
    return trace | {"line": style, "marker": marker, "showlegend": False} | hover


def _beside(layout: dict[str, Any], path: Path, below: bool = False) -> dict[str, Any]:
    """Make room for the view from above: on the right, or below the view in space."""
    titles = [{"text": label, "standoff": 6} for label in path.labels[:2]]
    across, up = ([0.0, 1.0], [0.0, 0.42]) if below else ([0.58, 1.0], [0.0, 1.0])
    seen = {"y": [0.5, 1.0], "x": [0.0, 1.0]} if below else {"x": [0.0, 0.5], "y": [0.0, 1.0]}
    x = {"domain": across, "anchor": "y", "title": titles[0], "constrain": "domain"}
    y = {"domain": up, "anchor": "x", "title": titles[1], "constrain": "domain",
         "scaleanchor": "x", "automargin": True}  # fmt: skip
    return layout | {
        "height": 2 * layout["height"] if below else layout["height"],
        "margin": {"l": 62 if below else 0, "r": 12, "t": 2 * TOP_PX, "b": BOTTOM_PX},
        "scene": layout["scene"] | {"domain": seen},
        "xaxis": x | {"range": list(path.ranges[0]), "zeroline": False},
        "yaxis": y | {"range": list(path.ranges[1]), "zeroline": False},
    }
