"""The uncertainty budget of each joint, and its check by Monte Carlo."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd

from reports.document import blocks as doc
from reports.document import formatting as fmt
from reports.document.charts import column, texts
from reports.results import Results
from reports.session.combinations import combination_blocks
from reports.session.figures import evidence

MAX_LISTED_PAIRS = 12  # pairs that are listed; summary.json names all
LISTED_NOTE = (
    "Listed where they may differ by more than {within} (a hundredth is left to the draws' own "
    "chance), or where the mean moves by a tenth of the standard deviation."
)


def monte_carlo_blocks(summary: dict[str, Any]) -> list[doc.Block]:
    """Say how the budget compares with drawing the whole chain anew."""
    check = (summary.get("budget") or {}).get("monte_carlo")
    if not check:
        return []
    entries = [e for e in check.get("joints") or [] if e.get("pairs")]
    away = [
        fmt.finite(e.get("largest_difference")) for e in entries if e.get("pairs") == e.get("holds")
    ]
    largest = max((a for a in away if a is not None), default=None)
    chain = (
        f"Monte Carlo: {fmt.count(check.get('pairs'))} pairs, each simulated "
        f"{fmt.count(check.get('draws'))} times through the whole chain, pose fit and the arm's "
        "inverse included."
    )
    fails = check.get("fails") or []
    within = fmt.percent(check.get("agrees_within"))
    if not fails:
        holds = (
            "The standard deviation of every joint's error agrees with linear propagation; the "
            f"largest difference is {fmt.percent(largest)}, where {within} are allowed."
        )
        return [doc.Paragraph(f"{chain} {holds}")]
    bad = sorted({j for fail in fails if not fail.get("coupled") for j in fail.get("joints") or []})
    counted = (
        f"It does not hold for {fmt.joint_names(bad)} at the poses below: there the budget says "
        "too little or too much."
        if bad
        else "It fails only for joints that a singularity couples, which no single joint's figure "
        "rests on."
    )
    return [doc.Paragraph(f"{chain} {counted}"), _failure_table(fails, within)]


def _failure_table(fails: list[dict[str, Any]], within: str) -> doc.Table:
    def gap(fail: dict[str, Any]) -> float:
        ratios = [fmt.finite(r) for r in fail.get("ratio") or []]
        return max((abs(np.log(r)) for r in ratios if r), default=np.inf)

    worst = sorted(fails, key=gap, reverse=True)[:MAX_LISTED_PAIRS]
    columns = (
        doc.Column("Pair", "r", doc.field("frame", fmt.count)),
        doc.Column("Ratio by joint", "l", _ratios, wide=True),
        doc.Column("Why", "l", _failure_reason),
    )
    title = "Where linear propagation does not hold: drawn over linear standard deviation."
    entries = sorted(worst, key=lambda f: f.get("frame") or 0)
    return doc.tabulate(title, columns, entries, LISTED_NOTE.format(within=within))


def _ratios(fail: dict[str, Any]) -> str:
    ratios = zip(fail.get("joints") or [], fail.get("ratio") or [], strict=False)
    return ", ".join(
        f"q{fmt.text_or_dash(joint)} {fmt.number(ratio, 2)}" for joint, ratio in ratios
    )


def _failure_reason(fail: dict[str, Any]) -> str:
    if fmt.finite(fail.get("unreachable")):
        return "the arm cannot stand in some of the drawn poses"
    if fail.get("coupled"):
        return "near a singularity; these joints are left out of single figures"
    return "the arm's inverse bends within the uncertainty"


MAX_PARAMETERS = 8  # the largest contributions; results/ holds all
MAX_TABLE_PARAMETERS = 4  # of the robot's own table
MIN_CONTRIBUTION_DEG = 1e-5  # degrees
PARTS_NOTE = (
    "Type A: from this session's own data; type B: stated. ν: degrees of freedom. Random parts are "
    "those of the mean, autocorrelation included; systematic parts do not average out. Effective ν "
    "by Welch and Satterthwaite. Expanded: combined times its coverage factor k."
)
NEGATIVE_NOTE = "A negative figure: errors cancel there; its square is taken off the variance."
UNITS_NOTE = (
    "Degrees of a joint's mean error by one unit of the parameter. All parameters stand in "
    "results/budget_parameters.parquet. Where no u is stated, the parameter is taken as exact."
)


def budget(results: Results) -> doc.Section:
    """Break each joint's uncertainty down by source."""
    blocks: list[doc.Block] = []
    table = results.table("budget")
    if len(table) and {"joint", "source"} <= set(table.columns):
        blocks += _largest_contribution(table, results.summary)
        blocks.append(_source_table(table, results.summary))
    figure = doc.Figure(
        "budget",
        "Share of each source in the sum of the variances of a joint's mean error; above each bar "
        "the joint's U, in degrees. Improve the largest source first.",
        "Stacked bars, one a joint: share of variance in percent by source.",
    )
    otherwise = "The uncertainty was not broken down by source."
    blocks.append(doc.block_or_paragraph(figure, evidence.budget(results), otherwise))
    blocks += combination_blocks(results.summary)
    blocks += _parameter_blocks(results.table("budget_parameters"))
    blocks += monte_carlo_blocks(results.summary)
    uncounted = (results.summary.get("budget") or {}).get("uncounted") or []
    if uncounted:
        named = fmt.join_words([fmt.text_or_dash(name) for name in uncounted])
        text = (
            f"Not counted, because their uncertainty is not stated: {named}. "
            "They are taken as exact, and every uncertainty here holds on that condition."
        )
        blocks.append(doc.Bullets((text,), "warning"))
        blocks += _unstated_table(results.summary["budget"].get("unstated") or [])
    else:
        blocks.append(doc.Paragraph("Every source that is known of is counted."))
    return doc.Section("budget", "Uncertainty budget", tuple(blocks))


