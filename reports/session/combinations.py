"""Sums of joint errors known well and badly; the smallest fault of each kind that shows."""

import math
from typing import Any

import numpy as np
import pandas as pd

from reports.document import formatting
from reports.document.blocks import Block, Bullets, Paragraph, Section, Table, row
from reports.document.charts import Array, numbers
from reports.document.formatting import (
    DASH,
    finite,
    joint_names,
    quantity,
    significant,
    text_or_dash,
    with_uncertainty,
)
from reports.results import Results
from reports.session import causes

MIN_RELATIVE_WEIGHT = 0.1  # of the largest weight: left out of a sum's name
MIN_JOINTS = 2  # joints


def combination_blocks(summary: dict[str, Any]) -> list[Block]:
    """Set sums that are known well beside their members and the sum that is known worst."""
    entries = summary.get("joints") or []
    u = np.array([_float_or_nan(joint.get("standard_uncertainty_deg")) for joint in entries])
    mean = np.array([_float_or_nan(joint.get("mean_error_deg")) for joint in entries])
    covariance = _covariance(summary.get("joint_error_correlation"), u)
    if covariance is None:
        return []
    names = [text_or_dash(joint.get("joint")) for joint in entries]
    known = np.flatnonzero(np.isfinite(np.diag(covariance)))
    part = covariance[np.ix_(known, known)]
    if len(known) < MIN_JOINTS or not np.isfinite(part).all():
        return []
    values, vectors = np.linalg.eigh(part)
    rows = [
        row(
            text_or_dash(c.get("label")),
            with_uncertainty(c.get("mean_error_deg"), sums),
            "axes are parallel",
        )
        for c in summary.get("combinations") or []
        if c.get("why") == "well_known"
        and (sums := finite(c.get("standard_uncertainty_deg"))) is not None
    ]
    members = {j for c in summary.get("combinations") or [] if c.get("why") == "well_known"
               for j in c.get("joints") or []}  # fmt: skip
    for place, name in enumerate(names):
        if entries[place].get("joint") in members and np.isfinite(u[place]):
            rows.append(
                row(f"q{name}", with_uncertainty(mean[place], u[place]), "a member by itself")
            )
    for which, why in ((0, "known best of all sums"), (-1, "known worst of all sums")):
        weights = vectors[:, which] / vectors[np.argmax(np.abs(vectors[:, which])), which]
        label = _combination_name(weights, [names[k] for k in known])
        # of weights whose largest is one, as a sum of joints has them
        size = float(np.sqrt(max(values[which], 0.0))) / float(np.abs(vectors[:, which]).max())
        rows.append(row(label, with_uncertainty(weights @ mean[known], size), why))
    return [
        Table(
            "Sums of the joints' mean errors, those known well beside those known badly.",
            "lrl",
            ("Sum", "Mean error ± u [°]", "Why it is given"),
            tuple(rows),
            (_uncertainty_ratio_text(values),),
        )
    ]


def _uncertainty_ratio_text(values: Array) -> str:
    ratio = float(np.sqrt(values[-1] / values[0])) if values[0] > 0 else None
    return (
        f"The worst known sum is {quantity(ratio, '')} times as uncertain as the best known one: "
        "single joints are to be read together with their correlation. Weights under a tenth are "
        "left out of a sum's name."
    )


def _float_or_nan(value: Any) -> float:
    known = finite(value)
    return float("nan") if known is None else known


def _covariance(rows: Any, u: Array) -> Array | None:
    lines = [numbers(line) for line in rows] if isinstance(rows, list) else []
    if not len(u) or len(lines) != len(u) or any(len(line) != len(u) for line in lines):
        return None
    covariance: Array = np.array(lines) * np.outer(u, u)
    return covariance


def _combination_name(weights: Array, names: list[str]) -> str:
    terms = [
        f"{'+' if w > 0 else '−'}{'' if abs(abs(w) - 1) < 0.005 else f'{abs(w):.2f}·'}q{name}"
        for w, name in zip(weights, names, strict=True)
        if abs(w) > MIN_RELATIVE_WEIGHT
    ]
    return "".join(terms).removeprefix("+")


