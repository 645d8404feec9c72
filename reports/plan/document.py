"""What the report of a planned session says, in which order. Keys: docs/plan.md."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from reports.document import blocks as doc
from reports.document.charts import column, records, texts
from reports.document.formatting import (
    DASH,
    count,
    exact_number,
    expanded,
    finite,
    join_words,
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
from reports.plan.words import ASSUMED, CLOCKS, KINDS, PARTS, REASONS, UNITS, PlanNotes
from reports.results import Results
from reports.session.figures.evidence import correlation

FIGURES = {
    "plan_detectable": doc.FigurePlan(
        figures.detectable,
        "Expanded uncertainty (k = 2) of each joint's mean error, and the smallest constant offset "
        "that will be detected.",
        "Two upright bars a joint, in degrees.",
        "This motion shows no joint's offset.",
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
        "The motion was not stored.",
    ),
    "plan_path": doc.FigurePlan(
        figures.path,
        "Path of the flange, the arm at some of the poses, and the cameras with their optical "
        "axes; robot's base frame.",
        "Lines in space: the path of the flange, the arm's links, the cameras' axes.",
        "The path of the arm was not stored.",
    ),
    "plan_view": doc.FigurePlan(
        figures.view,
        "The LEDs in both pictures, all pairs of the session.",
        "Two pictures with the images of every LED, in pixels.",
        "The LEDs' images were not stored.",
    ),
}

_figure_block = partial(doc.figure_or_text, FIGURES)


def document(results: Results) -> doc.Document:
    """Lay out the whole report: how well each joint will be known, the poses, then the evidence."""
    summary = results.summary
    fingerprint = text_or_dash(summary.get("robot_fingerprint"))[:23]
    evidence = [motion, kinds, *([identifiable_parameters] if summary.get("geometry") else [])]
    appendix = (replace(s(results), part="appendix") for s in (joints, candidates, conditions))
    return doc.lay_out(
        title=f"Planned session of {text_or_dash(summary.get('robot'))}",
        subtitle="how well each joint will be known",
        footer=f"{doc.software(summary)} · robot {fingerprint}",
        sections=(*(s(results) for s in (prediction, poses, *evidence)), *appendix),
    )


def prediction(results: Results) -> doc.Section:
    """Say on one page how well each joint will be known, and on which conditions."""
    summary = results.summary
    facts = doc.Facts(tuple(_facts(summary)), columns=2)
    blocks = (_answer(summary), facts, _figure_block(results, "plan_detectable"), _known(summary))
    return doc.Section("verdict", "Prediction", blocks, part="page")


def _answer(summary: dict[str, Any]) -> doc.Verdict:
    """The range of the joints' uncertainties, what would be noticed, and what cannot show."""
    every = summary.get("joints") or []
    known = {j.get("joint"): finite(j.get("expanded_uncertainty_deg")) for j in every}
    sizes = {j.get("joint"): finite(j.get("minimum_detectable_error_deg")) for j in every}
    blind = [joint for joint, size in sizes.items() if size is None]
    stated = {joint: u for joint, u in known.items() if u is not None and joint not in blind}
    detectable = {joint: size for joint, size in sizes.items() if size is not None}
    sentences = []
    if stated:
        best, worst = min(stated, key=stated.__getitem__), max(stated, key=stated.__getitem__)
        sentences.append(
            f"The mean error of each joint will be known to ±{quantity(stated[best], '°')} "
            f"(joint {best}) to ±{quantity(stated[worst], '°')} (joint {worst}), k = 2."
        )
    if detectable:
        whose = "every joint" if not blind else name_joints(list(detectable))
        least = quantity(max(detectable.values()), "°")
        sentences.append(f"A constant offset of {least} or more will be detected in {whose}.")
    if blind:
        sentences.append(f"This motion cannot show an offset of {name_joints(blind)}.")
    remarks = [PlanNotes.SAME_ANALYSIS, PlanNotes.OBSTACLES]
    if exact := summary.get("uncounted"):
        names = join_words([text_or_dash(name) for name in exact])
        remarks.insert(0, PlanNotes.EXACT.format(names))
    if summary.get("rig"):
        remarks.insert(0, PlanNotes.TO_BE_BUILT)
    if blind and summary.get("through_encoders"):
        remarks.insert(0, PlanNotes.HIDDEN)
    return doc.Verdict(
        tone="undecided" if blind else "none",
        label="How well each joint will be known",
        sentence=" ".join(sentences),
        remarks=tuple(remarks),
    )


