"""Figures of an interim check: tables in, chart out, None for nothing to draw."""

import numpy as np

from reports.document import charts
from reports.document.formatting import COVERAGE_FACTOR, finite
from reports.results import Results

MAX_NAMED_LENGTHS = 28  # lengths whose names fit under an axis
SHORT_NAMES = {"scale": "scale", "vertical": "height", "roll": "roll"}
PAIR_PANELS = (  # of the figures a pair: column, key in the summary, label, unit
    ("scale_permille", "scale [‰]", "‰"),
    ("vertical_px", "height [px]", "px"),
    ("roll_deg", "roll [°]", "°"),
)


def lengths(results: Results) -> charts.Chart | None:
    """Error of each known length with its expanded uncertainty."""
    table = results.table("lengths")
    error, u = charts.column(table, "error_mm"), charts.column(table, "standard_uncertainty_mm")
    if not np.isfinite(error + u).any():
        return None
    return _error_bars(error, COVERAGE_FACTOR * u, charts.texts(table, "ends"), "error [mm]", "mm")


def figures(results: Results) -> charts.Chart | None:
    """Each figure in its standard uncertainty, against the limit."""
    entries = results.summary.get("figures") or []
    z = [finite(entry.get("z")) for entry in entries]
    limit = finite(results.summary.get("limit"))
    if limit is None or not any(value is not None for value in z):
        return None
    places = np.arange(len(z), dtype=float)
    heights = np.array([np.nan if value is None else value for value in z])
    good = np.abs(heights) <= limit
    ends = (-0.6, len(z) - 0.4)
    marks: list[charts.Mark] = [
        _horizontal_line(limit, ends, "tolerance", f"limit ± {limit:.2f}"),
        _horizontal_line(-limit, ends, "tolerance"),
    ]
    for chosen, role, name in ((good, "used", "within"), (~good, "unused", "beyond")):
        shown = chosen & np.isfinite(heights)
        if shown.any():
            marks.append(charts.Points(places[shown], heights[shown], role, name, 4.0))
    reach = 1.25 * max(limit, float(np.nanmax(np.abs(heights))))
    panel = charts.Panel(
        tuple(marks),
        "figure over its u",
        x_ticks=tuple(
            (float(at), SHORT_NAMES.get(str(entry.get("figure")), ""))
            for at, entry in zip(places, entries, strict=True)
        ),
        x_range=ends,
        y_range=(-reach, reach),
    )
    return charts.Chart((panel,), row_height=1.9, width=0.7)


def over_pairs(results: Results) -> charts.Chart | None:
    """The three figures of single pairs, with what all of them give together."""
    table = results.table("pairs")
    frames = charts.column(table, "frame")
    if len(frames) < 2:
        return None
    entries = results.summary.get("figures") or []
    panels = []
    for place, (name, label, unit) in enumerate(PAIR_PANELS):
        values = charts.column(table, name)
        valid = np.isfinite(frames + values)
        if not valid.any():
            continue
        together = finite(entries[place].get(name)) if place < len(entries) else None
        ends = _frame_range(frames[valid])
        marks: list[charts.Mark] = [
            charts.Points(frames[valid], values[valid], "measured", "a pair", 3.0)
        ]
        if together is not None:
            marks.append(_horizontal_line(together, ends, "encoder", "all pairs together"))
        panels.append(
            charts.Panel(
                tuple(marks),
                label,
                x_range=ends,
                y_range=_range_with_zero(values[valid], together),
                unit=unit,
            )
        )
    return charts.strips(panels, "pair", row_height=1.0)


def _error_bars(
    error: charts.Array, half: charts.Array, names: list[str], label: str, unit: str
) -> charts.Chart:
    """Points with upright bars about them, and a line at 0."""
    places = np.arange(len(error), dtype=float)
    reach = 1.15 * float(np.nanmax(np.abs(error) + half)) or 1.0
    gap = np.full_like(error, np.nan)
    upright = np.stack([places, places, gap], axis=1).ravel()
    bars = np.stack([error - half, error + half, gap], axis=1).ravel()
    ends = (-0.6, len(error) - 0.4)
    marks: tuple[charts.Mark, ...] = (
        _horizontal_line(0.0, ends, "muted"),
        charts.Line(upright, bars, "error", "U (k = 2)"),
        charts.Points(places, error, "error", "measured less known", 4.0),
    )
    every = -(-len(names) // MAX_NAMED_LENGTHS)  # rounded up
    panel = charts.Panel(
        marks,
        label,
        "LEDs at its ends",
        x_ticks=tuple(zip(places.tolist(), names, strict=True))[::every],
        x_range=ends,
        y_range=(-reach, reach),
        unit=unit,
    )
    return charts.Chart((panel,), row_height=1.9)


def _horizontal_line(
    value: float, ends: tuple[float, float], role: str, name: str = ""
) -> charts.Line:
    """A level line over the whole panel, whatever the points' range."""
    return charts.Line(np.array(ends), np.full(2, value), role, name)


def _frame_range(frames: charts.Array) -> tuple[float, float]:
    room = 0.02 * float(np.ptp(frames)) + 0.5
    return float(frames.min()) - room, float(frames.max()) + room


def _range_with_zero(values: charts.Array, together: float | None) -> tuple[float, float]:
    """A range with 0 in it: how far off, not only how scattered, is to be seen."""
    every = np.append(values, [0.0, together or 0.0])
    room = 0.08 * float(np.ptp(every)) or 1.0
    return float(every.min()) - room, float(every.max()) + room
