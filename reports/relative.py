"""What shows without any registration: relative motions, measured against the encoders'."""

from typing import Any

import numpy as np

from reports.blocks import Block, Figure, Paragraph, Section, Table, drawn_or_said, row
from reports.charts import Band, Chart, Level, Mark, Panel, Points
from reports.formatting import count, finite, number, significant
from reports.results import Results
from reports.series import column

DOUBTFUL = 0.001  # p-value: below it noise is no explanation
WHAT = (
    "Between two poses the flange turns by an angle and advances along an axis. Both are the same "
    "wherever the robot stands and wherever the LEDs sit, so no registration enters here: only "
    "cameras, clock and arm."
)
CAPTION = (
    "Encoders' less measured turn and advance of each relative motion, against how far it turns; "
    "the bars are ± 2 standard uncertainties."
)
NONE = (
    "No test without registration: this session holds too few pairs of fully seen poses between "
    "which the flange turns by 10° to 170°."
)


def relative(results: Results) -> Section:
    """Say whether relative motions agree, and which joint could have shown in them."""
    entry = results.summary.get("relative_motions")
    if not entry:
        return Section("relative", "Without any registration", (Paragraph(NONE, "note"),))
    blocks: list[Block] = [
        Paragraph(_judged(entry)),
        Paragraph(WHAT),
        drawn_or_said(
            Figure(
                "relative",
                CAPTION,
                "Two strips against the angle turned: error of the turn in degrees, of the advance "
                "in millimetres, with bars of two standard uncertainties about zero.",
            ),
            _chart(results),
            "The relative motions were not kept.",
        ),
        _table(entry),
    ]
    return Section("relative", "Without any registration", tuple(blocks))


def _judged(entry: dict[str, Any]) -> str:
    p = finite(entry.get("p_value"))
    agrees = p is not None and p >= DOUBTFUL
    chance = f"{p:.2g}" if p is not None and p >= 1e-6 else "under 0.000001"
    said = (
        f"{count(entry.get('motions'))} relative motions: turns differ by "
        f"{number(entry.get('turn_rms_error_deg'), 3)}° rms, advances by "
        f"{number(entry.get('advance_rms_error_mm'), 3)} mm rms; noise and stated doubts alone "
        f"give as much with probability {chance}."
    )
    if agrees:
        return said + " Measured and encoders' motions agree."
    return said + (
        " They do not agree: something is wrong with arm, cameras or clock, whatever the "
        "registration."
    )


def _table(entry: dict[str, Any]) -> Table:
    offsets = entry.get("detectable_offset_deg") or []
    rows = tuple(
        row(
            f"q{joint}",
            "does not show" if finite(value) is None else significant(value),
        )
        for joint, value in enumerate(offsets, start=1)
    )
    return Table(
        "The smallest constant offset of each joint that these motions would show.",
        "lr",
        ("Joint", "Offset [°]"),
        rows,
        ("An offset that turns the whole arm, or the LEDs with the flange, never shows here.",),
    )


def _chart(results: Results) -> Chart | None:
    table = results.table("relative")
    turn = column(table, "turn_deg")
    if not len(turn):
        return None
    panels = []
    for name, unit, label in (
        ("turn", "deg", "turn error [°]"),
        ("advance", "mm", "advance error [mm]"),
    ):
        error, u = column(table, f"{name}_error_{unit}"), column(table, f"{name}_u_{unit}")
        bars = tuple(
            Band(np.array([x]), np.array([e - 2 * s]), np.array([e + 2 * s]), "error_band")
            for x, e, s in zip(turn, error, u, strict=True)
        )
        marks: tuple[Mark, ...] = (
            Level(0.0, "muted"),
            *bars,
            Points(turn, error, "measured", "", 1.5),
        )
        panels.append(Panel(marks, label, "angle turned [°]" if name == "advance" else ""))
    return Chart(tuple(panels), shared_x=True)
