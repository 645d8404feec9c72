"""Figures of a calibration from boards: tables in, chart out, None for nothing to draw."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd

from reports.document import charts
from reports.document.formatting import COVERAGE_FACTOR, decimals_of, expanded, number, quantity
from reports.results import Results

CAMERAS = (("left", "series_1"), ("right", "series_2"))
COLOUR_SCALE = ((0.0, "paper"), (1.0, "used"))
N_ARROW_CELLS = 12  # across the image, for which the mean residual is drawn
MAX_ARROW_LENGTH = 0.9  # of a cell's width: how long the 95th percentile of the arrows is drawn
HEAD_LENGTH, HEAD_HALF_WIDTH = 0.3, 0.5  # of an arrow's length, and of the head's
PANEL_MARGIN = 0.06  # share of its extent that a panel leaves free around the data
MIN_COARSE = 0.1  # mm, the largest value of a grid from which on a hundredth is fine enough
MAX_TICKS = 24  # words along an axis of pairs; more would touch
SQUARE_IN = 4.2  # in, the largest height of a correlation matrix: its labels take the rest


def view_errors(results: Results) -> charts.Chart | None:
    """Reprojection error of each view, either camera."""
    table = results.table("views")
    rms, frames = charts.column(table, "rms_px"), charts.column(table, "frame")
    if not np.isfinite(rms).any():
        return None
    places = {frame: float(i) for i, frame in enumerate(np.unique(frames).tolist())}
    cameras = np.array(charts.texts(table, "camera"))
    poor = table["poor"].to_numpy(dtype=bool) if "poor" in table else np.zeros(len(table), bool)
    marks: list[charts.Mark] = []
    for side, (camera, role) in enumerate(CAMERAS):
        own = (cameras == camera) & np.isfinite(rms)
        for chosen, colour, name in (
            (own & ~poor, role, f"{camera} camera"),
            (own & poor, "tolerance", "stands out"),
        ):
            if chosen.any():
                x = np.array([places[f] for f in frames[chosen].tolist()]) + 0.4 * side - 0.2
                marks.append(charts.Bars(x, rms[chosen], np.zeros(len(x)), colour, name, 0.36))
    every = -(-len(places) // MAX_TICKS)  # rounded up
    ticks = tuple((at, f"{frame:.0f}") for frame, at in places.items())[::every]
    panel = charts.Panel(
        tuple(marks), "rms [px]", "pair", x_ticks=ticks, x_range=(-0.6, len(places) - 0.4),
        y_range=(0.0, 1.08 * float(np.nanmax(rms))), unit="px",
    )  # fmt: skip
    return charts.Chart((panel,), row_height=1.8)


def residual_vectors(results: Results) -> charts.Chart | None:
    """Residuals over the image, magnified: each corner's, and their means over cells."""
    table = results.table("residuals")
    table = table[table["used"].to_numpy(dtype=bool)] if "used" in table else table
    size = charts.numbers(results.setup.get("image_size_px"))
    names = ("x_px", "y_px", "residual_x_px", "residual_y_px")
    x, y, dx, dy = (charts.column(table, name) for name in names)
    valid = np.isfinite(x + y + dx + dy)
    if len(size) != 2 or not valid.any():
        return None
    cell = size[0] / N_ARROW_CELLS
    usual = float(np.quantile(np.hypot(dx, dy)[valid], 0.95))
    gain = MAX_ARROW_LENGTH * cell / usual if usual > 0 else 1.0
    cameras = np.array(charts.texts(table, "camera"))
    panels = []
    for camera, _ in CAMERAS:
        own = valid & (cameras == camera)
        every = arrows(x[own], y[own], gain * dx[own], gain * dy[own], head=False)
        means = _cell_means(x[own], y[own], dx[own], dy[own], cell)
        strong = arrows(means[0], means[1], gain * means[2], gain * means[3])
        panels.append(
            charts.Panel(
                (
                    charts.Line(*every, "vector", "single residual"),
                    charts.Line(*strong, "series_6", "mean over a cell"),
                    *_scale_arrow(usual, gain, size),
                ),
                title=f"{camera} camera",
                x_label="x [px]",
                y_label="y [px]" if camera == "left" else "",
                x_range=(-0.5, size[0] - 0.5),
                y_range=(size[1] - 0.5, -0.13 * size[1]),  # y down; room for the scale on top
                equal=True,
                unit="px",
            )
        )
    return charts.Chart(tuple(panels), columns=2, row_height=2.1)


