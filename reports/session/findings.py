"""The first half of a report: the verdict, the joints, the causes, the errors, the pose."""

from collections.abc import Callable
from functools import partial
from pathlib import PurePath
from typing import Any

from reports.document import blocks as doc
from reports.document import formatting as fmt
from reports.document.charts import MAX_LINE_POINTS, records
from reports.results import Results
from reports.session import causes, phrases
from reports.session.figures import evidence, motion
from reports.session.headline import headline, is_hidden

ERROR_NOTE = (
    "The verdict rests on ê, the resolved error: the curve through the errors that noise does not "
    "follow, causes found included. Mean: of ê over these pairs, with its expanded uncertainty "
    "(k); worst ê: with k = 2. Max |e|, of single pairs, holds noise and is never judged."
)
DETECTABILITY_NOTE = (
    "Visible: share of an offset's signal left after all that was fitted, for an offset that "
    "was there before the registration and for one that arose since. Detectable: the smallest "
    "offset that would be noticed (false alarm 0.1 %, power 80 %). Separable: the smallest that "
    "would be told from an offset of another joint. A dash: none, or not known."
)
CAUSE_NOTE = (
    "A cause is named only where its fit beats every rival's by Δχ² ≥ 15 (at unequal numbers of "
    "parameters: BIC by 10). Explains: share of the weighted errors that goes with it. Runner-up: "
    "the rival that fits best in its place, and by how much worse."
)
ALARM_NOTE = (
    "t on the clock of the errors over time: when the alarm was raised, a little after what it "
    "tells of. alarms.csv has them all."
)
MAX_LISTED_ALARMS = 12  # on page one, the first; alarms.csv has all
MAX_LISTED_PAIRS = 30  # listed by their numbers; summary.json lists all


def verdict(results: Results) -> doc.Section:
    """Open with the verdict and what to do about it, then the facts at a glance."""
    summary = results.summary
    session, pairs = summary.get("session") or {}, summary.get("pairs") or {}
    instrument = session.get("instrument")
    measured = f"{fmt.count(pairs.get('measured'))} measured of {fmt.count(pairs.get('recorded'))}"
    items = [
        ("Robot", fmt.text_or_dash(session.get("robot"))),
        ("Session", fmt.text_or_dash(PurePath(session.get("path") or "").name)),
        ("Started", fmt.text_or_dash(session.get("started"))),
        *([("Measured by", fmt.text_or_dash(instrument))] if instrument else []),
        ("Poses" if instrument else "Stereo pairs", measured),
        ("Encoder clock", clock_text(summary)),
    ]
    return doc.Section(
        "verdict", "Verdict", (headline(results), doc.Facts(tuple(items)), *_alarm_blocks(results))
    )


def _alarm_blocks(results: Results) -> tuple[doc.Block, ...]:
    """List what a watched run told, and the cause that the diagnosis found for it."""
    if "alarms" not in results.tables:
        return ()
    alarms = records(results.table("alarms").astype({"joint": float}))
    if not alarms:
        return (doc.Paragraph("The robot was watched, and no alarm was raised."),)
    columns = (
        doc.Column("Alarm", "l", doc.field("alarm", fmt.count)),
        doc.Column("At [s]", "r", doc.field("t_s", fmt.number, 1)),
        doc.Column("Told", "l", doc.field("text"), wide=True),
        doc.Column("Explained by", "l", partial(_explanation, results.summary), wide=True),
    )
    return (
        doc.tabulate(
            "Alarms while the robot was watched.", columns, alarms[:MAX_LISTED_ALARMS], ALARM_NOTE
        ),
    )


def _explanation(summary: dict[str, Any], alarm: dict[str, Any]) -> str:
    """The causes of an alarm's joint, and common ones, that had begun when it was raised."""
    joint, raised = fmt.finite(alarm.get("joint")), fmt.finite(alarm.get("t_s"))
    if joint is None or raised is None:
        return fmt.DASH
    named = [
        causes.cause_name(one)
        for one in summary.get("diagnosis") or []
        if one.get("kind") != "ambiguous" and one.get("joint") in (None, int(joint))
        and (fmt.finite(one.get("t_s")) or raised) <= raised
    ]  # fmt: skip
    return "; ".join(named) or "no cause that the diagnosis found"


def clock_text(summary: dict[str, Any]) -> str:
    """Say the encoder clock's offset and where it comes from."""
    entry = summary.get("clock") or {}
    offset = doc.uncertain_field("encoder_offset_s", "standard_uncertainty_s", "s", k=2)(entry)
    if offset == fmt.DASH:
        return "not observable" if entry.get("observable") is False else fmt.DASH
    source = fmt.lookup_label(phrases.CLOCK_SOURCES, entry.get("source"))
    return f"{offset} (k = 2), {source}"


