"""Figures of an identified arm: tables in, chart out, None for nothing to draw."""

import numpy as np

from reports.document import charts
from reports.results import Results

AXIS_MARGIN = 1.08
POINT_SIZE = 3.0  # times the usual size: there are few


def residuals(results: Results) -> charts.Chart | None:
    """What is left of each pose before and after."""
    table = results.table("residuals")
    rows = np.arange(len(table), dtype=float)
    panels = []
    for unit, sign, name in (("mm", "mm", "position"), ("deg", "°", "orientation")):
        before, after = (
            charts.column(table, f"before_{unit}"),
            charts.column(table, f"after_{unit}"),
        )
        known = np.isfinite(before) & np.isfinite(after)
        if not known.any():
            continue
        highest = float(np.max([before[known], after[known]]))
        panels.append(
            charts.Panel(
                (
                    charts.Line(*charts.trace(rows, before), "encoder", "before"),
                    charts.Line(*charts.trace(rows, after), "measured", "after"),
                ),
                f"{name} [{sign}]",
                y_range=(0.0, AXIS_MARGIN * highest or 1.0),
                unit=sign,
            )
        )
    return charts.strips(panels, "pose", row_height=1.4)


def changes(results: Results) -> charts.Chart | None:
    """Change of each parameter of the arm with its uncertainty, angles and lengths."""
    table = results.table("parameters")
    names, units = np.array(charts.texts(table, "name")), np.array(charts.texts(table, "unit"))
    change, spread = charts.column(table, "change"), charts.column(table, "expanded_uncertainty")
    panels = []
    for unit, sign in (("deg", "°"), ("mm", "mm")):
        own = (units == unit) & np.isfinite(change)
        if not own.any():
            continue
        places = np.arange(own.sum(), dtype=float)
        low, high = change[own] - spread[own], change[own] + spread[own]
        marks: tuple[charts.Mark, ...] = (
            charts.Level(0.0, "muted"),
            charts.Line(*_vertical_bars(places, low, high), "measured"),
            charts.Points(places, change[own], "measured", size=POINT_SIZE),
        )
        ticks = tuple(zip(places.tolist(), (str(n) for n in names[own]), strict=True))
        panels.append(
            charts.Panel(
                marks, f"change [{sign}]", x_ticks=ticks, x_range=(-0.6, len(places) - 0.4),
                unit=sign,
            )
        )  # fmt: skip
    return charts.Chart(tuple(panels), row_height=1.7) if panels else None


def _vertical_bars(
    places: charts.Array, low: charts.Array, high: charts.Array
) -> tuple[charts.Array, charts.Array]:
    gap = np.full(len(places), np.nan)
    return np.repeat(places, 3), np.stack([low, high, gap], axis=1).reshape(-1)
