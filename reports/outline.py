"""What a report says, in which order, with which captions; shared by both formats."""

from collections.abc import Callable

from reports import conditions, evidence, findings, relative
from reports.blocks import Document, Section, numbered
from reports.formatting import DASH, word
from reports.results import Results
from reports.sources import software

SECTIONS: tuple[Callable[[Results], Section], ...] = (
    findings.verdict,
    relative.relative,
    findings.joints,
    findings.diagnosis,
    findings.errors_over_time,
    findings.pose,
    evidence.spots,
    evidence.clock,
    evidence.pairs,
    evidence.budget,
    conditions.conditions,
)


def document(results: Results) -> Document:
    """Lay out the whole report."""
    session = results.summary.get("session") or {}
    robot = (results.setup.get("robot") or {}).get("name") or session.get("robot") or DASH
    description = session.get("description") or "a recorded session"
    fingerprint = word((results.setup.get("robot") or {}).get("fingerprint"))
    pictures = "instrument" not in results.setup  # another instrument's poses have no spots
    footer = f"{software(results.summary)} · robot {fingerprint[:23]}"
    return numbered(
        Document(
            title=f"Encoder verification of {robot}",
            subtitle=word(description),
            footer=footer,
            sections=tuple(s(results) for s in SECTIONS if s is not evidence.spots or pictures),
        )
    )
