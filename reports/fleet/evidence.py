"""The second half of a fleet report: comparisons, worst sessions, what was not seen, failures."""

from dataclasses import replace
from functools import partial
from typing import Any

import pandas as pd

from reports.document import blocks as doc
from reports.document import formatting as fmt
from reports.document.charts import records
from reports.fleet import names
from reports.fleet.certificate import is_hidden, session_table
from reports.fleet.charts import STATES
from reports.results import Results

FALSE_ALARM_NOTE = (
    "Rates: a change is named beyond what chance gives the best of all dates, kinds and joints in "
    "{rate} % of fleets without one (Bonferroni); likewise an odd session, and a difference."
)
CONTRAST_NOTE = (
    "Mean error with the number of sessions in brackets, and the difference with its expanded "
    "uncertainty (k = 2); the part of a calibration's error that both sides share cancels. "
    "A difference counts as shown beyond what chance gives all joints together."
)
LARGEST_NOTE = (
    "The resolved error of largest magnitude in each session, of the joints with the session's "
    "verdict where any have it, with its expanded uncertainty."
)
UNREPORTED_NOTE = (
    "Sessions have no reports of their own yet: run the same command with --reports; nothing is "
    "measured again for it. sessions.parquet says in which folder the results of each lie "
    "(kept_in)."
)
VISIBLE_NOTE = (
    "Visible: share of an offset's signal that is left after the fit. Old: the offset was there at "
    "registration; new: it arose later. Detectable: the "
    "smallest offset that one session detects; separable: the smallest that it attributes to "
    "this joint alone. A dash: not known."
)
METHOD_PARAGRAPHS = tuple(
    " ".join(sentences)
    for sentences in (
        (
            "The unit is the session: its mean error of a joint, with the part of its uncertainty",
            "that is independent in every session (pixels, readings, clock) apart from the part",
            "that sessions of one calibration share (rig, registration, marker). A new",
            "calibration may shift all that follows by as much as it states.",
        ),
        (
            "Where sessions scatter more than that, by the median of how far each lies from the",
            "line through those before and after, their uncertainties grow by that factor, and",
            "Student's distribution allows for its being estimated. A change, an odd session or a",
            "difference counts if it is also beyond chance by the scatter that it leaves (F or t",
            "test). What is more than stated and not beyond that is change or scatter: undecided.",
        ),
        (
            "Level: a constant, steps, and drifts that begin at sessions, by generalised least",
            "squares, with at least three sessions on either side of a change.",
        ),
        ("Sessions that stand apart from those before and after are marked, and left out of it.",),
        (
            "Assumed: these parts are independent from one session to the next. A change of",
            "conditions (load, warm-up, poses) that moves a joint's error counts as a change.",
        ),
    )
)


def contrasts(results: Results) -> doc.Section | None:
    """Before and after, or one folder against another, where that was asked."""
    table = results.table("contrasts")
    table = table[table["question"].isin(["since", "compare"])]
    if not (results.summary.get("since") or results.summary.get("compare")):
        return None
    title = "Before and after" if results.summary.get("since") else "Two folders"
    if not len(table):
        text = "No joint of one arm has dated sessions with a figure on both sides."
        return doc.Section("contrasts", title, (doc.Paragraph(text, "note"),))
    blocks: list[doc.Block] = []
    for (first, second), rows in table.groupby(["first", "second"], sort=False):
        blocks.append(_contrast_table(str(first), str(second), records(rows)))
    return doc.Section("contrasts", title, tuple(blocks))


def _contrast_table(first: str, second: str, entries: list[dict[str, Any]]) -> doc.Table:
    columns = (
        doc.Column("Arm", "l", doc.field("arm")),
        doc.Column("Joint", "l", doc.field("joint", str)),
        doc.Column(f"{_side(first)} [°]", "r", partial(_mean_and_sessions, "first")),
        doc.Column(f"{_side(second)} [°]", "r", partial(_mean_and_sessions, "second")),
        doc.Column(
            "Difference ± U [°]",
            "r",
            doc.uncertain_field("difference_deg", "difference_u_deg", k=2),
        ),
        doc.Column("Result", "l", _contrast_result),
    )
    title = (
        f"Mean errors: {fmt.text_or_dash(first)}, {fmt.text_or_dash(second)}, and the difference."
    )
    return doc.tabulate(
        title, columns, sorted(entries, key=lambda e: not e["shown"]), CONTRAST_NOTE
    )


def _side(name: str) -> str:
    """A side as the head of a column: of a folder its own name."""
    return fmt.text_or_dash(name.rstrip("/").rpartition("/")[2])


def _mean_and_sessions(side: str, entry: dict[str, Any]) -> str:
    return f"{fmt.number(entry[f'{side}_deg'])} ({fmt.count(entry[f'{side}_sessions'])})"


