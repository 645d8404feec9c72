"""The second half of a report: what the figures rest on."""

from typing import Any

import numpy as np
import pandas as pd

from reports import words
from reports.blocks import Block, Bullets, Cell, Figure, Paragraph, Section, Table, row
from reports.findings import clock_words, figure_or_words
from reports.formatting import DASH, count, finite, joined, number, percent, significant, word
from reports.results import Results
from reports.series import column, texts

MEANS = (
    "A mean far from zero beside a small scatter speaks of an LED that sits elsewhere than the "
    "marker file says, or of a calibration that no longer holds."
)
PARTS = (
    "Random parts are those of the mean, autocorrelation included; systematic parts do not average "
    "out. Expanded: combined times its coverage factor."
)


def spots(results: Results) -> Section:
    """Say how well the spots fit the poses."""
    blocks: list[Block] = []
    table = results.table("spots")
    if len(table) and {"camera", "led"} <= set(table.columns):
        blocks.append(_led_table(table))
    blocks += [
        figure_or_words(
            results,
            Figure(
                "residuals",
                "Where each spot was seen, less where the measured pose puts it, either camera. "
                "Good spots lie as a round cloud about zero, most of them within the circle. Where "
                "they are too many to be told apart, the shade is the logarithm of their number.",
                "Two scatter plots of residuals in pixels, left and right camera.",
            ),
            "The residuals of the spots were not kept.",
        ),
        figure_or_words(
            results,
            Figure(
                "reprojection",
                "RMS residual of each pair in pixels, and the number of LEDs seen.",
                "Two strips against time: rms residual in pixels, number of LEDs.",
            ),
            "No pair gave a residual.",
        ),
        figure_or_words(
            results,
            Figure(
                "pair",
                "One stereo pair of the session with the spots that were found and named.",
                "Left and right camera image side by side, LEDs marked with their names.",
            ),
            "No picture of a stereo pair was kept.",
        ),
    ]
    return Section("spots", "Spots and reprojection", tuple(blocks))


def _led_table(table: pd.DataFrame) -> Table:
    frame = pd.DataFrame(
        {name: column(table, name) for name in ("residual_x_px", "residual_y_px", "u_px")}
    )
    frame["camera"], frame["led"] = texts(table, "camera"), texts(table, "led")
    rows = []
    for (camera, led), spots in frame.groupby(["camera", "led"], sort=True):
        x, y = spots["residual_x_px"].dropna(), spots["residual_y_px"].dropna()
        rms = float(np.sqrt(np.mean(np.square([*x, *y])))) if len(x) + len(y) else None
        rows.append(
            row(
                word(camera),
                word(led),
                count(len(spots)),
                number(x.mean(), 3, signed=True),
                number(y.mean(), 3, signed=True),
                number(rms, 3),
                number(spots["u_px"].median(), 3),
            )
        )
    return Table(
        "Residuals of the spots, a camera and LED.",
        "llrrrrr",
        ("Camera", "LED", "Spots", "Mean x [px]", "Mean y [px]", "RMS [px]", "Median u [px]"),
        tuple(rows),
        (MEANS,),
    )


def clock(results: Results) -> Section:
    """Say how the encoder clock was brought to the cameras' clock."""
    entry = results.summary.get("clock") or {}
    if entry.get("observable") is False:
        text = (
            "The offset between the encoder clock and the cameras' clock could not be observed: "
            "the motion was too slow or too even to tell a delay from an offset of the joints."
        )
        if finite(entry.get("encoder_offset_s")) is not None:
            text += f" The offset used is {clock_words(results.summary)}."
    elif finite(entry.get("encoder_offset_s")) is None:
        text = "The offset between the encoder clock and the cameras' clock is not known."
    else:
        text = f"Offset added to the encoders' times: {clock_words(results.summary)}."
    figure = Figure(
        "clock",
        "Misfit between measured and encoder motion for each offset of the encoder clock; the "
        "upright line is the offset that was used.",
        "A curve of cost against clock offset in seconds with its lowest point marked.",
    )
    given = entry.get("source") not in (None, "estimated")
    otherwise = "The offset was not searched for, so there is no curve of its cost."
    if not given:
        otherwise = "No curve of its cost was kept."
    blocks = (Paragraph(text), figure_or_words(results, figure, otherwise))
    return Section("clock", "Clock", blocks)