def _facts(summary: dict[str, Any]) -> list[tuple[str, str]]:
    moved, pairs = summary.get("motion") or {}, summary.get("pairs") or {}
    clock, flange = summary.get("clock") or {}, summary.get("flange") or {}
    facts = [
        ("Robot", text_or_dash(summary.get("robot"))),
        ("Poses", count(moved.get("poses"))),
        ("Duration", quantity(moved.get("duration_s"), "s", 3)),
        ("Pairs measured", f"{count(pairs.get('measured'))} of {count(pairs.get('recorded'))}"),
        ("Encoders' clock", lookup_label(CLOCKS, clock.get("source"))),
    ]
    if finite(clock.get("standard_uncertainty_s")) is not None:
        facts.append(("Clock, U (k = 2)", quantity(2e3 * clock["standard_uncertainty_s"], "ms")))
    if flange:
        mm, deg = (expanded(flange.get(f"standard_uncertainty_{unit}")) for unit in ("mm", "deg"))
        facts.append(("Flange, one pair", f"±{quantity(mm, 'mm')}, ±{quantity(deg, '°')}"))
    if rig := summary.get("rig"):
        size = " × ".join(count(n).replace("\u202f", "") for n in rig["image_size"])
        facts += [
            ("Cameras", f"{size} px, {rig['field_of_view_deg']:g}° wide"),
            ("Baseline, distance", f"{rig['baseline_m']:g} m, {rig['distance_m']:g} m"),
            ("Turned inwards", f"{rig['vergence_deg']:.1f}° each"),
            ("LEDs", f"{rig['leds']} on a circle of {rig['led_circle_mm']:g} mm"),
        ]
    return facts


def _known(summary: dict[str, Any]) -> doc.Table:
    """Each joint's uncertainty, what it moves at the flange, and what it comes from."""
    every = summary.get("joints") or []
    groups = list((every[0].get("parts_deg") if every else None) or {})
    columns = [
        doc.Column("Joint", "c", doc.field("joint")),
        doc.Column("U [°]", "r", doc.field("expanded_uncertainty_deg", significant)),
        doc.Column("At the flange [mm]", "r", _at_flange),
        *(doc.Column(f"{PARTS.get(g, g)} [°]", "r", _part_field(g)) for g in groups),
        doc.Column("Detectable [°]", "r", doc.field("minimum_detectable_error_deg", significant)),
    ]
    notes = [PlanNotes.KNOWN]
    if any(finite(j.get("tolerance_deg")) is not None for j in every):
        columns += [
            doc.Column("Tolerance [°]", "r", doc.field("tolerance_deg", exact_number)),
            doc.Column("Conforms to [°]", "r", doc.field("conform_limit_deg", significant)),
        ]
        notes.append(PlanNotes.CONFORMS)
    title = "How well the mean error of each joint will be known, and what limits it (k = 2)."
    return doc.tabulate(title, columns, every, *notes)


def _at_flange(joint: Mapping[str, Any]) -> str:
    u, lever = finite(joint.get("expanded_uncertainty_deg")), finite(joint.get("lever_mm"))
    return DASH if u is None or lever is None else significant(math.radians(u) * lever)


def _part_field(group: str) -> Callable[[Mapping[str, Any]], str]:
    return lambda joint: significant(expanded((joint.get("parts_deg") or {}).get(group)))


def poses(results: Results) -> doc.Section:
    """List the poses, each where it is first reached."""
    first: dict[float, dict[str, Any]] = {}
    for row, entry in enumerate(records(results.table("poses"))):
        pose = finite(entry.get("pose"))
        if pose == 1 or (row and pose is not None):
            first.setdefault(pose, entry)
    columns = [
        doc.Column("Pose", "c", doc.field("pose", count)),
        doc.Column("First reached [s]", "r", doc.field("arrive_s", number, 1)),
    ]
    for joint in results.summary.get("joints") or []:
        name = f"q{joint.get('joint')}"
        columns.append(doc.Column(f"{name} [°]", "r", doc.field(f"{name}_deg", number, 1)))
    listed = [first[pose] for pose in sorted(first)]
    table = doc.tabulate("The poses.", columns, listed, PlanNotes.POSES)
    return doc.Section("poses", "Poses", (table,))


