"""What the report of a robot's registration says, in which order. Keys: docs/calibration.md."""

from typing import Any

from reports.document import blocks as doc
from reports.document import formatting as fmt
from reports.registration.certificate import MIN_SHIFT, certificate, posed
from reports.registration.evidence import RegistrationNotes, axes, residuals
from reports.results import Results
from reports.session.phrases import (
    MAX_HIDDEN_SHARE,
    MAX_MOSTLY_HIDDEN_SHARE,
    MAX_PARTLY_HIDDEN_SHARE,
)


def document(results: Results) -> doc.Document:
    """Lay out the whole report."""
    summary = results.summary
    registration = fmt.text_or_dash(summary.get("registration"))
    return doc.lay_out(
        title=f"Registration of {fmt.text_or_dash(summary.get('robot'))}",
        subtitle=doc.described(summary, "a recorded session"),
        footer=f"{doc.software(summary)} · registration {registration[:23]}",
        sections=doc.answer_and_evidence(
            results, certificate, (s for s in EVIDENCE if not (posed(summary) and s is axes))
        ),
    )


def times(results: Results) -> doc.Section:
    """Say how the clocks stand to each other, and what was decided on the way."""
    rows = _times(results.summary)
    blocks = ((doc.Facts(tuple(rows)),) if rows else ()) + tuple(doc.decisions(results.summary))
    otherwise = (doc.Paragraph("Nothing was decided on the way.", "note"),)
    return doc.Section("base", "Clocks and decisions", blocks or otherwise)


def _times(summary: dict[str, Any]) -> list[tuple[str, str]]:
    items = []
    for label, key in (
        ("Encoder clock offset", "clock"),
        ("Right camera's stamps early by", "skew"),
    ):
        entry = summary.get(key)
        if entry:
            u = entry.get("standard_uncertainty_s")
            text = fmt.with_uncertainty(entry.get("offset_s"), fmt.expanded(u), "s")
            why = " (k = 2)" if u is not None else ", held: the motion does not show it"
            items.append((label, f"{text}{why}"))
    return items


def visibility(results: Results) -> doc.Section:
    """Say what the registration hides of each joint's offset."""
    summary = results.summary
    joints = summary.get("joints") or []
    if not joints:
        fixture = summary.get("method") == "fixture"
        text = RegistrationNotes.NOTHING_HIDDEN if fixture else RegistrationNotes.NOT_KNOWN
        return doc.Section("visibility", "What the registration hides", (doc.Paragraph(text),))
    columns = (
        doc.Column("Joint", "c", doc.field("joint")),
        doc.Column("Visible", "r", doc.field("visible_fraction", fmt.percent)),
        doc.Column("Base moved [mm/°]", "r", _shift),
        doc.Column("In words", "l", _share_text, wide=True),
    )
    title = "What this registration leaves visible of a constant offset that was there already."
    table = doc.tabulate(title, columns, joints, RegistrationNotes.VISIBLE)
    return doc.Section("visibility", "What the registration hides", (table,))


def _shift(joint: dict[str, Any]) -> str:
    shift = fmt.finite(joint.get("base_shift_mm_per_deg"))
    return fmt.significant(0.0 if shift is not None and abs(shift) < MIN_SHIFT else shift)


def _share_text(joint: dict[str, Any]) -> str:
    share = fmt.finite(joint.get("visible_fraction"))
    name = f"joint {fmt.text_or_dash(joint.get('joint'))}"
    if share is None:
        return "Not determined."
    if share < MAX_HIDDEN_SHARE:
        return f"A constant offset of {name} cannot show, however large."
    if share < MAX_MOSTLY_HIDDEN_SHARE:
        return f"Mostly hidden: only {fmt.percent(share)} of an offset of {name} shows."
    if share < MAX_PARTLY_HIDDEN_SHARE:
        return f"Partly hidden: {fmt.percent(share)} of an offset of {name} shows."
    return f"An offset of {name} shows in full."


def conditions(results: Results) -> doc.Section:
    """Say what the registration was made from."""
    registration = ("Registration", fmt.text_or_dash(results.summary.get("registration")))
    return doc.files_and_software(results, registration)


EVIDENCE = (visibility, residuals, axes, times, conditions)
