"""What a fleet report says: which joint of which arm changed, how, since when; the evidence."""

from collections.abc import Callable
from typing import Any

from reports.document import blocks as doc
from reports.document import formatting as fmt
from reports.document.charts import records
from reports.fleet import charts as fleet_charts
from reports.fleet import evidence
from reports.fleet.charts import charts
from reports.results import Results

MAX_NAMED_SESSIONS = 4  # in the headline
STATE_NOTE = (
    "State: what the sessions show of a change over time. Error now: level of the mean error at "
    "the last session, reading less truth, with its expanded uncertainty (k = 2), the share of "
    "the calibration included. Trend: slope at the last session, what the calibration shares left "
    "out. Scatter: how many times farther apart sessions lie than their own uncertainties say; "
    "where that is more than 1, all limits are as much wider."
)
CHANGE_NOTE = (
    "A step is dated to the first session after it, with the session before; a drift to the "
    "session from which on it goes. The range holds the true date with 99 %. Told by: how much "
    "better this kind of change fits than the other (ΔBIC; below 10 the kind is not named)."
)


def document(results: Results) -> doc.Document:
    """Lay out the whole report."""
    sections: tuple[Callable[[Results], doc.Section | None], ...] = (
        state,
        joints,
        changes,
        charts,
        evidence.contrasts,
        evidence.worst_sessions,
        evidence.hidden_errors,
        evidence.failures,
        evidence.method,
    )
    held, arms = results.summary.get("sessions") or {}, len(results.summary.get("arms") or [])
    period = f", {held['first']} to {held['last']}" if held.get("first") else ""
    return doc.lay_out(
        title=f"Fleet report: {'1 arm' if arms == 1 else f'{fmt.count(arms)} arms'}",
        subtitle=f"{fmt.count(held.get('measured'))} sessions{period}",
        footer=f"{doc.software(results.summary)} · fleet report",
        sections=(s for make in sections if (s := make(results)) is not None),
        sortable=True,
    )


def state(results: Results) -> doc.Section:
    """Open with what changed, then the facts at a glance."""
    summary = results.summary
    held = summary.get("sessions") or {}
    verdicts = summary.get("verdicts") or {}
    pairs = (fmt.count(held.get(f"pairs_{name}")) for name in ("measured", "recorded"))
    items = [
        (
            "Arms",
            fmt.join_words([fmt.text_or_dash(arm) for arm in summary.get("arms") or []][:8])
            or fmt.DASH,
        ),
        ("Sessions measured", fmt.count(held.get("measured"))),
        ("Sessions that failed", fmt.count(held.get("failed"))),
        (
            "From, to",
            f"{fmt.text_or_dash(held.get('first'))}, {fmt.text_or_dash(held.get('last'))}",
        ),
        ("Stereo pairs", " measured of ".join(pairs)),
    ]
    if verdicts:
        counts = [f"{fmt.count(n)} {fleet_charts.VERDICTS.get(v, v)}" for v, n in verdicts.items()]
        items.append(("Verdicts of the sessions", fmt.join_words(counts)))
    return doc.Section(
        "verdict", "State of the fleet", (_headline(results), doc.Facts(tuple(items)))
    )


def _headline(results: Results) -> doc.Verdict:
    table, found = results.table("joints"), results.table("changes")
    judged = int((table["state"] != "unknown").sum()) if len(table) else 0
    remark = fleet_charts.false_alarm_text(results.summary)
    failing = nonconforming_sessions(results)
    if not judged:
        fewest = fmt.count(results.summary.get("fewest_sessions"))
        sentence = (
            f"No joint has {fewest} dated sessions with a figure: nothing can be said of changes."
        )
        young = doc.Verdict("undecided", "Nothing to follow over time", sentence)
        return _failing(results, failing, (sentence,)) if failing else young
    if not len(found):
        sentence = f"None of the {fmt.count(judged)} joints that can be followed changed over time."
        if failing:
            return _failing(results, failing, (sentence, remark))
        return doc.Verdict("conform", "No change", sentence, (remark,))
    accused = found.drop_duplicates(["arm", "joint"])
    others = judged - len(accused)
    label = f"{fmt.count(len(accused))} of {fmt.count(judged)} joints changed"
    sentences = [fleet_charts.change_text(one) for one in records(found)[:4]]
    if len(found) > 4:
        sentences.append(f"{fmt.count(len(found) - 4)} further changes are listed below")
    rest = f" The other {fmt.count(others)} joints show no change." if others else ""
    sentence = f"{fmt.capitalise('; '.join(sentences))}.{rest}"
    remarks = (f"Beyond their tolerance: {_list_few(failing)}.", remark) if failing else (remark,)
    return doc.Verdict("nonconform", label, sentence, remarks)


