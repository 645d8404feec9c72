"""Figures of a robot's registration: tables in, chart out, None for nothing to draw."""

from collections.abc import Callable

import numpy as np

from reports.calibration_figures import CAMERAS, vectors
from reports.charts import Bars, Chart, Line, Mark, Note, Panel, Path
from reports.formatting import finite, percent
from reports.results import Results
from reports.series import column, texts, trace


def visible(results: Results) -> Chart | None:
    """Share of a constant offset of each joint that can still be seen."""
    joints = results.summary.get("joints") or []
    shares = [finite(joint.get("visible_fraction")) for joint in joints]
    if not any(share is not None for share in shares):
        return None
    places = np.arange(len(joints), dtype=float)
    heights = np.array([100 * share if share is not None else 0.0 for share in shares])
    marks: list[Mark] = [Bars(places, heights, np.zeros(len(joints)), "used", "")]
    marks += [
        Note(float(at), float(height) + 2.0, percent(share))
        for at, height, share in zip(places, heights, shares, strict=True)
    ]
    ticks = tuple((float(at), f"q{j.get('joint')}") for at, j in zip(places, joints, strict=True))
    panel = Panel(
        tuple(marks), "visible [%]", x_ticks=ticks, x_range=(-0.6, len(joints) - 0.4),
        y_range=(0.0, 112.0), unit="%",
    )  # fmt: skip
    return Chart((panel,), row_height=1.8, width=0.7)


def over_time(results: Results) -> Chart | None:
    """Residuals of each pair, either camera."""
    table = results.table("residuals")
    frames, dx, dy = (column(table, n) for n in ("frame", "residual_x_px", "residual_y_px"))
    known = np.isfinite(frames + dx + dy)
    if "used" in table:
        known &= table["used"].to_numpy(dtype=bool)
    if not known.any():
        return None
    cameras = np.array(texts(table, "camera"))
    panels = []
    for camera, role in CAMERAS:
        own = known & (cameras == camera)
        pairs = np.unique(frames[own])
        squares = dx**2 + dy**2
        rms = np.array([np.sqrt(np.mean(squares[own & (frames == f)])) for f in pairs])
        panels.append(
            Panel(
                (Line(*trace(pairs, rms), role, f"{camera} camera"),),
                "rms [px]",
                "pair" if camera == "right" else "",
                y_range=(0.0, 1.08 * float(rms.max())) if len(rms) else None,
                unit="px",
            )
        )
    return Chart(tuple(panels), row_height=1.1, shared_x=True)


def linearity(results: Results) -> Chart | None:
    """Encoder less turn about the axis, over each swept joint."""
    table = results.table("sweeps")
    joints = column(table, "joint")
    panels = []
    for joint in np.unique(joints[np.isfinite(joints)]).tolist():
        own = joints == joint
        q, error = column(table, "reading_deg")[own], column(table, "nonlinearity_deg")[own]
        order = np.argsort(q, kind="stable")
        panels.append(
            Panel(
                (Line(q[order], error[order], "measured"),),
                f"q{joint:.0f} [°]",
                "reading [°]",
                unit="°",
            )
        )
    return Chart(tuple(panels), columns=2, row_height=1.1) if panels else None


REGISTRATION_FIGURES: dict[str, Callable[[Results], Chart | Path | None]] = {
    "visible": visible,
    "over_time": over_time,
    "vectors": vectors,
    "linearity": linearity,
}
