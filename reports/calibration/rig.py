"""The rig in a calibration's report: parameters, stereo relation, scale, accuracy of a point."""

from functools import partial
from typing import Any

import pandas as pd

from reports.calibration.words import (
    FIGURES,
    GROUPS,
    PARAMETERS,
    CalibrationNotes,
)
from reports.document import blocks as doc
from reports.document import formatting as fmt
from reports.document.charts import column, records, texts
from reports.results import Results


def parameters(results: Results) -> doc.Section:
    """List every parameter with its uncertainty, and say what was held and why."""
    summary = results.summary
    blocks: list[doc.Block] = [_parameter_table(results.table("parameters"))]
    blocks += doc.decisions(summary)
    blocks += [_principal_point(point) for point in summary.get("principal_points") or []]
    blocks.append(figure_block(results, "parameter_correlation"))
    return doc.Section("parameters", "Parameters of the cameras", tuple(blocks))


def _parameter_table(table: pd.DataFrame) -> doc.Table:
    values, u = column(table, "value"), column(table, "standard_uncertainty")
    cells: dict[tuple[str, str], str] = {}
    chosen = False
    for i, (camera, key, state) in enumerate(
        zip(texts(table, "camera"), texts(table, "parameter"), texts(table, "state"), strict=True)
    ):
        text = fmt.exact_number(round(float(values[i]), 6) + 0.0)  # no minus before zero
        if fmt.finite(u[i]) is not None:
            text = fmt.with_uncertainty(values[i], fmt.expanded(u[i]), signed=False)
        if state != "found":
            text += " (chosen)"
            chosen = True
        cells[camera, key] = text
    keys = list(dict.fromkeys(texts(table, "parameter")))
    columns = (
        doc.Column("Parameter", "l", lambda key: PARAMETERS.get(key, key)),
        doc.Column("Left camera", "r", lambda key: cells.get(("left", key), fmt.DASH)),
        doc.Column("Right camera", "r", lambda key: cells.get(("right", key), fmt.DASH)),
    )
    notes = (CalibrationNotes.CHOSEN,) if chosen else ()
    return doc.tabulate("Parameters and expanded uncertainties (k = 2).", columns, keys, *notes)


def _principal_point(point: dict[str, Any]) -> doc.Paragraph:
    camera, distance = fmt.text_or_dash(point.get("camera")), fmt.finite(point.get("distance_px"))
    u = fmt.finite(point.get("standard_uncertainty_px"))
    if distance is None or u is None or u == 0:
        return doc.Paragraph(
            f"The uncertainty of the {camera} camera's principal point is not stated."
        )
    text = (
        f"The {camera} camera's principal point lies "
        f"{fmt.with_uncertainty(distance, fmt.expanded(u), 'px', signed=False)} (k = 2) from the "
        f"image's centre, {fmt.significant(distance / u)} times its standard uncertainty"
    )
    if not point.get("odd"):
        return doc.Paragraph(f"{text}: within the usual range of such cameras.")
    if point.get("believed"):
        return doc.Paragraph(
            f"{text}. This is outside the usual range, but the pictures determine it well: the "
            "result can be used. A picture cropped from a larger sensor has such a principal "
            "point; record sessions in the same mode."
        )
    return doc.Paragraph(
        f"{text}. This is outside the usual range, and the pictures do not determine it: the "
        "result cannot be relied on. Take more pictures with tilted boards."
    )


def stereo(results: Results) -> doc.Section:
    """State the cameras' relative pose, and check the scale against the squares."""
    entry = results.summary.get("stereo") or {}
    convergence = format_with_uncertainty(entry, "convergence", "deg")
    rows = [
        doc.row("Baseline [mm]", format_with_uncertainty(entry, "baseline", "mm")),
        doc.row("Convergence of the optical axes [°]", convergence),
    ]
    for name, key, unit, sign in (
        ("Right camera in the left one", "position", "mm", "mm"),
        ("Rotation vector of the right camera in the left one", "rotation_vector", "deg", "°"),
    ):
        values = entry.get(f"{key}_{unit}") or [None] * 3
        spreads = entry.get(f"{key}_standard_uncertainty_{unit}") or [None] * 3
        rows += [
            doc.row(
                f"{name}, {axis} [{sign}]",
                fmt.with_uncertainty(value, fmt.expanded(u), signed=False),
            )
            for axis, value, u in zip("xyz", values, spreads, strict=True)
        ]
    turning = results.summary.get("turning")
    if turning:
        angle = format_with_uncertainty(turning, "axes_angle", "deg")
        rows.append(doc.row("Angle between the turning axes [°]", angle))
    note = CalibrationNotes.TURNING if turning else CalibrationNotes.STILL
    table = doc.Table(
        "Relation of the cameras, with expanded uncertainties (k = 2).",
        "lr",
        ("Quantity", "Value ± U"),
        tuple(rows),
    )
    blocks: tuple[doc.Block, ...] = (table, doc.Paragraph(note), *_scale(results.summary))
    return doc.Section("stereo", "Stereo relation and scale", blocks)


def format_with_uncertainty(entry: dict[str, Any], name: str, unit: str) -> str:
    """Write an entry's value ± U (k = 2), without its unit."""
    u = entry.get(f"{name}_standard_uncertainty_{unit}")
    return fmt.with_uncertainty(entry.get(f"{name}_{unit}"), fmt.expanded(u), signed=False)