def _unstated_table(effects: list[dict[str, Any]]) -> list[doc.Block]:
    """What errors of the sources that are not counted would do."""
    columns = (
        doc.Column("Source", "l", doc.field("source", fmt.text_or_dash)),
        doc.Column("Error", "l", doc.field("error", fmt.text_or_dash), wide=True),
        doc.Column("Joint", "r", doc.field("joint", fmt.count)),
        doc.Column("Moved by [°]", "r", doc.field("moves_mean_error_deg", fmt.significant)),
    )
    title = "What it would take to matter: the mean error that each would move the most."
    return [doc.tabulate(title, columns, effects)] if effects else []


def _largest_contribution(table: pd.DataFrame, summary: dict[str, Any]) -> list[doc.Block]:
    """Say what limits the joint that is known worst."""
    determined = [
        joint
        for joint in summary.get("joints") or []
        if fmt.finite(joint.get("expanded_uncertainty_deg")) is not None
    ]
    if not determined or "share" not in table.columns:
        return []
    worst = max(determined, key=lambda joint: float(joint["expanded_uncertainty_deg"]))
    mine = table[table["joint"] == worst.get("joint")].dropna(subset=["share"])
    if mine.empty:
        return []
    first = mine.sort_values("share", ascending=False, kind="stable").iloc[0]
    size = fmt.quantity(worst["expanded_uncertainty_deg"], "°")
    text = (
        f"Joint {fmt.text_or_dash(worst.get('joint'))} has the largest uncertainty, U = {size}. "
        f"Its largest source: {_source_name(first['source'])}, {fmt.percent(first['share'])} of "
        "the variance."
    )
    return [doc.Paragraph(text)]


def _source_name(source: Any) -> str:
    return fmt.text_or_dash(source).replace("_", " ")


def _source_table(table: pd.DataFrame, summary: dict[str, Any]) -> doc.Table:
    frame = table.assign(u=column(table, "standard_uncertainty_deg"), word=texts(table, "kind"))
    joints = sorted(frame["joint"].dropna().unique().tolist())
    rows = []
    for (source, kind), part in frame.groupby(["source", "word"], sort=False, dropna=False):
        by_joint = dict(zip(part["joint"].tolist(), part["u"].tolist(), strict=True))
        rows.append(
            doc.row(
                _source_name(source),
                fmt.text_or_dash(kind),
                fmt.text_or_dash(texts(part, "type")[0]),
                _format_degrees_of_freedom(column(part, "degrees_of_freedom")),
                *(_format_contribution(by_joint.get(joint)) for joint in joints),
            )
        )
    rows += _totals(summary, joints)
    return doc.Table(
        "Standard uncertainty of each joint's mean error by source, in degrees (but ν and k).",
        "llcr" + "r" * len(joints),
        ("Source", "Kind", "Type", "ν", *(f"q{joint}" for joint in joints)),
        tuple(rows),
        (PARTS_NOTE, *[NEGATIVE_NOTE] * bool((frame["u"] < 0).any())),
        wide=(0,),
    )


