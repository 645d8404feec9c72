"""Page one of an identification's report: what to type into the controller, and what it gains."""

from typing import Any

from reports.document import blocks as doc
from reports.document import formatting as fmt
from reports.identification import figures
from reports.identification.names import in_words
from reports.results import Results

LEVELS = {
    "registration": "base and tool alone",
    "offsets": "with the joints' offsets",
    "geometry": "with all of the arm's geometry",
}
# Of the identification's matrix: below it its results are reliable, by Schröer and others as cited
# in Nahvi and Hollerbach, "The noise amplification index for optimal pose selection in robot
# calibration", ICRA 1996.
MAX_CONDITION = 100.0
MAX_COVERAGE_FACTOR = 2.05  # of 95 %: beyond it k = 2 covers clearly less, which is then told
MAX_NAMED = 4  # parameters that page one names
SAME = "No parameter of the arm was changed: the data call for no correction."
SIGN = (
    "Error: encoder less measured. A correction is its negative: it is to be added to the reading. "
    "U is expanded with k = 2."
)
ALONE = (
    "Offsets alone hold for an arm whose lengths and twists stay as they are: enter these in a "
    "controller that takes nothing else. The others go with the corrected robot file."
)
NOT_TOLD = "A dash: not identified."
UNJUDGED = "How the arm predicts a session that it was not identified from: name one with --judge."


def certificate(results: Results) -> doc.Section:
    """Say all that a reader needs who reads one page."""
    summary = results.summary
    before, after = (
        _held_out_entry(summary, name) for name in ("registration", summary.get("level"))
    )
    first, second = fmt.finite(before.get("mean_mm")), fmt.finite(after.get("mean_mm"))
    changed = summary.get("level") != "registration"
    better = first is not None and second is not None and second < first
    label = "The arm is identified" if changed else "The arm stays as it is"
    verdict = doc.Verdict(
        tone="conform" if better or not changed else "undecided",
        label=label,
        sentence=" ".join(_findings(summary, first, second) if changed else [SAME]),
        remarks=tuple(_remarks(summary)),
    )
    figure = doc.Figure(
        "identified_residuals",
        "Residual of each pose: with base and tool alone, and with the identified arm.",
        "Two strips over the poses: position in millimetres, orientation in degrees.",
    )
    blocks = (
        verdict,
        doc.Facts(tuple(_identification(summary)), columns=2),
        doc.block_or_paragraph(figure, figures.residuals(results), "The residuals were not kept."),
        offset_table(summary),
        doc.remedies(_actions(summary), _unchecked(summary)),
    )
    return doc.Section("verdict", "Verdict", blocks)


def _findings(summary: dict[str, Any], first: float | None, second: float | None) -> list[str]:
    """Say the largest offset, and how much better poses that were held out are predicted."""
    sentences = []
    key = "error_deg"
    known = [one for one in summary.get("offsets") or [] if fmt.finite(one.get(key)) is not None]
    if known:
        worst = max(known, key=lambda one: abs(one[key]))
        u = fmt.expanded(worst.get("standard_uncertainty_deg"))
        amount = fmt.with_uncertainty(abs(worst[key]), u, "°", signed=False)
        way = "high" if worst[key] > 0 else "low"
        sentences.append(
            f"The largest offset is that of joint {worst.get('joint')}, which reads {amount} "
            f"(k = 2) too {way}."
        )
    if first is not None and second is not None:
        times = f", {fmt.significant(first / second)} times less" if 0 < second < first else ""
        sentences.append(
            f"On poses held out, the mean position residual goes from "
            f"{fmt.quantity(first, 'mm', 3)} to {fmt.quantity(second, 'mm', 3)}{times}."
        )
    return sentences


def _remarks(summary: dict[str, Any]) -> list[str]:
    used = (summary.get("poses") or {}).get("used")
    blind = [j.get("joint") for j in summary.get("offsets") or [] if _is_hidden(j)]
    count = fmt.count(summary.get("identified"))
    level = fmt.lookup_label(LEVELS, summary.get("level"))
    remarks = [f"{count} parameters were identified from {fmt.count(used)} poses, {level}."]
    if blind:
        remarks.append(f"The offset of {fmt.joint_names(blind)} was not identified.")
    if text := observability_text(summary):
        remarks.append(text)
    factor = fmt.finite(summary.get("coverage_factor"))
    if factor is not None and factor > MAX_COVERAGE_FACTOR:
        remarks.append(
            f"The noise rests on few poses: for a confidence of 95 %, take "
            f"{fmt.significant(factor / 2, 3)} times every U (Student's t)."
        )
    scatter = fmt.finite((summary.get("recordings") or {}).get("scatter"))
    if scatter is not None:
        several = fmt.count(summary["recordings"].get("count"))
        remarks.append(
            f"The {several} recordings differ by {fmt.number(scatter, 1)} times their own "
            "uncertainties: the uncertainties include that."
        )
    return [*remarks, *(fmt.text_or_dash(text) for text in summary.get("warnings") or [])]


