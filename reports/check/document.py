"""What the report of an interim check says, in which order. Keys: docs/calibration.md."""

from functools import partial
from typing import Any

from reports.check import figures as check_figures
from reports.document import blocks as doc
from reports.document import formatting as fmt
from reports.document.charts import records
from reports.results import Results

VERDICTS = {
    "held": ("conform", "The calibration holds"),
    "not_held": ("nonconform", "The calibration does not hold"),
}
SUMMARY_KEYS = {"scale": ("scale_permille", "‰"), "vertical": ("vertical_px", "px"),
        "roll": ("roll_deg", "°")}  # fmt: skip
FIGURE_NAMES = {
    "scale": "Scale of known lengths",
    "vertical": "Height between the images",
    "roll": "Roll between the images",
}
UNITS = {"deg": "°"}


class CheckNotes:
    """Notes that stand under tables."""

    UNSTATED = "No uncertainty is stated for {}: taken as exact, and the verdict rests on that."
    FIGURES = (
        "Scale: measured length over known, less 1. Height: by how much the right image lies below "
        "where the left one says. Roll: by how much it is turned against it, clockwise. A camera "
        "that was knocked shifts at least one of them; a turn of both together shifts none."
    )
    LENGTHS = (
        "The uncertainty counts what the rig, the known length and the pictures state. Lengths "
        "share most of it, so they err together."
    )
    VISIBLE = "A dash: however large, these figures do not show it."