COLUMNS = (
    ("offset", "Offset [°]"),
    ("gain", "Gain [%]"),
    ("backlash", "Backlash [°]"),
    ("once", "Eccentricity [°]"),
    ("waves", "Waves [°]"),
    ("compliance", "Compliance [°/m]"),
    ("drift", "Drift [°/h]"),
)
TABLE_NOTE = (
    "Each entry: the smallest fault that the diagnosis would list, / the smallest that it would "
    "also tell from every other fault it knows (in four of five such sessions, all faults tried "
    "at once; so a little more than the size at which one offset alone is noticed). "
    "A dash: none, or not tried with this motion."
)
FAULT_NOTE = (
    "Eccentricity: one wave a turn, of the least favourable phase; tried where a joint turns more "
    "than 60°. Waves: the least favourable number of waves a turn of those that the swing shows. "
    "Compliance: error a metre of horizontal lever, tried where the lever varies by half."
)


def detectable(results: Results) -> Section:
    """Say what could not show, then how small a fault of each kind could have been."""
    table = results.table("detectable")
    if table.empty:
        text = "Not known: these results were made without it."
        return Section("detectable", "What could be seen", (Paragraph(text, "note"),))
    own, common = table[table["joint"].notna()], table[table["joint"].isna()]
    hidden = _hidden_sentences(own)
    blocks: tuple[Block, ...] = (
        Bullets(hidden)
        if hidden
        else Paragraph("An offset, a gain and backlash of every joint could have shown."),
        _joint_table(own[own["kind"] != "dh"]),
        _other_table(pd.concat([common, own[own["kind"] == "dh"]])),
    )
    return Section("detectable", "What could be seen", blocks)


def _hidden_sentences(own: pd.DataFrame) -> tuple[str, ...]:
    every = sorted(own["joint"].astype(int).unique().tolist())
    said = []
    for kind, text in (
        ("offset", "A constant offset of {joints} cannot show."),
        ("gain", "A gain of {joints} cannot show: it hardly moved, or what was fitted took it in."),
        ("backlash", "Backlash of {joints} cannot show: it moved one way only."),
    ):
        seen = own[(own["kind"] == kind) & own["detectable"].notna()]["joint"].astype(int).tolist()
        missing = [joint for joint in every if joint not in seen]
        if missing:
            said.append(text.format(joints=joint_names(missing)))
    return tuple(said)


def _joint_table(own: pd.DataFrame) -> Table:
    rows = []
    for joint in sorted(own["joint"].astype(int).unique().tolist()):
        entries = own[own["joint"] == joint]
        cells = [_format_cell(_column_entries(entries, column)) for column, _ in COLUMNS]
        rows.append(row(f"q{joint}", *cells))
    return Table(
        "The smallest fault of each joint that would be listed / told from every other.",
        "l" + "r" * len(COLUMNS),
        ("Joint", *(head for _, head in COLUMNS)),
        tuple(rows),
        (TABLE_NOTE, FAULT_NOTE),
    )


def _column_entries(entries: pd.DataFrame, column: str) -> pd.DataFrame:
    """Rows that a column stands for; in percent where it says so."""
    if column in ("once", "waves"):
        waves = entries[entries["kind"] == "eccentricity"]
        return waves[(waves["per_turn"] == 1) == (column == "once")]
    chosen = entries[entries["kind"] == column]
    if column == "gain":
        return chosen.assign(detectable=chosen["detectable"] * 100,
                             separable=chosen["separable"] * 100)  # fmt: skip
    return chosen


def _format_cell(entries: pd.DataFrame) -> str:
    """`listed / told`, the least favourable of several."""
    if entries.empty or not finite(entries["detectable"].max()):
        return DASH
    told = entries["separable"].max(skipna=False)
    return f"{significant(entries['detectable'].max())} / {significant(told)}"


def _other_table(entries: pd.DataFrame) -> Table:
    rows = []
    for entry in entries.to_dict("records"):
        joint = finite(entry["joint"])
        named = {
            "kind": entry["kind"],
            "joint": None if joint is None else math.floor(joint),
            "parameter": entry["parameter"] if isinstance(entry["parameter"], str) else None,
        }
        what = causes.cause_name(named)
        if joint is None and named["parameter"] is not None:
            what = f"{what}, {named['parameter']}"
        rows.append(row(
            what,
            significant(entry["detectable"]),
            significant(entry["separable"]),
            formatting.lookup_label(formatting.UNITS, entry["unit"]),
        ))  # fmt: skip
    return Table(
        "The smallest common fault and link error that would be listed / told from every other.",
        "lrrl",
        ("Fault", "Listed", "Told apart", "Unit"),
        tuple(rows),
        ("Base and LED body: moved along or turned about one axis alone.",),
    )