def observability_text(summary: dict[str, Any]) -> str:
    """Say in one sentence whether the poses determine the parameters well; empty: not known.

    O2 is one over the condition number. The columns are whitened and scaled by 1 mm and 1°, so
    one over O3 is the standard uncertainty of the combination that is known worst, by the noise of
    the poses: what recordings differ by is in the parameters' uncertainties alone.
    """
    indexes = summary.get("observability") or {}
    inverse, least = fmt.finite(indexes.get("O2")), fmt.finite(indexes.get("O3"))
    if not inverse or not least:
        return ""
    condition = 1.0 / inverse
    worst = fmt.significant(fmt.COVERAGE_FACTOR / least)
    well = condition <= MAX_CONDITION
    verdict = "good" if well else "poor"
    side = "below" if well else "above"
    advice = "" if well else " Add poses that differ more in every joint."
    scatter = fmt.finite((summary.get("recordings") or {}).get("scatter"))
    alone = " by the poses' noise alone" if scatter is not None and scatter > 1 else ""
    return (
        f"Observability (O1 to O5) is {verdict}: the condition number is "
        f"{fmt.significant(condition)}, {side} the limit of {MAX_CONDITION:.0f} for reliable "
        f"results, and the combination of parameters that is known worst has U = {worst} "
        f"(mm or °, k = 2){alone}.{advice}"
    )


def _is_hidden(joint: dict[str, Any]) -> bool:
    return all(fmt.finite(joint.get(key)) is None for key in ("error_deg", "alone_error_deg"))


def _held_out_entry(summary: dict[str, Any], name: Any) -> dict[str, Any]:
    for level in summary.get("levels") or []:
        if level.get("name") == name:
            return level.get("held_out") or {}
    return {}


def _identification(summary: dict[str, Any]) -> list[tuple[str, str]]:
    rank, candidates = fmt.count(summary.get("rank")), fmt.count(summary.get("candidates"))
    return [
        ("Robot", fmt.text_or_dash(summary.get("robot"))),
        ("Recorded in", fmt.text_or_dash((summary.get("source") or {}).get("path"))),
        ("Corrected arm", fmt.text_or_dash(summary.get("robot_file"))),
        ("Determined", f"{rank} of {candidates} parameters"),
        ("Base", "found with the arm" if summary.get("base_free") else "held"),
        ("Tool", "found with the arm" if summary.get("tool_free") else "held"),
    ]


def offset_table(summary: dict[str, Any]) -> doc.Table:
    """Each joint's offset with its sign, as error and as what to type into the controller."""
    columns = [
        doc.Column("Joint", "c", doc.field("joint")),
        doc.Column("Encoder less measured [°]", "r", _offset_field("error_deg")),
        doc.Column("Add to the reading [°]", "r", _offset_field("add_to_reading_deg")),
    ]
    notes = [SIGN]
    if summary.get("level") == "geometry":
        alone = _offset_field("alone_add_to_reading_deg", "alone_")
        columns.append(doc.Column("Offsets alone: add to the reading [°]", "r", alone))
        notes.append(ALONE)
    entries = summary.get("offsets") or []
    if any(fmt.finite(entry.get("error_deg")) is None for entry in entries):
        notes.append(NOT_TOLD)
    return doc.tabulate("Constant offset of each joint, ± U (k = 2).", columns, entries, *notes)


def _offset_field(key: str, head: str = "") -> Any:
    return doc.uncertain_field(key, f"{head}standard_uncertainty_deg", k=2)


def _actions(summary: dict[str, Any]) -> list[str]:
    """List what to do in the controller, and what would make the figures better."""
    if summary.get("level") == "registration":
        return ["Leave the controller as it is."]
    file = fmt.text_or_dash(summary.get("robot_file"))
    entered = "the corrections of the table"
    if summary.get("level") == "geometry":
        entered = "the last column of the table"
    entry = (
        f"Enter {entered} in the controller as joint offsets, or use the corrected arm {file} "
        "where the controller or planner takes a robot model. Never both."
    )
    actions = [entry, "Then measure again: the errors must be gone."]
    if fmt.finite((summary.get("recordings") or {}).get("scatter")) is None:
        actions.append("Record the motion a second time and give both sessions.")
    return actions


def _unchecked(summary: dict[str, Any]) -> list[str]:
    """List what the poses do not determine, and what did not judge the arm."""
    held = summary.get("held") or []
    sentences = []
    for reason, words in (
        ("gauge", "no motion can determine"), ("prior", "this motion does not determine"),
    ):  # fmt: skip
        names = [in_words(str(e.get("name"))) for e in held if e.get("reason") == reason]
        if names:
            more = len(names) - MAX_NAMED
            named = "; ".join(names[:MAX_NAMED]) + (f"; {more} more" if more > 0 else "")
            noun = "parameter" if len(names) == 1 else "parameters"
            sentences.append(f"The {noun} that {words}: {named}.")
    if not summary.get("judged"):
        sentences.append(UNJUDGED)
    return sentences
