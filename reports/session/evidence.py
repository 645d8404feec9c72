"""What the figures of a session rest on: spots, clock, pairs, registration-free tests."""

from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from reports.document import blocks as doc
from reports.document import formatting as fmt
from reports.document.charts import Array, Band, Chart, Level, Mark, Panel, Points, column, texts
from reports.results import Results
from reports.session import phrases
from reports.session.figures import evidence
from reports.session.figures.evidence import PANEL_MARGIN
from reports.session.findings import clock_text

USUAL_SHARE = 0.9  # of the bars, that a frame holds: those near a singularity are far longer
MEAN_NOTE = (
    "A mean far from zero with a small scatter indicates an LED that is not where the marker file "
    "says, or a calibration that no longer holds."
)


def relative_errors(results: Results) -> Chart | None:
    """Draw the errors of turn and advance of each relative motion against its turn."""
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
        x_label = "angle turned [°]" if name == "advance" else ""
        panels.append(Panel(marks, label, x_label, y_range=_usual_range(error, 2 * u)))
    return Chart(tuple(panels), shared_x=True)


def _usual_range(error: Array, half: Array) -> tuple[float, float] | None:
    """Extent of every error and of all but the widest tenth of the bars, with a margin."""
    known = np.isfinite(error + half)
    if not known.any():
        return None
    error, half = error[known], half[known]
    half = np.minimum(half, np.quantile(half, USUAL_SHARE, method="lower"))
    low, high = float((error - half).min()), float((error + half).max())
    room = PANEL_MARGIN * (high - low) or 1e-3  # a thousandth of a degree or millimetre
    return min(low, 0.0) - room, max(high, 0.0) + room


FIGURES = {
    "residuals": doc.FigurePlan(
        evidence.residuals,
        "Where each spot was seen, less where the measured pose puts it, either camera. Good spots "
        "lie as a round cloud about zero, most of them within the circle. Where they are too many "
        "to be distinguished, the shade is the logarithm of their number.",
        "Two scatter plots of residuals in pixels, left and right camera.",
        "The residuals of the spots were not kept.",
    ),
    "reprojection": doc.FigurePlan(
        evidence.reprojection,
        "RMS residual of each pair in pixels, and the number of LEDs that either camera saw.",
        "Two strips against time: rms residual in pixels, number of LEDs.",
        "No pair gave a residual.",
    ),
    "pair": doc.FigurePlan(
        None,
        "One stereo pair of the session with the spots that were found and named.",
        "Left and right camera image side by side, LEDs marked with their names.",
        "No picture of a stereo pair was kept.",
    ),
    "timeline": doc.FigurePlan(
        evidence.timeline,
        "When pairs were measured, and when they were not and why. No bar: no pair was recorded.",
        "A timeline with one row an outcome; bars where pairs had that outcome.",
        "The times of the pairs are not known.",
    ),
    "relative": doc.FigurePlan(
        relative_errors,
        "Encoders' less measured turn and advance of each relative motion, against how far it "
        "turns; the bars are ± 2 standard uncertainties, of which those near a singularity may "
        "leave the frame.",
        "Two strips against the angle turned: error of the turn in degrees, of the advance in "
        "millimetres, with bars of two standard uncertainties about zero.",
        "The relative motions were not kept.",
    ),
}

figure_block = partial(doc.figure_or_text, FIGURES)


def spots(results: Results) -> doc.Section:
    """Say how well the spots fit the poses."""
    blocks: list[doc.Block] = []
    table = results.table("spots")
    if len(table) and {"camera", "led"} <= set(table.columns):
        blocks.append(_led_table(table))
    blocks += [figure_block(results, name) for name in ("residuals", "reprojection", "pair")]
    return doc.Section("spots", "Spots and reprojection", tuple(blocks))


def _led_table(table: pd.DataFrame) -> doc.Table:
    frame = pd.DataFrame(
        {name: column(table, name) for name in ("residual_x_px", "residual_y_px", "u_px")}
    )
    frame["camera"], frame["led"] = texts(table, "camera"), texts(table, "led")
    groups = [
        {"camera": camera, "led": led, "spots": spots}
        for (camera, led), spots in frame.groupby(["camera", "led"], sort=True)
    ]
    columns = (
        doc.Column("Camera", "l", doc.field("camera")),
        doc.Column("LED", "l", doc.field("led")),
        doc.Column("Spots", "r", lambda g: fmt.count(len(g["spots"]))),
        doc.Column(
            "Mean x [px]", "r", lambda g: fmt.number(g["spots"]["residual_x_px"].mean(), 3, True)
        ),
        doc.Column(
            "Mean y [px]", "r", lambda g: fmt.number(g["spots"]["residual_y_px"].mean(), 3, True)
        ),
        doc.Column("RMS [px]", "r", lambda g: fmt.number(_rms_residual(g["spots"]))),
        doc.Column("Median u [px]", "r", lambda g: fmt.number(g["spots"]["u_px"].median())),
    )
    return doc.tabulate("Residuals of the spots, a camera and LED.", columns, groups, MEAN_NOTE)


