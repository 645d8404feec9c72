"""What was found: the joints, the causes, the errors over time, the pose."""

from collections.abc import Callable
from functools import partial
from typing import Any

from reports.document import blocks as doc
from reports.document import formatting as fmt
from reports.document.charts import MAX_LINE_POINTS, Chart, legend
from reports.results import Results
from reports.session import causes, phrases
from reports.session.figures import evidence, motion
from reports.session.headline import is_hidden

ERROR_NOTE = (
    "The verdict rests on ê, the resolved error: the curve through the errors that noise does not "
    "follow, causes found included. Mean: of ê over these pairs. U: expanded by the factor k. "
    "Max |e|, of single pairs, holds noise and is never judged."
)
DETECTABILITY_NOTE = (
    "Visible: share of an offset's signal that is left after the fit. Old: the offset was there "
    "at registration. New: it arose later. Detectable: the smallest offset that is detected "
    "(false alarm 0.1 %, power 80 %). Separable: the smallest that can be attributed to this joint "
    "alone. A dash: not known."
)
CAUSE_NOTE = (
    "A cause is named only where its fit beats every rival's by Δχ² ≥ 15 (at unequal numbers of "
    "parameters: BIC by 10). Explains: share of the weighted errors that goes with it. Runner-up: "
    "the rival that fits best in its place, and by how much worse."
)
MAX_LISTED_PAIRS = 30  # listed by their numbers; summary.json lists all


def clock_text(summary: dict[str, Any]) -> str:
    """Say the encoder clock's offset and where it comes from."""
    entry = summary.get("clock") or {}
    offset = doc.uncertain_field("encoder_offset_s", "standard_uncertainty_s", "s", k=2)(entry)
    if offset == fmt.DASH:
        return "not observable" if entry.get("observable") is False else fmt.DASH
    source = fmt.lookup_label(phrases.CLOCK_SOURCES, entry.get("source"))
    return f"{offset}{' (k = 2)' * ('±' in offset)}, {source}"


def joints(results: Results) -> doc.Section:
    """Say what was found of each joint, and what could have been seen of it."""
    summary = results.summary
    entries = summary.get("joints") or []
    blocks: list[doc.Block] = [_error_table(entries), _detectability_table(entries)]
    hidden = [j.get("joint") for j in entries if is_hidden(j)]
    if hidden:
        blocks.append(
            doc.Paragraph(
                f"A constant offset of {fmt.joint_names(hidden)} cannot show in this "
                "session, whatever its size: it moves the base or the LEDs that were fitted "
                "through the same encoders, or the clock. An error figure for such a joint says "
                "nothing about its zero.",
                "note",
            )
        )
    if summary.get("combinations"):
        blocks.append(_combination_table(summary["combinations"], summary["joints"]))
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
            "Largest ê ± U [°]", "r", phrases.worst_error(),
        ),
        doc.Column("Tolerance [°]", "r", doc.field("tolerance_deg", phrases.tolerance)),
        doc.Column("P(conform)", "r", doc.field("conformance_probability", fmt.probability)),
        doc.Column("Verdict", "l", phrases.verdict_cell, wide=True),
    )  # fmt: skip
    title = "Error (reading − true angle) of each joint, in degrees, over the measured pairs."
    return doc.tabulate(title, columns, entries, ERROR_NOTE)


def _detectability_table(entries: list[dict[str, Any]]) -> doc.Table:
    since = doc.field("visible_fraction_since_registration", fmt.percent)
    columns = (
        doc.Column("Joint", "c", doc.field("joint")),
        doc.Column("Pairs", "r", doc.field("pairs", fmt.count)),
        doc.Column("Visible, old offset", "r", doc.field("visible_fraction", fmt.percent)),
        doc.Column("Visible, new offset", "r", since),
        doc.Column(
            "Detectable [°]", "r", doc.field("minimum_detectable_error_deg", fmt.significant)
        ),
        doc.Column("Separable [°]", "r", doc.field("minimum_separable_error_deg", fmt.significant)),
        doc.Column("In words", "l", phrases.visibility, wide=True),
    )
    title = "How much of a constant offset of each joint this session can show."
    return doc.tabulate(title, columns, entries, DETECTABILITY_NOTE)


