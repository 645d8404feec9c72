"""What a fleet report says: which joint of which arm changed, how, since when; the evidence."""

from typing import Any

from reports.document import blocks as doc
from reports.document import formatting as fmt
from reports.document.charts import records
from reports.fleet import charts as fleet_charts
from reports.fleet import evidence, names
from reports.fleet.certificate import (
    certificate,
    change_text,
    counted,
    judged_joints,
    present_error,
    verdict_counts,
)
from reports.fleet.charts import charts
from reports.results import Results
from reports.session import phrases

STATE_NOTE = (
    "State: what the sessions show of a change over time. Error now: level of the mean error at "
    "the last session, reading less truth, with its expanded uncertainty (k = 2), the share of "
    "the calibration included; of a joint with too few sessions, the latest error. Trend: slope "
    "at the last session, what the calibration shares left out. Scatter: how many times farther "
    "apart sessions lie than their own uncertainties say; where that is more than 1, all limits "
    "are as much wider."
)
CHANGE_NOTE = (
    "A step is dated to the first session after it, with the session before; a drift to the "
    "session from which on it goes. The range holds the true date with 99 %. Told by: how much "
    "better this kind of change fits than the other (ΔBIC; below 10 the kind is not named)."
)


def document(results: Results) -> doc.Document:
    """Lay out the whole report."""
    held, arms = results.summary.get("sessions") or {}, len(results.summary.get("arms") or [])
    ends = dict.fromkeys([held.get("first"), held.get("last")])  # a single day is named once
    period = f", {' to '.join(map(str, ends))}" if held.get("first") else ""
    evidence_sections = (
        joints,
        changes,
        charts,
        evidence.worst_sessions,
        evidence.hidden_errors,
        evidence.failures,
        evidence.method,
    )
    page, *appendix = doc.answer_and_evidence(results, certificate, evidence_sections)
    asked = evidence.contrasts(results)
    return doc.lay_out(
        title=f"Fleet report: {'1 arm' if arms == 1 else f'{fmt.count(arms)} arms'}",
        subtitle=f"{counted(int(held.get('measured') or 0), 'session')}{period}",
        footer=f"{doc.software(results.summary)} · fleet report",
        sections=(page, *([asked] if asked else []), *appendix),
        sortable=True,
    )


def joints(results: Results) -> doc.Section:
    """A row a joint: state, trend, error now."""
    order = {"several": 0, "drift": 1, "step": 1, "change": 1, "unclear": 2, "scattered": 2,
             "steady": 3, "unknown": 4}  # fmt: skip
    entries = sorted(
        records(results.table("joints")),
        key=lambda e: (order.get(str(e["state"]), 3), str(e["arm"]), int(e["joint"])),
    )
    if not judged_joints(results):
        return doc.Section("joints", "Arms and joints", (_latest_table(results, entries),))
    columns = (
        doc.Column("Arm", "l", doc.field("arm")),
        doc.Column("Joint", "l", doc.field("joint", str)),
        doc.Column("State", "l", _state),
        doc.Column("Error now [°]", "r", lambda e: fmt.with_uncertainty(*present_error(e))),
        doc.Column("Trend [°/month]", "r", _trend),
        doc.Column("Sessions", "r", doc.field("sessions", fmt.count)),
        doc.Column("Odd ones", "r", doc.field("odd_sessions", fmt.count)),
        doc.Column("Scatter", "r", doc.field("excess", fmt.number, 1)),
        doc.Column("Conform / undecided / not", "r", verdict_counts),
    )
    table = doc.tabulate("Arms and joints, those that changed first.", columns, entries, STATE_NOTE)
    return doc.Section("joints", "Arms and joints", (table,))


def _latest_table(results: Results, entries: list[dict[str, Any]]) -> doc.Table:
    """The latest error of each joint: what there is below the sessions that a trend needs."""
    shorten = names.shortener(results)
    columns = (
        doc.Column("Arm", "l", doc.field("arm")),
        doc.Column("Joint", "l", doc.field("joint", str)),
        doc.Column("Latest error ± U [°]", "r", lambda e: fmt.with_uncertainty(*present_error(e))),
        doc.Column(
            "Tolerance [°]", "r", lambda e: phrases.tolerance(e.get("latest_tolerance_deg"))
        ),
        doc.Column(
            "Verdict", "l", lambda e: phrases.verdict_cell({"verdict": e.get("latest_verdict")})
        ),
        doc.Column("Session", "l", lambda e: shorten(e.get("latest_session")), wide=True),
        doc.Column("Date", "l", doc.field("latest_started")),
        doc.Column("Sessions", "r", doc.field("sessions", fmt.count)),
    )
    factors = fmt.coverage_text(*(one.get("latest_coverage_factor") for one in entries))
    caption = f"Mean error of each joint in its latest session, {factors}."
    return doc.tabulate(caption, columns, entries)


def _state(one: dict[str, Any]) -> doc.Cell:
    state = str(one["state"])
    worse = ", getting worse" if one.get("worse") is True else ""
    words = fleet_charts.STATES.get(state, state)
    if state == "scattered":
        words = f"scatter {fmt.number(one.get('excess'), 1)} times what is stated: not explained"
    return doc.Cell(f"{words}{worse}", fleet_charts.TONES.get(state, ""))


def _trend(one: dict[str, Any]) -> str:
    u = fmt.finite(one.get("trend_u_deg_per_month"))
    return fmt.with_uncertainty(one.get("trend_deg_per_month"), 2 * u) if u else fmt.DASH


def changes(results: Results) -> doc.Section:
    """Every change with its date, size and how surely its kind is told."""
    found = records(results.table("changes"))
    if not found:
        return doc.Section("changes", "Changes", (doc.Paragraph(change_text(results)),))
    shorten = names.shortener(results)
    columns = (
        doc.Column("Arm", "l", doc.field("arm")),
        doc.Column("Joint", "l", doc.field("joint", str)),
        doc.Column(
            "Kind", "l", lambda one: fleet_charts.KINDS.get(str(one["kind"]), str(one["kind"]))
        ),
        doc.Column("Date", "l", fleet_charts.change_date, wide=True),
        doc.Column("Session", "l", lambda one: shorten(one["session"]), wide=True),
        doc.Column("Size ± U", "r", _change_size),
        doc.Column("Range of the date", "l", _date_range),
        doc.Column("Told by", "l", doc.field("clearer_by", fmt.significant)),
    )
    blocks: list[doc.Block] = [
        doc.tabulate("Changes, in order of arm and joint.", columns, found, CHANGE_NOTE)
    ]
    if any(one["recalibrated"] is True for one in found):
        text = (
            "A step that falls on a new calibration may be the calibration's: it counts as found "
            "only because it is beyond what rig and marker state as their uncertainty. Where they "
            "state none, measure again with the old calibration."
        )
        blocks.append(doc.Bullets((text,), "warning"))
    return doc.Section("changes", "Changes", tuple(blocks))


def _change_size(one: dict[str, Any]) -> str:
    unit = "°" if one["unit"] == "deg" else "°/month"
    return f"{fmt.with_uncertainty(one['size'], 2 * float(one['size_u']))}{unit}"


def _date_range(one: dict[str, Any]) -> str:
    first, last = (fleet_charts.format_day(one[f"{end}_t_days"]) for end in ("earliest", "latest"))
    return f"{first} to {last}"
