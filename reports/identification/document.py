"""What the report of an identified arm says, in which order.

The summary's keys, units in their names; what is not known is null or missing:

    kind                  "identification"
    tool, inputs, warnings as in a run's summary
    source                path, description; robot: its name; robot_fingerprint; robot_file
    poses                 used, outlying (source, frame, squared_distance), position_only
    base_free, tool_free  found with the arm, or held as rig and marker have them
    level                 "registration", "offsets" or "geometry": the model that was chosen
    levels                each: name, identified, rank, candidates, criterion (mean χ² a number
                          of poses held out, by the noise of the richest model), noise_position and
                          noise_orientation (of what is left, over what was stated; m and rad where
                          nothing was), outlying, held_out (splits, rows, mean_mm, rms_mm, …)
    identified, rank, candidates   told by the poses, of the chosen model; of all parameters
    coverage_factor       2, or Student's where the noise is known from few poses or recordings
    recordings            count; scatter of parameters between them, over u; null: there is one
    parameters            name, kind, joint, unit, nominal, identified, change, prior (standard
                          deviation), standard_uncertainty, expanded_uncertainty; a base's and a
                          tool's own numbers are null
    placements            each base and tool found: kind, number, position_mm, rotation_vector_deg,
                          standard_uncertainty (x_mm … rz_deg)
    offsets               joint, error_deg (encoder less measured), add_to_reading_deg,
                          standard_uncertainty_deg, expanded_uncertainty_deg; the same with alone_
                          in front: by the model of offsets alone
    judged                null, or path and poses of sessions that it was not identified from, with
                          before and after (mean_mm, rms_mm, max_mm, mean_deg, …)
    held                  name, unit, reason (gauge, prior, not_called_for),
                          confounded_with (name, share), standard_uncertainty_if_free
    observability         O1 … O5
    parameter_correlation parameters, correlation

Tables: residuals (source, frame, used, before_mm, after_mm, before_deg, after_deg), parameters.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from reports.calibration.figures import correlation
from reports.document import blocks as doc
from reports.document import formatting as fmt
from reports.identification import figures
from reports.identification.certificate import LEVELS, SAME, certificate, observability_text
from reports.identification.names import in_words
from reports.results import Results

REASONS = {"gauge": "gauge", "prior": "rests on its prior", "not_called_for": "not needed"}


class IdentificationNotes:
    """Notes that stand under tables."""

    HOLD_OUT = (
        "Fitted on the other poses, means over the splits; every pose counts that was held out, "
        "outlying or not. Criterion: mean χ² a number held out, by the noise that the richest "
        "model leaves, each pose's at most 25; a larger model is taken where it predicts clearly "
        "better."
    )
    JUDGED = "The arm was not identified from these."
    PLACES = (
        "Base and tool are found again with every model; only changes of the arm's own numbers are "
        "shown. All are adjusted together, the arm's held by weak priors: standard deviations of "
        "3 mm and 3° about its file, less for twists and lengths where these show that they lie "
        "closer. U: k = 2."
    )
    GAUGE = (
        "Gauge: no motion can determine it, because the other parameters make up for it; where "
        "these are the arm's own, its prior divides the change. Rests on its prior: another motion "
        "could determine it. Not needed: it could be freed, but held-out poses are predicted as "
        "well without it. U: by the poses alone, k = 2."
    )
    INDEXES = (
        "From the singular values of the whitened columns, scaled by 1 mm and 1°: O1 their "
        "geometric mean over √N (Borm and Menq), O2 the smallest over the largest (Driels and "
        "Pathre), O3 the smallest (Nahvi and others), O4 its square over the largest (Nahvi and "
        "Hollerbach), O5 one over the sum of their inverses (Sun and Hollerbach)."
    )
    OUTLYING = (
        "These poses do not belong to the others: noise reaches their distance once in a thousand "
        "recordings. They were left out of the fit, not of the residuals; never more than a tenth."
    )


FIGURES = {
    "identified_angles": doc.FigurePlan(
        partial(figures.changes, unit="deg"),
        "Change of each angle of the arm, with its expanded uncertainty (k = 2).",
        "Points with level bars, one a parameter, in degrees.",
        "No angle of the arm was changed.",
    ),
    "identified_lengths": doc.FigurePlan(
        partial(figures.changes, unit="mm"),
        "Change of each length of the arm, with its expanded uncertainty (k = 2).",
        "Points with level bars, one a parameter, in millimetres.",
        "No length of the arm was changed.",
    ),
    "parameter_correlation": doc.FigurePlan(
        partial(correlation, write=in_words),
        "Correlation of the identified parameters; numbers below stand for the names at the left.",
        "A square of coloured cells, one a pair of parameters, from −1 to 1.",
        "There are no correlations to show.",
    ),
}


MAX_OUTLIERS = 60  # outlying poses in the table; the others are in summary.json
UNITS = {"deg": "°", "mm": "mm"}

_figure_block = partial(doc.figure_or_text, FIGURES)


def document(results: Results) -> doc.Document:
    """Lay out the whole report."""
    summary = results.summary
    fingerprint = fmt.text_or_dash(summary.get("robot_fingerprint"))[:23]
    return doc.lay_out(
        title=f"Identification of {fmt.text_or_dash(summary.get('robot'))}",
        subtitle=doc.described(summary, "a recorded session"),
        footer=f"{doc.software(summary)} · robot {fingerprint}",
        sections=doc.answer_and_evidence(results, certificate, EVIDENCE),
    )


def parameters(results: Results) -> doc.Section:
    """List every parameter of the arm that was identified."""
    entries = [
        entry
        for entry in results.summary.get("parameters") or []
        if fmt.finite(entry.get("change")) is not None
    ]
    if not entries:
        return doc.Section("parameters", "Parameters", (doc.Paragraph(SAME),))
    columns = (
        doc.Column("Parameter", "l", lambda e: in_words(str(e.get("name")))),
        doc.Column(
            "Unit", "l", lambda e: UNITS.get(str(e.get("unit")), fmt.text_or_dash(e.get("unit")))
        ),
        doc.Column("Before", "r", doc.field("nominal", fmt.number, 4)),
        doc.Column("Identified", "r", doc.field("identified", fmt.number, 4)),
        doc.Column("Change ± U", "r", doc.uncertain_field("change", "standard_uncertainty", k=2)),
    )
    title = "Parameters of the arm: as its file has them, and identified."
    table = doc.tabulate(title, columns, entries, IdentificationNotes.PLACES)
    shown = (_figure_block(results, f"identified_{kind}") for kind in ("angles", "lengths"))
    return doc.Section("parameters", "Parameters", (table, *shown))


def residuals(results: Results) -> doc.Section:
    """Say how each model carries over to poses that it has not seen."""
    summary = results.summary
    table = doc.tabulate(
        "Residuals of poses held out, model by model.",
        (
            doc.Column("Model", "l", lambda e: fmt.lookup_label(LEVELS, e.get("name")), wide=True),
            doc.Column("Parameters", "r", doc.field("identified", fmt.count)),
            *_residual_columns("held_out"),
            doc.Column("Criterion", "r", doc.field("criterion", fmt.significant, 3)),
        ),
        summary.get("levels") or [],
        IdentificationNotes.HOLD_OUT,
    )
    blocks: list[doc.Block] = [table]
    if summary.get("judged"):
        blocks.append(_validation_table(summary["judged"]))
    outlying = (summary.get("poses") or {}).get("outlying") or []
    if outlying:
        blocks.append(_outlier_table(outlying))
    else:
        blocks.append(doc.Paragraph("No pose was outlying."))
    return doc.Section("residuals", "Residuals", tuple(blocks))


def _residual_columns(key: str) -> list[doc.Column]:
    """Residuals that an entry holds under `key`."""

    def residual(name: str) -> Callable[[dict[str, Any]], str]:
        return lambda entry: fmt.number((entry.get(key) or {}).get(name), 3)

    return [
        doc.Column(f"{name} [{sign}]", "r", residual(f"{name}_{unit}"))
        for unit, sign in (("mm", "mm"), ("deg", "°"))
        for name in ("mean", "rms", "max")
    ]


def _validation_table(entry: dict[str, Any]) -> doc.Table:
    arms = (("as its file has it", "before"), ("identified", "after"))
    return doc.tabulate(
        "Residuals of other sessions, registered again with each robot file.",
        (doc.Column("Model", "l", doc.field("name")), *_residual_columns("residuals")),
        [{"name": name, "residuals": entry.get(key)} for name, key in arms],
        f"{fmt.text_or_dash(entry.get('path'))}, {fmt.count(entry.get('poses'))} poses",
        IdentificationNotes.JUDGED,
    )


def _outlier_table(entries: list[dict[str, Any]]) -> doc.Table:
    notes = [IdentificationNotes.OUTLYING]
    if len(entries) > MAX_OUTLIERS:
        notes.append(f"{fmt.count(len(entries) - MAX_OUTLIERS)} more are in summary.json.")
    columns = (
        doc.Column("Session", "l", doc.field("source")),
        doc.Column("Pair", "r", doc.field("frame", fmt.count)),
        doc.Column("Distance²", "r", doc.field("squared_distance", fmt.significant, 3)),
    )
    return doc.tabulate("Outlying poses.", columns, entries[:MAX_OUTLIERS], *notes)


def unidentifiable_parameters(results: Results) -> doc.Section:
    """Name what these poses cannot tell, and with what it is confounded."""
    entries = results.summary.get("held") or []
    if not entries:
        text = doc.Paragraph("These poses determine every parameter.")
        return doc.Section("held", "What these poses do not determine", (text,))
    columns = (
        doc.Column("Parameter", "l", lambda e: in_words(str(e.get("name")))),
        doc.Column("Why", "l", lambda e: fmt.lookup_label(REASONS, e.get("reason"))),
        doc.Column("Confounded with", "l", _confounding_text, wide=True),
        doc.Column("U if free", "r", _uncertainty_if_free),
    )
    title = "Parameters that the poses do not determine, and what they are confounded with."
    table = doc.tabulate(title, columns, entries, IdentificationNotes.GAUGE)
    return doc.Section("held", "What these poses do not determine", (table,))


def _uncertainty_if_free(entry: dict[str, Any]) -> str:
    unit = UNITS.get(str(entry.get("unit")), "")
    return fmt.quantity(fmt.expanded(entry.get("standard_uncertainty_if_free")), unit)


def _confounding_text(entry: dict[str, Any]) -> str:
    parts = entry.get("confounded_with") or []
    return (
        ", ".join(f"{in_words(str(p.get('name')))} ({fmt.percent(p.get('share'))})" for p in parts)
        or fmt.DASH
    )


def parameter_uncertainty(results: Results) -> doc.Section:
    """Show how the identified parameters hang together, and how observable they are."""
    blocks: list[doc.Block] = [_figure_block(results, "parameter_correlation")]
    if results.summary.get("observability"):
        table = observability_table(results.summary["observability"])
        notes = (observability_text(results.summary), IdentificationNotes.INDEXES)
        blocks.append(replace(table, notes=notes))
    return doc.Section("sureness", "Correlations and observability", tuple(blocks))


def observability_table(indexes: dict[str, Any]) -> doc.Table:
    """List the indices of observability."""
    rows = tuple(doc.row(name, fmt.significant(value, 3)) for name, value in indexes.items())
    return doc.Table("Observability.", "lr", ("Index", "Value"), rows)


EVIDENCE = (
    residuals, parameters, unidentifiable_parameters, parameter_uncertainty,
    doc.files_and_software,
)  # fmt: skip
