"""What a fleet report says: which joint of which arm changed, how, since when; the evidence."""

from collections.abc import Callable
from typing import Any

from reports.document.blocks import (
    Block,
    Bullets,
    Cell,
    Document,
    Facts,
    Section,
    Table,
    Verdict,
    lay_out,
    row,
    software,
)
from reports.document.charts import records
from reports.document.formatting import (
    DASH,
    count,
    finite,
    join_words,
    quantity,
    text_or_dash,
    with_uncertainty,
)
from reports.fleet import charts as fleet_charts
from reports.fleet import evidence
from reports.fleet.charts import charts
from reports.results import Results

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


def document(results: Results) -> Document:
    """Lay out the whole report."""
    sections: tuple[Callable[[Results], Section | None], ...] = (
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
    held = results.summary.get("sessions") or {}
    return lay_out(
        title=f"Fleet report: {_arm_count(results)}",
        subtitle=f"{count(held.get('measured'))} sessions{fleet_charts.format_period(held)}",
        footer=f"{software(results.summary)} · fleet report",
        sections=(s for make in sections if (s := make(results)) is not None),
        sortable=True,
    )


def _arm_count(results: Results) -> str:
    number = len(results.summary.get("arms") or [])
    return "1 arm" if number == 1 else f"{count(number)} arms"


def state(results: Results) -> Section:
    """Open with what changed, then the facts at a glance."""
    summary = results.summary
    held = summary.get("sessions") or {}
    verdicts = summary.get("verdicts") or {}
    items = [
        ("Arms", join_words([text_or_dash(arm) for arm in summary.get("arms") or []][:8]) or DASH),
        ("Sessions measured", count(held.get("measured"))),
        ("Sessions that failed", count(held.get("failed"))),
        ("From, to", f"{text_or_dash(held.get('first'))}, {text_or_dash(held.get('last'))}"),
        (
            "Stereo pairs",
            f"{count(held.get('pairs_measured'))} measured of {count(held.get('pairs_recorded'))}",
        ),
    ]
    if verdicts:
        said = [f"{count(n)} {fleet_charts.VERDICTS.get(v, v)}" for v, n in verdicts.items()]
        items.append(("Verdicts of the sessions", join_words(said)))
    return Section("verdict", "State of the fleet", (_headline(results), Facts(tuple(items))))


def _headline(results: Results) -> Verdict:
    table, found = results.table("joints"), results.table("changes")
    judged = int((table["state"] != "unknown").sum()) if len(table) else 0
    remark = fleet_charts.false_alarm_text(results.summary)
    if not judged:
        sentence = (
            f"No joint has {count(results.summary.get('fewest_sessions'))} dated sessions with a "
            "figure: nothing can be said of changes."
        )
        return Verdict("undecided", "Nothing to follow over time", sentence)
    if not len(found):
        sentence = f"None of the {count(judged)} joints that can be followed changed over time."
        return Verdict("conform", "No change", sentence, (remark,))
    accused = found.drop_duplicates(["arm", "joint"])
    others = judged - len(accused)
    label = f"{count(len(accused))} of {count(judged)} joints changed"
    sentences = [fleet_charts.change_text(one) for one in records(found)[:4]]
    if len(found) > 4:
        sentences.append(f"{count(len(found) - 4)} further changes are listed below")
    rest = f" The other {count(others)} joints show no change." if others else ""
    said = "; ".join(sentences)
    return Verdict("nonconform", label, f"{said[:1].upper()}{said[1:]}.{rest}", (remark,))


def joints(results: Results) -> Section:
    """A row a joint: state, trend, error now."""
    table = results.table("joints")
    order = {"several": 0, "drift": 1, "step": 1, "change": 1, "steady": 2, "unknown": 3}
    entries = sorted(
        records(table),
        key=lambda e: (order.get(str(e["state"]), 2), str(e["arm"]), int(e["joint"])),
    )
    rows = []
    for one in entries:
        state_word = fleet_charts.STATES.get(str(one["state"]), str(one["state"]))
        worse = ", getting worse" if one.get("worse") is True else ""
        u, trend_u = finite(one.get("error_u_deg")), finite(one.get("trend_u_deg_per_month"))
        trend = (
            with_uncertainty(one.get("trend_deg_per_month"), _expanded(trend_u))
            if trend_u
            else DASH
        )
        excess = finite(one.get("excess"))
        rows.append(
            row(
                text_or_dash(one["arm"]),
                str(one["joint"]),
                Cell(f"{state_word}{worse}", fleet_charts.TONES.get(str(one["state"]), "")),
                with_uncertainty(one.get("error_deg"), _expanded(u)),
                trend,
                count(one["sessions"]),
                count(one.get("odd_sessions")),
                DASH if excess is None else f"{excess:.1f}",
                _verdict_counts(one),
            )
        )
    shown = Table(
        "Arms and joints, those that changed first.",
        "lllrrrrrr",
        ("Arm", "Joint", "State", "Error now [°]", "Trend [°/month]", "Sessions", "Odd ones",
         "Scatter", "Conform / undecided / not"),
        tuple(rows),
        (STATE_NOTE,),
    )  # fmt: skip
    return Section("joints", "Arms and joints", (shown,))


def _verdict_counts(one: dict[str, Any]) -> str:
    counts = [one["conform"], one["undecided"], one["nonconform"]]
    return " / ".join(count(n) for n in counts) if any(counts) else DASH


def _expanded(u: float | None) -> float | None:
    return None if u is None else 2 * u


def changes(results: Results) -> Section:
    """Every change with its date, size and how surely its kind is told."""
    found = records(results.table("changes"))
    if not found:
        text = "No change was found beyond what chance brings about."
        return Section("changes", "Changes", (Bullets((text,)),))
    rows = []
    for one in found:
        unit = "°" if one["unit"] == "deg" else "°/month"
        rows.append(
            row(
                text_or_dash(one["arm"]),
                str(one["joint"]),
                fleet_charts.KINDS.get(str(one["kind"]), str(one["kind"])),
                fleet_charts.change_date(one),
                text_or_dash(one["session"]),
                f"{with_uncertainty(one['size'], 2 * float(one['size_u']))}{unit}",
                f"{fleet_charts.format_day(one['earliest_t_days'])} to "
                f"{fleet_charts.format_day(one['latest_t_days'])}",
                quantity(one["clearer_by"], "", 2),
            )
        )
    blocks: list[Block] = [
        Table(
            "Changes, in order of arm and joint.",
            "lllllrll",
            ("Arm", "Joint", "Kind", "Date", "Session", "Size ± U", "Range of the date", "Told by"),
            tuple(rows),
            (CHANGE_NOTE,),
            wide=(3, 4),
        )
    ]
    if any(one["recalibrated"] is True for one in found):
        text = (
            "A step that falls on a new calibration may be the calibration's: it counts as found "
            "only because it is beyond what rig and marker state as their uncertainty. Where they "
            "state none, measure again with the old calibration."
        )
        blocks.append(Bullets((text,), "warning"))
    return Section("changes", "Changes", tuple(blocks))
