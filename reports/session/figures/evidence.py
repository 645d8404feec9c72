"""Figures of what the results rest on: tables in, chart out, None for nothing."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from reports.document import charts
from reports.document import formatting as fmt
from reports.results import Results
from reports.session import phrases

PANEL_MARGIN = 0.06  # share of its extent that a panel leaves free around the data
# spots; more of them cover each other, so their density is shown instead
MAX_SCATTER_POINTS = 5_000
DENSITY_CELLS = 61  # a side; odd, so that one cell is centred on zero


def correlation(results: Results) -> charts.Chart | None:
    """How the mean errors of the joints hang together."""
    rows = results.summary.get("joint_error_correlation")
    names = [f"q{joint.get('joint')}" for joint in (results.summary.get("joints") or [])]
    values = charts.square(rows, len(names))
    if len(names) < 2 or not np.isfinite(values).any():
        return None
    text = tuple(tuple(fmt.number(v, 2) for v in line) for line in values)
    ticks = tuple((float(place), name) for place, name in enumerate(names))
    panel = charts.correlation_panel(values, ticks, ticks, text)
    return charts.Chart((panel,), row_height=0.25 + 0.32 * len(names), width=0.62)


def residuals(results: Results) -> charts.Chart | None:
    """Where spots were seen, less where the measured pose puts them, for either camera."""
    spots = results.table("spots")
    x, y = charts.column(spots, "residual_x_px"), charts.column(spots, "residual_y_px")
    valid = np.isfinite(x) & np.isfinite(y)
    if not valid.any():
        return None
    used = _used_spots(spots)
    cameras = np.array(charts.texts(spots, "camera"))
    reach = float(np.max(np.abs(np.concatenate([x[valid], y[valid]])))) * (1 + PANEL_MARGIN) or 1.0
    panels = []
    for camera in ("left", "right"):
        chosen = valid & (cameras == camera)
        marks: list[charts.Mark] = []
        if chosen.sum() > MAX_SCATTER_POINTS:
            marks.append(_density(x[chosen], y[chosen], reach))
        else:
            marks.append(charts.Points(x[chosen & used], y[chosen & used], "used", "used"))
            if (chosen & ~used).any():
                marks.append(
                    charts.Points(x[chosen & ~used], y[chosen & ~used], "unused", "refused")
                )
        u = charts.column(spots, "u_px")[chosen]
        if np.isfinite(u).any():
            turn = np.linspace(0, 2 * np.pi, 73)
            radius = 2 * float(np.nanmedian(u))
            circle = radius * np.cos(turn), radius * np.sin(turn)
            marks.append(charts.Line(*circle, "tolerance", "2u of a spot (median)"))
        panels.append(
            charts.Panel(
                tuple(marks),
                title=f"{camera} camera",
                x_label="x residual [px]",
                y_label="y residual [px]" if camera == "left" else "",
                x_range=(-reach, reach),
                y_range=(reach, -reach),  # y down, as in the image
                equal=True,
                unit="px",
            )
        )
    return charts.Chart(tuple(panels), columns=2, row_height=2.6)


def reprojection(results: Results) -> charts.Chart | None:
    """Reprojection residual of each pair, and how many LEDs were seen, over time."""
    frames = results.table("frames")
    t, time = charts.time_axis(frames)
    rms, leds = charts.column(frames, "reprojection_rms_px"), charts.column(frames, "leds_seen")
    if not (np.isfinite(rms).any() or np.isfinite(leds).any()):
        return None
    top = float(np.nanmax(leds)) if np.isfinite(leds).any() else 1.0
    return charts.Chart(
        (
            charts.Panel(
                (charts.Line(*charts.trace(t, rms), "measured"),), "rms residual [px]", unit="px"
            ),
            charts.Panel(
                (charts.Line(*charts.trace(t, leds), "measured"),),
                "LEDs seen",
                time,
                y_range=(-0.3, top + 0.5),
            ),
        ),
        row_height=1.3,
        shared_x=True,
    )


def clock(results: Results) -> charts.Chart | None:
    """How well each encoder clock offset explains the motion, and the one that was found."""
    curve = results.table("clock_curve")
    offset, cost = charts.column(curve, "offset_s"), charts.column(curve, "cost")
    if np.isfinite(offset + cost).sum() < 2:
        return None
    marks: list[charts.Mark] = [charts.Line(offset, cost, "measured", "misfit")]
    entry = results.summary.get("clock") or {}
    found = fmt.finite(entry.get("encoder_offset_s"))
    if found is not None:
        name = f"offset {fmt.quantity(found, 's', 4)}"
        marks.append(charts.Level(found, "resolved", name, upright=True))
    panel = charts.Panel(tuple(marks), "misfit", "encoder clock offset [s]")
    return charts.Chart((panel,), row_height=2.0, width=0.8)


def timeline(results: Results) -> charts.Chart | None:
    """Which pairs were measured and which were not, over time."""
    frames = results.table("frames")
    t, time = charts.time_axis(frames)
    statuses = charts.texts(frames, "status")
    kinds = [s for s in phrases.STATUSES if s in statuses]
    kinds += sorted(set(statuses) - set(kinds))
    if not kinds or not np.isfinite(t).any():
        return None
    half = charts.median_step(t) / 2
    found = charts.runs(statuses, t)
    marks = []
    for row, kind in enumerate(kinds):
        own = [(first, last) for status, first, last in found if status == kind]
        starts = np.array([t[first] - half for first, _ in own])
        ends = np.array([t[last] + half for _, last in own])
        marks.append(charts.Runs(starts, ends, row, "used" if kind == "measured" else "unused"))
    ticks = tuple(
        (float(i), fmt.lookup_label(phrases.STATUSES, kind)) for i, kind in enumerate(kinds)
    )
    panel = charts.Panel(
        tuple(marks), x_label=time, y_ticks=ticks, y_range=(len(kinds) - 0.4, -0.6)
    )
    return charts.Chart((panel,), row_height=0.6 + 0.25 * len(kinds))


def budget(results: Results) -> charts.Chart | None:
    """What share of each joint's variance comes from which source."""
    shares = budget_shares(results.table("budget"))
    if shares.empty:
        return None
    order = shares.sum(axis=1).sort_values(ascending=False, kind="stable").index
    head = list(order[: len(charts.SERIES) - 1]) if len(order) > len(charts.SERIES) else list(order)
    layers = [(str(name).replace("_", " "), shares.loc[name].to_numpy(float)) for name in head]
    if len(head) < len(order):
        layers.append(("all others", shares.loc[order[len(head) :]].sum().to_numpy(float)))
    x = np.arange(shares.shape[1], dtype=float)
    below = np.zeros(len(x))
    marks: list[charts.Mark] = []
    for (name, heights), role in zip(layers, charts.SERIES, strict=False):
        marks.append(charts.Bars(x, 100 * heights, below, role, name))
        below = below + 100 * heights
    joints = {joint.get("joint"): joint for joint in (results.summary.get("joints") or [])}
    for place, name in zip(x, shares.columns, strict=True):
        u = (joints.get(name) or {}).get("expanded_uncertainty_deg")
        if fmt.finite(u) is not None:
            marks.append(charts.Note(float(place), 104.0, fmt.significant(u)))
    ticks = tuple((float(i), f"q{name}") for i, name in zip(x, shares.columns, strict=True))
    panel = charts.Panel(
        tuple(marks), "share of variance [%]", x_ticks=ticks, y_range=(0, 112), unit="%",
        x_range=(-0.6, len(x) - 0.4),
    )  # fmt: skip
    return charts.Chart((panel,), row_height=2.6)


