"""The second half of a report: what the figures rest on."""

import numpy as np
import pandas as pd

from reports import words
from reports.blocks import Block, Figure, Paragraph, Section, Table, row
from reports.findings import clock_words, figure_or_words
from reports.formatting import DASH, count, finite, number, percent, word
from reports.results import Results
from reports.series import column, texts

MEANS = (
    "A mean far from zero beside a small scatter speaks of an LED that sits elsewhere than the "
    "marker file says, or of a calibration that no longer holds."
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
