"""Identified corrections: joint by joint what to type in, what it corrects, and when not to."""

from typing import Any

from reports.document import blocks as doc
from reports.document import formatting as fmt
from reports.results import Results
from reports.session import causes
from reports.session.headline import hiding_parameter, is_hidden

RULE = (
    "Corrected reading = reading + correction, at every pose; a correction is the error with the "
    "opposite sign. Type it in as the joint's zero offset: as it stands where the controller adds "
    "that offset to the encoder's angle, with the opposite sign where it subtracts it. Then record "
    "again to confirm it. No correction holds for an encoder that was set to zero again since this "
    "session."
)
NOTHING = "no correction"
TABLE_NOTE = (
    "± U with {factors}. Detectable: the smallest offset that is detected. Separable: the "
    "smallest that can be attributed to this joint alone."
)


def corrections(results: Results) -> doc.Section:
    """Say what to correct by how much, or why nothing is to be corrected."""
    summary = results.summary
    rows = [row for joint in summary.get("joints") or [] for row in _joint_rows(results, joint)]
    rows += [_common_row(entry) for entry in _named(summary) if entry.get("joint") is None]
    head = ("Joint", "Correction ± U", "What it corrects", "When not to apply it, or why")
    title = "Corrections that this session identifies."
    factors = fmt.coverage_text(*(causes.coverage_factor(entry) for entry in _named(summary)))
    notes = (TABLE_NOTE.format(factors=factors), *_condition(summary))
    table = doc.Table(title, "clll", head, tuple(rows), notes, wide=(3,))
    return doc.Section("corrections", "Identified corrections", (doc.Paragraph(RULE), table))


def _named(summary: dict[str, Any]) -> list[dict[str, Any]]:
    """Select the causes that are separated from every rival."""
    return [entry for entry in summary.get("diagnosis") or [] if entry.get("kind") != "ambiguous"]


def _joint_rows(results: Results, joint: dict[str, Any]) -> list[tuple[doc.Cell, ...]]:
    """Make a row for each cause of a joint, or the one row that says why there is none."""
    number = joint.get("joint")
    name = fmt.text_or_dash(number)
    own = [entry for entry in _named(results.summary) if entry.get("joint") == number]
    if not own:
        return [doc.row(name, NOTHING, fmt.DASH, _why_none(results, joint))]
    return [
        doc.row(name, NOTHING, causes.cause_name(entry), _not_visible(results, joint))
        if entry.get("kind") == "offset" and is_hidden(joint)
        else doc.row(name, *_correction(entry), _caution(results, entry, own))
        for entry in own
    ]


def _correction(entry: dict[str, Any]) -> tuple[str, str]:
    """Give what to type in for a cause with its uncertainty, and what that corrects."""
    kind, value = entry.get("kind"), fmt.finite(entry.get("value"))
    spread = entry.get("expanded_uncertainty")
    what = causes.cause_name(entry)
    if value is None or causes.is_implausible(entry):
        return NOTHING, what
    if kind == "offset":
        return f"{fmt.with_uncertainty(-value, spread, '°')}, added to the reading", what
    if kind == "gain":
        factor = fmt.with_uncertainty(1 + value, spread, signed=False)
        return f"counts per turn × {factor}", f"{what}, about the robot file's zero"
    if kind == "dh":
        amount = fmt.with_uncertainty(value, spread, causes.unit_sign(entry))
        return f"{amount}, added to {entry.get('parameter')} in the robot file", what
    if kind == "clock":
        return f"{fmt.with_uncertainty(value, spread, 's')}, added to the clock offset", what
    if kind == "latency":
        return f"{fmt.with_uncertainty(-value, spread, 's')}, added to its readings' times", what
    if kind == "camera_skew":
        return f"{fmt.with_uncertainty(value, spread, 's')}, added to t_right_s", what
    return NOTHING, what


def _caution(results: Results, entry: dict[str, Any], own: list[dict[str, Any]]) -> str:
    """Say when a cause's correction does not hold, or what to do where no number corrects it."""
    if _correction(entry)[0] == NOTHING:
        return f"no number corrects it: {causes.remedy(entry)}"
    cautions = [same] if (same := causes.same_as(entry)) else []
    others = [causes.cause_name(other) for other in own if other is not entry]
    if others:
        cautions.append(f"it holds only together with the {fmt.join_words(others)}")
    sums = [
        fmt.text_or_dash(c.get("label"))
        for c in results.summary.get("combinations") or []
        if c.get("why") == "singularity" and entry.get("joint") in (c.get("joints") or [])
    ]
    if sums:
        cautions.append(f"near a singularity only {fmt.join_words(sums)} is determined")
    if entry.get("kind") == "gain":
        cautions.append("first check the gear ratio that the controller holds")
    return "; ".join(cautions) or "separated from every other cause"


def _not_visible(results: Results, joint: dict[str, Any]) -> str:
    return f"not visible: {'; '.join(hiding_parameter(results, joint))}"


def _why_none(results: Results, joint: dict[str, Any]) -> str:
    """Say why a joint has no correction: not separable, not visible, or none found."""
    number = joint.get("joint")
    for entry in results.summary.get("diagnosis") or []:
        rivals = [c for c in entry.get("candidates") or [] if isinstance(c, dict)]
        if number in [c.get("joint") for c in rivals]:
            return f"not separable: {causes.rivals(entry, ' or ')}; {causes.separation(entry)}"
    if is_hidden(joint):
        return _not_visible(results, joint)
    if fmt.finite(joint.get("mean_error_deg")) is None:
        return "not determined in this session"
    common = [causes.cause_name(e) for e in _named(results.summary) if e.get("joint") is None]
    if joint.get("verdict") == "nonconform" and common:
        return f"no cause of its own; common causes: {fmt.join_words(common)}"
    if joint.get("verdict") == "nonconform":
        return "no single cause accounts for its error: no constant would correct it"
    seen, separable = (
        fmt.quantity(joint.get(f"minimum_{name}_error_deg"), "°")
        for name in ("detectable", "separable")
    )
    return f"no cause found; detectable {seen}, separable {separable}"


def _common_row(entry: dict[str, Any]) -> tuple[doc.Cell, ...]:
    parts = {"clock": "clock", "clock_drift": "clock", "dh": "arm", "geometry": "arm"}
    part = parts.get(str(entry.get("kind")), "set-up")
    typed, what = _correction(entry)
    if typed == NOTHING:
        return doc.row(part, NOTHING, what, f"no number corrects it: {causes.remedy(entry)}")
    return doc.row(part, typed, what, "separated from every other cause")


def _condition(summary: dict[str, Any]) -> tuple[str, ...]:
    """Say what is taken as exact."""
    uncounted = (summary.get("budget") or {}).get("uncounted") or []
    if not uncounted:
        return ()
    names = fmt.join_words([fmt.text_or_dash(name) for name in uncounted])
    return (f"Every U holds on the condition that what is taken as exact is so: {names}.",)
