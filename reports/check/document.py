"""What the report of an interim check says, in which order. Keys: docs/calibration.md."""

from functools import partial
from typing import Any

from reports.check import figures as check_figures
from reports.check.certificate import FIGURE_NAMES, certificate
from reports.check.figures import FIGURE_KEYS, unit_factor
from reports.document import blocks as doc
from reports.document import formatting as fmt
from reports.document.charts import records
from reports.results import Results

UNITS = {"deg": "°"}


class CheckNotes:
    """Notes that stand under tables."""

    LENGTHS = (
        "The uncertainty counts what the rig, the known length and the pictures state. Lengths "
        "share most of it, so they err together."
    )
    VISIBLE = (
        "Each change in the unit of what has changed. A dash: however large, these figures do not "
        "show it."
    )


FIGURES = {
    "lengths": doc.FigurePlan(
        check_figures.lengths,
        "Error of each known length, with its expanded uncertainty (k = 2) as a bar about it.",
        "Points with upright bars, one a known length: measured less known in millimetres.",
        "No length was kept.",
    ),
    "over_pairs": doc.FigurePlan(
        check_figures.over_pairs,
        "The figures of single pairs. The dashed line is what all pairs give together; pairs "
        "scatter about it by the pixels' noise.",
        "Three strips over the pairs: scale, height and roll in millimetres per metre.",
        "One pair alone: there is nothing to see pair by pair.",
    ),
}


_figure_block = partial(doc.figure_or_text, FIGURES)


def document(results: Results) -> doc.Document:
    """Lay out the whole report."""
    return doc.lay_out(
        title="Interim check of a calibration",
        subtitle=doc.described(results.summary, "a set of pictures"),
        footer=f"{doc.software(results.summary)} · interim check",
        sections=doc.answer_and_evidence(results, certificate, EVIDENCE),
    )


def figures(results: Results) -> doc.Section:
    """Show the figures pair by pair, and what was decided on the way."""
    blocks = (_figure_block(results, "over_pairs"), *doc.decisions(results.summary))
    return doc.Section("figures", "The figures pair by pair", blocks)


def lengths(results: Results) -> doc.Section:
    """Show each known length."""
    blocks: list[doc.Block] = []
    table = results.table("lengths")
    square = results.summary.get("square")
    if square:
        u = square.get("standard_uncertainty_mm")
        stated = fmt.with_uncertainty(square.get("known_mm"), None, "mm", signed=False)
        measured = fmt.with_uncertainty(
            square.get("measured_mm"), fmt.expanded(u), "mm", signed=False
        )
        facts = ("Square as stated", stated), ("Square as measured (k = 2)", measured)
        blocks.append(doc.Facts(facts))
    if len(table):
        title = "Known lengths: measured less known, k = 2."
        columns = (
            doc.Column("LEDs", "l", doc.field("ends")),
            doc.Column("Known [mm]", "r", doc.field("known_mm", fmt.number, 3)),
            doc.Column(
                "Error ± U [mm]",
                "r",
                doc.uncertain_field("error_mm", "standard_uncertainty_mm", k=2),
            ),
            doc.Column("Pairs", "r", doc.field("pairs", fmt.count)),
        )
        blocks.append(doc.tabulate(title, columns, records(table), CheckNotes.LENGTHS))
        blocks.append(_figure_block(results, "lengths"))
    if not blocks:
        blocks.append(doc.Paragraph("No length was kept.", "note"))
    return doc.Section("lengths", "Known lengths", tuple(blocks))


def power(results: Results) -> doc.Section:
    """Say which changes the check would have seen, and where its uncertainty comes from."""
    blocks: list[doc.Block] = []
    visible = results.summary.get("visible") or []
    if visible:
        title = "The smallest change that this check detects, four times in five."
        columns: tuple[doc.Column, ...] = (
            doc.Column("Change since the calibration", "l", doc.field("change")),
            doc.Column("Smallest", "r", _smallest_change),
        )
        blocks.append(doc.tabulate(title, columns, visible, CheckNotes.VISIBLE))
    table = results.table("sources")
    if len(table):
        columns = (
            doc.Column("Source", "l", doc.field("source")),
            *(_source_column(results.summary, figure) for figure in FIGURE_KEYS),
        )
        title = "U (k = 2) of each figure in mm/m, by what it comes from."
        blocks.append(doc.tabulate(title, columns, records(table)))
    if not blocks:
        blocks.append(doc.Paragraph("What the check can detect is not known.", "note"))
    return doc.Section("power", "What this check detects", tuple(blocks))


def _source_column(summary: dict[str, Any], figure: str) -> doc.Column:
    """U that each source gives a figure, mm per metre."""
    key, factor = FIGURE_KEYS[figure], unit_factor(summary, figure)

    def write(entry: dict[str, Any]) -> str:
        u = fmt.expanded(entry.get(key))
        return fmt.DASH if u is None or factor is None else fmt.significant(factor * u)

    return doc.Column(FIGURE_NAMES[figure], "r", write)


def _smallest_change(entry: dict[str, Any]) -> str:
    unit = str(entry.get("unit"))
    return fmt.quantity(entry.get("smallest"), UNITS.get(unit, unit))


EVIDENCE = (lengths, figures, power, doc.files_and_software)
