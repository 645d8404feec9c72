"""Figures of the errors and of the flange's motion: tables in, chart out, None for nothing."""

from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from reports.document import charts
from reports.document import formatting as fmt
from reports.results import Results

PANEL_MARGIN = 0.06  # share of its extent that a panel leaves free above and below the data
# colours of the classes of a path's error, small to large; beyond the tolerance reddish ones
PATH_ROLES = ("series_3", "measured")
PATH_ROLES_BEYOND = ("resolved", "beyond")
TOLERANCE_ROOM = 1.3  # times the largest tolerance: what the joints' common scale spans


def joint_errors(results: Results) -> charts.Chart | None:
    """Encoder less measured angle, one strip a joint: pair errors, resolved error, tolerance."""
    frames, resolved = results.table("frames"), _resolved_per_frame(results)
    t, time = charts.time_axis(frames)
    joints = results.summary.get("joints") or []
    limits = [fmt.finite(joint.get("tolerance_deg")) for joint in joints]
    scale = max((v for v in limits if v is not None), default=None)
    panels = []
    for joint, limit in zip(joints, limits, strict=True):
        name = f"q{joint.get('joint')}"
        error = (
            charts.column(frames, f"{name}_error_deg"),
            charts.column(frames, f"{name}_error_u_deg"),
        )
        fit = (
            charts.column(resolved, f"{name}_resolved_deg"),
            charts.column(resolved, f"{name}_resolved_u_deg"),
        )
        panels.append(_error_panel(t, error, fit, limit, f"{name} [°]", "°", scale=scale))
    if not any(has_lines(panel) for panel in panels):
        return None
    if scale is None:
        reach = max(abs(end) for panel in panels for end in panel.y_range or ())
        panels = [replace(panel, y_range=(-reach, reach)) for panel in panels]
    return charts.strips(panels, time, row_height=0.82)


def pose_errors(results: Results) -> charts.Chart | None:
    """Distance and angle between the measured and the encoders' pose, and the resolved ones."""
    frames, resolved = results.table("frames"), _resolved_per_frame(results)
    t, time = charts.time_axis(frames)
    panels = []
    for name, unit in (("position", "mm"), ("orientation", "deg")):
        sign = fmt.UNITS[unit]
        error = charts.column(frames, f"{name}_error_{unit}")
        fit = charts.column(resolved, f"{name}_resolved_{unit}")
        u_fit = charts.column(resolved, f"{name}_resolved_u_{unit}")
        limit = fmt.finite((results.summary.get(name) or {}).get(f"tolerance_{unit}"))
        panels.append(
            _error_panel(
                t,
                (error, error * np.nan),
                (fit, u_fit),
                limit,
                f"{name} error [{sign}]",
                sign,
                one_sided=True,
            )
        )
    drawn = any(has_lines(panel) for panel in panels)
    return charts.strips(panels, time, row_height=1.3) if drawn else None


def pose(results: Results) -> charts.Chart | None:
    """Position and rotation vector of the flange over time, measured and from the encoders."""
    frames = results.table("frames")
    t, time = charts.time_axis(frames)
    turned = charts.unwrap_rotation(charts.columns(frames, ["rx_deg", "ry_deg", "rz_deg"]))
    turned_encoder = charts.unwrap_rotation(
        charts.columns(frames, ["rx_encoder_deg", "ry_encoder_deg", "rz_encoder_deg"]), turned
    )
    panels = []
    for i, axis in enumerate("xyz"):
        last = time if i == 2 else ""
        position = charts.column(frames, f"{axis}_mm"), charts.column(frames, f"{axis}_encoder_mm")
        rotation = turned[:, i], turned_encoder[:, i]
        panels.append(_pose_panel(t, *position, f"{axis} [mm]", "mm", last))
        panels.append(_pose_panel(t, *rotation, f"r{axis} [°]", "°", last))
    if not any(has_lines(panel) for panel in panels):
        return None
    return charts.Chart(tuple(panels), columns=2, row_height=1.2, shared_x=True)