def arrows(
    x: charts.Array, y: charts.Array, dx: charts.Array, dy: charts.Array, head: bool = True
) -> tuple[charts.Array, charts.Array]:
    """Draw arrows as one line that NaN breaks: shaft, and a head of two strokes."""
    gap = np.full_like(x, np.nan)
    tip_x, tip_y = x + dx, y + dy
    rows_x, rows_y = [x, tip_x], [y, tip_y]
    if head:
        back_x, back_y = tip_x - HEAD_LENGTH * dx, tip_y - HEAD_LENGTH * dy
        side_x, side_y = -HEAD_LENGTH * HEAD_HALF_WIDTH * dy, HEAD_LENGTH * HEAD_HALF_WIDTH * dx
        rows_x += [gap, back_x + side_x, tip_x, back_x - side_x]
        rows_y += [gap, back_y + side_y, tip_y, back_y - side_y]
    x_line, y_line = (np.stack([*rows, gap], axis=1).ravel() for rows in (rows_x, rows_y))
    return x_line, y_line


def _cell_means(
    x: charts.Array, y: charts.Array, dx: charts.Array, dy: charts.Array, cell: float
) -> tuple[charts.Array, ...]:
    places = pd.DataFrame({"i": np.floor(x / cell), "j": np.floor(y / cell), "dx": dx, "dy": dy})
    means = places.groupby(["i", "j"], sort=True)[["dx", "dy"]].mean().reset_index()
    i, j = means["i"].to_numpy(), means["j"].to_numpy()
    return (i + 0.5) * cell, (j + 0.5) * cell, means["dx"].to_numpy(), means["dy"].to_numpy()


def _scale_arrow(usual: float, gain: float, size: list[float]) -> tuple[charts.Mark, ...]:
    """Give an arrow of a round length, and its length in words, above the picture."""
    long = float(f"{2 * usual:.0e}")
    start, level = 0.02 * size[0], -0.065 * size[1]
    line = arrows(np.array([start]), np.array([level]), np.array([gain * long]), np.zeros(1))
    words = charts.Note(
        start + gain * long + 0.1 * size[0], level + 0.025 * size[1], f"{long:g} px"
    )
    return charts.Line(*line, "ink"), words


def coverage(results: Results) -> charts.Chart | None:
    """How many corners fell into each part of either image."""
    table = results.table("coverage")
    counts = charts.column(table, "corners")
    if not np.isfinite(counts).any():
        return None
    top = float(np.nanmax(counts)) or 1.0
    panels = []
    for camera, _ in CAMERAS:
        own = table[np.array(charts.texts(table, "camera")) == camera]
        grid = own.pivot_table(index="y_px", columns="x_px", values="corners")
        if grid.empty:
            continue
        panel = _grid_panel(grid, top, lambda v: f"{v:.0f}", f"{camera} camera", "px")
        panels.append(replace(panel, equal=True, y_label=panel.y_label if camera == "left" else ""))
    return charts.Chart(tuple(panels), columns=2, row_height=1.9) if panels else None


def _grid_panel(
    grid: pd.DataFrame, top: float, write: Callable[[float], str], title: str, unit: str
) -> charts.Panel:
    """Lay out a table of numbers over x and y, y down as in an image; NaN is an empty cell."""
    values = grid.to_numpy(dtype=float)
    text = tuple(tuple(write(v) if np.isfinite(v) else "" for v in line) for line in values)
    x, y = grid.columns.to_numpy(dtype=float), grid.index.to_numpy(dtype=float)
    return charts.Panel(
        (charts.Cells(values, x, y, COLOUR_SCALE, 0.0, top, text),),
        title=title,
        x_label=f"x [{unit}]",
        y_label=f"y [{unit}]",
        x_range=_cell_range(x),
        y_range=_cell_range(y)[::-1],
    )


def _cell_range(centres: charts.Array) -> tuple[float, float]:
    half = (centres[1] - centres[0]) / 2 if len(centres) > 1 else 0.5
    return float(centres[0] - half), float(centres[-1] + half)


def board_poses(results: Results) -> charts.Chart | None:
    """How the boards stood: tilt about either axis, and distance."""
    table = results.table("boards")
    horizontal, vertical = (
        charts.column(table, f"about_{a}_deg") for a in ("horizontal", "vertical")
    )
    distance, tilt = charts.column(table, "distance_mm"), charts.column(table, "tilt_deg")
    if not np.isfinite(distance).any():
        return None
    reach = max(float(np.nanmax(np.abs([horizontal, vertical]))), 20.0) * (1 + PANEL_MARGIN)
    room = PANEL_MARGIN * (float(np.nanmax(distance)) - float(np.nanmin(distance))) + 1.0
    tilts = charts.Panel(
        (charts.Points(vertical, horizontal, "used", "a board", 3.0),),
        title="tilt of each board",
        x_label="tilt about the vertical axis [°]",
        y_label="about the horizontal axis [°]",
        x_range=(-reach, reach),
        y_range=(-reach, reach),
        unit="°",
    )
    far = charts.Panel(
        (charts.Points(distance, tilt, "used", "a board", 3.0),),
        title="distance of each board",
        x_label="distance [mm]",
        y_label="tilt in all [°]",
        x_range=(float(np.nanmin(distance)) - room, float(np.nanmax(distance)) + room),
        y_range=(0.0, 1.08 * max(float(np.nanmax(tilt)), 20.0)),
        unit="°",
    )
    return charts.Chart((tilts, far), columns=2, row_height=2.2)


