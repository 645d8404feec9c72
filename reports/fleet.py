"""What a fleet report says: which joint of which arm changed, how, since when; the evidence."""

from collections.abc import Callable
from typing import Any

from reports import fleet_evidence, fleet_words
from reports.blocks import (
    Block,
    Bullets,
    Cell,
    Document,
    Facts,
    Section,
    Table,
    Verdict,
    numbered,
    row,
)
from reports.fleet_charts import charts
from reports.formatting import DASH, count, finite, joined, measured, quantity, word
from reports.results import Results
from reports.sources import software

EXPLAINED = (
    "State: what the sessions show of a change over time. Error now: level of the mean error at "
    "the last session, reading less truth, with its expanded uncertainty (k = 2), the share of "
    "the calibration included. Trend: slope at the last session, what the calibration shares left "
    "out. Scatter: how many times farther apart sessions lie than their own uncertainties say; "
    "where that is more than 1, all limits are as much wider."
)
NAMED = (
    "A step is dated to the first session after it, with the session before; a drift to the "
    "session from which on it goes. The range holds the true date with 99 %. Told by: how much "
    "better this kind of change fits than the other (ΔBIC; below 10 the kind is not named)."
)


def document(results: Results) -> Document:
    """Lay out the whole report."""
    sections: tuple[Callable[[Results], Section | None], ...] = (
        state,
        joints,
        found_changes,
        charts,
        fleet_evidence.contrasts,
        fleet_evidence.worst,
        fleet_evidence.unseen,
        fleet_evidence.failures,
        fleet_evidence.method,
    )
    held = results.summary.get("sessions") or {}
    return numbered(
        Document(
            title=f"Fleet report: {_arms(results)}",
            subtitle=f"{count(held.get('measured'))} sessions{fleet_words.period(held)}",
            footer=f"{software(results.summary)} · fleet report",
            sections=tuple(s for make in sections if (s := make(results)) is not None),
            sortable=True,
        )
    )


def _arms(results: Results) -> str:
    number = len(results.summary.get("arms") or [])
    return "1 arm" if number == 1 else f"{count(number)} arms"


def state(results: Results) -> Section:
    """Open with what changed, then the facts at a glance."""
    summary = results.summary
    held = summary.get("sessions") or {}
    verdicts = summary.get("verdicts") or {}
    items = [
        ("Arms", joined([word(arm) for arm in summary.get("arms") or []][:8]) or DASH),
        ("Sessions measured", count(held.get("measured"))),
        ("Sessions that failed", count(held.get("failed"))),
        ("From, to", f"{word(held.get('first'))}, {word(held.get('last'))}"),
        (
            "Stereo pairs",
            f"{count(held.get('pairs_measured'))} measured of {count(held.get('pairs_recorded'))}",
        ),
    ]
    if verdicts:
        said = [f"{count(n)} {fleet_words.VERDICTS.get(v, v)}" for v, n in verdicts.items()]
        items.append(("Verdicts of the sessions", joined(said)))
    return Section("verdict", "State of the fleet", (_headline(results), Facts(tuple(items))))


def _headline(results: Results) -> Verdict:
    table, found = results.table("joints"), results.table("changes")
    judged = int((table["state"] != "unknown").sum()) if len(table) else 0
    remark = fleet_words.rate(results.summary)
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
    sentences = [fleet_words.change(one) for one in fleet_words.records(found)[:4]]
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
        fleet_words.records(table),
        key=lambda e: (order.get(str(e["state"]), 2), str(e["arm"]), int(e["joint"])),
    )
    rows = []
    for one in entries:
        state_word = fleet_words.STATES.get(str(one["state"]), str(one["state"]))
        worse = ", getting worse" if one.get("worse") is True else ""
        u, trend_u = finite(one.get("error_u_deg")), finite(one.get("trend_u_deg_per_month"))
        trend = measured(one.get("trend_deg_per_month"), _twice(trend_u)) if trend_u else DASH
        excess = finite(one.get("excess"))
        rows.append(
            row(
                word(one["arm"]),
                str(one["joint"]),
                Cell(f"{state_word}{worse}", fleet_words.TONES.get(str(one["state"]), "")),
                measured(one.get("error_deg"), _twice(u)),
                trend,
                count(one["sessions"]),
                count(one.get("odd_sessions")),
                DASH if excess is None else f"{excess:.1f}",
                _verdicts(one),
            )
        )
    shown = Table(
        "Arms and joints, those that changed first.",
        "lllrrrrrr",
        ("Arm", "Joint", "State", "Error now [°]", "Trend [°/month]", "Sessions", "Odd ones",
         "Scatter", "Conform / undecided / not"),
        tuple(rows),
        (EXPLAINED,),
    )  # fmt: skip
    return Section("joints", "Arms and joints", (shown,))


def _verdicts(one: dict[str, Any]) -> str:
    counts = [one["conform"], one["undecided"], one["nonconform"]]
    return " / ".join(count(n) for n in counts) if any(counts) else DASH


def _twice(u: float | None) -> float | None:
    return None if u is None else 2 * u


def found_changes(results: Results) -> Section:
    """Every change with its date, size and how surely its kind is told."""
    found = fleet_words.records(results.table("changes"))
    if not found:
        text = "No change was found beyond what chance brings about."
        return Section("changes", "Changes", (Bullets((text,)),))
    rows = []
    for one in found:
        unit = "°" if one["unit"] == "deg" else "°/month"
        rows.append(
            row(
                word(one["arm"]),
                str(one["joint"]),
                fleet_words.KINDS.get(str(one["kind"]), str(one["kind"])),
                fleet_words.dated(one),
                word(one["session"]),
                f"{measured(one['size'], 2 * float(one['size_u']))}{unit}",
                f"{fleet_words.day(one['earliest_t_days'])} to "
                f"{fleet_words.day(one['latest_t_days'])}",
                quantity(one["clearer_by"], "", 2),
            )
        )
    blocks: list[Block] = [
        Table(
            "Changes, in order of arm and joint.",
            "lllllrll",
            ("Arm", "Joint", "Kind", "Date", "Session", "Size ± U", "Range of the date", "Told by"),
            tuple(rows),
            (NAMED,),
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
