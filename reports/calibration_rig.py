"""The rig in the report of a calibration: its parameters, the stereo relation, the scale."""

from typing import Any

import pandas as pd

from reports.blocks import (
    Block,
    Bullets,
    Paragraph,
    Section,
    Table,
    row,
)
from reports.calibration_words import (
    PARAMETERS,
    STATES,
    STATES_NOTE,
    Words,
)
from reports.formatting import (
    DASH,
    finite,
    measured,
    quantity,
    significant,
    stated,
    word,
)
from reports.headline import capital
from reports.results import Results
from reports.series import column, texts


def parameters(results: Results) -> Section:
    """List every parameter with its uncertainty, and say what was held and why."""
    summary = results.summary
    blocks: list[Block] = [_parameter_table(results.table("parameters"))]
    decisions = [capital(word(sentence)) for sentence in summary.get("decisions") or []]
    if decisions:
        blocks.append(Bullets(tuple(decisions)))
    blocks += [_principal_point(point) for point in summary.get("principal_points") or []]
    return Section("parameters", "Parameters of the cameras", tuple(blocks))


def _parameter_table(table: pd.DataFrame) -> Table:
    values, u = column(table, "value"), column(table, "standard_uncertainty")
    cells: dict[tuple[str, str], str] = {}
    held = set()
    for i, (camera, key, state) in enumerate(
        zip(texts(table, "camera"), texts(table, "parameter"), texts(table, "state"), strict=True)
    ):
        text = stated(round(float(values[i]), 6) + 0.0)  # no minus before zero
        if finite(u[i]) is not None:
            text = measured(values[i], u[i], signed=False)
        if state != "found":
            text += f" ({STATES.get(state, state)})"
            held.add(state)
        cells[camera, key] = text
    keys = list(dict.fromkeys(texts(table, "parameter")))
    rows = tuple(
        row(
            PARAMETERS.get(key, key),
            cells.get(("left", key), DASH),
            cells.get(("right", key), DASH),
        )
        for key in keys
    )
    notes = tuple(STATES_NOTE[state] for state in STATES if state in held)
    return Table(
        "Parameters and standard uncertainties (k = 1).",
        "lrr",
        ("Parameter", "Left camera", "Right camera"),
        rows,
        notes,
    )


def _principal_point(point: dict[str, Any]) -> Paragraph:
    camera, distance = word(point.get("camera")), finite(point.get("distance_px"))
    u = finite(point.get("standard_uncertainty_px"))
    if distance is None or u is None or u == 0:
        return Paragraph(f"How well the {camera} camera's principal point is known is not stated.")
    text = (
        f"The {camera} camera's principal point lies {measured(distance, u, 'px', signed=False)} "
        f"from the image's centre, {significant(distance / u)} times its standard uncertainty"
    )
    if not point.get("odd"):
        return Paragraph(f"{text}: within what cameras of this kind have.")
    if point.get("believed"):
        return Paragraph(
            f"{text}. That is far off, yet the pictures give it: believe it. A picture cut out of "
            "a larger sensor does that; sessions must be recorded in the same mode."
        )
    return Paragraph(
        f"{text}. That is far off, and the pictures do not give it: do not believe it."
    )


def stereo(results: Results) -> Section:
    """Say how the cameras stand to each other, and check the scale against the squares."""
    entry = results.summary.get("stereo") or {}
    rows = [
        row("Baseline [mm]", _with_u(entry, "baseline", "mm")),
        row("Convergence of the optical axes [°]", _with_u(entry, "convergence", "deg")),
    ]
    for name, key, unit, sign in (
        ("Right camera in the left one", "position", "mm", "mm"),
        ("Rotation vector of the right camera in the left one", "rotation_vector", "deg", "°"),
    ):
        values = entry.get(f"{key}_{unit}") or [None] * 3
        spreads = entry.get(f"{key}_standard_uncertainty_{unit}") or [None] * 3
        rows += [
            row(f"{name}, {axis} [{sign}]", measured(value, spread, signed=False))
            for axis, value, spread in zip("xyz", values, spreads, strict=True)
        ]
    turning = results.summary.get("turning")
    if turning:
        rows.append(
            row("Angle between the turning axes [°]", _with_u(turning, "axes_angle", "deg"))
        )
        said = Words.TURNING
    else:
        said = Words.STILL
    table = Table(
        "Relation of the cameras, with standard uncertainties (k = 1).",
        "lr", ("Quantity", "Value ± u"), tuple(rows),
    )  # fmt: skip
    blocks: tuple[Block, ...] = (table, Paragraph(said), *_scale(results.summary))
    return Section("stereo", "Stereo relation and scale", blocks)


def _with_u(entry: dict[str, Any], name: str, unit: str) -> str:
    u = entry.get(f"{name}_standard_uncertainty_{unit}")
    return measured(entry.get(f"{name}_{unit}"), u, signed=False)


def _scale(summary: dict[str, Any]) -> tuple[Block, ...]:
    square, board = summary.get("square") or {}, "a square's edge"
    found, u = finite(square.get("found_mm")), finite(square.get("standard_uncertainty_mm"))
    given = finite(square.get("stated_mm"))
    if found is None or given is None:
        return (Paragraph("The scale was not checked against the squares."),)
    off = significant(abs(found - given) / u) if u else DASH
    exact = square.get("stated_standard_uncertainty_mm")
    text = (
        f"Triangulated, {board} comes out as {measured(found, u, 'mm', signed=False)} on average, "
        f"where {stated(given)} mm is stated: {off} times the standard uncertainty apart. Single "
        f"edges scatter by {quantity(square.get('deviation_mm'), 'mm')}. "
    )
    if exact is None:
        text += (
            "The stated size is taken as exact: all lengths scale with it, and a ruler on the "
            "printed board is the only check of it."
        )
    else:
        text += f"The stated size itself is known to {quantity(exact, 'mm')}."
    return (Paragraph(text),)
