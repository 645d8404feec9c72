"""Figures of an identified arm: tables in, chart out, None for nothing to draw."""

import numpy as np

from reports.document import charts
from reports.document.formatting import COVERAGE_FACTOR, UNITS
from reports.identification.names import in_words
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
    return charts.strips(panels, "pose", row_height=1.05)


def changes(results: Results, unit: str) -> charts.Chart | None:
    """Change of each parameter of the arm in deg or mm with its U (k = 2), the first on top."""
    table = results.table("parameters")
    change = charts.column(table, "change")
    own = (np.array(charts.texts(table, "unit")) == unit) & np.isfinite(change)
    if not own.any():
        return None
    names = np.array(charts.texts(table, "name"))[own].tolist()
    places = np.arange(len(names), dtype=float)
    half = COVERAGE_FACTOR * charts.column(table, "standard_uncertainty")[own]
    bars = np.stack([change[own] - half, change[own] + half, np.full(len(names), np.nan)], axis=1)
    marks: tuple[charts.Mark, ...] = (
        charts.Level(0.0, "muted", upright=True),
        charts.Line(bars.ravel(), np.repeat(places, 3), "measured"),
        charts.Points(change[own], places, "measured", size=POINT_SIZE),
    )
    panel = charts.Panel(
        marks,
        x_label=f"change [{UNITS[unit]}]",
        y_ticks=tuple(zip(places.tolist(), map(in_words, names), strict=True)),
        y_range=(len(names) - 0.4, -0.6),
        unit=UNITS[unit],
    )
    return charts.Chart((panel,), row_height=0.45 + 0.17 * len(names))
