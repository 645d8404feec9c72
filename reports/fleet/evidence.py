"""The second half of a fleet report: comparisons, worst sessions, what was not seen, failures."""

from typing import Any

import pandas as pd

from reports.document import formatting
from reports.document.blocks import Block, Bullets, Cell, Paragraph, Section, Table, row
from reports.document.charts import records
from reports.document.formatting import (
    DASH,
    count,
    exact_number,
    finite,
    joint_names,
    number,
    percent,
    quantity,
    text_or_dash,
    with_uncertainty,
)
from reports.fleet.charts import STATES
from reports.results import Results
from reports.session import phrases

MAX_HIDDEN_SHARE = 0.005  # share of an offset below which nothing of it is seen


FALSE_ALARM_NOTE = (
    "Rates: a change is named beyond what chance gives the best of all dates, kinds and joints in "
    "{rate} % of fleets without one (Bonferroni); likewise an odd session, and a difference."
)
METHOD_PARAGRAPHS = tuple(
    " ".join(sentences)
    for sentences in (
        (
            "The unit is the session: its mean error of a joint, with the part of its uncertainty",
            "that every session draws anew (pixels, readings, clock) apart from the part that",
            "sessions of one calibration share (rig, registration, marker). A new calibration may",
            "shift all that follows by as much as it states.",
        ),
        (
            "Where sessions scatter more than that, by the median of what neighbours in time",
            "differ, their uncertainties grow by that factor, and Student's distribution allows",
            "for its being estimated.",
        ),
        (
            "Level: a constant, steps, and drifts that begin at sessions, by generalised least",
            "squares, with at least three sessions on either side of a change.",
        ),
        ("Sessions that stand apart from those before and after are marked, and left out of it.",),
        (
            "Assumed: what sessions draw anew is independent from one to the next. A change of",
            "conditions (load, warm-up, poses) that moves a joint's error counts as a change.",
        ),
    )
)


def contrasts(results: Results) -> Section | None:
    """Before and after, or one folder against another, where that was asked."""
    table = results.table("contrasts")
    asked = results.summary.get("since"), results.summary.get("compare")
    if not any(asked):
        return None
    if not len(table):
        text = "No joint has dated sessions with a figure on both sides."
        return Section("contrasts", "Before and after", (Paragraph(text, "note"),))
    blocks: list[Block] = []
    for (first, second), rows in table.groupby(["first", "second"], sort=False):
        blocks.append(_contrast_table(str(first), str(second), records(rows)))
    return Section("contrasts", "Before and after", tuple(blocks))


def _contrast_table(first: str, second: str, entries: list[dict[str, Any]]) -> Table:
    rows = []
    for one in sorted(entries, key=lambda e: not e["shown"]):
        shown = one["shown"] is True
        rows.append(
            row(
                text_or_dash(one["arm"]),
                str(one["joint"]),
                f"{number(one['first_deg'])} ({count(one['first_sessions'])})",
                f"{number(one['second_deg'])} ({count(one['second_sessions'])})",
                with_uncertainty(one["difference_deg"], 2 * float(one["difference_u_deg"])),
                Cell("changed", "nonconform") if shown else Cell("no change shown", "conform"),
            )
        )
    note = (
        "Mean error with the number of sessions in brackets, and the difference with its expanded "
        "uncertainty (k = 2); what both sides share of a calibration's error drops out of it. "
        "A difference counts as shown beyond what chance gives all joints together."
    )
    return Table(
        f"Mean errors: {text_or_dash(first)}, {text_or_dash(second)}, and the difference.",
        "llrrrl",
        ("Arm", "Joint", "First [°]", "Second [°]", "Difference ± U [°]", "Result"),
        tuple(rows),
        (note,),
    )