def pairs(results: Results) -> Section:
    """Count the pairs by what became of them, and say how LEDs were told apart."""
    summary = results.summary
    entry = summary.get("pairs") or {}
    recorded = finite(entry.get("recorded"))
    counts = {"measured": entry.get("measured"), **(entry.get("rejected") or {})}
    rows = tuple(
        row(
            words.said(words.STATUSES, status),
            count(n),
            percent(float(n) / recorded) if recorded and finite(n) is not None else DASH,
        )
        for status, n in counts.items()
    )
    blocks: list[Block] = [
        Table("What became of the recorded pairs.", "lrr", ("Outcome", "Pairs", "Share"), rows),
        figure_or_words(
            results,
            Figure(
                "timeline",
                "When pairs were measured, and when they were not and why.",
                "A timeline with one row an outcome; bars where pairs had that outcome.",
            ),
            "The times of the pairs are not known.",
        ),
    ]
    choices = summary.get("choices") or {}
    if choices:
        made = tuple(row(words.said(words.CHOICES, name), count(n)) for name, n in choices.items())
        blocks.append(Table("How the LEDs were told apart.", "lr", ("Settled", "Pairs"), made))
    return Section("pairs", "Pairs rejected, and why", tuple(blocks))


def budget(results: Results) -> Section:
    """Break each joint's uncertainty down by source."""
    blocks: list[Block] = []
    table = results.table("budget")
    if len(table) and {"joint", "source"} <= set(table.columns):
        blocks.append(_budget_table(table, results.summary))
    blocks.append(
        figure_or_words(
            results,
            Figure(
                "budget",
                "Share of each source in the sum of the variances of a joint's mean error. What is "
                "largest is what to improve first.",
                "Stacked bars, one a joint: share of variance in percent by source.",
            ),
            "The uncertainty was not broken down by source.",
        )
    )
    uncounted = (results.summary.get("budget") or {}).get("uncounted") or []
    if uncounted:
        named = joined([word(name) for name in uncounted])
        text = (
            f"Not counted, because their uncertainty is not stated: {named}. "
            "They are taken as exact, and every uncertainty here holds on that condition."
        )
        blocks.append(Bullets((text,), "warning"))
    else:
        blocks.append(Paragraph("Every source that is known of is counted."))
    return Section("budget", "Uncertainty budget", tuple(blocks))


def _budget_table(table: pd.DataFrame, summary: dict[str, Any]) -> Table:
    frame = table.assign(u=column(table, "standard_uncertainty_deg"), word=texts(table, "kind"))
    joints = sorted(frame["joint"].dropna().unique().tolist())
    rows = []
    for (source, kind), part in frame.groupby(["source", "word"], sort=False, dropna=False):
        by_joint = dict(zip(part["joint"].tolist(), part["u"].tolist(), strict=True))
        cells = [significant(by_joint.get(joint)) for joint in joints]
        rows.append(row(word(source).replace("_", " "), word(kind), *cells))
    known = {joint.get("joint"): joint for joint in (summary.get("joints") or [])}
    for label, key in (
        ("combined", "standard_uncertainty_deg"),
        ("expanded", "expanded_uncertainty_deg"),
    ):
        cells = [significant((known.get(joint) or {}).get(key)) for joint in joints]
        rows.append(tuple(Cell(text, "total") for text in (label, "", *cells)))
    return Table(
        "Standard uncertainty of each joint's mean error by source, in degrees.",
        "ll" + "r" * len(joints),
        ("Source", "Kind", *(f"q{joint} [°]" for joint in joints)),
        tuple(rows),
        (PARTS,),
        wide=(0,),
    )
