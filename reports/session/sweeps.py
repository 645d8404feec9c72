"""What single-joint sweeps show of a joint's encoder, without any registration."""

from typing import Any

import numpy as np
import pandas as pd

from reports.document import blocks as doc
from reports.document import formatting as fmt
from reports.document.charts import Chart, Level, Line, Mark, Panel, Points, column
from reports.results import Results
from reports.session.evidence import relative_motions

# standard uncertainties: a false one in a dozen sessions of seven figures
MIN_SIGNIFICANT_RATIO = 3.49
P_SIGNIFICANT = 0.001  # p-value: below it noise is no explanation
COVERAGE_FACTOR = 2.0
PANEL_MARGIN = 0.05  # of the span, free on either side
POINT_SIZE = 2.0  # of a point: a sweep has some tens
SWEEP_NOTE = (
    "While one joint turns alone, the flange turns about that joint's axis, wherever the robot "
    "stands, however the measured body is mounted and whatever the arm's table says. How far it "
    "turned, against what the encoder says, shows that joint directly. A constant offset does not "
    "show."
)
NO_SWEEPS = (
    "No single-joint sweep: turn one joint alone by 10° or more, up and down, while all others "
    "rest, and its gear ratio, hysteresis and eccentricity show here."
)
SWEEP_CAPTION = (
    "Reading less angle turned about the joint's own axis, against the reading, either way; the "
    "lines are what was fitted. The mean of each sweep is zero, as a constant does not show."
)
TABLE_NOTE = (
    "Gear error: what the reading grows by, over what the joint turns by, less one. Hysteresis: "
    "reading on the way up less reading on the way down. Eccentricity: amplitude once a turn; it "
    "shows where more than 60° are swept. Beside the line: rms of what gear error and hysteresis "
    "leave. Off the axis: rms distance of the flange from a circle about one fixed axis."
)


def registration_free_tests(results: Results) -> doc.Section:
    """Lay out all tests that no registration enters: relative motions, then single joints."""
    blocks = (*relative_motions(results), *_blocks(results))
    return doc.Section("relative", "Without any registration", blocks)


def _blocks(results: Results) -> tuple[doc.Block, ...]:
    entries = results.summary.get("sweeps") or []
    if not entries:
        return (doc.Paragraph(NO_SWEEPS, "note"),)
    findings = tuple(text for entry in entries for text in _findings(entry))
    names = fmt.joint_names(sorted({entry.get("joint") for entry in entries}))
    nothing = (
        f"Turned alone, {names}: the encoder follows the turn about its own axis; no gear error, "
        "hysteresis or eccentricity beyond chance."
    )
    figure = doc.Figure(
        "sweeps",
        SWEEP_CAPTION,
        "One panel a sweep: error of the reading in degrees against the reading, up and down.",
    )
    return (
        doc.Bullets(findings) if findings else doc.Paragraph(nothing),
        doc.Paragraph(SWEEP_NOTE),
        doc.block_or_paragraph(figure, _chart(results), "The sweeps' pairs were not kept."),
        _table(entries),
        *_excluded_pairs(entries),
    )


def _excluded_pairs(entries: list[dict[str, Any]]) -> list[doc.Block]:
    lines = [
        f"Left out of joint {fmt.count(entry.get('joint'))}'s sweep, as they lie off the circle "
        f"beyond chance: pairs {', '.join(fmt.count(frame) for frame in entry['outlying_frames'])}."
        for entry in entries
        if entry.get("outlying_frames")
    ]
    return [doc.Bullets(tuple(lines), "warning")] if lines else []


def _findings(entry: dict[str, Any]) -> list[str]:
    """What of a sweep is beyond chance, a sentence each."""
    findings = []
    if _is_significant(*_figure(entry, "gain", "")):
        findings.append(f"gear error {_gear_error(entry)} % (k = 2).")
    hysteresis = _figure(entry, "hysteresis")
    if _is_significant(*hysteresis):
        findings.append(f"hysteresis {_expanded(*hysteresis, unit='°')} (k = 2).")
    eccentricity = _figure(entry, "eccentricity")
    if entry.get("eccentricity_beyond_chance") and eccentricity[0] is not None:
        size = _expanded(*eccentricity, unit="°", signed=False)
        findings.append(f"eccentricity {size} (k = 2), once a turn.")
    if _is_beyond_chance(entry, "nonlinearity"):
        size = fmt.quantity(entry.get("nonlinearity_rms_deg"), "°")
        noise = fmt.quantity(entry.get("noise_rms_deg"), "°")
        findings.append(
            f"its errors follow no known curve; beside the line they are {size} rms, where noise "
            f"gives {noise}."
        )
    if _is_beyond_chance(entry, "wobble"):
        place = fmt.quantity(entry.get("wobble_rms_mm"), "mm")
        turn = fmt.quantity(entry.get("wobble_rms_deg"), "°")
        findings.append(
            f"the flange does not turn about one fixed axis; it leaves it by {place} and {turn} "
            "rms, more than noise explains."
        )
    return [f"Joint {fmt.count(entry.get('joint'))}: {finding}" for finding in findings]


