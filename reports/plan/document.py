"""What the report of a planned session says, in which order. Keys: docs/plan.md."""

from collections.abc import Callable
from functools import partial
from typing import Any

from reports.document import blocks as doc
from reports.document.charts import column, texts
from reports.document.formatting import (
    count,
    exact_number,
    expanded,
    finite,
    lookup_label,
    number,
    percent,
    quantity,
    significant,
    text_or_dash,
)
from reports.document.formatting import joint_names as name_joints
from reports.identification.document import observability_table
from reports.plan import figures
from reports.results import Results
from reports.session.figures.evidence import correlation

KINDS = {
    "offsets": "Offset",
    "gains": "Gain",
    "backlash": "Backlash",
    "eccentricity": "Eccentricity",
}
CLOCKS = {
    "estimated": "found from the motion",
    "given": "given",
    "none": "the motion does not show it",
}
REASONS = {"gauge": "gauge", "not_supported": "not supported"}


class PlanNotes:
    """Sentences, and notes that stand under tables."""

    SAME_JUDGEMENT = (
        "Predicted by the judgement itself, from the spots that this motion would show: what the "
        "run's report will state, if the session is as assumed below and nothing is at fault."
    )
    OBSTACLES = (
        "Obstacles and cables are not known to the plan: bring the arm to the first pose and try "
        "the motion slowly first."
    )
    JOINTS = (
        "U: expanded uncertainty of the joint's mean error (k as stated). Detectable: the smallest "
        "constant offset that would be noticed (false alarm 0.1 %, power 80 %). Separable: the "
        "smallest that can be attributed to this joint alone. Visible: the share of an offset that "
        "was there at registration. The mean weights every pair alike. The fit behind the "
        "detectable offset also estimates the errors of rig and LEDs from the whole motion, so it "
        "may detect less than U."
    )
    SOURCES = (
        "U, k = 2; the largest is the one to mend first. What does not average out "
        "is no smaller for a longer session."
    )
    HIDDEN = (
        "Base or LEDs were registered through the robot's own encoders: what a registration from "
        "these hides of an offset, no motion shows."
    )
    KINDS = (
        "U (k = 2): with all requested kinds estimated together. Detectable: the smallest that "
        "would be noticed if it were alone. A dash: this motion does not show it."
    )
    SPAN = (
        "Upward: the share of pairs whose last travel was upward. Backlash shows where both "
        "directions occur."
    )
    EXCLUDED = "Each posture counts once, under the first that excludes it, in this order."
    GEOMETRY = (
        "U (k = 2) of what `verify identify` would find with base and LEDs held as "
        "their files state them. No motion can determine a gauge."
    )


FIGURES = {
    "plan_detectable": doc.FigurePlan(
        figures.detectable,
        "Predicted of each joint: expanded uncertainty of its mean error, and the smallest "
        "constant offset that would be noticed.",
        "Two upright bars a joint, in degrees.",
        "No joint's offset would show.",
    ),
    "correlation": doc.FigurePlan(
        correlation,
        "Predicted correlation of the joints' mean errors.",
        "A square matrix of correlation coefficients, one row and one column a joint.",
        "The correlation of the joints' mean errors is not known.",
    ),
    "plan_joints": doc.FigurePlan(
        figures.over_time,
        "The joints over time.",
        "Strips over time, one a joint, in degrees.",
        "The motion was not kept.",
    ),
    "plan_path": doc.FigurePlan(
        figures.path,
        "The flange's way, the arm at some of the poses, and the cameras with their view; robot's "
        "base frame.",
        "Lines in space: the flange's way, the arm's links, the cameras' axes.",
        "The arm's way was not kept.",
    ),
    "plan_view": doc.FigurePlan(
        figures.view,
        "The LEDs in both pictures, all pairs of the session.",
        "Two pictures with the places of every LED in them, in pixels.",
        "The LEDs' places were not kept.",
    ),
}


UNITS = {"deg": "°", "percent": "%", "mm": "mm"}

_figure_block = partial(doc.figure_or_text, FIGURES)


def document(results: Results) -> doc.Document:
    """Lay out the whole report."""
    summary = results.summary
    sections = [verdict, joints, kinds, identifiable_parameters, motion, candidates, conditions]
    if not summary.get("geometry"):
        sections.remove(identifiable_parameters)
    fingerprint = text_or_dash(summary.get("robot_fingerprint"))[:23]
    return doc.lay_out(
        title=f"Planned session of {text_or_dash(summary.get('robot'))}",
        subtitle="what the next session would show",
        footer=f"{doc.software(summary)} · robot {fingerprint}",
        sections=(section(results) for section in sections),
    )


