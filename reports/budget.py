"""The uncertainty budget: what each joint's uncertainty is made of, and whether that holds."""

from typing import Any

import numpy as np
import pandas as pd

from reports.blocks import Block, Bullets, Cell, Paragraph, Section, Table, row
from reports.blocks import Figure as Picture
from reports.budget_combinations import known_well_and_badly
from reports.budget_drawn import drawn
from reports.findings import figure_or_words
from reports.formatting import DASH, finite, joined, number, percent, quantity, significant, word
from reports.results import Results
from reports.series import column, texts

MOST_PARAMETERS = 8  # the largest contributions; results/ holds all
MOST_OF_TABLE = 4  # of the robot's own table
LEAST = 1e-5  # degrees
PARTS = (
    "Type A: from this session's own data; type B: stated. ν: degrees of freedom. Random parts are "
    "those of the mean, autocorrelation included; systematic parts do not average out. Effective ν "
    "by Welch and Satterthwaite. Expanded: combined times its coverage factor k."
)
UNITS = (
    "Degrees of a joint's mean error by one unit of the parameter. All parameters stand in "
    "results/budget_parameters.parquet. Where no u is stated, the parameter is taken as exact."
)


def budget(results: Results) -> Section:
    """Break each joint's uncertainty down by source."""
    blocks: list[Block] = []
    table = results.table("budget")
    if len(table) and {"joint", "source"} <= set(table.columns):
        blocks += _largest(table, results.summary)
        blocks.append(_sources(table, results.summary))
    blocks.append(
        figure_or_words(
            results,
            Picture(
                "budget",
                "Share of each source in the sum of the variances of a joint's mean error. What is "
                "largest is what to improve first.",
                "Stacked bars, one a joint: share of variance in percent by source.",
            ),
            "The uncertainty was not broken down by source.",
        )
    )
    blocks += known_well_and_badly(results.summary)
    blocks += _parameters(results.table("budget_parameters"))
    blocks += drawn(results.summary)
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


def _largest(table: pd.DataFrame, summary: dict[str, Any]) -> list[Block]:
    """Say what limits the joint that is known worst."""
    known = [
        joint
        for joint in summary.get("joints") or []
        if finite(joint.get("expanded_uncertainty_deg")) is not None
    ]
    if not known or "share" not in table.columns:
        return []
    worst = max(known, key=lambda joint: float(joint["expanded_uncertainty_deg"]))
    mine = table[table["joint"] == worst.get("joint")].dropna(subset=["share"])
    if mine.empty:
        return []
    first = mine.sort_values("share", ascending=False, kind="stable").iloc[0]
    size = quantity(worst["expanded_uncertainty_deg"], "°")
    text = (
        f"Known worst is joint {word(worst.get('joint'))}, with U = {size}; most of that comes "
        f"from: {_name(first['source'])}, {percent(first['share'])} of the variance."
    )
    return [Paragraph(text)]


def _name(source: Any) -> str:
    return word(source).replace("_", " ")


def _sources(table: pd.DataFrame, summary: dict[str, Any]) -> Table:
    frame = table.assign(u=column(table, "standard_uncertainty_deg"), word=texts(table, "kind"))
    joints = sorted(frame["joint"].dropna().unique().tolist())
    rows = []
    for (source, kind), part in frame.groupby(["source", "word"], sort=False, dropna=False):
        by_joint = dict(zip(part["joint"].tolist(), part["u"].tolist(), strict=True))
        types = texts(part, "type") if "type" in part else [""]
        degrees = column(part, "degrees_of_freedom")
        cells = [_size(by_joint.get(joint)) for joint in joints]
        rows.append(row(_name(source), word(kind), word(types[0]), _degrees(degrees), *cells))
    rows += _totals(summary, joints)
    return Table(
        "Standard uncertainty of each joint's mean error by source, in degrees.",
        "llcr" + "r" * len(joints),
        ("Source", "Kind", "Type", "ν", *(f"q{joint} [°]" for joint in joints)),
        tuple(rows),
        (PARTS,),
        wide=(0,),
    )


