"""What a report says, in which order, with which captions; shared by both formats."""

from collections.abc import Callable
from dataclasses import replace

from reports.document.blocks import Document, Section, lay_out, software
from reports.document.formatting import DASH, text_or_dash
from reports.results import Results
from reports.session import (
    budget,
    certificate,
    combinations,
    conditions,
    corrections,
    evidence,
    findings,
    performance,
    sweeps,
)
from reports.session.times import from_first_pair

Writer = Callable[[Results], Section]
ANSWERS: tuple[Writer, ...] = (
    certificate.certificate, findings.errors_over_time, findings.path, findings.diagnosis,
    corrections.corrections,
)  # fmt: skip
APPENDIX: tuple[Writer, ...] = (  # in the order in which an expert checks it
    evidence.spots,
    evidence.clock,
    evidence.pairs,
    sweeps.registration_free_tests,
    findings.joints,
    combinations.detectable,
    findings.components,
    performance.performance,
    budget.budget,
    conditions.conditions,
)


def document(results: Results) -> Document:
    """Lay out the whole report."""
    results = from_first_pair(results)
    session = results.summary.get("session") or {}
    robot = (results.setup.get("robot") or {}).get("name") or session.get("robot") or DASH
    description = session.get("description") or "a recorded session"
    fingerprint = text_or_dash((results.setup.get("robot") or {}).get("fingerprint"))
    left_out = set()
    if "instrument" in results.setup:  # another instrument's poses have no spots
        left_out.add(evidence.spots)
    if "performance" not in results.summary:  # results of before it was sought
        left_out.add(performance.performance)
    appendix = (
        replace(section(results), part="appendix")
        for section in APPENDIX
        if section not in left_out
    )
    footer = f"{software(results.summary)} · robot {fingerprint[:23]}"
    return lay_out(
        title=f"Encoder verification of {robot}",
        subtitle=text_or_dash(description),
        footer=footer,
        sections=(*(s(results) for s in ANSWERS), *appendix),
    )
