"""What a report says, in which order, with which captions; shared by both formats."""

from collections.abc import Callable

from reports import budget, conditions, detectable, evidence, findings, performance, sweeps
from reports.blocks import Document, Section, numbered
from reports.formatting import DASH, word
from reports.results import Results
from reports.sources import software

SECTIONS: tuple[Callable[[Results], Section], ...] = (
    findings.verdict,
    sweeps.unregistered,
    findings.joints,
    detectable.detectable,
    findings.diagnosis,
    findings.errors_over_time,
    findings.pose,
    performance.performance,
    evidence.spots,
    evidence.clock,
    evidence.pairs,
    budget.budget,
    conditions.conditions,
)


def document(results: Results) -> Document:
    """Lay out the whole report."""
    session = results.summary.get("session") or {}
    robot = (results.setup.get("robot") or {}).get("name") or session.get("robot") or DASH
    description = session.get("description") or "a recorded session"
    fingerprint = word((results.setup.get("robot") or {}).get("fingerprint"))
    left_out = set()
    if "instrument" in results.setup:  # another instrument's poses have no spots
        left_out.add(evidence.spots)
    if "performance" not in results.summary:  # results of before it was sought
        left_out.add(performance.performance)
    footer = f"{software(results.summary)} · robot {fingerprint[:23]}"
    return numbered(
        Document(
            title=f"Encoder verification of {robot}",
            subtitle=word(description),
            footer=footer,
            sections=tuple(s(results) for s in SECTIONS if s not in left_out),
        )
    )