def _rms_residual(spots: pd.DataFrame) -> float | None:
    x, y = spots["residual_x_px"].dropna(), spots["residual_y_px"].dropna()
    return float(np.sqrt(np.mean(np.square([*x, *y])))) if len(x) + len(y) else None


def clock(results: Results) -> doc.Section:
    """Say how the encoder clock was brought to that of the cameras or the instrument."""
    entry = results.summary.get("clock") or {}
    other = "cameras'" if "instrument" not in results.setup else "instrument's"
    between = f"The offset between the encoder clock and the {other} clock"
    if entry.get("observable") is False:
        text = (
            f"{between} could not be observed. At rest, at constant speed, or in too few pairs, a "
            "delay looks like an offset of the joints."
        )
        if fmt.finite(entry.get("encoder_offset_s")) is not None:
            text += f" The offset used is {clock_text(results.summary)}."
    elif fmt.finite(entry.get("encoder_offset_s")) is None:
        text = f"{between} is not known."
    else:
        text = f"Offset added to the encoders' times: {clock_text(results.summary)}."
    return doc.Section("clock", "Clock", (doc.Paragraph(text), _cost_curve(results)))


def _cost_curve(results: Results) -> doc.Block:
    source = (results.summary.get("clock") or {}).get("source")
    otherwise = "The offset was not searched for, so there is no curve of its misfit."
    if source in (None, "estimated"):
        otherwise = "No curve of its misfit was kept."
    figure = doc.Figure(
        "clock",
        "Misfit between measured and encoder motion for each offset of the encoder clock; the "
        "vertical line is the offset that was used.",
        "A curve of misfit against clock offset in seconds with its lowest point marked.",
    )
    return doc.block_or_paragraph(figure, evidence.clock(results), otherwise)


def pairs(results: Results) -> doc.Section:
    """Count the pairs by what became of them, and say how LEDs were told apart."""
    summary = results.summary
    entry = summary.get("pairs") or {}
    recorded = fmt.finite(entry.get("recorded"))
    counts = {"measured": entry.get("measured"), **(entry.get("rejected") or {})}
    rows = tuple(
        doc.row(
            fmt.lookup_label(phrases.STATUSES, status),
            fmt.count(n),
            fmt.percent(float(n) / recorded)
            if recorded and fmt.finite(n) is not None
            else fmt.DASH,
        )
        for status, n in counts.items()
    )
    blocks: list[doc.Block] = [
        doc.Table("What became of the recorded pairs.", "lrr", ("Outcome", "Pairs", "Share"), rows),
        figure_block(results, "timeline"),
    ]
    choices = summary.get("choices") or {}
    if choices:
        made = tuple(
            doc.row(fmt.lookup_label(phrases.CHOICES, name), fmt.count(n))
            for name, n in choices.items()
        )
        blocks.append(doc.Table("How the LEDs were identified.", "lr", ("Decided", "Pairs"), made))
    return doc.Section("pairs", "Pairs rejected, and why", tuple(blocks))


P_SIGNIFICANT = 0.001  # p-value: below it noise is no explanation
RELATIVE_NOTE = (
    "Between two poses the flange turns by an angle and advances along an axis. Both are the same "
    "wherever the robot stands and wherever the measured body sits on the flange, so no "
    "registration enters here: only instrument, clock and arm."
)
NO_RELATIVE_MOTIONS = (
    "No test without registration: this session holds too few pairs of fully seen poses between "
    "which the flange turns by 10° to 170°."
)


def relative_motions(results: Results) -> tuple[doc.Block, ...]:
    """Say whether relative motions agree, and which joint could have shown in them."""
    entry = results.summary.get("relative_motions")
    if not entry:
        return (doc.Paragraph(NO_RELATIVE_MOTIONS, "note"),)
    return (
        doc.Paragraph(_test_text(entry)),
        doc.Paragraph(RELATIVE_NOTE),
        figure_block(results, "relative"),
        _table(entry),
    )


def _test_text(entry: dict[str, Any]) -> str:
    p = fmt.finite(entry.get("p_value"))
    agrees = p is not None and p >= P_SIGNIFICANT
    chance = fmt.significant(p) if p is not None and p >= 1e-6 else "under 0.000001"
    text = (
        f"{fmt.count(entry.get('motions'))} relative motions: turns differ by "
        f"{fmt.number(entry.get('turn_rms_error_deg'), 3)}° rms, advances by "
        f"{fmt.number(entry.get('advance_rms_error_mm'), 3)} mm rms; noise and stated "
        f"uncertainties alone give as much with probability {chance}."
    )
    if agrees:
        return f"{text} Measured and encoders' motions agree."
    return (
        f"{text} They do not agree: something is wrong with arm, instrument or clock, whatever the "
        "registration."
    )


def _table(entry: dict[str, Any]) -> doc.Table:
    offsets = entry.get("detectable_offset_deg") or []
    rows = tuple(
        doc.row(
            f"q{joint}", "does not show" if fmt.finite(value) is None else fmt.significant(value)
        )
        for joint, value in enumerate(offsets, start=1)
    )
    return doc.Table(
        "The smallest constant offset of each joint that these motions would show.",
        "lr",
        ("Joint", "Offset [°]"),
        rows,
        ("An offset that turns the whole arm, or the body on the flange, never shows here.",),
    )
