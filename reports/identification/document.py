"""What the report of an identified arm says, in which order.

The summary's keys, units in their names; what is not known is null or missing:

    kind                  "identification"
    tool, inputs, warnings as in a run's summary
    source                path, description; robot: its name; robot_fingerprint; robot_file
    poses                 used, outlying (source, frame, squared_distance), position_only
    base_free, tool_free  found with the arm, or held as rig and marker have them
    level                 "registration", "offsets" or "geometry": the model that was chosen
    levels                each: name, identified, rank, candidates, criterion, noise_position and
                          noise_orientation (of what is left, over what was stated), outlying,
                          held_out (splits, rows, mean_mm, rms_mm, max_mm, mean_deg, …)
    identified, rank, candidates   of the chosen model; of all parameters together
    parameters            name, kind, joint, unit, nominal, identified, change,
                          standard_uncertainty, expanded_uncertainty (k = 2); a base's and a
                          tool's own numbers are null
    offsets               joint, error_deg (encoder less measured), add_to_reading_deg,
                          standard_uncertainty_deg; the same with alone_ in front: by the model of
                          offsets alone
    judged                null, or path and poses of sessions that it was not identified from, with
                          before and after (mean_mm, rms_mm, max_mm, mean_deg, …)
    held                  name, unit, reason (gauge, not_supported, not_called_for),
                          confounded_with (name, share), standard_uncertainty_if_free
    observability         O1 … O5
    parameter_correlation parameters, correlation

Tables: residuals (source, frame, used, before_mm, after_mm, before_deg, after_deg), parameters.

The report of an identified arm, in words: models, figures, notes.
"""

from functools import partial
from typing import Any

from reports.document.blocks import (
    Block,
    Cell,
    Document,
    Facts,
    FigureText,
    Paragraph,
    Section,
    Table,
    Verdict,
    described,
    figure_or_text,
    files_and_software,
    lay_out,
    row,
    software,
)
from reports.document.formatting import (
    DASH,
    count,
    finite,
    lookup_label,
    number,
    percent,
    quantity,
    significant,
    text_or_dash,
    with_uncertainty,
)
from reports.document.formatting import joint_names as name_joints
from reports.identification.figures import IDENTIFICATION_FIGURES
from reports.results import Results

LEVELS = {
    "registration": "base and tool alone",
    "offsets": "with the joints' offsets",
    "geometry": "with all of the arm's geometry",
}
REASONS = {
    "gauge": "gauge",
    "not_supported": "not supported",
    "not_called_for": "not called for",
}


class IdentificationNotes:
    """Notes that stand under tables."""

    SIGN = (
        "Error: encoder less measured. A correction is its negative: it is to be added to the "
        "reading. ± is the standard uncertainty (k = 1)."
    )
    ALONE = (
        "The offsets alone hold for an arm whose lengths and twists stay as they are: enter these "
        "in a controller that takes nothing else. The others go with the corrected robot file."
    )
    NOT_TOLD = "Not identified: what it is confounded with stands further below."
    HOLD_OUT = (
        "Fitted on the other poses, means over the splits; every pose counts that was held out, "
        "outlying or not. The criterion is the Bayesian one: a larger model is taken where it "
        "falls by 10 or more."
    )
    JUDGED = "The arm was not identified from these."
    PLACES = (
        "Base and tool are found anew with every model; only changes of the arm's own numbers are "
        "shown. U is the expanded uncertainty (k = 2)."
    )
    GAUGE = (
        "A gauge is told apart by no motion: the others make it up, whatever the arm does. What is "
        "not supported could be told by another motion; what is not called for could be freed, but "
        "the data fit as well without. u: standard uncertainty beside all that is supported."
    )
    INDEXES = (
        "From the singular values of the whitened columns, scaled by 1 mm and 1°: O1 their "
        "geometric mean over √N (Borm and Menq), O2 the smallest over the largest (Driels and "
        "Pathre), O3 the smallest (Nahvi and others), O4 its square over the largest (Nahvi and "
        "Hollerbach), O5 one over the sum of their inverses (Sun and Hollerbach)."
    )
    OUTLYING = (
        "These poses do not belong to the others: noise reaches their distance once in a thousand "
        "recordings. They were left out of the fit, not of the residuals."
    )
    SAME = "No parameter of the arm was changed: the data call for no correction."


FIGURES = {
    "identified_residuals": FigureText(
        "What is left of each pose: by base and tool alone, and by the identified arm.",
        "Two strips over the poses: position in millimetres, orientation in degrees.",
        "The residuals were not kept.",
    ),
    "identified_changes": FigureText(
        "Change of each parameter of the arm, with its expanded uncertainty (k = 2).",
        "Points with upright bars, one a parameter: angles in degrees, lengths in millimetres.",
        "No parameter of the arm was changed.",
    ),
    "parameter_correlation": FigureText(
        "Correlation of the identified parameters; numbers below stand for the names at the left.",
        "A square of coloured cells, one a pair of parameters, from −1 to 1.",
        "There are no correlations to show.",
    ),
}