def _format_contribution(u: Any) -> str:
    """A contribution in degrees; below what anybody resolves only that it is small."""
    figure = fmt.finite(u)
    small = figure is not None and 0 < abs(figure) < MIN_CONTRIBUTION_DEG
    return "< 0.00001" if small else fmt.significant(figure)


def _format_degrees_of_freedom(values: Any) -> str:
    """Degrees of freedom of a line: the fewest of its joints."""
    stated = [float(v) for v in values if not np.isnan(v)]
    if not stated:
        return fmt.DASH
    least = min(stated)
    return "∞" if np.isinf(least) else f"{least:.0f}"


def _totals(summary: dict[str, Any], joints: list[Any]) -> list[tuple[doc.Cell, ...]]:
    results = {joint.get("joint"): joint for joint in summary.get("joints") or []}
    parts = (summary.get("budget") or {}).get("joints") or []
    sums = {part.get("joint"): part for part in parts}
    lines: list[tuple[str, dict[Any, Any], Callable[[dict[str, Any]], str]]] = [
        ("random, together", sums, doc.field("random_standard_uncertainty_deg", fmt.significant)),
        (
            "systematic, together",
            sums,
            doc.field("systematic_standard_uncertainty_deg", fmt.significant),
        ),
        ("combined", results, doc.field("standard_uncertainty_deg", fmt.significant)),
        ("effective ν", sums, _format_effective_dof),
        ("k", results, doc.field("coverage_factor", fmt.number, 2)),
        ("expanded", results, doc.field("expanded_uncertainty_deg", fmt.significant)),
    ]
    if not sums:
        lines = [line for line in lines if line[0] in ("combined", "expanded")]
    return [
        tuple(
            doc.Cell(text, "total")
            for text in (label, "", "", "", *(write(of.get(joint) or {}) for joint in joints))
        )
        for label, of, write in lines
    ]


def _format_effective_dof(part: dict[str, Any]) -> str:
    """Effective degrees of freedom; beyond a thousand the number says nothing any more."""
    degrees = fmt.finite(part.get("effective_degrees_of_freedom"))
    if fmt.finite(part.get("coverage_factor")) is None:
        return fmt.DASH
    return "> 1000" if degrees is None or degrees > 1000 else f"{degrees:.0f}"


def _parameter_blocks(table: pd.DataFrame) -> list[doc.Block]:
    needed = {"parameter", "joint", "sensitivity_deg", "contribution_deg", "unit"}
    if not len(table) or not needed <= set(table.columns):
        return []
    table = table[table["unit"].notna() & (table["parameter"] != "alignment_1")]  # no quantity
    largest = table.groupby("parameter", sort=False)["contribution_deg"].max()
    contributing = largest.dropna().nlargest(MAX_PARAMETERS).index
    lengths = table[table["standard_uncertainty"].isna() & (table["unit"] == "mm")]
    steep = lengths["sensitivity_deg"].abs().groupby(lengths["parameter"], sort=False).max()
    exact = steep.nlargest(MAX_TABLE_PARAMETERS).index
    joints = sorted(table["joint"].unique().tolist())
    rows = []
    for name in [*contributing, *exact]:
        part = table[table["parameter"] == name]
        first = part.iloc[0]
        by_joint = dict(zip(part["joint"], part["sensitivity_deg"], strict=True))
        rows.append(
            doc.row(
                _source_name(first["source"]),
                fmt.text_or_dash(name),
                fmt.significant(first["standard_uncertainty"]),
                *(fmt.number(by_joint.get(joint), 3, signed=True) for joint in joints),
            )
        )
    if not rows:
        return []
    return [
        doc.Table(
            "Sensitivity to single parameters: those that contribute most, and the steepest of the "
            "robot's own table.",
            "lll" + "r" * len(joints),
            ("Source", "Parameter", "u", *(f"q{joint}" for joint in joints)),
            tuple(rows),
            (UNITS_NOTE,),
        )
    ]