def _is_significant(value: float | None, u: float | None) -> bool:
    return value is not None and u is not None and abs(value) > MIN_SIGNIFICANT_RATIO * u


def _is_beyond_chance(entry: dict[str, Any], name: str) -> bool:
    p = fmt.finite(entry.get(f"{name}_p_value"))
    return p is not None and p < P_SIGNIFICANT


def _expanded(value: float | None, u: float | None, unit: str = "", signed: bool = True) -> str:
    return fmt.with_uncertainty(value, None if u is None else COVERAGE_FACTOR * u, unit, signed)


def _gear_error(entry: dict[str, Any]) -> str:
    gain, u = _figure(entry, "gain", "")
    return _expanded(None if gain is None else 100 * gain, None if u is None else 100 * u)


def _figure(
    entry: dict[str, Any], name: str, unit: str = "_deg"
) -> tuple[float | None, float | None]:
    """Take a figure of a sweep and its standard uncertainty."""
    u = entry.get(f"{name}_standard_uncertainty{unit}")
    return fmt.finite(entry.get(f"{name}{unit}")), fmt.finite(u)


def _table(entries: list[dict[str, Any]]) -> doc.Table:
    columns = (
        doc.Column("Joint", "c", doc.field("joint")),
        doc.Column("Pairs", "r", doc.field("pairs", fmt.count)),
        doc.Column("Swept [°]", "r", doc.field("span_deg", fmt.number, 1)),
        doc.Column("Gear error [%]", "r", _gear_error),
        doc.Column("Hysteresis [°]", "r", lambda e: _expanded(*_figure(e, "hysteresis"))),
        doc.Column("Eccentricity [°]", "r", _eccentricity),
        doc.Column("Beside the line [°]", "r", doc.field("nonlinearity_rms_deg", fmt.number)),
        doc.Column("Noise gives [°]", "r", doc.field("noise_rms_deg", fmt.number)),
        doc.Column("Off the axis [mm]", "r", doc.field("wobble_rms_mm", fmt.number, 2)),
    )
    title = "Each joint's encoder against the turn about its own axis; ± U with k = 2."
    return doc.tabulate(title, columns, entries, TABLE_NOTE)


def _eccentricity(entry: dict[str, Any]) -> str:
    """An amplitude that chance explains is no value but a bound."""
    value, u = _figure(entry, "eccentricity")
    if value is None or u is None:
        return fmt.DASH
    if entry.get("eccentricity_beyond_chance"):
        return _expanded(value, u, signed=False)
    return f"< {fmt.quantity(value + COVERAGE_FACTOR * u, '')}"


def _chart(results: Results) -> Chart | None:
    table = results.table("sweeps")
    if not len(table) or not {"sweep", "joint"} <= set(table.columns):
        return None
    panels = [
        _panel(part, f"joint {fmt.count(joint)}")
        for (_, joint), part in table.groupby(["sweep", "joint"], sort=True)
    ]
    return Chart(tuple(panels), columns=2 if len(panels) > 1 else 1, row_height=1.7)


def _panel(part: pd.DataFrame, title: str) -> Panel:
    angle, error = column(part, "angle_deg"), column(part, "error_deg")
    curve, direction = column(part, "curve_deg"), column(part, "direction")
    marks: list[Mark] = [Level(0.0, "muted")]
    for sense, role, name in ((1, "measured", "on the way up"), (-1, "encoder", "on the way down")):
        mine = np.flatnonzero(direction == sense)
        mine = mine[np.argsort(angle[mine], kind="stable")]
        if len(mine):
            marks.append(Points(angle[mine], error[mine], role, name, POINT_SIZE))
            marks.append(Line(angle[mine], curve[mine], role))
    least, most = float(np.nanmin(angle)), float(np.nanmax(angle))
    room = PANEL_MARGIN * (most - least)
    return Panel(
        tuple(marks), "error [°]", "reading [°]", title, (least - room, most + room), unit="°"
    )
