"""Figures of an interim check: tables in, chart out, None for nothing to draw."""

from typing import Any

import numpy as np

from reports.document import charts
from reports.document.formatting import COVERAGE_FACTOR, finite
from reports.results import Results

MAX_NAMED_LENGTHS = 28  # lengths whose names fit under an axis
FIGURE_KEYS = {"scale": "scale_permille", "vertical": "vertical_px", "roll": "roll_deg"}
SHORT_NAMES = {"scale": "scale", "vertical": "height", "roll": "roll"}


def unit_factor(summary: dict[str, Any], figure: str) -> float | None:
    """What carries a figure from its unit in the summary to mm per metre; None: not known."""
    return finite((summary.get("mm_per_m") or {}).get(figure))


def per_metre(summary: dict[str, Any], entry: dict[str, Any]) -> tuple[float | None, float | None]:
    """A tested figure and its standard uncertainty, mm per metre."""
    name = str(entry.get("figure"))
    key, factor = FIGURE_KEYS.get(name, ""), unit_factor(summary, name)
    value = finite(entry.get(key))
    u = finite(entry.get(f"standard_uncertainty_{key.rpartition('_')[2]}"))
    if factor is None or value is None or u is None:
        return None, None
    return factor * value, factor * u


def lengths(results: Results) -> charts.Chart | None:
    """Error of each known length with its expanded uncertainty."""
    table = results.table("lengths")
    error, u = charts.column(table, "error_mm"), charts.column(table, "standard_uncertainty_mm")
    if not np.isfinite(error + u).any():
        return None
    return _error_bars(error, COVERAGE_FACTOR * u, charts.texts(table, "ends"), "error [mm]", "mm")


def figures(results: Results) -> charts.Chart | None:
    """Each figure with U (k = 2) between its limits, mm per metre."""
    entries = results.summary.get("figures") or []
    limit = finite(results.summary.get("limit"))
    known = [(at, entry, value, u) for at, entry in enumerate(entries)
             for value, u in (per_metre(results.summary, entry),)
             if value is not None and u is not None]  # fmt: skip
    if limit is None or not known:
        return None
    marks: list[charts.Mark] = [_horizontal_line(0.0, (-0.6, len(entries) - 0.4), "muted")]
    reach = 0.0
    for at, entry, value, u in known:
        for side in (-limit * u, limit * u):
            ends = (at - 0.3, at + 0.3)
            marks.append(_horizontal_line(side, ends, "tolerance", "allowed"))
        good = abs(entry.get("z") or 0.0) <= limit
        role, name = ("used", "within") if good else ("unused", "beyond")
        half = COVERAGE_FACTOR * u
        place = np.array([float(at)])
        bar = np.array([value - half, value + half])
        marks += [
            charts.Line(np.repeat(place, 2), bar, role),
            charts.Points(place, np.array([value]), role, f"{name}, ± U", 4.0),
        ]
        reach = max(reach, abs(value) + half, limit * u)
    panel = charts.Panel(
        tuple(marks),
        "value [mm/m]",
        x_ticks=tuple(
            (float(at), SHORT_NAMES.get(str(entry.get("figure")), ""))
            for at, entry in enumerate(entries)
        ),
        x_range=(-0.6, len(entries) - 0.4),
        y_range=(-1.15 * reach or -1.0, 1.15 * reach or 1.0),
        unit="mm/m",
    )
    return charts.Chart((panel,), row_height=2.6)


def over_pairs(results: Results) -> charts.Chart | None:
    """The three figures of single pairs, with what all of them give together."""
    table = results.table("pairs")
    frames = charts.column(table, "frame")
    if len(frames) < 2:
        return None
    entries = results.summary.get("figures") or []
    panels = []
    for place, (figure, key) in enumerate(FIGURE_KEYS.items()):
        factor = unit_factor(results.summary, figure)
        if factor is None:
            continue
        values = factor * charts.column(table, key)
        valid = np.isfinite(frames + values)
        if not valid.any():
            continue
        entry = entries[place] if place < len(entries) else {}
        together = per_metre(results.summary, entry)[0]
        ends = _frame_range(frames[valid])
        marks: list[charts.Mark] = [
            charts.Points(frames[valid], values[valid], "measured", "a pair", 3.0)
        ]
        if together is not None:
            marks.append(_horizontal_line(together, ends, "encoder", "all pairs together"))
        panels.append(
            charts.Panel(
                tuple(marks),
                f"{SHORT_NAMES[figure]} [mm/m]",
                x_range=ends,
                x_ticks=charts.count_ticks(frames[valid]),
                y_range=_range_with_zero(values[valid], together),
                unit="mm/m",
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
