"""Page one of a grab's report: what came of it, both pictures, the times, what to do."""

from dataclasses import replace
from typing import Any

import numpy as np

from reports.document import blocks as doc
from reports.document import formatting as fmt
from reports.document.charts import column, records, texts
from reports.results import Results

OUTCOMES = {  # by the state: tone, label
    "lifted": ("conform", "Grasped and lifted"),
    "missed": ("nonconform", "Missed: nothing was held"),
    "fault": ("nonconform", "Stopped by a fault"),
    "holding-stale": ("undecided", "Held: pictures or joint angles were too old"),
    "holding-lost": ("undecided", "Held: the target was out of sight"),
    "holding-unreachable": ("undecided", "Held: no safe way led to the target"),
    "holding-operator": ("undecided", "Held by the operator"),
}
REMEDIES = {  # by the state, what to do
    "lifted": "Nothing: the object was grasped and lifted.",
    "missed": "See in the film where the fingers closed, and in the appendix how well the object's "
    "place was known; then grab again.",
    "fault": "Clear the fault at the controller, see what caused it, then grab again.",
    "holding-stale": "Find out why pictures or joint angles came late: cameras, network, load.",
    "holding-lost": "Keep the target in view of both cameras, then grab again.",
    "holding-unreachable": "Move the target or the arm, so that a safe way leads to it.",
}
OTHERWISE = "See in the states over time why it ended, then grab again."
MAX_STAGES = 9  # rows of the table of page one; the appendix has all
MIN_STAGE_S = 1e-6  # a state that was left at once is no stage
PICTURES = doc.Figure(
    "pictures",
    "Both cameras, left and right{moments}. Box: searched window; ellipse: detected object.",
    "Pictures of both cameras: the object, and the hand where it came to it",
)
PICTURED = {"following": "the object before the grasp", "closing": "the grasp"}


def certificate(results: Results) -> doc.Section:
    """Say all that a reader needs who reads one page."""
    summary = results.summary
    picture = results.images.get(PICTURES.name)
    blocks: list[doc.Block] = [
        replace(outcome(summary), remarks=_duration(results)),
        doc.Facts(tuple(_identification(results)), columns=2),
    ]
    if summary.get("warnings"):
        blocks.append(doc.Bullets(tuple(summary["warnings"]), "warning"))
    blocks += [
        doc.block_or_paragraph(_pictures(results), picture, "There are no pictures."),
        *_film(results),
        *_stage_table(results),
        doc.remedies(_actions(summary), _unchecked(summary)),
    ]
    return doc.Section("outcome", "Outcome", tuple(blocks))


def _pictures(results: Results) -> doc.Figure:
    """The figure of both cameras, with what its one or two pairs of pictures show."""
    states = set(texts(results.table("cycles"), "state"))
    shown = [words for state, words in PICTURED.items() if state in states]
    moments = f": {shown[0]}" if shown else ", at the end"
    if len(shown) > 1:
        moments = f". Above: {shown[0]}; below: {shown[1]}"
    return replace(PICTURES, caption=PICTURES.caption.format(moments=moments))


def outcome(summary: dict[str, Any]) -> doc.Verdict:
    """Say how it ended, in a label and a sentence."""
    state, reason = str(summary.get("state")), fmt.text_or_dash(summary.get("reason"))
    plan, refusal = summary.get("plan"), summary.get("refusal") or {}
    if not summary.get("execute") and plan:
        duration = fmt.number(plan.get("duration_s"), 1)
        sentence = f"A safe way leads to the target, with {plan['branch']}; it takes {duration} s."
        return doc.Verdict("none", "Planned; nothing was moved", sentence)
    if refusal:
        return doc.Verdict(
            "undecided", "Refused", f"{refusal['reason']}.{_tool_offset_text(summary)}"
        )
    if state == "searching":
        unselected = summary.get("reason") == "no object is selected"
        sentence = (
            "No object was selected: give --target or --roi, or select it on the page."
            if unselected
            else "Nothing of the target's colours was seen by both cameras, or more than one thing."
        )
        return doc.Verdict("undecided", "The target was not found", sentence)
    if state not in OUTCOMES:
        operator = summary.get("stopped_by_operator")
        ended = "The operator ended it." if operator else "Its time was over."
        begun = f" It had not begun: {reason}." if state == "idle" and reason != fmt.DASH else ""
        return doc.Verdict("undecided", f"Ended while {state}", ended + begun)
    tone, label = OUTCOMES[state]
    if seen_left_behind(summary):
        tone, label, reason = "undecided", "The object stayed behind", "something is held"
    by = _evidence_text(summary) if state == "lifted" else ""
    return doc.Verdict(tone, label, f"{as_sentence(reason + by)}{_tool_offset_text(summary)}")


def seen_left_behind(summary: dict[str, Any]) -> bool:
    """The hand went up and the cameras saw the object, less U, farther off than half of its way."""
    far, up = (fmt.finite(summary.get(f"seen_{key}_mm")) for key in ("from_grip", "raised"))
    if summary.get("state") != "lifted" or far is None or up is None:
        return False
    u = fmt.finite(summary.get("seen_from_grip_expanded_uncertainty_mm")) or 0.0
    return far - u > up / 2 > 0