def _size(u: Any) -> str:
    """A contribution in degrees; below what anybody resolves only that it is small."""
    known = finite(u)
    return "< 0.00001" if known is not None and 0 < abs(known) < LEAST else significant(known)


def _degrees(values: Any) -> str:
    """Degrees of freedom of a line: the fewest of its joints."""
    known = [float(v) for v in values if not np.isnan(v)]
    if not known:
        return DASH
    least = min(known)
    return "∞" if np.isinf(least) else f"{least:.0f}"


def _totals(summary: dict[str, Any], joints: list[Any]) -> list[tuple[Cell, ...]]:
    known = {joint.get("joint"): joint for joint in (summary.get("joints") or [])}
    parts = (summary.get("budget") or {}).get("joints") or []
    made = {part.get("joint"): part for part in parts}
    lines: list[tuple[str, list[str]]] = []
    if made:
        for label, key in (
            ("random, together", "random_standard_uncertainty_deg"),
            ("systematic, together", "systematic_standard_uncertainty_deg"),
        ):
            lines.append((label, [significant((made.get(j) or {}).get(key)) for j in joints]))
    for label, key in (("combined", "standard_uncertainty_deg"),):
        lines.append((label, [significant((known.get(j) or {}).get(key)) for j in joints]))
    if made:
        lines.append(("effective ν", [_effective(made.get(j) or {}) for j in joints]))
        lines.append(
            ("k", [number((known.get(j) or {}).get("coverage_factor"), 2) for j in joints])
        )
    lines.append(
        (
            "expanded",
            [significant((known.get(j) or {}).get("expanded_uncertainty_deg")) for j in joints],
        )
    )
    return [
        tuple(Cell(text, "total") for text in (label, "", "", "", *cells)) for label, cells in lines
    ]


def _effective(part: dict[str, Any]) -> str:
    """Effective degrees of freedom; beyond a thousand the number says nothing any more."""
    degrees = finite(part.get("effective_degrees_of_freedom"))
    if finite(part.get("coverage_factor")) is None:
        return DASH
    return "> 1000" if degrees is None or degrees > 1000 else f"{degrees:.0f}"


def _parameters(table: pd.DataFrame) -> list[Block]:
    needed = {"parameter", "joint", "sensitivity_deg", "contribution_deg", "unit"}
    if not len(table) or not needed <= set(table.columns):
        return []
    table = table[table["unit"].notna() & (table["parameter"] != "alignment_1")]  # no quantity
    largest = table.groupby("parameter", sort=False)["contribution_deg"].max()
    contributing = largest.dropna().nlargest(MOST_PARAMETERS).index
    lengths = table[table["standard_uncertainty"].isna() & (table["unit"] == "mm")]
    steep = lengths["sensitivity_deg"].abs().groupby(lengths["parameter"], sort=False).max()
    exact = steep.nlargest(MOST_OF_TABLE).index
    joints = sorted(table["joint"].unique().tolist())
    rows = []
    for name in [*contributing, *exact]:
        part = table[table["parameter"] == name]
        first = part.iloc[0]
        by_joint = dict(zip(part["joint"], part["sensitivity_deg"], strict=True))
        rows.append(
            row(
                _name(first["source"]),
                word(name),
                significant(first["standard_uncertainty"]),
                *(number(by_joint.get(joint), 3, signed=True) for joint in joints),
            )
        )
    if not rows:
        return []
    return [
        Table(
            "Sensitivity to single parameters: those that contribute most, and the steepest of the "
            "robot's own table.",
            "lll" + "r" * len(joints),
            ("Source", "Parameter", "u", *(f"q{joint}" for joint in joints)),
            tuple(rows),
            (UNITS,),
        )
    ]
