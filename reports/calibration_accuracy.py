"""What a point is worth in the report of a calibration, and what would help most."""

from typing import Any

from reports.blocks import (
    Block,
    Figure,
    Paragraph,
    Section,
    Table,
    drawn_or_said,
    row,
)
from reports.calibration_figures import CALIBRATION_FIGURES
from reports.calibration_words import (
    FIGURES,
    GROUPS,
    Words,
)
from reports.formatting import (
    DASH,
    finite,
    significant,
    stated,
    word,
)
from reports.headline import capital
from reports.results import Results
from reports.series import column, texts


def drawn(results: Results, name: str) -> Block:
    """Show one of the report's figures, or say why it is not there."""
    said = FIGURES[name]
    draw = CALIBRATION_FIGURES.get(name)
    drawing = results.images.get(name) if draw is None else draw(results)
    return drawn_or_said(Figure(name, said.caption, said.alt), drawing, said.otherwise)


def working(summary: dict[str, Any]) -> dict[str, Any]:
    """Take the accuracy at the working distance; empty where there is none."""
    entries: list[dict[str, Any]] = summary.get("accuracy") or []
    wanted = summary.get("working_distance_mm")
    return next((e for e in entries if e.get("distance_mm") == wanted), {})


def metres(entry: dict[str, Any]) -> str:
    """Say an entry's distance."""
    far = finite(entry.get("distance_mm"))
    return DASH if far is None else f"{far / 1e3:g} m"


def first(summary: dict[str, Any]) -> str:
    """Say what counts most and what helps against it."""
    first = summary.get("improve_first") or {}
    help_ = first.get("help")
    if not help_:
        return "What to improve first is not known."
    named = GROUPS.get(str(first.get("group")), word(first.get("group")))
    return f"What counts most is {named}: {help_}."


def accuracy(results: Results) -> Section:
    """Say what a point is worth over the working volume."""
    entries: list[dict[str, Any]] = results.summary.get("accuracy") or []
    blocks: list[Block] = []
    if entries:
        blocks += [_point_table(entries), _length_table(entries, results.summary)]
    blocks.append(drawn(results, "accuracy"))
    return Section("accuracy", "Expected accuracy of a point", tuple(blocks))


def _point_table(entries: list[dict[str, Any]]) -> Table:
    names = [
        f"{kind}_{part}_mm" for kind in ("random", "systematic") for part in ("lateral", "depth")
    ]
    names += ["total_lateral_mm", "total_depth_mm", "worst_total_mm"]
    rows = tuple(row(metres(e), *(significant(e.get(name)) for name in names)) for e in entries)
    return Table(
        "Standard uncertainty (k = 1) of one LED's place in the middle of the field, in mm.",
        "lrrrrrrr",
        (
            "Distance", "Noise, across", "Noise, depth", "Rig, across", "Rig, depth",
            "Both, across", "Both, depth", "Worst in the field, in all",
        ),
        rows,
        (Words.POINT,),
    )  # fmt: skip


def _length_table(entries: list[dict[str, Any]], summary: dict[str, Any]) -> Table:
    names = [
        f"length_{way}_{kind}_um"
        for way in ("across", "depth")
        for kind in ("random", "systematic")
    ]
    rows = tuple(row(metres(e), *(significant(e.get(name)) for name in names)) for e in entries)
    return Table(
        f"Standard uncertainty (k = 1) of a length of {stated(summary.get('length_mm'))} mm "
        "between two LEDs in the middle of the field, in µm.",
        "lrrrr",
        ("Distance", "Across, noise", "Across, rig", "In depth, noise", "In depth, rig"),
        rows,
        (Words.LENGTH,),
    )


def improvement(results: Results) -> Section:
    """Say what would help most."""
    blocks: list[Block] = [Paragraph(capital(first(results.summary)))]
    table = results.table("contributions")
    if len(table):
        rows = tuple(
            row(capital(GROUPS.get(g, g)), significant(alone), significant(without))
            for g, alone, without in zip(
                texts(table, "group"), column(table, "alone_mm"), column(table, "without_mm"),
                strict=True,
            )
        )  # fmt: skip
        blocks.append(
            Table(
                f"Depth of a point {metres(working(results.summary))} away, by what its "
                "uncertainty comes from.",
                "lrr",
                ("Source", "u from it alone [mm]", "u left, were it exact [mm]"),
                rows,
                (Words.GROUPS,),
            )
        )
    blocks += [drawn(results, "contributions"), drawn(results, "parameter_correlation")]
    return Section("improvement", "What would help most", tuple(blocks))