def _scale(summary: dict[str, Any]) -> tuple[doc.Block, ...]:
    square, board = summary.get("square") or {}, "a square's edge"
    found, u = fmt.finite(square.get("found_mm")), fmt.finite(square.get("standard_uncertainty_mm"))
    given = fmt.finite(square.get("stated_mm"))
    if found is None or given is None:
        return (doc.Paragraph("The scale was not checked against the squares."),)
    off = fmt.significant(abs(found - given) / u) if u else fmt.DASH
    exact = square.get("stated_standard_uncertainty_mm")
    text = (
        f"Triangulated, {board} is "
        f"{fmt.with_uncertainty(found, fmt.expanded(u), 'mm', signed=False)} (k = 2) on average, "
        f"and {fmt.exact_number(given)} mm is stated: the difference is {off} times the "
        "standard uncertainty. Single edges scatter by "
        f"{fmt.quantity(square.get('deviation_mm'), 'mm')}. "
    )
    if exact is None:
        text += (
            "The stated size is taken as exact: all lengths scale with it, and a ruler on the "
            "printed board is the only check of it."
        )
    else:
        size = fmt.quantity(fmt.expanded(exact), "mm")
        text += f"The stated size itself is known to ± {size} (k = 2)."
    return (doc.Paragraph(text),)


figure_block = partial(doc.figure_or_text, FIGURES)


def working_distance_entry(summary: dict[str, Any]) -> dict[str, Any]:
    """Take the accuracy at the working distance; empty where there is none."""
    entries: list[dict[str, Any]] = summary.get("accuracy") or []
    wanted = summary.get("working_distance_mm")
    return next((e for e in entries if e.get("distance_mm") == wanted), {})


def format_distance(entry: dict[str, Any]) -> str:
    """Say an entry's distance."""
    far = fmt.finite(entry.get("distance_mm"))
    return fmt.DASH if far is None else f"{far / 1e3:g} m"


def main_improvement(summary: dict[str, Any]) -> str:
    """Say what counts most and what helps against it."""
    first = summary.get("improve_first") or {}
    help_ = first.get("help")
    if not help_:
        return "The largest source of uncertainty is not known."
    named = GROUPS.get(str(first.get("group")), fmt.text_or_dash(first.get("group")))
    return f"The largest source of uncertainty is {named}. To reduce it, {help_}."


def accuracy(results: Results) -> doc.Section:
    """Say what a point is worth over the working volume."""
    entries: list[dict[str, Any]] = results.summary.get("accuracy") or []
    blocks: list[doc.Block] = []
    if entries:
        blocks += [_point_table(entries), _length_table(entries, results.summary)]
    blocks.append(figure_block(results, "accuracy"))
    return doc.Section("accuracy", "Expected accuracy of a point", tuple(blocks))


def _point_table(entries: list[dict[str, Any]]) -> doc.Table:
    keys = {
        "Noise, across": "random_lateral_mm",
        "Noise, depth": "random_depth_mm",
        "Rig, across": "systematic_lateral_mm",
        "Rig, depth": "systematic_depth_mm",
        "Both, across": "total_lateral_mm",
        "Both, depth": "total_depth_mm",
        "Largest in the field, both": "worst_total_mm",
    }
    title = "U (k = 2) of one LED's position in the middle of the field, in mm."
    return doc.tabulate(title, distance_columns(keys), entries, CalibrationNotes.POINT)


def _length_table(entries: list[dict[str, Any]], summary: dict[str, Any]) -> doc.Table:
    keys = {
        "Across, noise": "length_across_random_um",
        "Across, rig": "length_across_systematic_um",
        "In depth, noise": "length_depth_random_um",
        "In depth, rig": "length_depth_systematic_um",
    }
    title = (
        f"U (k = 2) of a length of {fmt.exact_number(summary.get('length_mm'))} mm "
        "between two LEDs in the middle of the field, in µm."
    )
    return doc.tabulate(title, distance_columns(keys), entries, CalibrationNotes.LENGTH)


def distance_columns(keys: dict[str, str]) -> list[doc.Column]:
    """Make the distance, then the figures of these keys, by their heads."""
    figures = [doc.Column(head, "r", doc.expanded_field(key)) for head, key in keys.items()]
    return [doc.Column("Distance", "l", format_distance), *figures]


def improvement(results: Results) -> doc.Section:
    """List the sources of uncertainty, the largest first."""
    blocks: list[doc.Block] = [doc.Paragraph(fmt.capitalise(main_improvement(results.summary)))]
    table = results.table("contributions")
    if len(table):
        title = (
            f"Depth of a point {format_distance(working_distance_entry(results.summary))} away: "
            "sources of its uncertainty; U with k = 2."
        )
        columns = (
            doc.Column("Source", "l", lambda e: fmt.capitalise(GROUPS.get(e["group"], e["group"]))),
            doc.Column("U from this source [mm]", "r", doc.expanded_field("alone_mm")),
            doc.Column("U without this source [mm]", "r", doc.expanded_field("without_mm")),
        )
        blocks.append(doc.tabulate(title, columns, records(table), CalibrationNotes.GROUPS))
    blocks.append(figure_block(results, "contributions"))
    return doc.Section("improvement", "Sources of uncertainty", tuple(blocks))