FIGURES = {
    "lengths": doc.FigurePlan(
        check_figures.lengths,
        "Error of each known length, with its expanded uncertainty (k = 2) as a bar about it.",
        "Points with upright bars, one a known length: measured less known in millimetres.",
        "No length was kept.",
    ),
    "figures": doc.FigurePlan(
        check_figures.figures,
        "The figures in units of their standard uncertainty; beyond the dotted limits the "
        "calibration does not hold.",
        "A point a figure, between two level lines that are the limits.",
        "The figures are not known.",
    ),
    "over_pairs": doc.FigurePlan(
        check_figures.over_pairs,
        "The figures of single pairs. The dashed line is what all pairs give together; pairs "
        "scatter about it by the pixels' noise.",
        "Three strips over the pairs: scale in thousandths, height in pixels, roll in degrees.",
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
        sections=(section(results) for section in SECTIONS),
    )


def verdict(results: Results) -> doc.Section:
    """Open with whether the calibration holds, and what that rests on."""
    summary = results.summary
    tone, label = VERDICTS.get(
        str(summary.get("verdict")), ("none", "Not known whether the calibration holds")
    )
    uncounted = [fmt.text_or_dash(source) for source in summary.get("uncounted") or []]
    remarks = [CheckNotes.UNSTATED.format(fmt.join_words(uncounted))] if uncounted else []
    block = doc.Verdict(
        tone=tone, label=label, sentence=_verdict_text(summary), remarks=tuple(remarks)
    )
    pairs, source = summary.get("pairs") or {}, summary.get("source") or {}
    left_out = [fmt.count(frame) for frame in pairs.get("left_out") or []]
    facts = doc.Facts(
        (
            ("Pictures", fmt.text_or_dash(source.get("path"))),
            ("Pairs used", fmt.count(pairs.get("used"))),
            ("Pairs left out", fmt.join_words(left_out) or "none"),
            (
                "Reprojection rms",
                fmt.quantity((summary.get("reprojection") or {}).get("rms_px"), "px"),
            ),
        )
    )
    return doc.Section("verdict", "Verdict", (block, facts))


def _verdict_text(summary: dict[str, Any]) -> str:
    limit = fmt.finite(summary.get("limit"))
    entries = [e for e in summary.get("figures") or [] if fmt.finite(e.get("z")) is not None]
    if limit is None or not entries:
        return "Nothing was tested."
    beyond = [FIGURE_NAMES[str(e.get("figure"))] for e in entries if abs(e["z"]) > limit]
    share = fmt.percent(summary.get("confidence"))
    if beyond:
        verb = "is" if len(beyond) == 1 else "are"
        return (
            f"{fmt.join_words(beyond)} {verb} off by more than the uncertainty explains ({share}, "
            "two-sided, for all figures together): calibrate again before measuring."
        ).capitalize()
    largest = max(abs(e["z"]) for e in entries)
    return (
        f"Every figure lies within its uncertainty ({share}, two-sided, for all together): the "
        f"farthest is {largest:.1f} standard uncertainties from 0, {limit:.2f} are allowed."
    )


def figures(results: Results) -> doc.Section:
    """Show the three figures that were tested, all pairs together and pair by pair."""
    blocks: list[doc.Block] = []
    entries = results.summary.get("figures") or []
    if entries:
        blocks.append(_figure_table(entries, fmt.finite(results.summary.get("limit"))))
    blocks += [_figure_block(results, "figures"), _figure_block(results, "over_pairs")]
    decisions = tuple(
        fmt.text_or_dash(sentence) for sentence in results.summary.get("decisions") or []
    )
    if decisions:
        blocks.append(doc.Bullets(decisions))
    return doc.Section("figures", "What was tested", tuple(blocks))


def _figure_table(entries: list[dict[str, Any]], limit: float | None) -> doc.Table:
    columns = (
        doc.Column("Figure", "l", lambda e: fmt.lookup_label(FIGURE_NAMES, e.get("figure"))),
        doc.Column("Value ± U", "r", _figure_value),
        doc.Column("Value over u", "r", doc.field("z", fmt.number, 1, signed=True)),
        doc.Column("Verdict", "l", lambda e: _figure_verdict(fmt.finite(e.get("z")), limit)),
    )
    title = "The figures, all pairs together; U with k = 2, u half of it."
    return doc.tabulate(title, columns, entries, CheckNotes.FIGURES)


def _figure_value(entry: dict[str, Any]) -> str:
    key, unit = SUMMARY_KEYS.get(str(entry.get("figure")), ("", ""))
    u = entry.get(f"standard_uncertainty_{key.rpartition('_')[2]}")
    return fmt.with_uncertainty(entry.get(key), fmt.expanded(u), unit)


def _figure_verdict(z: float | None, limit: float | None) -> doc.Cell:
    if z is None or limit is None:
        return doc.Cell("not tested", "none")
    return doc.Cell("within", "conform") if abs(z) <= limit else doc.Cell("beyond", "nonconform")


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
        title = "The smallest change that this check would have seen, four times in five."
        columns: tuple[doc.Column, ...] = (
            doc.Column("Change since the calibration", "l", doc.field("change")),
            doc.Column("Smallest", "r", _smallest_change),
        )
        blocks.append(doc.tabulate(title, columns, visible, CheckNotes.VISIBLE))
    table = results.table("sources")
    if len(table):
        heads = zip(("Scale [‰]", "Height [px]", "Roll [°]"), SUMMARY_KEYS.values(), strict=True)
        columns = (
            doc.Column("Source", "l", doc.field("source")),
            *(doc.Column(head, "r", doc.expanded_field(key)) for head, (key, _) in heads),
        )
        title = "U (k = 2) of each figure, by what it comes from."
        blocks.append(doc.tabulate(title, columns, records(table)))
    if not blocks:
        blocks.append(doc.Paragraph("What the check could have seen is not known.", "note"))
    return doc.Section("power", "What it would have seen", tuple(blocks))


def _smallest_change(entry: dict[str, Any]) -> str:
    unit = str(entry.get("unit"))
    return fmt.quantity(entry.get("smallest"), UNITS.get(unit, unit))


def conditions(results: Results) -> doc.Section:
    """Say what the check was made from."""
    return doc.files_and_software(results.summary)


SECTIONS = (verdict, figures, lengths, power, conditions)