MAX_OUTLIERS = 60  # outlying poses in the table; the others are in summary.json
RESIDUAL_COLUMNS = ("mean [mm]", "rms [mm]", "max [mm]", "mean [°]", "rms [°]", "max [°]")
UNITS = {"deg": "°", "mm": "mm"}

_figure_block = partial(figure_or_text, IDENTIFICATION_FIGURES, FIGURES)


def document(results: Results) -> Document:
    """Lay out the whole report."""
    summary = results.summary
    fingerprint = text_or_dash(summary.get("robot_fingerprint"))[:23]
    return lay_out(
        title=f"Identification of {text_or_dash(summary.get('robot'))}",
        subtitle=described(summary, "a recorded session"),
        footer=f"{software(summary)} · robot {fingerprint}",
        sections=(section(results) for section in SECTIONS),
    )


def verdict(results: Results) -> Section:
    """Open with what was identified, and what it is worth on poses held out."""
    summary = results.summary
    before, after = (
        _held_out_entry(summary, "registration"),
        _held_out_entry(summary, summary.get("level")),
    )
    first, second = finite(before.get("mean_mm")), finite(after.get("mean_mm"))
    better = first is not None and second is not None and second < first
    changed = summary.get("level") != "registration"
    number_of, used = summary.get("identified"), (summary.get("poses") or {}).get("used")
    sentences = [f"{count(number_of)} parameters were identified from {count(used)} poses."]
    if first is not None and second is not None and changed:
        sentences.append(
            f"On poses held out, the mean position residual goes from {quantity(first, 'mm', 3)} "
            f"to {quantity(second, 'mm', 3)}."
        )
    if not changed:
        sentences.append(IdentificationNotes.SAME)
    blind = [j.get("joint") for j in summary.get("offsets") or [] if _is_hidden(j)]
    remarks = [f"The offset of {name_joints(blind)} was not identified."] if blind else []
    block = Verdict(
        tone="conform" if better or not changed else "undecided",
        label="The arm is identified" if changed else "The arm stays as it is",
        sentence=" ".join(sentences),
        remarks=tuple(remarks),
    )
    rank, candidates = count(summary.get("rank")), count(summary.get("candidates"))
    facts = [
        ("Robot", text_or_dash(summary.get("robot"))),
        ("Recorded in", text_or_dash((summary.get("source") or {}).get("path"))),
        ("Corrected arm", text_or_dash(summary.get("robot_file"))),
        ("Model", lookup_label(LEVELS, summary.get("level"))),
        ("Base", "free" if summary.get("base_free") else "held"),
        ("Tool", "free" if summary.get("tool_free") else "held"),
        ("Told apart", f"{rank} of {candidates} parameters"),
    ]
    return Section("verdict", "Verdict", (block, Facts(tuple(facts))))


def _is_hidden(joint: dict[str, Any]) -> bool:
    return all(finite(joint.get(key)) is None for key in ("error_deg", "alone_error_deg"))


def _held_out_entry(summary: dict[str, Any], name: Any) -> dict[str, Any]:
    for level in summary.get("levels") or []:
        if level.get("name") == name:
            return level.get("held_out") or {}
    return {}


def offsets(results: Results) -> Section:
    """Give each joint's offset with its sign, as error and as what to add."""
    summary = results.summary
    geometry = summary.get("level") == "geometry"
    heads = ["Joint", "Encoder less measured [°]", "Add to the reading [°]"]
    keys = [("error_deg", "standard_uncertainty_deg"),
            ("add_to_reading_deg", "standard_uncertainty_deg")]  # fmt: skip
    if geometry:
        heads.append("Offsets alone: add to the reading [°]")
        keys.append(("alone_add_to_reading_deg", "alone_standard_uncertainty_deg"))
    rows = tuple(
        row(
            text_or_dash(joint.get("joint")),
            *(with_uncertainty(joint.get(value), joint.get(u)) for value, u in keys),
        )
        for joint in summary.get("offsets") or []
    )
    notes = [IdentificationNotes.SIGN, *([IdentificationNotes.ALONE] if geometry else [])]
    if any(DASH in cell.text for line in rows for cell in line):
        notes.append(IdentificationNotes.NOT_TOLD)
    table = Table(
        "Constant offset of each joint.", "c" + "r" * len(keys), tuple(heads), rows, tuple(notes)
    )
    return Section("offsets", "Joint offsets", (table,))


def parameters(results: Results) -> Section:
    """List every parameter of the arm that was identified."""
    rows = tuple(
        row(
            Cell(text_or_dash(entry.get("name"))),
            UNITS.get(str(entry.get("unit")), text_or_dash(entry.get("unit"))),
            number(entry.get("nominal"), 4),
            number(entry.get("identified"), 4),
            with_uncertainty(entry.get("change"), entry.get("standard_uncertainty")),
            significant(entry.get("expanded_uncertainty")),
        )
        for entry in results.summary.get("parameters") or []
        if finite(entry.get("change")) is not None
    )
    if not rows:
        return Section("parameters", "Parameters", (Paragraph(IdentificationNotes.SAME),))
    table = Table(
        "Parameters of the arm: as its file has them, and identified.",
        "llrrrr",
        ("Parameter", "Unit", "Before", "Identified", "Change ± u", "U"),
        rows,
        (IdentificationNotes.PLACES,),
    )
    return Section(
        "parameters", "Parameters", (table, _figure_block(results, "identified_changes"))
    )