def joints(results: Results) -> doc.Section:
    """Say what was found of each joint, and what could have been seen of it."""
    summary = results.summary
    entries = summary.get("joints") or []
    blocks: list[doc.Block] = [_error_table(entries), _detectability_table(entries)]
    hidden = [j.get("joint") for j in entries if is_hidden(j)]
    if hidden:
        blocks.append(
            doc.Paragraph(
                f"A constant offset of {fmt.joint_names(hidden)} could not have been seen in this "
                "session, however large: it moves the base or the LEDs that were fitted through "
                "the same encoders, or the clock. An error figure for such a joint says nothing "
                "about its zero.",
                "note",
            )
        )
    if summary.get("combinations"):
        blocks.append(_combination_table(summary["combinations"]))
    figure = doc.Figure(
        "correlation",
        "Correlation of the joints' mean errors, systematic part included. Joints that "
        "trade against each other (near ±1) are to be judged by their sum as well.",
        "A square matrix of correlation coefficients, one row and one column a joint.",
    )
    otherwise = "The correlation of the joints' mean errors is not known."
    blocks.append(doc.block_or_paragraph(figure, evidence.correlation(results), otherwise))
    return doc.Section("joints", "Joints", tuple(blocks))


def _error_table(entries: list[dict[str, Any]]) -> doc.Table:
    columns = (
        doc.Column("Joint", "c", doc.field("joint")),
        doc.Column(
            "Mean ± U [°]", "r", doc.uncertain_field("mean_error_deg", "expanded_uncertainty_deg")
        ),
        doc.Column("k", "r", doc.field("coverage_factor", fmt.number, 2)),
        doc.Column("RMS [°]", "r", doc.field("rms_error_deg", fmt.number)),
        doc.Column("Max |e| [°]", "r", doc.field("max_abs_error_deg", fmt.number)),
        doc.Column(
            "Worst ê ± U [°]", "r",
            doc.uncertain_field("worst_error_deg", "worst_error_standard_uncertainty_deg", k=2),
        ),
        doc.Column("Tolerance [°]", "r", doc.field("tolerance_deg", _format_tolerance)),
        doc.Column("P(conform)", "r", doc.field("conformance_probability", fmt.probability)),
        doc.Column("Verdict", "l", _joint_verdict, wide=True),
    )  # fmt: skip
    title = "Error (reading − true angle) of each joint, in degrees, over the measured pairs."
    return doc.tabulate(title, columns, entries, ERROR_NOTE)


def _format_tolerance(value: Any) -> str:
    bound = fmt.exact_number(value)
    return bound if bound == fmt.DASH else f"±{bound}"


def _joint_verdict(joint: dict[str, Any]) -> doc.Cell:
    verdict = joint.get("verdict")
    return doc.Cell(phrases.verdict_text(verdict, joint.get("reason")), phrases.tone(verdict))


def _detectability_table(entries: list[dict[str, Any]]) -> doc.Table:
    since = doc.field("visible_fraction_since_registration", fmt.percent)
    columns = (
        doc.Column("Joint", "c", doc.field("joint")),
        doc.Column("Pairs", "r", doc.field("pairs", fmt.count)),
        doc.Column("Visible if before", "r", doc.field("visible_fraction", fmt.percent)),
        doc.Column("Visible if since", "r", since),
        doc.Column(
            "Detectable [°]", "r", doc.field("minimum_detectable_error_deg", fmt.significant)
        ),
        doc.Column("Separable [°]", "r", doc.field("minimum_separable_error_deg", fmt.significant)),
        doc.Column("In words", "l", phrases.visibility, wide=True),
    )
    title = "What this session could see of a constant offset of each joint."
    return doc.tabulate(title, columns, entries, DETECTABILITY_NOTE)


def _combination_table(entries: list[dict[str, Any]]) -> doc.Table:
    value = doc.uncertain_field("mean_error_deg", "standard_uncertainty_deg", k=2)
    columns = (
        doc.Column("Sum", "l", doc.field("label")),
        doc.Column("Mean error ± U [°]", "r", value),
        doc.Column("Pairs", "r", doc.field("pairs", fmt.count)),
        doc.Column("Why it is given", "l", _coupling, wide=True),
    )
    title = "Sums of joint errors that are known where their members are not, or better than they."
    return doc.tabulate(title, columns, entries)


def _coupling(entry: dict[str, Any]) -> str:
    return fmt.lookup_label(phrases.COUPLINGS, entry.get("why"))


def diagnosis(results: Results) -> doc.Section:
    """List the causes that the data single out, and those they do not tell apart."""
    entries = results.summary.get("diagnosis") or []
    if not entries:
        text = (
            "The data single out no cause: no fault beats its rivals by the margin that is asked."
        )
        return doc.Section(
            "diagnosis", "Diagnosis", (doc.Paragraph(text), *_outlier_blocks(results))
        )
    columns = (
        doc.Column("Cause", "l", _cause, wide=True),
        doc.Column("Value ± U", "r", _of_one_cause(causes.format_value)),
        doc.Column("Unit", "l", _of_one_cause(causes.unit_sign)),
        doc.Column("Explains", "r", doc.field("explains", fmt.percent)),
        doc.Column("Runner-up", "l", _of_one_cause(causes.runner_up), wide=True),
        doc.Column("What to do", "l", causes.remedy, wide=True),
    )
    table = doc.tabulate("Causes of the errors found.", columns, entries, CAUSE_NOTE)
    return doc.Section("diagnosis", "Diagnosis", (table, *_outlier_blocks(results)))