def _contrast_result(entry: dict[str, Any]) -> doc.Cell:
    since = entry["question"] == "since"
    if entry["shown"] is True:
        return doc.Cell("changed" if since else "differs", "nonconform")
    what = "change" if since else "difference"
    if entry.get("unclear") is True:
        return doc.Cell(f"{what} or scatter: too few sessions", "undecided")
    return doc.Cell(f"no {what} shown", "conform")


def worst_sessions(results: Results) -> doc.Section | None:
    """The sessions with the largest errors, with links to their own reports."""
    listed = results.table("worst")
    tables = session_table(results, len(listed))
    if not tables:
        return None
    notes = (LARGEST_NOTE,) if listed["reported"].any() else (LARGEST_NOTE, UNREPORTED_NOTE)
    return doc.Section("worst", "Worst sessions", (replace(tables[0], notes=notes),))


def hidden_errors(results: Results) -> doc.Section:
    """What the fleet's sessions could not show, joint by joint."""
    table = results.table("joints")
    columns = (
        doc.Column("Arm", "l", doc.field("arm")),
        doc.Column("Joint", "l", doc.field("joint", str)),
        doc.Column("Sessions without a figure", "r", _sessions_without_figure),
        doc.Column("Visible, old offset", "r", doc.field("visible", fmt.percent)),
        doc.Column("Visible, new offset", "r", doc.field("visible_since", fmt.percent)),
        doc.Column("Detectable [°]", "r", doc.field("detectable_deg", fmt.significant)),
        doc.Column("Separable [°]", "r", doc.field("separable_deg", fmt.significant)),
    )
    title = "What the sessions of each joint could show: medians over its sessions."
    shown = doc.tabulate(title, columns, records(table), VISIBLE_NOTE)
    return doc.Section(
        "unseen", "What was not determined", (*_hidden_blocks(results, table), shown)
    )


def _sessions_without_figure(one: dict[str, Any]) -> str:
    without = one["without_figure"]
    return f"{fmt.count(without)} of {fmt.count(without + one['sessions'])}"


def _hidden_blocks(results: Results, table: pd.DataFrame) -> tuple[doc.Block, ...]:
    sentences = []
    for arm, rows in table.groupby("arm", sort=False):
        entries = records(rows)
        blind = [one["joint"] for one in entries if is_hidden(one["visible"])]
        if blind:
            sentences.append(
                f"{fmt.text_or_dash(arm)}: an offset of {fmt.joint_names(blind)} that was there at "
                "registration shows in none of the usual sessions, however large."
            )
        short = [one["joint"] for one in entries if one["state"] == "unknown"]
        if short:
            fewest = fmt.count(results.summary.get("fewest_sessions"))
            sentences.append(
                f"{fmt.text_or_dash(arm)}: {fmt.joint_names(short)}: {STATES['unknown']} to follow "
                f"over time (at least {fewest} dated ones with a figure)."
            )
    undated = int((results.summary.get("sessions") or {}).get("undated") or 0)
    if undated:
        sentences.append(
            f"{fmt.count(undated)} sessions say no start (`started` in session.toml): they are in "
            "the tables, and in no chart."
        )
    return (doc.Bullets(tuple(sentences), "warning"),) if sentences else ()


def failures(results: Results) -> doc.Section | None:
    """Sessions that could not be measured, and why."""
    table = results.table("failures")
    if not len(table):
        return None
    shorten = names.shortener(results)
    columns = (
        doc.Column("Session", "l", lambda one: shorten(one["session"]), wide=True),
        doc.Column("Kind", "l", doc.field("kind")),
        doc.Column("Why", "l", doc.field("why"), wide=True),
    )
    note = "failures.csv holds the same. They are tried again when the batch is started again."
    title = "Sessions that could not be measured, or are copies."
    shown = doc.tabulate(title, columns, records(table), note)
    return doc.Section("failures", "Failures", (shown,))


def method(results: Results) -> doc.Section:
    """How changes are found, and what is assumed."""
    summary = results.summary
    share = fmt.finite(summary.get("false_alarm"))
    rate = fmt.DASH if share is None else fmt.exact_number(100 * share)
    by = {"robot": "the robot that session.toml names, and its serial number where several are",
          "folder": "that robot and the folder that holds the session"}  # fmt: skip
    grouping = by.get(str(summary.get("by")), fmt.text_or_dash(summary.get("by")))
    items = (
        f"Arms are distinguished by {grouping}.",
        *METHOD_PARAGRAPHS,
        FALSE_ALARM_NOTE.format(rate=rate),
    )
    return doc.Section("method", "How changes are found", (doc.Bullets(items),))