def residuals(results: Results) -> Section:
    """Say how each model carries over to poses that it has not seen."""
    summary = results.summary
    rows = tuple(
        row(
            lookup_label(LEVELS, level.get("name")),
            count(level.get("identified")),
            *(
                number((level.get("held_out") or {}).get(f"{name}_{unit}"), 3)
                for unit in ("mm", "deg")
                for name in ("mean", "rms", "max")
            ),
            number(level.get("criterion"), 0),
        )
        for level in summary.get("levels") or []
    )
    table = Table(
        "Residuals of poses held out, model by model.",
        "lrrrrrrrr",
        (
            "Model", "Parameters", *RESIDUAL_COLUMNS, "Criterion",
        ),
        rows,
        (IdentificationNotes.HOLD_OUT,),
        wide=(0,),
    )  # fmt: skip
    blocks: list[Block] = [table, _figure_block(results, "identified_residuals")]
    if summary.get("judged"):
        blocks.append(_validation_table(summary["judged"]))
    outlying = (summary.get("poses") or {}).get("outlying") or []
    if outlying:
        blocks.append(_outlier_table(outlying))
    else:
        blocks.append(Paragraph("No pose was outlying."))
    return Section("residuals", "Residuals", tuple(blocks))


def _validation_table(entry: dict[str, Any]) -> Table:
    rows = tuple(
        row(
            name,
            *(
                number((entry.get(key) or {}).get(f"{length}_{unit}"), 3)
                for unit in ("mm", "deg")
                for length in ("mean", "rms", "max")
            ),
        )
        for name, key in (("as its file has it", "before"), ("identified", "after"))
    )
    return Table(
        "Residuals of other sessions, registered anew with either arm.",
        "lrrrrrr",
        ("Model", *RESIDUAL_COLUMNS),
        rows,
        (
            f"{text_or_dash(entry.get('path'))}, {count(entry.get('poses'))} poses",
            IdentificationNotes.JUDGED,
        ),
    )


def _outlier_table(entries: list[dict[str, Any]]) -> Table:
    rows = tuple(
        row(
            text_or_dash(entry.get("source")),
            count(entry.get("frame")),
            significant(entry.get("squared_distance"), 3),
        )
        for entry in entries[:MAX_OUTLIERS]
    )
    notes = [IdentificationNotes.OUTLYING]
    if len(entries) > MAX_OUTLIERS:
        notes.append(f"{count(len(entries) - MAX_OUTLIERS)} more are in summary.json.")
    return Table("Outlying poses.", "lrr", ("Session", "Pair", "Distance²"), rows, tuple(notes))


def unidentifiable_parameters(results: Results) -> Section:
    """Name what these poses cannot tell, and with what it is confounded."""
    entries = results.summary.get("held") or []
    if not entries:
        text = Paragraph("Every parameter could be told from the others.")
        return Section("held", "What these poses cannot tell", (text,))
    rows = tuple(
        row(
            text_or_dash(entry.get("name")),
            lookup_label(REASONS, entry.get("reason")),
            _confounding_text(entry),
            quantity(entry.get("standard_uncertainty_if_free"),
                     UNITS.get(str(entry.get("unit")), "")),
        )
        for entry in entries
    )  # fmt: skip
    table = Table(
        "Parameters that were held, and what makes them up.",
        "lllr",
        ("Parameter", "Why it is held", "Confounded with", "u if free"),
        rows,
        (IdentificationNotes.GAUGE,),
        wide=(2,),
    )
    return Section("held", "What these poses cannot tell", (table,))


def _confounding_text(entry: dict[str, Any]) -> str:
    parts = entry.get("confounded_with") or []
    return (
        ", ".join(f"{text_or_dash(p.get('name'))} ({percent(p.get('share'))})" for p in parts)
        or DASH
    )


def parameter_uncertainty(results: Results) -> Section:
    """Show how the identified parameters hang together, and how observable they are."""
    indexes = results.summary.get("observability") or {}
    blocks: list[Block] = [_figure_block(results, "parameter_correlation")]
    if indexes:
        rows = tuple(row(name, significant(value, 3)) for name, value in indexes.items())
        blocks.append(
            Table("Observability.", "lr", ("Index", "Value"), rows, (IdentificationNotes.INDEXES,))
        )
    return Section("sureness", "Correlations and observability", tuple(blocks))


def conditions(results: Results) -> Section:
    """Say what the identification was made from."""
    return files_and_software(results.summary)


SECTIONS = (
    verdict,
    offsets,
    parameters,
    residuals,
    unidentifiable_parameters,
    parameter_uncertainty,
    conditions,
)
