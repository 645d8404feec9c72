"""The first half of a report: the verdict, the joints, the causes, the errors, the pose."""

from pathlib import PurePath
from typing import Any

from reports.document import formatting
from reports.document.blocks import (
    Block,
    Cell,
    Charts,
    Facts,
    Figure,
    Paragraph,
    Section,
    Table,
    block_or_paragraph,
    chart_of,
    row,
)
from reports.document.charts import MAX_LINE_POINTS
from reports.document.formatting import (
    DASH,
    count,
    exact_number,
    join_words,
    number,
    percent,
    probability,
    quantity,
    text_or_dash,
    with_uncertainty,
)
from reports.document.formatting import joint_names as name_joints
from reports.results import Results
from reports.session import causes, phrases
from reports.session.figures import evidence, motion
from reports.session.headline import headline, is_hidden

ERROR_NOTE = (
    "U: expanded uncertainty (k · u) of the mean over these pairs. Max |e| holds noise and is "
    "never judged. The verdict rests on ê, the resolved error, with its standard uncertainty u: "
    "the curve through the errors that noise does not follow."
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
FIGURES: Charts = {
    "correlation": evidence.correlation,
    "joint_errors": motion.joint_errors,
    "pose": motion.pose,
    "pose_errors": motion.pose_errors,
    "path": motion.flange_path,
    "residuals": evidence.residuals,
    "reprojection": evidence.reprojection,
    "clock": evidence.clock,
    "timeline": evidence.timeline,
    "budget": evidence.budget,
}
MAX_LISTED_PAIRS = 30  # listed by their numbers; summary.json lists all


def verdict(results: Results) -> Section:
    """Open with the verdict and what to do about it, then the facts at a glance."""
    summary = results.summary
    session, pairs = summary.get("session") or {}, summary.get("pairs") or {}
    items = [
        ("Robot", text_or_dash(session.get("robot"))),
        ("Session", text_or_dash(PurePath(session.get("path") or "").name)),
        ("Started", text_or_dash(session.get("started"))),
        *(
            [("Measured by", text_or_dash(session["instrument"]))]
            if session.get("instrument")
            else []
        ),
        (
            "Poses" if session.get("instrument") else "Stereo pairs",
            f"{count(pairs.get('measured'))} measured of {count(pairs.get('recorded'))}",
        ),
        ("Encoder clock", clock_text(summary)),
    ]
    return Section("verdict", "Verdict", (headline(results), Facts(tuple(items))))


def clock_text(summary: dict[str, Any]) -> str:
    """Say the encoder clock's offset and where it comes from."""
    entry = summary.get("clock") or {}
    offset = with_uncertainty(
        entry.get("encoder_offset_s"), entry.get("standard_uncertainty_s"), "s"
    )
    if offset == DASH:
        return "not observable" if entry.get("observable") is False else DASH
    source = formatting.lookup_label(phrases.CLOCK_SOURCES, entry.get("source"))
    return f"{offset} (1σ), {source}"


def chart_or_text(results: Results, figure: Figure, otherwise: str) -> Block:
    """Show a figure where there is something to draw, else say in words why there is none."""
    return block_or_paragraph(figure, chart_of(FIGURES, results, figure.name), otherwise)


def joints(results: Results) -> Section:
    """Say what was found of each joint, and what could have been seen of it."""
    summary = results.summary
    entries = summary.get("joints") or []
    blocks: list[Block] = [_error_table(entries), _detectability_table(entries)]
    hidden = [j.get("joint") for j in entries if is_hidden(j)]
    if hidden:
        blocks.append(
            Paragraph(
                f"A constant offset of {name_joints(hidden)} could not have been seen in this "
                "session, however large: it moves the base or the LEDs that were fitted through "
                "the same encoders, or the clock. An error figure for such a joint says nothing "
                "about its zero.",
                "note",
            )
        )
    if summary.get("combinations"):
        blocks.append(_combination_table(summary["combinations"]))
    blocks.append(
        chart_or_text(
            results,
            Figure(
                "correlation",
                "Correlation of the joints' mean errors, systematic part included. Joints that "
                "trade against each other (near ±1) are to be judged by their sum as well.",
                "A square matrix of correlation coefficients, one row and one column a joint.",
            ),
            "The correlation of the joints' mean errors is not known.",
        )
    )
    return Section("joints", "Joints", tuple(blocks))


def _error_table(entries: list[dict[str, Any]]) -> Table:
    rows = []
    for joint in entries:
        tone = phrases.tone(joint.get("verdict"))
        label = phrases.verdict_text(joint.get("verdict"), joint.get("reason"))
        rows.append(
            row(
                text_or_dash(joint.get("joint")),
                with_uncertainty(
                    joint.get("mean_error_deg"), joint.get("expanded_uncertainty_deg")
                ),
                number(joint.get("coverage_factor"), 2),
                number(joint.get("rms_error_deg")),
                number(joint.get("max_abs_error_deg")),
                with_uncertainty(
                    joint.get("worst_error_deg"), joint.get("worst_error_standard_uncertainty_deg")
                ),
                bound
                if (bound := exact_number(joint.get("tolerance_deg"))) == DASH
                else f"±{bound}",
                probability(joint.get("conformance_probability")),
                Cell(label, tone),
            )
        )
    return Table(
        "Error (reading − true angle) of each joint, in degrees, over the measured pairs.",
        "crrrrrrrl",
        (
            "Joint",
            "Mean ± U [°]",
            "k",
            "RMS [°]",
            "Max |e| [°]",
            "Worst ê ± u [°]",
            "Tolerance [°]",
            "P(conform)",
            "Verdict",
        ),
        tuple(rows),
        (ERROR_NOTE,),
        wide=(8,),
    )


def _detectability_table(entries: list[dict[str, Any]]) -> Table:
    rows = tuple(
        row(
            text_or_dash(joint.get("joint")),
            count(joint.get("pairs")),
            percent(joint.get("visible_fraction")),
            percent(joint.get("visible_fraction_since_registration")),
            quantity(joint.get("minimum_detectable_error_deg"), ""),
            quantity(joint.get("minimum_separable_error_deg"), ""),
            phrases.visibility(joint),
        )
        for joint in entries
    )
    return Table(
        "What this session could see of a constant offset of each joint.",
        "crrrrrl",
        (
            "Joint",
            "Pairs",
            "Visible if before",
            "Visible if since",
            "Detectable [°]",
            "Separable [°]",
            "In words",
        ),
        rows,
        (DETECTABILITY_NOTE,),
        wide=(6,),
    )


def _combination_table(entries: list[dict[str, Any]]) -> Table:
    rows = tuple(
        row(
            text_or_dash(entry.get("label")),
            with_uncertainty(entry.get("mean_error_deg"), entry.get("standard_uncertainty_deg")),
            count(entry.get("pairs")),
            formatting.lookup_label(phrases.COUPLINGS, entry.get("why")),
        )
        for entry in entries
    )
    return Table(
        "Sums of joint errors that are known where their members are not, or better than they.",
        "lrrl",
        ("Sum", "Mean error ± u [°]", "Pairs", "Why it is given"),
        rows,
        wide=(3,),
    )


def diagnosis(results: Results) -> Section:
    """List the causes that the data single out, and those they do not tell apart."""
    entries = results.summary.get("diagnosis") or []
    if not entries:
        text = (
            "The data single out no cause: no fault beats its rivals by the margin that is asked."
        )
        return Section("diagnosis", "Diagnosis", (Paragraph(text), *_outlier_blocks(results)))
    table = Table(
        "Causes of the errors found.",
        "lrlrll",
        ("Cause", "Value ± U", "Unit", "Explains", "Runner-up", "What to do"),
        tuple(_cause_row(entry) for entry in entries),
        (CAUSE_NOTE,),
        wide=(0, 4, 5),
    )
    return Section("diagnosis", "Diagnosis", (table, *_outlier_blocks(results)))


def _cause_row(entry: dict[str, Any]) -> tuple[Cell, ...]:
    unclear = entry.get("kind") == "ambiguous"
    return row(
        f"ambiguous, one of: {causes.rivals(entry, '; ')}" if unclear else causes.cause_name(entry),
        DASH if unclear else causes.format_value(entry),  # each candidate says its own
        DASH if unclear else causes.unit_sign(entry),
        percent(entry.get("explains")),
        DASH if unclear else causes.runner_up(entry),
        causes.remedy(entry),
    )


def _outlier_blocks(results: Results) -> tuple[Block, ...]:
    """List the pairs that follow none of the causes."""
    pairs = results.summary.get("outlying_pairs") or []
    if not pairs:
        return ()
    shown = ", ".join(count(pair) for pair in pairs[:MAX_LISTED_PAIRS])
    more = (
        f" and {count(len(pairs) - MAX_LISTED_PAIRS)} more" if len(pairs) > MAX_LISTED_PAIRS else ""
    )
    text = (
        f"Left out of the diagnosis: {count(len(pairs))} of the pairs, which lie further off than "
        f"noise explains (numbers {shown}{more}). They count in every other figure."
    )
    return (Paragraph(text, "note"),)


def errors_over_time(results: Results) -> Section:
    """Show the errors of each joint over time."""
    frames = results.table("frames")
    thinned = ""
    if len(frames) > MAX_LINE_POINTS:
        thinned = (
            f" Of the {count(len(frames))} pairs, each short stretch is drawn by its smallest and "
            "its largest error; its band is the envelope of the bands, and a gap shorter than it "
            "is not seen."
        )
    figure = Figure(
        "joint_errors",
        "Error of each joint over time: of each pair with its ±2u band (all sources), the resolved "
        "error on which the verdict rests with its own, and the tolerance. Lines break where pairs "
        "are missing; the band of a pair near a singularity may leave the frame, an error does not."
        + thinned,
        "One strip a joint: error in degrees against time, with uncertainty bands, the resolved "
        "error's curve and the tolerance as dotted lines.",
    )
    block = chart_or_text(
        results, figure, "There is no measured pair with an encoder reading to draw."
    )
    return Section("errors", "Errors over time", (block,))


def pose(results: Results) -> Section:
    """Show position and orientation of the flange, measured and from the encoders."""
    nothing = "No pair gave the flange's pose."
    blocks: list[Block] = [_pose_table(results.summary)]
    figures = (
        Figure(
            "pose",
            "Position (left) and rotation vector (right) of the flange in the robot's base frame, "
            "measured and computed from the encoders.",
            "Six panels against time: x, y, z in millimetres and the three components of the "
            "rotation vector in degrees, each measured and from the encoders.",
        ),
        Figure(
            "pose_errors",
            "Position and orientation error of the flange: distance and angle between the measured "
            "and the encoders' pose of each pair, and the resolved joint errors carried "
            "through the arm.",
            "Two strips against time: position error in millimetres, orientation error in degrees.",
        ),
        Figure(
            "path",
            "Path of the flange in the robot's base frame.",
            "A curve in space drawn twice: measured, and from the encoders.",
        ),
    )
    drawn = [chart_or_text(results, figure, nothing) for figure in figures]
    blocks += [block for block in drawn if isinstance(block, Figure)] or drawn[:1]
    return Section("pose", "Position and orientation", tuple(blocks))


def _pose_table(summary: dict[str, Any]) -> Table:
    rows = []
    for name, key in (("position", "mm"), ("orientation", "deg")):
        entry = summary.get(name) or {}
        sign = formatting.UNITS[key]
        rows.append(
            row(
                f"{name} [{sign}]",
                number(entry.get(f"rms_error_{key}")),
                number(entry.get(f"max_error_{key}")),
                number(entry.get(f"expanded_uncertainty_{key}")),
                exact_number(entry.get(f"tolerance_{key}")),
                probability(entry.get("conformance_probability")),
                Cell(
                    formatting.lookup_label(phrases.VERDICTS, entry.get("verdict")),
                    phrases.tone(entry.get("verdict")),
                ),
            )
        )
    dof = summary.get("known_dof")
    posed = (summary.get("session") or {}).get("instrument")
    who = "The poses" if posed else "The LEDs"
    text = f"{who} determine {count(dof)} of the flange's 6 degrees of freedom." if dof else ""
    missing = [n for n in ("position", "orientation") if not summary.get(n)]
    if missing:
        text = f"{text} No figures for {join_words(missing)}.".strip()
    return Table(
        "Error of the flange's pose over the measured pairs.",
        "lrrrrrl",
        ("Error of", "RMS", "Max", "U of the mean", "Tolerance", "P(conform)", "Verdict"),
        tuple(rows),
        (text,) if text else (),
    )