def worst_sessions(results: Results) -> Section | None:
    """The sessions with the largest errors, with links to their own reports."""
    table = results.table("worst")
    if not len(table):
        return None
    rows = []
    for one in records(table):
        tone = phrases.tone(one["verdict"])
        place = f"{one['kept_in']}/report.html"
        u = finite(one["worst_error_u_deg"])
        rows.append(
            row(
                Cell(text_or_dash(one["session"]), link=place if one["reported"] is True else ""),
                text_or_dash(one["started"]),
                text_or_dash(one["arm"]),
                str(one["joint"]),
                with_uncertainty(one["worst_error_deg"], None if u is None else 2 * u),
                Cell(
                    formatting.lookup_label(phrases.VERDICTS, one["verdict"]),
                    tone if tone != "none" else "",
                ),
                text_or_dash(one["kept_in"]),
            )
        )
    notes = [
        "The resolved error of largest magnitude in each session, with its expanded uncertainty."
    ]
    if not table["reported"].any():
        notes.append(
            "Sessions have no reports of their own yet: run the same command with --reports; "
            "nothing is measured again for it."
        )
    shown = Table(
        "Sessions with the largest errors.",
        "lllrrll",
        ("Session", "Started", "Arm", "Joint", "Largest error ± U [°]", "Verdict", "Kept in"),
        tuple(rows),
        tuple(notes),
        wide=(0, 6),
    )
    return Section("worst", "Worst sessions", (shown,))


def hidden_errors(results: Results) -> Section:
    """What the fleet's sessions could not show, joint by joint."""
    table = results.table("joints")
    rows = [
        row(
            text_or_dash(one["arm"]),
            str(one["joint"]),
            f"{count(one['without_figure'])} of {count(one['without_figure'] + one['sessions'])}",
            percent(one["visible"]),
            percent(one["visible_since"]),
            quantity(one["detectable_deg"], ""),
            quantity(one["separable_deg"], ""),
        )
        for one in records(table)
    ]
    shown = Table(
        "What the sessions of each joint could show: medians over its sessions.",
        "llrrrrr",
        ("Arm", "Joint", "Sessions without a figure", "Visible at registration", "Visible since",
         "Detectable [°]", "Separable [°]"),
        tuple(rows),
        (
            ("Visible: share of an offset's signal left after all that was fitted, for an offset "
            "that was there before the registration and for one that arose since. Detectable: the "
            "smallest offset that one session would notice; separable: that it would tell from an "
            "offset of another joint. A dash: not known."),
        ),
    )  # fmt: skip
    return Section("unseen", "What could not be seen", (*_hidden_blocks(results, table), shown))


def _hidden_blocks(results: Results, table: pd.DataFrame) -> tuple[Block, ...]:
    said = []
    for arm, rows in table.groupby("arm", sort=False):
        entries = records(rows)
        blind = [one["joint"] for one in entries if _is_hidden(one["visible"])]
        if blind:
            said.append(
                f"{text_or_dash(arm)}: an offset of {joint_names(blind)} that was there at "
                "registration shows in none of the usual sessions, however large."
            )
        short = [one["joint"] for one in entries if one["state"] == "unknown"]
        if short:
            fewest = count(results.summary.get("fewest_sessions"))
            said.append(
                f"{text_or_dash(arm)}: {joint_names(short)}: {STATES['unknown']} to follow over "
                f"time (at least {fewest} dated ones with a figure)."
            )
    undated = int((results.summary.get("sessions") or {}).get("undated") or 0)
    if undated:
        said.append(
            f"{count(undated)} sessions say no start (`started` in session.toml): they are in the "
            "tables, and in no chart."
        )
    return (Bullets(tuple(said), "warning"),) if said else ()


def _is_hidden(share: Any) -> bool:
    known = finite(share)
    return known is not None and known < MAX_HIDDEN_SHARE


def failures(results: Results) -> Section | None:
    """Sessions that could not be measured, and why."""
    table = results.table("failures")
    if not len(table):
        return None
    rows = [
        row(text_or_dash(one["session"]), text_or_dash(one["kind"]), text_or_dash(one["why"]))
        for one in records(table)
    ]
    shown = Table(
        "Sessions that could not be measured.",
        "lll",
        ("Session", "Kind", "Why"),
        tuple(rows),
        ("failures.csv holds the same. They are tried again when the batch is started again.",),
        wide=(0, 2),
    )
    return Section("failures", "Failures", (shown,))


def method(results: Results) -> Section:
    """How changes are found, and what is assumed."""
    summary = results.summary
    share = finite(summary.get("false_alarm"))
    rate = DASH if share is None else exact_number(100 * share)
    by = {"robot": "the robot that session.toml names",
          "folder": "that robot and the folder that holds the session"}  # fmt: skip
    grouping = by.get(str(summary.get("by")), text_or_dash(summary.get("by")))
    items = (
        f"Arms are told apart by {grouping}.",
        *METHOD_PARAGRAPHS,
        FALSE_ALARM_NOTE.format(rate=rate),
    )
    return Section("method", "How changes are found", (Bullets(items),))