def _evidence_text(summary: dict[str, Any]) -> str:
    """Who says that the object came along: the gripper does, the cameras where they saw it."""
    far = _grip_distance_text(summary)
    if far is None:
        return ", by the gripper's status; the cameras did not see it after the descent"
    up = fmt.quantity(summary.get("seen_raised_mm"), "mm", 3)
    return (
        f", by the gripper's status; the cameras saw the object last {far} from the grip point, "
        f"with the hand {up} up"
    )


def _grip_distance_text(summary: dict[str, Any]) -> str | None:
    """How far the object was seen from the grip point; None where it was not seen."""
    far = fmt.finite(summary.get("seen_from_grip_mm"))
    if far is None:
        return None
    u = summary.get("seen_from_grip_expanded_uncertainty_mm")
    return f"{fmt.with_uncertainty(far, u, 'mm', signed=False)} (k = 2)"


def _tool_offset_text(summary: dict[str, Any]) -> str:
    """What came of looking at the hand, as a sentence to add; empty where nobody looked."""
    hand = summary.get("hand")
    return f" {as_sentence(hand['reason'])}" if hand else ""


def as_sentence(words: str) -> str:
    """Start with a capital, end with a full stop."""
    return f"{fmt.capitalise(words)}."


def _identification(results: Results) -> list[tuple[str, str]]:
    summary, table = results.summary, results.table("cycles")
    t, took = column(table, "t_s"), column(table, "took_ms")
    work = fmt.number(float(np.median(took)) if len(t) else None, 1)
    items = [
        ("Target", fmt.text_or_dash(summary.get("target"))),
        ("Allowed to move", "yes" if summary.get("execute") else "no"),
        ("State reached", fmt.text_or_dash(summary.get("state"))),
        ("Controls given back", "yes" if summary.get("released") else "no"),
        ("Cycles", fmt.count(summary.get("cycles"))),
        ("Work per cycle", f"{work} ms (median)"),
    ]
    far = _grip_distance_text(summary)
    if far is not None or summary.get("state") == "lifted":
        items.append(("Object off grip point", far or "not seen after the descent"))
    items.append(("Recorded session", fmt.text_or_dash(summary.get("session"))))
    return items


def _duration(results: Results) -> tuple[str, ...]:
    """Say how long it took; until the object was lifted, where it was."""
    t = column(results.table("cycles"), "t_s")
    if not len(t):
        return ()
    lifts = [float(one["t_s"]) for one in records(results.table("passages"))
             if one["to_state"] == "lifted"]  # fmt: skip
    until = f"Lifted {fmt.number(lifts[-1] - float(t[0]), 1)} s after the start. " if lifts else ""
    return (f"{until}Total time {fmt.number(float(np.ptp(t)), 1)} s.",)


def _film(results: Results) -> tuple[doc.Film, ...]:
    """The film, by the name of its file beside the report."""
    name = results.summary.get("film")
    if not name:
        return ()
    film = results.films.get(str(name), b"")
    caption = "Film of the grab: both cameras, every cycle."
    return (doc.Film(str(name), caption, film, PICTURES.name),)


def _stage_table(results: Results) -> tuple[doc.Table, ...]:
    """When each stage began, how long it lasted, and why it was entered."""
    passages = records(results.table("passages"))
    t = column(results.table("cycles"), "t_s")
    if not passages or not len(t):
        return ()
    begins = [float(one["t_s"]) for one in passages]
    ends = [*begins[1:], float(t[-1])]
    stages = [
        one | {"lasted": end - begin}
        for one, begin, end in zip(passages, begins, ends, strict=True)
        if end - begin > MIN_STAGE_S
    ]
    columns = (
        doc.Column("Stage", "l", doc.field("to_state", str)),
        doc.Column("Began [s]", "r", doc.field("t_s", fmt.number, 2)),
        doc.Column("Lasted [s]", "r", doc.field("lasted", fmt.number, 2)),
        doc.Column("Because", "l", doc.field("reason", str), wide=True),
    )
    notes = []
    if len(stages) > MAX_STAGES:
        notes.append(f"The last {MAX_STAGES} of {fmt.count(len(stages))} stages.")
    return (doc.tabulate("Times of the grab.", columns, stages[-MAX_STAGES:], *notes),)


def _actions(summary: dict[str, Any]) -> list[str]:
    if not summary.get("execute") and summary.get("plan"):
        return ["Start it again with --execute, and the arm moves as planned."]
    if summary.get("refusal"):
        return ["Remove what the refusal names, then grab again."]
    if seen_left_behind(summary):
        return ["See in the film and in the cell what the fingers hold."]
    return [REMEDIES.get(str(summary.get("state")), OTHERWISE)]


def _unchecked(summary: dict[str, Any]) -> list[str]:
    sentences = []
    if summary.get("state") == "lifted" and _grip_distance_text(summary) is None:
        sentences.append(
            "Whether the cameras confirm the lift: they did not see the object after the descent, "
            "so the verdict rests on the gripper's status alone."
        )
    if not summary.get("hand"):
        sentences.append("Where the hand really was: its LEDs were not measured.")
    sentences.append("How firmly the object is held, and whether a second grab would succeed.")
    return sentences
