"""Figures of repeated poses and paths: tables in, chart out, None for nothing to draw."""

from typing import Any

import numpy as np

from reports.document import charts
from reports.document.formatting import exact_number, finite
from reports.results import Results

MAX_POSES, MAX_PATHS = 6, 6
PANELS_PER_ROW = 3  # panels in a row that are as high as usual
AXIS_MARGIN = 1.12
CIRCLE_ANGLES = np.linspace(0, 2 * np.pi, 73)


def pose_clusters(results: Results) -> charts.Chart | None:
    """Every visit about the commanded position, two views a pose; of many poses the worst."""
    table = results.table("performance_poses")
    poses = charts.texts(table, "pose")
    if not poses:
        return None
    places = charts.columns(table, (f"d{axis}_mm" for axis in "xyz"))
    shown = _worst_entries(results, "poses", "pose", "rp_mm", MAX_POSES)
    clusters = {name: places[np.array(poses) == name] for name in shown}
    radii = {name: finite(entry.get("rp_mm")) or 0.0 for name, entry in shown.items()}
    far = AXIS_MARGIN * max(
        float(max(np.abs(own).max(), np.abs(own.mean(axis=0)).max() + radii[name]))
        for name, own in clusters.items()
    )
    panels = tuple(
        _visit_panel(own, radii[name], axes, name, far or 1.0, first=i == 0)
        for axes in ((0, 1), (0, 2))
        for i, (name, own) in enumerate(clusters.items())
    )
    many = len(shown) > PANELS_PER_ROW  # panels side by side get narrower, and need no more height
    return charts.Chart(
        panels,
        columns=len(shown),
        row_height=1.2 if many else 1.5,
        width=min(1.0, 0.28 * len(shown)),
    )


def _visit_panel(
    places: charts.Array,
    radius: float,
    axes: tuple[int, int],
    name: str,
    far: float,
    *,
    first: bool,
) -> charts.Panel:
    centre = places.mean(axis=0)
    x, y = (places[:, axis] for axis in axes)
    u, v = (float(centre[axis]) for axis in axes)
    marks: tuple[charts.Mark, ...] = (
        charts.Level(0.0, "muted"),
        charts.Level(0.0, "muted", upright=True),
        charts.Line(
            u + radius * np.cos(CIRCLE_ANGLES), v + radius * np.sin(CIRCLE_ANGLES), "resolved"
        ),
        charts.Points(x, y, "measured"),
        charts.Points(np.array([u]), np.array([v]), "resolved", "", 2.0),
    )
    step = float(f"{0.6 * far:.0e}")  # one digit: three ticks have room under a small panel
    ticks = tuple((at, exact_number(at)) for at in (-step, 0.0, step))
    return charts.Panel(
        marks,
        f"{'xyz'[axes[1]]} [mm]" if first else "",
        "x [mm]",
        name if axes[1] == 1 else "",
        x_range=(-far, far),
        y_range=(-far, far),
        x_ticks=ticks,
        y_ticks=ticks,
        equal=True,
        unit="mm",
    )


def path_band(results: Results) -> charts.Chart | None:
    """Distance of the passages' mean from each path, with RT about it."""
    table = results.table("performance_paths")
    paths = np.array(charts.texts(table, "path"))
    if not len(paths):
        return None
    panels = []
    shown = _worst_entries(results, "paths", "path", "at_mm", MAX_PATHS)
    for i, name in enumerate(shown):
        own = table[paths == name]
        along, off, radius = (charts.column(own, c) for c in ("along_mm", "off_mm", "rt_mm"))
        marks: tuple[charts.Mark, ...] = (
            charts.Band(along, np.maximum(off - radius, 0.0), off + radius, "error_band"),
            charts.Line(along, off, "error"),
        )
        last = i == len(shown) - 1
        highest = float(np.max(off + radius)) or 1.0
        panels.append(
            charts.Panel(
                marks,
                "off [mm]",
                "along the path [mm]" if last else "",
                name,
                y_range=(0.0, AXIS_MARGIN * highest),
                unit="mm",
            )
        )
    return charts.Chart(tuple(panels), row_height=1.1)


def _worst_entries(
    results: Results, kind: str, name: str, figure: str, most: int
) -> dict[str, dict[str, Any]]:
    """The entries with the largest figures, in the order of the summary."""
    entries = (results.summary.get("performance") or {}).get(kind) or []
    ranked = sorted(entries, key=lambda e: -(finite(e.get(figure)) or 0.0))[:most]
    return {str(e.get(name)): e for e in entries if e in ranked}