def scene(results: Results) -> charts.Path | None:
    """Where the boards stood before the cameras, in space."""
    table = results.table("scene")
    points = charts.columns(table, (f"{axis}_mm" for axis in "xyz"))
    if not np.isfinite(points).any():
        return None
    shown = points[:, [0, 2, 1]] * [1.0, 1.0, -1.0]  # depth to the back, up upwards
    kinds, names = np.array(charts.texts(table, "kind")), np.array(charts.texts(table, "name"))
    lines = []
    for kind, wanted, role, name in (
        ("board", "", "series_8", "boards"),
        *(("camera", camera, role, f"{camera} camera") for camera, role in CAMERAS),
    ):
        chosen = (kinds == kind) & ((names == wanted) | (wanted == ""))
        if chosen.any():
            lines.append((charts.broken(shown[chosen], names[chosen]), role, name))
    low, high = np.nanmin(shown, axis=0), np.nanmax(shown, axis=0)
    room = 0.02 * float(np.max(high - low))
    ranges = tuple(zip((low - room).tolist(), (high + room).tolist(), strict=True))
    return charts.Path(tuple(lines), ("x [mm]", "distance [mm]", "up [mm]"), ranges)


def accuracy(results: Results) -> charts.Chart | None:
    """Expected uncertainty (k = 2) of a point over the field, a row a distance."""
    table = results.table("accuracy")
    parts = (("random_total_mm", "the spots' noise"), ("systematic_total_mm", "the rig"))
    every = np.concatenate([charts.column(table, name) for name, _ in parts])
    if not np.isfinite(every).any():
        return None
    top = COVERAGE_FACTOR * float(np.nanmax(every))
    panels = []
    for distance in np.unique(charts.column(table, "distance_mm")).tolist():
        own = table[charts.column(table, "distance_mm") == distance]
        for name, words in parts:
            grid = own.pivot_table(index="y_mm", columns="x_mm", values=name, dropna=False)
            grid = COVERAGE_FACTOR * grid
            title = f"{distance / 1e3:g} m away, from {words} [mm]"
            finest = 2 if float(np.nanmax(grid.to_numpy())) >= MIN_COARSE else 3
            panel = _grid_panel(grid, top, partial(_two_digits, finest=finest), title, "mm")
            panels.append(panel if name == parts[0][0] else replace(panel, y_label=""))
    return charts.Chart(tuple(panels), columns=2, row_height=1.55)


def contributions(results: Results) -> charts.Chart | None:
    """What would be left of a depth's uncertainty (k = 2), were one group of parameters exact."""
    table = results.table("contributions")
    left = COVERAGE_FACTOR * charts.column(table, "without_mm")
    if not np.isfinite(left).any():
        return None
    places = np.arange(len(table), dtype=float)
    marks: list[charts.Mark] = [charts.Bars(places, left, np.zeros(len(left)), "used", "")]
    total = expanded((results.summary.get("improve_first") or {}).get("depth_mm"))
    top = float(np.nanmax(left))
    if total is not None:
        ends = np.array([-0.6, len(table) - 0.4])
        marks.append(
            charts.Line(
                ends, np.full(2, total), "tolerance", f"at present: {quantity(total, 'mm')}"
            )
        )
        top = max(top, total)
    # they stand side by side
    names = [text.replace(" ", "\n", 1) for text in charts.texts(table, "group")]
    ticks = tuple(zip(places.tolist(), names, strict=True))
    panel = charts.Panel(
        tuple(marks), "U of the depth [mm]", "source left out", x_ticks=ticks,
        x_range=(-0.6, len(table) - 0.4), y_range=(0.0, 1.08 * top), unit="mm",
    )  # fmt: skip
    return charts.Chart((panel,), row_height=1.9)


def _two_digits(value: float, finest: int) -> str:
    """Two significant digits, and no more than `finest` decimals: as many as fit a cell."""
    return number(value, 0 if value >= 10 else min(decimals_of(value), finest))


def correlation(results: Results, write: Callable[[str], str] = str) -> charts.Chart | None:
    """How parameters hang together; `write` gives the word for a parameter's name."""
    entry = results.summary.get("parameter_correlation") or {}
    names = [write(str(name)) for name in entry.get("parameters") or []]
    values = charts.square(entry.get("correlation"), len(names))
    if len(names) < 2 or not values.size:
        return None
    rows = tuple((at, f"{name} ({at + 1})") for at, name in enumerate(names))
    step = 1 + len(names) // MAX_TICKS
    columns = tuple((at, f"{at + 1}") for at in range(0, len(names), step))
    panel = charts.correlation_panel(values, rows, columns)
    height = min(0.3 + 0.175 * len(names), SQUARE_IN)
    return charts.Chart((panel,), row_height=height, width=0.85)