def verdict(results: Results) -> doc.Section:
    """Open with the smallest offset that would be noticed, and with what cannot show."""
    summary = results.summary
    every = summary.get("joints") or []
    sizes = {j.get("joint"): finite(j.get("minimum_detectable_error_deg")) for j in every}
    detectable = {joint: size for joint, size in sizes.items() if size is not None}
    blind = [joint for joint, size in sizes.items() if size is None]
    sentences = []
    if detectable:
        worst = max(detectable, key=lambda joint: detectable[joint])
        sentences.append(
            f"A constant offset of {quantity(detectable[worst], '°')} or more would be noticed in "
            f"{'every joint' if not blind else name_joints(list(detectable))}."
        )
    if blind:
        sentences.append(f"An offset of {name_joints(blind)} cannot show.")
    remarks = [PlanNotes.SAME_JUDGEMENT, PlanNotes.OBSTACLES]
    if blind and summary.get("through_encoders"):
        remarks.insert(0, PlanNotes.HIDDEN)
    block = doc.Verdict(
        tone="undecided" if blind else "none",
        label="What this motion would show",
        sentence=" ".join(sentences),
        remarks=tuple(remarks),
    )
    moved, pairs = summary.get("motion") or {}, summary.get("pairs") or {}
    clock = summary.get("clock") or {}
    facts = [
        ("Robot", text_or_dash(summary.get("robot"))),
        ("Duration", quantity(moved.get("duration_s"), "s", 3)),
        ("Poses", count(moved.get("poses"))),
        ("Pairs measured", f"{count(pairs.get('measured'))} of {count(pairs.get('recorded'))}"),
        ("Encoders' clock", lookup_label(CLOCKS, clock.get("source"))),
    ]
    if finite(clock.get("standard_uncertainty_s")) is not None:
        facts.append(("Clock, U (k = 2)", quantity(2e3 * clock["standard_uncertainty_s"], "ms")))
    return doc.Section("verdict", "Prediction", (block, doc.Facts(tuple(facts))))


def joints(results: Results) -> doc.Section:
    """Give each joint's uncertainty, and what would be noticed and told apart."""
    columns = (
        doc.Column("Joint", "c", doc.field("joint")),
        doc.Column("U [°]", "r", doc.field("expanded_uncertainty_deg", significant)),
        doc.Column("k", "r", doc.field("coverage_factor", number, 2)),
        doc.Column("Detectable [°]", "r", doc.field("minimum_detectable_error_deg", significant)),
        doc.Column("Separable [°]", "r", doc.field("minimum_separable_error_deg", significant)),
        doc.Column("Visible", "r", doc.field("visible_fraction", percent)),
    )
    title = "Predicted uncertainty and detectable error of each joint."
    table = doc.tabulate(title, columns, results.summary.get("joints") or [], PlanNotes.JOINTS)
    blocks = [table, _figure_block(results, "plan_detectable"), *_sources(results)]
    return doc.Section("joints", "Joints", (*blocks, _figure_block(results, "correlation")))


def _sources(results: Results) -> tuple[doc.Block, ...]:
    parts = results.table("sources")
    names = list(dict.fromkeys(texts(parts, "source")))
    every = results.summary.get("joints") or []
    if not names or not every:
        return ()
    sizes = column(parts, "standard_uncertainty_deg").reshape(len(names), len(every))
    rows = tuple(
        doc.row(name, *(number(expanded(size), 4) for size in line))
        for name, line in zip(names, sizes.tolist(), strict=True)
    )
    heads = ("Source", *(f"q{joint.get('joint')} [°]" for joint in every))
    caption = "What the uncertainty of each joint's mean error comes from."
    return (doc.Table(caption, "l" + "r" * len(every), heads, rows, (PlanNotes.SOURCES,)),)


def kinds(results: Results) -> doc.Section:
    """Give every kind of fault that was asked for, a joint."""
    every = results.summary.get("joints") or []
    requested = (every[0].get("kinds") if every else None) or []
    if not requested:
        text = doc.Paragraph("No fault of a joint was asked for.")
        return doc.Section("kinds", "Kinds of fault", (text,))
    columns = [doc.Column("Joint", "c", doc.field("joint"))]
    for i, kind in enumerate(requested):
        unit = UNITS.get(str(kind.get("unit")), "")
        name = lookup_label(KINDS, kind.get("kind"))
        columns += [
            doc.Column(
                f"{name}, U [{unit}]", "r", _kind_field(i, "standard_uncertainty", expanded)
            ),
            doc.Column(f"detectable [{unit}]", "r", _kind_field(i, "minimum_detectable", finite)),
        ]
    table = doc.tabulate("What would show of each kind of fault.", columns, every, PlanNotes.KINDS)
    return doc.Section("kinds", "Kinds of fault", (table,))