def _combination_table(entries: list[dict[str, Any]], joints: list[dict[str, Any]]) -> doc.Table:
    k = phrases.sum_factor(joints)
    value = doc.uncertain_field("mean_error_deg", "standard_uncertainty_deg", k=k)
    why = doc.field("why", partial(fmt.lookup_label, phrases.COUPLINGS))
    columns = (
        doc.Column("Sum", "l", lambda e: fmt.text_or_dash(e.get("label")).replace("-", fmt.MINUS)),
        doc.Column(f"Mean error ± U ({fmt.coverage_text(k)}) [°]", "r", value),
        doc.Column("Pairs", "r", doc.field("pairs", fmt.count)),
        doc.Column("Why it is given", "l", why, wide=True),
    )
    title = "Sums of joint errors that are known where their members are not, or better than they."
    return doc.tabulate(title, columns, entries)


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
    factors = fmt.coverage_text(*(causes.coverage_factor(entry) for entry in entries))
    title = f"Causes of the errors found, {factors}."
    table = doc.tabulate(title, columns, entries, CAUSE_NOTE)
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
        f"Left out of the diagnosis: {fmt.count(len(pairs))} pairs that lie further off than noise "
        f"explains (numbers {shown}{more}). They count in every other figure."
    )
    if len(pairs) == 1:
        text = (
            f"Left out of the diagnosis: pair {shown}, which lies further off than noise explains. "
            "It counts in every other figure."
        )
    return (doc.Paragraph(text, "note"),)


def errors_over_time(results: Results) -> doc.Section:
    """Show the errors of each joint and of the flange over time."""
    frames = results.table("frames")
    thinned = ""
    if len(frames) > MAX_LINE_POINTS:
        thinned = (
            f" Of the {fmt.count(len(frames))} pairs, each short stretch is drawn by its smallest "
            "and its largest error; its band is the envelope of the bands, and a gap shorter than "
            "it is not seen."
        )
    drawing = motion.joint_errors(results)
    named = legend(drawing) if isinstance(drawing, Chart) else {}
    band = " with its ±2u band (all sources)" * ("±2u of a pair" in named)
    # single pairs do not determine the joints of an arm of more than six
    pairs = f"of each pair{band}, " * ("error of a pair" in named)
    figure = doc.Figure(
        "joint_errors",
        f"Error of each joint over time: {pairs}the resolved error on which the verdict "
        "rests with its own ±2u band, and the tolerance. Lines break where pairs are "
        "missing; the band of a pair near a singularity may leave the frame, an error does not."
        + thinned,
        "One strip a joint: error in degrees against time, with uncertainty bands, the resolved "
        "error's curve and the tolerance as dotted lines.",
    )
    carried = motion.pose_errors(results)
    of_pairs = "distance and angle between the measured and the encoders' pose of each pair, and "
    single = isinstance(carried, Chart) and "error of a pair" in legend(carried)
    flange = doc.Figure(
        "pose_errors",
        f"Position and orientation error of the flange: {of_pairs * single}the resolved joint "
        "errors carried through the arm.",
        "Two strips against time: position error in millimetres, orientation error in degrees.",
        carried,
    )
    otherwise = "There is no measured pair with an encoder reading to draw."
    block = doc.block_or_paragraph(figure, drawing, otherwise)
    shown = (flange,) if flange.drawing is not None else ()
    return doc.Section("errors", "Errors over time", (block, *shown))


def path(results: Results) -> doc.Section:
    """Show where along its path the flange is off, and by how much."""
    figure = doc.Figure(
        "path",
        "Measured path of the flange in the robot's base frame, in space and from above, coloured "
        "by its position error, resolved; no line where pairs are missing. U: k = 2. Colours that "
        "differ by less than U show no difference.",
        "The path as a curve in space and from above, coloured by the size of the position error.",
        motion.flange_path(results),
    )
    return doc.Section("path", "Error along the path", _drawn((figure,), results.summary))


def components(results: Results) -> doc.Section:
    """Show the components of the flange's pose, measured and from the encoders."""
    drawing = motion.pose(results)
    measured = isinstance(drawing, Chart) and "measured" in legend(drawing)
    figure = doc.Figure(
        "pose",
        "Position (x, y, z) and rotation vector (rx, ry, rz) of the flange in the robot's base "
        f"frame, {'measured and ' * measured}computed from the encoders.",
        "Six panels against time: x, y, z in millimetres and the three components of the "
        f"rotation vector in degrees, {'each measured and ' * measured}from the encoders.",
        drawing,
    )
    blocks = _drawn((figure,), results.summary)
    return doc.Section("components", "Components of the pose", blocks)


def _drawn(figures: tuple[doc.Figure, ...], summary: dict[str, Any]) -> tuple[doc.Block, ...]:
    """The figures that show anything, and how much of the pose is known."""
    drawn = tuple(figure for figure in figures if figure.drawing is not None)
    dof = summary.get("known_dof")
    who = "The poses" if (summary.get("session") or {}).get("instrument") else "The LEDs"
    known = f"{who} determine {fmt.count(dof)} of the flange's 6 degrees of freedom."
    note = (doc.Paragraph(known, "note"),) if dof not in (None, 6) else ()
    return (*note, *(drawn or (doc.Paragraph("No pair gave the flange's pose.", "note"),)))
