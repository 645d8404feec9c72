"""Figures of a grab: tables in, chart out, None for nothing to draw."""

import numpy as np
import pandas as pd

from reports.document import charts
from reports.document.formatting import COVERAGE_FACTOR
from reports.results import Results

N_JOINTS = 6
N_COLUMNS = 2  # of their panels
AXIS_EXTENSION = 1.15  # of the data, so that no line runs along the frame
MIN_BOX_SIDE = 0.8  # of a box in space, against its longest side: a slim one is cut off
MIN_NAMED_SHARE = 0.02  # of the motion: a shorter part would be named and not seen
MIN_SPAN_DEG = 2.0  # °, of an axis: what is less is noise
MAX_MARGIN_RATIO = 1.3  # times what the gripper leaves: an axis shows no more
SIDES = (("left", "series_1"), ("right", "series_6"))


def states(results: Results) -> charts.Chart | None:
    """Which state it was in when; in the order in which they came up."""
    table = results.table("cycles")
    t, names = charts.column(table, "t_s"), charts.texts(table, "state")
    if len(t) < 2:
        return None
    order = list(dict.fromkeys(names))
    step = float(np.median(np.diff(t)))
    marks: list[charts.Mark] = []
    for place, name in enumerate(order):
        inside = np.array([other == name for other in names])
        edges = np.diff(np.concatenate([[0], inside.astype(int), [0]]))
        starts, ends = t[edges[:-1] == 1], t[np.flatnonzero(edges == -1) - 1] + step
        marks.append(charts.Runs(starts, ends, len(order) - 1 - place, f"series_{1 + place % 8}"))
    ticks = tuple((float(len(order) - 1 - i), name) for i, name in enumerate(order))
    panel = charts.Panel(
        tuple(marks), x_label="time [s]", y_ticks=ticks, x_range=(float(t[0]), float(t[-1]) + step),
        y_range=(-0.7, len(order) - 0.3),
    )  # fmt: skip
    return charts.Chart((panel,), row_height=0.35 + 0.17 * len(order))


def track(results: Results) -> charts.Path | None:
    """The target's track and the grip point's way in space, base frame."""
    table = results.table("cycles")
    target, grip = _point_columns(table, "target"), _point_columns(table, "grip")
    planned = _point_columns(results.table("plan"), "grip")
    lines = [
        (points, role, name)
        for points, role, name in (
            (target, "measured", "target, seen by the cameras"),
            (grip, "encoder", "grip point, by the encoders"),
            (planned, "series_3", "grip point, planned"),
        )
        if np.isfinite(points).all(axis=1).any()
    ]
    if not lines:
        return None
    every = np.vstack([points for points, _, _ in lines])
    ranges = charts.box(every, AXIS_EXTENSION, MIN_BOX_SIDE / 2)
    return charts.Path(tuple(lines), ("x [mm]", "y [mm]", "z [mm]"), ranges)


def windows(results: Results) -> charts.Chart | None:
    """CAMSHIFT's window over time: where it is, how large, and how good."""
    table = results.table("cycles")
    t = charts.column(table, "t_s")
    if not np.isfinite(charts.column(table, "left_x_px")).any():
        return None
    labels = {"x": "centre x [px]", "y": "centre y [px]", "width": "width [px]",
              "height": "height [px]"}  # fmt: skip
    panels = [_camera_panel(table, t, what, label) for what, label in labels.items()]
    quality = charts.Line(t, charts.column(table, "quality"), "series_3", "quality")
    panels.append(charts.Panel((quality,), "quality", y_range=(0.0, 1.05), x_label="time [s]"))
    return charts.Chart(tuple(panels), row_height=0.85, shared_x=True)