def budget_shares(table: pd.DataFrame) -> pd.DataFrame:
    """Share of the sum of variances, sources down, joints across; empty without a budget."""
    if not {"joint", "source", "standard_uncertainty_deg"} <= set(table.columns):
        return pd.DataFrame()
    stated = table.dropna(subset=["joint", "source", "standard_uncertainty_deg"])
    u = stated["standard_uncertainty_deg"].astype(float)
    # correlated sources that cancel take away from the sum; there is no bar for that
    variance = stated.assign(variance=(u * u.abs()).clip(lower=0.0))
    wide = variance.pivot_table(
        index="source", columns="joint", values="variance", aggfunc="sum", sort=False
    ).fillna(0.0)
    total = wide.sum()
    shares: pd.DataFrame = (wide / total.where(total > 0)).fillna(0.0)
    return shares if bool((total > 0).any()) else pd.DataFrame()


def _used_spots(spots: pd.DataFrame) -> NDArray[np.bool_]:
    if "used" not in spots:
        return np.ones(len(spots), dtype=bool)
    return spots["used"].fillna(False).to_numpy(dtype=bool)


def _density(x: charts.Array, y: charts.Array, reach: float) -> charts.Cells:
    edges = np.linspace(-reach, reach, DENSITY_CELLS + 1)
    counts, _, _ = np.histogram2d(y, x, bins=(edges, edges))
    centres = (edges[1:] + edges[:-1]) / 2
    shade = np.log10(1 + counts)  # a few stray spots must still show beside thousands
    return charts.Cells(
        shade, centres, centres, ((0.0, "paper"), (1.0, "used")), 0.0, float(shade.max())
    )
