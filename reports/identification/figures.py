"""Figures of an identified arm: tables in, chart out, None for nothing to draw."""

import numpy as np

from reports.document.charts import (
    Array,
    Chart,
    Level,
    Line,
    Mark,
    Panel,
    Points,
    column,
    strips,
    texts,
    trace,
)
from reports.results import Results

AXIS_MARGIN = 1.08
POINT_SIZE = 3.0  # times the usual size: there are few


def residuals(results: Results) -> Chart | None:
    """What is left of each pose before and after."""
    table = results.table("residuals")
    rows = np.arange(len(table), dtype=float)
    panels = []
    for unit, sign, name in (("mm", "mm", "position"), ("deg", "°", "orientation")):
        before, after = column(table, f"before_{unit}"), column(table, f"after_{unit}")
        known = np.isfinite(before) & np.isfinite(after)
        if not known.any():
            continue
        highest = float(np.max([before[known], after[known]]))
        panels.append(
            Panel(
                (
                    Line(*trace(rows, before), "encoder", "before"),
                    Line(*trace(rows, after), "measured", "after"),
                ),
                f"{name} [{sign}]",
                y_range=(0.0, AXIS_MARGIN * highest or 1.0),
                unit=sign,
            )
        )
    return strips(panels, "pose", row_height=1.4)


def changes(results: Results) -> Chart | None:
    """Change of each parameter of the arm with its uncertainty, angles and lengths."""
    table = results.table("parameters")
    names, units = np.array(texts(table, "name")), np.array(texts(table, "unit"))
    change, spread = column(table, "change"), column(table, "expanded_uncertainty")
    panels = []
    for unit, sign in (("deg", "°"), ("mm", "mm")):
        own = (units == unit) & np.isfinite(change)
        if not own.any():
            continue
        places = np.arange(own.sum(), dtype=float)
        low, high = change[own] - spread[own], change[own] + spread[own]
        marks: tuple[Mark, ...] = (
            Level(0.0, "muted"),
            Line(*_vertical_bars(places, low, high), "measured"),
            Points(places, change[own], "measured", size=POINT_SIZE),
        )
        ticks = tuple(zip(places.tolist(), (str(n) for n in names[own]), strict=True))
        panels.append(
            Panel(
                marks, f"change [{sign}]", x_ticks=ticks, x_range=(-0.6, len(places) - 0.4),
                unit=sign,
            )
        )  # fmt: skip
    return Chart(tuple(panels), row_height=1.7) if panels else None


def _vertical_bars(places: Array, low: Array, high: Array) -> tuple[Array, Array]:
    gap = np.full(len(places), np.nan)
    return np.repeat(places, 3), np.stack([low, high, gap], axis=1).reshape(-1)
