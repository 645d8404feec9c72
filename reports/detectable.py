"""What this session could have seen: the smallest fault of each kind, a joint and a kind."""

import math

import pandas as pd

from reports import words
from reports.blocks import Block, Bullets, Paragraph, Section, Table, row
from reports.formatting import DASH, finite, joints, significant
from reports.results import Results

COLUMNS = (
    ("offset", "Offset [°]"),
    ("gain", "Gain [%]"),
    ("backlash", "Backlash [°]"),
    ("once", "Eccentricity [°]"),
    ("waves", "Waves [°]"),
    ("compliance", "Compliance [°/m]"),
    ("drift", "Drift [°/h]"),
)
WHAT = (
    "Each entry: the smallest fault that the diagnosis would list, / the smallest that it would "
    "also tell from every other fault it knows (in four of five such sessions, all faults tried "
    "at once; so a little more than the size at which one offset alone is noticed). "
    "A dash: none, or not tried with this motion."
)
SHAPES = (
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
    hidden = _hidden(own)
    blocks: tuple[Block, ...] = (
        Bullets(hidden)
        if hidden
        else Paragraph("An offset, a gain and backlash of every joint could have shown."),
        _of_joints(own[own["kind"] != "dh"]),
        _of_others(pd.concat([common, own[own["kind"] == "dh"]])),
    )
    return Section("detectable", "What could be seen", blocks)


def _hidden(own: pd.DataFrame) -> tuple[str, ...]:
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
            said.append(text.format(joints=joints(missing)))
    return tuple(said)


def _of_joints(own: pd.DataFrame) -> Table:
    rows = []
    for joint in sorted(own["joint"].astype(int).unique().tolist()):
        entries = own[own["joint"] == joint]
        cells = [_cell(_chosen(entries, column)) for column, _ in COLUMNS]
        rows.append(row(f"q{joint}", *cells))
    return Table(
        "The smallest fault of each joint that would be listed / told from every other.",
        "l" + "r" * len(COLUMNS),
        ("Joint", *(head for _, head in COLUMNS)),
        tuple(rows),
        (WHAT, SHAPES),
    )


def _chosen(entries: pd.DataFrame, column: str) -> pd.DataFrame:
    """Rows that a column stands for; in percent where it says so."""
    if column in ("once", "waves"):
        waves = entries[entries["kind"] == "eccentricity"]
        return waves[(waves["per_turn"] == 1) == (column == "once")]
    chosen = entries[entries["kind"] == column]
    if column == "gain":
        return chosen.assign(detectable=chosen["detectable"] * 100,
                             separable=chosen["separable"] * 100)  # fmt: skip
    return chosen


def _cell(entries: pd.DataFrame) -> str:
    """`listed / told`, the least favourable of several."""
    if entries.empty or not finite(entries["detectable"].max()):
        return DASH
    told = entries["separable"].max(skipna=False)
    return f"{significant(entries['detectable'].max())} / {significant(told)}"


def _of_others(entries: pd.DataFrame) -> Table:
    rows = []
    for entry in entries.to_dict("records"):
        joint = finite(entry["joint"])
        named = {
            "kind": entry["kind"],
            "joint": None if joint is None else math.floor(joint),
            "parameter": entry["parameter"] if isinstance(entry["parameter"], str) else None,
        }
        what = words.cause(named)
        if joint is None and named["parameter"] is not None:
            what = f"{what}, {named['parameter']}"
        rows.append(row(
            what,
            significant(entry["detectable"]),
            significant(entry["separable"]),
            words.said(words.UNITS, entry["unit"]),
        ))  # fmt: skip
    return Table(
        "The smallest common fault and link error that would be listed / told from every other.",
        "lrrl",
        ("Fault", "Listed", "Told apart", "Unit"),
        tuple(rows),
        ("Base and LED body: moved along or turned about one axis alone.",),
    )