def _cause(entry: dict[str, Any]) -> str:
    if entry.get("kind") == "ambiguous":
        return f"ambiguous, one of: {causes.rivals(entry, '; ')}"
    return causes.cause_name(entry)


def _of_one_cause(write: Callable[[dict[str, Any]], str]) -> Callable[[dict[str, Any]], str]:
    """Write a dash for an ambiguous cause: each of its candidates says its own."""
    return lambda entry: fmt.DASH if entry.get("kind") == "ambiguous" else write(entry)


def _outlier_blocks(results: Results) -> tuple[doc.Block, ...]:
    """List the pairs that follow none of the causes."""
    pairs = results.summary.get("outlying_pairs") or []
    if not pairs:
        return ()
    shown = ", ".join(fmt.count(pair) for pair in pairs[:MAX_LISTED_PAIRS])
    more = (
        f" and {fmt.count(len(pairs) - MAX_LISTED_PAIRS)} more"
        if len(pairs) > MAX_LISTED_PAIRS
        else ""
    )
    text = (
        f"Left out of the diagnosis: {fmt.count(len(pairs))} of the pairs, which lie further off "
        f"than noise explains (numbers {shown}{more}). They count in every other figure."
    )
    return (doc.Paragraph(text, "note"),)


def errors_over_time(results: Results) -> doc.Section:
    """Show the errors of each joint over time."""
    frames = results.table("frames")
    thinned = ""
    if len(frames) > MAX_LINE_POINTS:
        thinned = (
            f" Of the {fmt.count(len(frames))} pairs, each short stretch is drawn by its smallest "
            "and its largest error; its band is the envelope of the bands, and a gap shorter than "
            "it is not seen."
        )
    figure = doc.Figure(
        "joint_errors",
        "Error of each joint over time: of each pair with its ±2u band (all sources), the resolved "
        "error on which the verdict rests with its own, and the tolerance. Lines break where pairs "
        "are missing; the band of a pair near a singularity may leave the frame, an error does not."
        + thinned,
        "One strip a joint: error in degrees against time, with uncertainty bands, the resolved "
        "error's curve and the tolerance as dotted lines.",
    )
    otherwise = "There is no measured pair with an encoder reading to draw."
    block = doc.block_or_paragraph(figure, motion.joint_errors(results), otherwise)
    return doc.Section("errors", "Errors over time", (block,))


def pose(results: Results) -> doc.Section:
    """Show position and orientation of the flange, measured and from the encoders."""
    blocks: list[doc.Block] = [_pose_table(results.summary)]
    figures = (
        doc.Figure(
            "pose",
            "Position (left) and rotation vector (right) of the flange in the robot's base frame, "
            "measured and computed from the encoders.",
            "Six panels against time: x, y, z in millimetres and the three components of the "
            "rotation vector in degrees, each measured and from the encoders.",
            motion.pose(results),
        ),
        doc.Figure(
            "pose_errors",
            "Position and orientation error of the flange: distance and angle between the measured "
            "and the encoders' pose of each pair, and the resolved joint errors carried "
            "through the arm.",
            "Two strips against time: position error in millimetres, orientation error in degrees.",
            motion.pose_errors(results),
        ),
        doc.Figure(
            "path",
            "Path of the flange in the robot's base frame.",
            "A curve in space drawn twice: measured, and from the encoders.",
            motion.flange_path(results),
        ),
    )
    drawn = [figure for figure in figures if figure.drawing is not None]
    blocks += drawn or [doc.Paragraph("No pair gave the flange's pose.", "note")]
    return doc.Section("pose", "Position and orientation", tuple(blocks))


def _pose_table(summary: dict[str, Any]) -> doc.Table:
    rows = []
    for name, unit in (("position", "mm"), ("orientation", "deg")):
        entry = summary.get(name) or {}
        verdict = entry.get("verdict")
        rows.append(
            doc.row(
                f"{name} [{fmt.UNITS[unit]}]",
                fmt.number(entry.get(f"rms_error_{unit}")),
                fmt.number(entry.get(f"max_error_{unit}")),
                fmt.number(entry.get(f"expanded_uncertainty_{unit}")),
                fmt.exact_number(entry.get(f"tolerance_{unit}")),
                fmt.probability(entry.get("conformance_probability")),
                doc.Cell(fmt.lookup_label(phrases.VERDICTS, verdict), phrases.tone(verdict)),
            )
        )
    dof = summary.get("known_dof")
    posed = (summary.get("session") or {}).get("instrument")
    who = "The poses" if posed else "The LEDs"
    text = f"{who} determine {fmt.count(dof)} of the flange's 6 degrees of freedom." if dof else ""
    missing = [n for n in ("position", "orientation") if not summary.get(n)]
    if missing:
        text = f"{text} No figures for {fmt.join_words(missing)}.".strip()
    return doc.Table(
        "Error of the flange's pose over the measured pairs.",
        "lrrrrrl",
        ("Error of", "RMS", "Max", "U of the mean", "Tolerance", "P(conform)", "Verdict"),
        tuple(rows),
        (text,) if text else (),
    )