def joints(results: Results) -> charts.Chart | None:
    """Joint angles: read, and as they were ordered."""
    table = results.table("cycles")
    t = charts.column(table, "t_s")
    if not np.isfinite(charts.column(table, "q1_deg")).any():
        return None
    ordered = np.isfinite(charts.column(table, "q1_ordered_deg")).any()
    panels = []
    for joint in range(1, N_JOINTS + 1):
        marks: list[charts.Mark] = [
            charts.Line(t, charts.column(table, f"q{joint}_deg"), "measured", "read")
        ]
        if ordered:
            name = f"q{joint}_ordered_deg"
            marks.append(charts.Line(t, charts.column(table, name), "encoder", "ordered"))
        panels.append(_angle_panel(joint, marks))
    return charts.Chart(tuple(panels), columns=N_COLUMNS, row_height=0.95, shared_x=True)


def planned_motion(results: Results) -> charts.Chart | None:
    """Joint angles over the planned motion."""
    table = results.table("plan")
    if len(table) < 2:
        return None
    t, parts = charts.column(table, "t_s"), np.array(charts.texts(table, "part"))
    shortest = MIN_NAMED_SHARE * float(np.ptp(t))
    panels = []
    for joint in range(1, N_JOINTS + 1):
        q = charts.column(table, f"q{joint}_deg")
        marks: list[charts.Mark] = [
            charts.Line(t[own], q[own], role, name if np.ptp(t[own]) > shortest else "")
            for part, role, name in (
                ("over", "series_1", "over to it"),
                ("down", "series_6", "down"),
                ("up", "series_3", "up"),
            )
            if (own := parts == part).any()
        ]
        panels.append(_angle_panel(joint, marks))
    return charts.Chart(tuple(panels), columns=N_COLUMNS, row_height=0.95, shared_x=True)


def margins(results: Results) -> charts.Chart | None:
    """Expanded uncertainty (k = 2) of the target's position over time, and the clearance."""
    table = results.table("cycles")
    t = charts.column(table, "t_s")
    marks: list[charts.Mark] = [
        charts.Line(
            t,
            COVERAGE_FACTOR * charts.column(table, f"u_{axis}_mm"),
            f"series_{place}",
            f"U({axis})",
        )
        for place, axis in zip((1, 2, 3), "xyz", strict=True)
    ]
    if not np.isfinite(charts.column(table, "u_x_mm")).any():
        return None
    most = 0.0
    margin = (results.summary.get("plan") or {}).get("margin") or {}
    for what, key, role in (
        ("sideways", "across", "tolerance"), ("along the approach", "along", "second_limit"),
    ):  # fmt: skip
        allowed = margin.get(f"{key}_mm")
        if allowed:
            most = max(most, MAX_MARGIN_RATIO * float(allowed))
            marks.append(charts.Level(float(allowed), role, f"clearance {what}"))
    ends = (0.0, most) if most else None
    panel = charts.Panel(tuple(marks), "U [mm]", "time [s]", y_range=ends, unit="mm")
    return charts.Chart((panel,), row_height=1.7)


def _camera_panel(table: pd.DataFrame, t: charts.Array, what: str, label: str) -> charts.Panel:
    marks = tuple(
        charts.Line(t, charts.column(table, f"{s}_{what}_px"), role, s) for s, role in SIDES
    )
    return charts.Panel(marks, label, unit="px")


def _angle_panel(joint: int, marks: list[charts.Mark]) -> charts.Panel:
    drawn = np.concatenate([mark.y for mark in marks if isinstance(mark, charts.Line)])
    low, high = float(np.nanmin(drawn)), float(np.nanmax(drawn))
    half = max((high - low) * AXIS_EXTENSION, MIN_SPAN_DEG) / 2
    ends = ((low + high) / 2 - half, (low + high) / 2 + half)
    label = f"joint {joint} [°]"
    below = "time [s]" if joint > N_JOINTS - N_COLUMNS else ""  # the lowest row: one axis for all
    return charts.Panel(tuple(marks), label, x_label=below, y_range=ends, unit="°")


def _point_columns(table: pd.DataFrame, name: str) -> charts.Array:
    return charts.columns(table, (f"{name}_{axis}_mm" for axis in "xyz"))