def joints(results: Results) -> doc.Section:
    """Give each joint's uncertainty, its sources, and how the joints' errors correlate."""
    columns = (
        doc.Column("Joint", "c", doc.field("joint")),
        doc.Column("U [°]", "r", doc.field("expanded_uncertainty_deg", significant)),
        doc.Column("k", "r", doc.field("coverage_factor", number, 2)),
        doc.Column("Largest U [°]", "r", doc.expanded_field("largest_standard_uncertainty_deg")),
        doc.Column("Detectable [°]", "r", doc.field("minimum_detectable_error_deg", significant)),
        doc.Column("Separable [°]", "r", doc.field("minimum_separable_error_deg", significant)),
        doc.Column("Visible", "r", doc.field("visible_fraction", percent)),
    )
    title = "Predicted uncertainty and detectable error of each joint."
    table = doc.tabulate(title, columns, results.summary.get("joints") or [], PlanNotes.JOINTS)
    blocks = [table, *_sources(results), _figure_block(results, "correlation")]
    return doc.Section("joints", "Joints", tuple(blocks))


def _sources(results: Results) -> tuple[doc.Block, ...]:
    parts = results.table("sources")
    names = list(dict.fromkeys(texts(parts, "source")))
    every = results.summary.get("joints") or []
    if not names or not every:
        return ()
    sizes = column(parts, "standard_uncertainty_deg").reshape(len(names), len(every))
    rows = tuple(
        doc.row(name, *(significant(expanded(size)) for size in line))
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
    path, view, angles = (
        _figure_block(results, name) for name in ("plan_path", "plan_view", "plan_joints")
    )
    return doc.Section("motion", "Motion", (path, _cameras(results), view, table, angles))


def _cameras(results: Results) -> doc.Table:
    """Where the cameras stand, and where they look."""
    columns = (
        doc.Column("Camera", "l", doc.field("camera")),
        *(doc.Column(f"{a} [mm]", "r", doc.field(f"{a}_mm", number, 0)) for a in "xyz"),
        *(doc.Column(f"axis {a}", "r", doc.field(f"axis_{a}", number)) for a in "xyz"),
    )
    entries = records(results.table("cameras"))
    return doc.tabulate("Where the cameras stand and look; robot's base frame.", columns, entries)


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
    """State the assumptions about the session, and the files that the plan was made from."""
    taken = results.summary.get("conditions") or {}
    moved = results.summary.get("motion") or {}
    clock = taken.get("clock_standard_uncertainty_ms")
    clock_text = lookup_label(CLOCKS, "estimated") if clock is None else quantity(clock, "ms")
    facts = doc.Facts(
        (
            ("Stereo pairs per second", exact_number(taken.get("rate_hz"))),
            ("Right picture after the left", quantity(taken.get("skew_ms"), "ms")),
            ("Scatter of an LED's image (1σ)", quantity(taken.get("spot_noise_px"), "px")),
            ("Encoder readings per second", exact_number(taken.get("reading_rate_hz"))),
            ("Scatter of a reading (1σ)", quantity(taken.get("reading_noise_deg"), "°")),
            ("Encoders' clock known to (1σ)", clock_text),
            ("LEDs seen from the flange's z", quantity(moved.get("view_angle_deg"), "°", 3)),
            ("Software", doc.software(results.summary)),
        )
    )  # fmt: skip
    blocks: list[doc.Block] = [facts]
    if rig := results.summary.get("rig"):
        rows = tuple(
            doc.row(ASSUMED.get(name, name), exact_number(u))
            for name, u in rig["standard_uncertainties"].items()
        )
        title = "Standard uncertainties assumed of a rig that does not exist yet (k = 1)."
        blocks.append(doc.Table(title, "lr", ("Of", "Assumed"), rows, (PlanNotes.ASSUMED,)))
    blocks += doc.provenance(results.summary)
    return doc.Section("conditions", "Assumptions, files and software", tuple(blocks))