def _kind_field(place: int, key: str, scaled: Callable[[Any], Any]) -> Callable[[Any], str]:
    return lambda joint: significant(scaled(joint["kinds"][place].get(key)))


def identifiable_parameters(results: Results) -> doc.Section:
    """List which of the arm's parameters could be identified."""
    found: dict[str, Any] = results.summary.get("geometry") or {}
    columns: tuple[doc.Column, ...] = (
        doc.Column("Parameter", "l", doc.field("name")),
        doc.Column("Unit", "l", lambda e: UNITS.get(str(e.get("unit")), "")),
        doc.Column("U", "r", doc.expanded_field("standard_uncertainty")),
    )
    title = "Parameters of the arm that could be identified."
    table = doc.tabulate(title, columns, found.get("parameters") or [], PlanNotes.GEOMETRY)
    rank = f"{count(found.get('rank'))} of {count(found.get('candidates'))} parameters"
    blocks: list[doc.Block] = [doc.Facts((("Determined", rank),)), table]
    if found.get("held"):
        columns = (
            doc.Column("Parameter", "l", doc.field("name")),
            doc.Column("Why it is held", "l", lambda e: lookup_label(REASONS, e.get("reason"))),
        )
        blocks.append(
            doc.tabulate("Parameters that this motion does not determine.", columns, found["held"])
        )
    if found.get("observability"):
        blocks.append(observability_table(found["observability"]))
    return doc.Section("geometry", "The arm's geometry", tuple(blocks))


def motion(results: Results) -> doc.Section:
    """Show the motion, its path and the view of it."""
    columns = (
        doc.Column("Joint", "c", doc.field("joint")),
        doc.Column("Lowest [°]", "r", doc.field("lowest_deg", number, 1)),
        doc.Column("Highest [°]", "r", doc.field("highest_deg", number, 1)),
        doc.Column("Fastest [°/s]", "r", doc.field("greatest_speed_deg_s", number, 1)),
        doc.Column("Upward", "r", doc.field("upward_share", percent)),
    )
    entries = results.summary.get("joints") or []
    table = doc.tabulate("How the joints move.", columns, entries, PlanNotes.SPAN)
    shown = (_figure_block(results, name) for name in ("plan_joints", "plan_path", "plan_view"))
    return doc.Section("motion", "Motion", (table, *shown))


def candidates(results: Results) -> doc.Section:
    """Say how many postures were drawn, and what excluded the others."""
    found = results.summary.get("candidates") or {}
    rows = tuple(
        doc.row(text_or_dash(name), count(number_of))
        for name, number_of in (found.get("excluded") or {}).items()
    )
    table = doc.Table(
        "What excludes postures.", "lr", ("Excluded by", "Postures"), rows, (PlanNotes.EXCLUDED,)
    )
    drawn = doc.Facts((("Postures drawn", count(found.get("tried"))),))
    return doc.Section("candidates", "Postures", (drawn, table))


def conditions(results: Results) -> doc.Section:
    """Say what the session is taken to be like, and what the plan was made from."""
    taken = results.summary.get("conditions") or {}
    moved = results.summary.get("motion") or {}
    clock = taken.get("clock_standard_uncertainty_ms")
    clock_text = lookup_label(CLOCKS, "estimated") if clock is None else quantity(clock, "ms")
    facts = doc.Facts(
        (
            ("Stereo pairs a second", exact_number(taken.get("rate_hz"))),
            ("Right picture after the left", quantity(taken.get("skew_ms"), "ms")),
            ("Scatter of an LED's image (1σ)", quantity(taken.get("spot_noise_px"), "px")),
            ("Encoder readings a second", exact_number(taken.get("reading_rate_hz"))),
            ("Scatter of a reading (1σ)", quantity(taken.get("reading_noise_deg"), "°")),
            ("Encoders' clock known to (1σ)", clock_text),
            ("LEDs seen from the flange's z", quantity(moved.get("view_angle_deg"), "°", 3)),
            ("Software", doc.software(results.summary)),
        )
    )  # fmt: skip
    return doc.Section(
        "conditions", "Assumptions, files and software", (facts, *doc.provenance(results.summary))
    )