def flange_path(results: Results) -> charts.Path | None:
    """The flange's measured way through the robot's base frame, by how far off it is there."""
    frames, resolved = results.table("frames"), _resolved_per_frame(results)
    points = charts.columns(frames, ("x_mm", "y_mm", "z_mm"))
    error = charts.column(resolved, "position_resolved_mm")
    if not np.isfinite(points).any():
        return None
    seen = np.flatnonzero(np.isfinite(points).all(axis=1))
    marked = [(points[seen[:1]], "start", "first pair")]
    if np.isfinite(error[seen]).any():
        worst = seen[int(np.nanargmax(error[seen]))]
        spread = charts.column(resolved, "position_resolved_u_mm")[worst]
        name = f"largest, {fmt.with_uncertainty(error[worst], 2 * spread, 'mm', signed=False)}"
        marked.append((points[[worst]], "ink", name))
    kept, part = charts.split_at_gaps(charts.time_axis(frames)[0], points.sum(axis=1))
    stride = max(1, -(-len(kept) // charts.MAX_LINE_POINTS))
    kept, part = kept[::stride], part[::stride]
    points, error = (charts.broken(values[kept], part) for values in (points, error))
    limit = fmt.finite((results.summary.get("position") or {}).get("tolerance_mm"))
    lines = [
        (_up_to_the_next(points, inside), role, name)
        for named, role, name in _error_classes(error, limit)
        if (inside := named & np.isfinite(points[:, 0])).any()
    ]
    ranges = charts.box(points, 1 + PANEL_MARGIN, least=0.5)  # mm: the arm may stand still
    labels = ("x [mm]", "y [mm]", "z [mm]")
    return charts.Path((*lines, *marked), labels, ranges, from_above=True)


def place_of_largest(results: Results, name: str) -> str:
    """Say where and when a resolved error of the flange is largest; a dash where nobody knows."""
    frames, error = results.table("frames"), charts.column(_resolved_per_frame(results), name)
    points, t = charts.columns(frames, ("x_mm", "y_mm", "z_mm")), charts.column(frames, "t_s")
    known = np.isfinite(error) & np.isfinite(points).all(axis=1)
    if not known.any():
        return fmt.DASH
    worst = int(np.nanargmax(np.where(known, error, np.nan)))
    place = ", ".join(fmt.number(value, 0) for value in points[worst])
    when = "" if not np.isfinite(t[worst]) else f", t = {fmt.number(t[worst], 1)} s"
    return f"({place}) mm{when}"


def _up_to_the_next(points: charts.Array, inside: NDArray[np.bool_]) -> charts.Array:
    """Keep a class' points, (n, 3), and the one behind each, so that the way is not broken."""
    drawn = inside.copy()
    drawn[1:] |= inside[:-1]
    return np.where(drawn[:, None], points, np.nan)


def _error_classes(
    error: charts.Array, limit: float | None
) -> list[tuple[NDArray[np.bool_], str, str]]:
    """Classes of the error between its least and its largest, parted at the tolerance too."""
    known = np.isfinite(error)
    if not known.any():
        return [(np.ones(len(error), dtype=bool), "measured", "measured")]
    edges, beyond = _class_edges(float(np.nanmin(error)), float(np.nanmax(error)), limit)
    place = np.digitize(error, edges[1:-1])
    decimals = fmt.decimals_of(edges[-1] - edges[0])
    roles = [*PATH_ROLES[: len(edges) - 1 - beyond], *PATH_ROLES_BEYOND[:beyond]]
    classes = [
        (known & (place == i), role,
         f"{fmt.number(edges[i], decimals)} to {fmt.number(edges[i + 1], decimals)} mm"
         + (", beyond the tolerance" if i >= len(roles) - beyond else ""))
        for i, role in enumerate(roles)
    ]  # fmt: skip
    return [*classes, (~known, "muted", "error not known")]


def _class_edges(least: float, most: float, limit: float | None) -> tuple[list[float], int]:
    """Edges of at most four classes, in the error's unit, and how many lie beyond the tolerance."""
    if limit is None or most <= limit:
        return [float(v) for v in np.linspace(least, most, len(PATH_ROLES) + 1)], 0
    if least >= limit:
        return [float(v) for v in np.linspace(least, most, len(PATH_ROLES_BEYOND) + 1)], 2
    return [least, (least + limit) / 2, limit, (limit + most) / 2, most], 2


def _resolved_per_frame(results: Results) -> pd.DataFrame:
    """Give the resolved errors a row for every frame, so that they break where the errors do."""
    frames, resolved = results.table("frames"), results.table("resolved")
    if "frame" not in frames or "frame" not in resolved:
        return pd.DataFrame(index=frames.index)
    return resolved.drop_duplicates("frame").set_index("frame").reindex(frames["frame"])


def _pose_panel(
    t: charts.Array, measured: charts.Array, encoder: charts.Array, label: str, unit: str, time: str
) -> charts.Panel:
    drawn = (
        charts.Line(*charts.trace(t, measured), "measured", "measured"),
        charts.Line(*charts.trace(t, encoder), "encoder", "from encoders"),
    )
    marks = tuple(line for line in drawn if np.isfinite(line.y).any())
    return charts.Panel(marks, label, time, unit=unit)


def _error_panel(
    t: charts.Array,
    pairs: tuple[charts.Array, charts.Array],
    resolved: tuple[charts.Array, charts.Array],
    limit: float | None,
    label: str,
    unit: str,
    one_sided: bool = False,
    scale: float | None = None,
) -> charts.Panel:
    (error, u), (fit, u_fit) = pairs, resolved
    low = fit - 2 * u_fit
    if one_sided:
        low = np.maximum(low, 0.0)  # a length
    drawn: list[charts.Band | charts.Line] = [
        charts.Band(*charts.band(t, error - 2 * u, error + 2 * u), "error_band", "±2u of a pair"),
        charts.Line(*charts.trace(t, error), "error", "error of a pair"),
        charts.Band(*charts.band(t, low, fit + 2 * u_fit), "resolved_band", "±2u resolved"),
        charts.Line(*charts.trace(t, fit), "resolved", "resolved error"),
    ]
    marks: list[charts.Mark] = [mark for mark in drawn if len(mark.x)]
    reach = _error_range(error, fit, u, u_fit)
    if reach is None:
        return charts.Panel((), label, title="no measured pair", unit=unit)
    title = ""
    if limit is not None:
        marks.append(charts.Level(limit, "tolerance", "tolerance"))
        reach = min(reach[0], 0.0), max(reach[1], limit)
        if not one_sided:
            marks.append(charts.Level(-limit, "tolerance", "tolerance"))
            reach = min(reach[0], -limit), reach[1]
    room = PANEL_MARGIN * (reach[1] - reach[0]) or 1e-3  # a thousandth of a degree or millimetre
    ends = (0.0 if one_sided else reach[0] - room, reach[1] + room)
    if scale is not None:  # the scale of all joints, where the errors of this one fit in
        common = TOLERANCE_ROOM * scale
        fits = max(-reach[0], reach[1]) <= common
        ends, title = ((-common, common), "") if fits else (ends, "errors beyond the common scale")
    return charts.Panel(tuple(marks), label, title=title, unit=unit, y_range=ends)


def _error_range(
    error: charts.Array, fit: charts.Array, u: charts.Array, u_fit: charts.Array
) -> tuple[float, float] | None:
    """Extent of a strip: every error, and all but the widest twentieth of the bands.

    A pair near a singularity has a band many times wider than the others; it may leave the
    frame, an error may not.
    """
    edges = [v[np.isfinite(v)] for v in (error, fit)]
    for centre, spread in ((error, u), (fit, u_fit)):
        width = 2 * spread[np.isfinite(spread)]
        if len(width):
            usual = np.minimum(2 * spread, np.quantile(width, 0.95))
            edges += [v[np.isfinite(v)] for v in (centre - usual, centre + usual)]
    every = np.concatenate(edges)
    return (float(every.min()), float(every.max())) if len(every) else None


def has_lines(panel: charts.Panel) -> bool:
    """Tell whether a panel shows any data."""
    return any(isinstance(m, charts.Line) and bool(np.isfinite(m.y).any()) for m in panel.marks)
