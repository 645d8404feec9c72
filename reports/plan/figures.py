"""Figures of a planned session: tables in, chart out, None for nothing to draw."""

import numpy as np

from reports.document import charts
from reports.document.formatting import finite
from reports.results import Results

AXIS_MARGIN = 1.12
BAR_OFFSET = 0.2  # of a joint's room: two bars stand beside each other
MAX_SPOTS = 1500  # a camera: more only blacken
AXIS_MM = 150.0  # of a camera's axis in the picture
PATH_MARGIN = 0.08  # share of the path's extent left free


def detectable(results: Results) -> charts.Chart | None:
    """Expanded uncertainty and detectable error, two bars a joint."""
    joints = results.summary.get("joints") or []
    keys = (
        ("expanded_uncertainty_deg", "measured", "U of the mean error"),
        ("minimum_detectable_error_deg", "encoder", "detectable offset"),
    )
    places = np.arange(len(joints), dtype=float)
    marks: list[charts.Mark] = []
    highest = 0.0
    for side, (key, role, name) in zip((-BAR_OFFSET, BAR_OFFSET), keys, strict=True):
        heights = np.array([finite(j.get(key)) or 0.0 for j in joints], dtype=float)
        highest = max(highest, float(heights.max(initial=0.0)))
        none = np.zeros(len(joints))
        marks.append(charts.Bars(places + side, heights, none, role, name, width=1.8 * BAR_OFFSET))
    if highest == 0.0:
        return None
    ticks = tuple((float(at), f"q{j.get('joint')}") for at, j in zip(places, joints, strict=True))
    panel = charts.Panel(
        tuple(marks), "angle [°]", x_ticks=ticks, x_range=(-0.6, len(joints) - 0.4),
        y_range=(0.0, AXIS_MARGIN * highest), unit="°",
    )  # fmt: skip
    return charts.Chart((panel,), row_height=1.8)


def over_time(results: Results) -> charts.Chart | None:
    """Each joint's angle over time, rests at poses marked."""
    table = results.table("trajectory")
    t, rest = charts.column(table, "t_s"), np.isfinite(charts.column(table, "pose"))
    panels = []
    for joint in results.summary.get("joints") or []:
        q = charts.column(table, f"q{joint.get('joint')}_deg")
        if not np.isfinite(q).any():
            return None
        marks: tuple[charts.Mark, ...] = (charts.Line(*charts.trace(t, q), "measured", "motion"),)
        if rest.any():
            marks += (charts.Points(t[rest], q[rest], "encoder", "at a pose", size=0.8),)
        panels.append(charts.Panel(marks, f"q{joint.get('joint')} [°]", unit="°"))
    return charts.strips(panels, "time [s]", row_height=0.66)


def view(results: Results) -> charts.Chart | None:
    """Where the LEDs are in either picture."""
    table, size = results.table("spots"), charts.numbers(results.summary.get("image_size"))
    x, y = charts.column(table, "x_px"), charts.column(table, "y_px")
    if not np.isfinite(x).any() or len(size) != 2:
        return None
    cameras, leds = np.array(charts.texts(table, "camera")), np.array(charts.texts(table, "led"))
    panels = []
    for camera in ("left", "right"):
        own = np.flatnonzero(cameras == camera)
        own = own[:: max(1, -(-len(own) // MAX_SPOTS))]
        marks: tuple[charts.Mark, ...] = tuple(
            charts.Points(x[of], y[of], charts.SERIES[i % len(charts.SERIES)], f"LED {led}")
            for i, led in enumerate(np.unique(leds).tolist())
            for of in (own[leds[own] == led],)
        )
        panels.append(
            charts.Panel(
                marks, "y [px]", "x [px]", f"{camera} camera", x_range=(0.0, size[0]),
                y_range=(size[1], 0.0), equal=True, unit="px",
            )
        )  # fmt: skip
    return charts.Chart(tuple(panels), columns=2, row_height=2.1)


def path(results: Results) -> charts.Path | None:
    """The flange's way, the arm at some poses, and the cameras."""
    table, cameras = results.table("arm"), results.table("cameras")
    points = charts.columns(table, (f"{a}_mm" for a in "xyz"))
    what, number = np.array(charts.texts(table, "what")), charts.column(table, "number")
    if not np.isfinite(points).any():
        return None
    arm = what == "arm"
    eyes = charts.columns(cameras, (f"{a}_mm" for a in "xyz"))
    ahead = charts.columns(cameras, (f"axis_{a}" for a in "xyz"))
    axes = np.stack([eyes, eyes + AXIS_MM * ahead], axis=1).reshape(-1, 3)
    lines = (
        (points[what == "flange"], "measured", "flange"),
        (charts.broken(points[arm], number[arm]), "muted", "arm"),
        (charts.broken(axes, np.repeat(np.arange(len(eyes)), 2)), "encoder", "cameras"),
    )
    every = np.concatenate([line for line, _, _ in lines])
    return charts.Path(lines, ("x [mm]", "y [mm]", "z [mm]"), charts.box(every, 1 + PATH_MARGIN))