def nonconforming_sessions(results: Results) -> list[str]:
    """Say of each session that does not conform which joint is off most, and by how much."""
    lines = []
    for one in records(results.table("worst")):
        error = fmt.finite(one.get("worst_error_deg"))
        if one.get("verdict") == "nonconform" and error is not None:
            way = "high" if error > 0 else "low"
            u = fmt.finite(one.get("worst_error_u_deg"))
            amount = fmt.with_uncertainty(abs(error), None if u is None else 2 * u, "°", False)
            joint = fmt.text_or_dash(one.get("joint"))
            name = fmt.text_or_dash(one.get("session"))
            lines.append(f"{name}: joint {joint} reads up to {amount} too {way}")
    return lines


def _failing(results: Results, failing: list[str], remarks: tuple[str, ...]) -> doc.Verdict:
    """The headline where nothing is said of changes, and sessions do not conform."""
    count = int((results.summary.get("verdicts") or {}).get("nonconform") or 0)
    measured = fmt.count((results.summary.get("sessions") or {}).get("measured"))
    verb = "does" if count == 1 else "do"
    label = f"{fmt.count(count)} of {measured} sessions {verb} not conform"
    return doc.Verdict("nonconform", label, f"{_list_few(failing)}.", remarks)


def _list_few(lines: list[str]) -> str:
    more = len(lines) - MAX_NAMED_SESSIONS
    rest = f"; {fmt.count(more)} more are listed below" if more > 0 else ""
    return "; ".join(lines[:MAX_NAMED_SESSIONS]) + rest


def joints(results: Results) -> doc.Section:
    """A row a joint: state, trend, error now."""
    order = {"several": 0, "drift": 1, "step": 1, "change": 1, "steady": 2, "unknown": 3}
    entries = sorted(
        records(results.table("joints")),
        key=lambda e: (order.get(str(e["state"]), 2), str(e["arm"]), int(e["joint"])),
    )
    columns = (
        doc.Column("Arm", "l", doc.field("arm")),
        doc.Column("Joint", "l", doc.field("joint", str)),
        doc.Column("State", "l", _state),
        doc.Column("Error now [°]", "r", doc.uncertain_field("error_deg", "error_u_deg", k=2)),
        doc.Column("Trend [°/month]", "r", _trend),
        doc.Column("Sessions", "r", doc.field("sessions", fmt.count)),
        doc.Column("Odd ones", "r", doc.field("odd_sessions", fmt.count)),
        doc.Column("Scatter", "r", doc.field("excess", fmt.number, 1)),
        doc.Column("Conform / undecided / not", "r", _verdict_counts),
    )
    table = doc.tabulate("Arms and joints, those that changed first.", columns, entries, STATE_NOTE)
    return doc.Section("joints", "Arms and joints", (table,))


def _state(one: dict[str, Any]) -> doc.Cell:
    state = str(one["state"])
    worse = ", getting worse" if one.get("worse") is True else ""
    words = fleet_charts.STATES.get(state, state)
    return doc.Cell(f"{words}{worse}", fleet_charts.TONES.get(state, ""))


def _trend(one: dict[str, Any]) -> str:
    u = fmt.finite(one.get("trend_u_deg_per_month"))
    return fmt.with_uncertainty(one.get("trend_deg_per_month"), 2 * u) if u else fmt.DASH


def _verdict_counts(one: dict[str, Any]) -> str:
    counts = [one["conform"], one["undecided"], one["nonconform"]]
    return " / ".join(fmt.count(n) for n in counts) if any(counts) else fmt.DASH


def changes(results: Results) -> doc.Section:
    """Every change with its date, size and how surely its kind is told."""
    found = records(results.table("changes"))
    if not found:
        text = "No change was found beyond what chance brings about."
        return doc.Section("changes", "Changes", (doc.Bullets((text,)),))
    columns = (
        doc.Column("Arm", "l", doc.field("arm")),
        doc.Column("Joint", "l", doc.field("joint", str)),
        doc.Column(
            "Kind", "l", lambda one: fleet_charts.KINDS.get(str(one["kind"]), str(one["kind"]))
        ),
        doc.Column("Date", "l", fleet_charts.change_date, wide=True),
        doc.Column("Session", "l", doc.field("session"), wide=True),
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
