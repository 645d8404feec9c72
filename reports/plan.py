"""What the report of a planned session says, in which order.

The summary's keys, units in their names; what this motion would not show is null:

    kind                  "plan"
    tool, inputs, warnings, joint_error_correlation   as in a run's summary
    robot, robot_fingerprint; observe: kinds of fault that were asked for
    motion                duration_s, poses, visits, hold_s, there_and_back, view_angle_deg,
                          floor_mm, seed
    pairs                 recorded, measured, rejected, measured_share: as foreseen
    candidates            tried, excluded: postures by what excludes them
    conditions            rate_hz, skew_ms, spot_noise_px, reading_rate_hz, reading_noise_deg,
                          clock_standard_uncertainty_ms (null: found from the motion)
    joints                as a run's: standard_uncertainty_deg, expanded_uncertainty_deg,
                          coverage_factor, visible_fraction (…_since_registration),
                          minimum_detectable_error_deg, minimum_separable_error_deg; lowest_deg,
                          highest_deg, greatest_speed_deg_s, upward_share; kinds, each: kind,
                          unit (deg, percent), standard_uncertainty, minimum_detectable
    clock                 source, standard_uncertainty_s, minimum_detectable_error_s
    geometry              null, or supported, rank, candidates, parameters (name, unit,
                          standard_uncertainty), held (name, reason), observability
    through_encoders      base or LEDs were registered through the robot's own encoders
    uncounted             sources taken as exact
    image_size            px

Tables: trajectory, poses, pairs, spots, arm, cameras, shown, sources.
"""

from typing import Any

from reports.blocks import (
    Block,
    Document,
    Facts,
    Figure,
    Paragraph,
    Section,
    Table,
    Verdict,
    drawn_or_said,
    numbered,
    row,
)
from reports.formatting import (
    count,
    finite,
    number,
    percent,
    quantity,
    significant,
    stated,
    word,
)
from reports.formatting import joints as name_joints
from reports.plan_figures import PLAN_FIGURES
from reports.plan_words import CLOCKS, FIGURES, KINDS, REASONS, Words
from reports.results import Results
from reports.series import column, texts
from reports.sources import provenance, software
from reports.words import said

UNITS = {"deg": "°", "percent": "%", "mm": "mm"}


def document(results: Results) -> Document:
    """Lay out the whole report."""
    summary = results.summary
    sections = [verdict, joints, kinds, geometry, motion, candidates, conditions]
    if not summary.get("geometry"):
        sections.remove(geometry)
    fingerprint = word(summary.get("robot_fingerprint"))[:23]
    return numbered(
        Document(
            title=f"Planned session of {word(summary.get('robot'))}",
            subtitle="what the next session would show",
            footer=f"{software(summary)} · robot {fingerprint}",
            sections=tuple(section(results) for section in sections),
        )
    )


def verdict(results: Results) -> Section:
    """Open with the smallest offset that would be noticed, and with what cannot show."""
    summary = results.summary
    every = summary.get("joints") or []
    sizes = {j.get("joint"): finite(j.get("minimum_detectable_error_deg")) for j in every}
    known = {joint: size for joint, size in sizes.items() if size is not None}
    blind = [joint for joint, size in sizes.items() if size is None]
    sentences = []
    if known:
        worst = max(known, key=lambda joint: known[joint])
        sentences.append(
            f"A constant offset of {quantity(known[worst], '°')} or more would be noticed in "
            f"{'every joint' if not blind else name_joints(list(known))}."
        )
    if blind:
        sentences.append(f"An offset of {name_joints(blind)} cannot show.")
    remarks = [Words.SAME_JUDGEMENT, Words.OBSTACLES]
    if blind and summary.get("through_encoders"):
        remarks.insert(0, Words.HIDDEN)
    block = Verdict(
        tone="undecided" if blind else "none",
        label="What this motion would show",
        sentence=" ".join(sentences),
        remarks=tuple(remarks),
    )
    moved, pairs = summary.get("motion") or {}, summary.get("pairs") or {}
    clock = summary.get("clock") or {}
    facts = [
        ("Robot", word(summary.get("robot"))),
        ("Duration", quantity(moved.get("duration_s"), "s", 3)),
        ("Poses", count(moved.get("poses"))),
        ("Pairs measured", f"{count(pairs.get('measured'))} of {count(pairs.get('recorded'))}"),
        ("Encoders' clock", said(CLOCKS, clock.get("source"))),
    ]
    if finite(clock.get("standard_uncertainty_s")) is not None:
        facts.append(("Clock, u", quantity(1e3 * clock["standard_uncertainty_s"], "ms")))
    return Section("verdict", "Prediction", (block, Facts(tuple(facts))))


def joints(results: Results) -> Section:
    """Give each joint's uncertainty, and what would be noticed and told apart."""
    rows = tuple(
        row(
            word(joint.get("joint")),
            significant(joint.get("standard_uncertainty_deg")),
            significant(joint.get("expanded_uncertainty_deg")),
            number(joint.get("coverage_factor"), 2),
            significant(joint.get("minimum_detectable_error_deg")),
            significant(joint.get("minimum_separable_error_deg")),
            percent(joint.get("visible_fraction")),
        )
        for joint in results.summary.get("joints") or []
    )
    heads = ("Joint", "u [°]", "U [°]", "k", "Detectable [°]", "Separable [°]", "Visible")
    table = Table(
        "Predicted uncertainty and detectable error of each joint.", "crrrrrr", heads, rows,
        (Words.JOINTS,),
    )  # fmt: skip
    blocks = [table, _drawn(results, "plan_detectable"), *_sources(results)]
    return Section("joints", "Joints", (*blocks, _drawn(results, "correlation")))


def _sources(results: Results) -> tuple[Block, ...]:
    """Say what each joint's uncertainty is made of."""
    parts = results.table("sources")
    names = list(dict.fromkeys(texts(parts, "source")))
    every = results.summary.get("joints") or []
    if not names or not every:
        return ()
    sizes = column(parts, "standard_uncertainty_deg").reshape(len(names), len(every))
    rows = tuple(
        row(name, *(number(size, 4) for size in line))
        for name, line in zip(names, sizes.tolist(), strict=True)
    )
    heads = ("Source", *(f"q{joint.get('joint')} [°]" for joint in every))
    caption = "What the uncertainty of each joint's mean error comes from."
    return (Table(caption, "l" + "r" * len(every), heads, rows, (Words.SOURCES,)),)


def kinds(results: Results) -> Section:
    """Give every kind of fault that was asked for, a joint."""
    every = results.summary.get("joints") or []
    names = [str(k.get("kind")) for k in (every[0].get("kinds") if every else None) or []]
    if not names:
        return Section(
            "kinds", "Kinds of fault", (Paragraph("No fault of a joint was asked for."),)
        )
    heads = ["Joint"]
    units = {str(k.get("kind")): UNITS.get(str(k.get("unit")), "") for k in every[0]["kinds"]}
    for name in names:
        heads += [f"{said(KINDS, name)}, u [{units[name]}]", f"detectable [{units[name]}]"]
    rows = tuple(
        row(
            word(joint.get("joint")),
            *(
                significant(one.get(key))
                for one in joint.get("kinds") or []
                for key in ("standard_uncertainty", "minimum_detectable")
            ),
        )
        for joint in every
    )
    table = Table(
        "What would show of each kind of fault.", "c" + "rr" * len(names), tuple(heads), rows,
        (Words.KINDS,),
    )  # fmt: skip
    return Section("kinds", "Kinds of fault", (table,))


def geometry(results: Results) -> Section:
    """List which of the arm's parameters could be identified."""
    found: dict[str, Any] = results.summary.get("geometry") or {}
    rows = tuple(
        row(
            word(p.get("name")),
            UNITS.get(str(p.get("unit")), ""),
            significant(p.get("standard_uncertainty")),
        )
        for p in found.get("parameters") or []
    )
    facts = Facts(
        (
            (
                "Told apart",
                f"{count(found.get('rank'))} of {count(found.get('candidates'))} parameters",
            ),
        )
    )
    table = Table(
        "Parameters of the arm that could be identified.", "llr", ("Parameter", "Unit", "u"), rows,
        (Words.GEOMETRY,),
    )  # fmt: skip
    blocks: list[Block] = [facts, table]
    held = tuple(
        row(word(h.get("name")), said(REASONS, h.get("reason"))) for h in found.get("held") or []
    )
    if held:
        heads = ("Parameter", "Why it is held")
        blocks.append(Table("Parameters that could not be told.", "ll", heads, held))
    indexes = found.get("observability") or {}
    if indexes:
        listed = tuple(row(name, significant(value, 3)) for name, value in indexes.items())
        blocks.append(Table("Observability.", "lr", ("Index", "Value"), listed))
    return Section("geometry", "The arm's geometry", tuple(blocks))


def motion(results: Results) -> Section:
    """Show the motion, its path and the view of it."""
    rows = tuple(
        row(
            word(joint.get("joint")),
            number(joint.get("lowest_deg"), 1),
            number(joint.get("highest_deg"), 1),
            number(joint.get("greatest_speed_deg_s"), 1),
            percent(joint.get("upward_share")),
        )
        for joint in results.summary.get("joints") or []
    )
    heads = ("Joint", "Lowest [°]", "Highest [°]", "Fastest [°/s]", "Upward")
    table = Table("How the joints move.", "crrrr", heads, rows, (Words.SPAN,))
    figures = (_drawn(results, name) for name in ("plan_joints", "plan_path", "plan_view"))
    return Section("motion", "Motion", (table, *figures))


def candidates(results: Results) -> Section:
    """Say how many postures were drawn, and what excluded the others."""
    found = results.summary.get("candidates") or {}
    rows = tuple(
        row(word(name), count(number_of))
        for name, number_of in (found.get("excluded") or {}).items()
    )
    table = Table(
        "What excludes postures.", "lr", ("Excluded by", "Postures"), rows, (Words.EXCLUDED,)
    )
    drawn = Facts((("Postures drawn", count(found.get("tried"))),))
    return Section("candidates", "Postures", (drawn, table))


def conditions(results: Results) -> Section:
    """Say what the session is taken to be like, and what the plan was made from."""
    taken = results.summary.get("conditions") or {}
    moved = results.summary.get("motion") or {}
    clock = taken.get("clock_standard_uncertainty_ms")
    known = said(CLOCKS, "estimated") if clock is None else quantity(clock, "ms")
    facts = Facts(
        (
            ("Stereo pairs a second", stated(taken.get("rate_hz"))),
            ("Right picture after the left", quantity(taken.get("skew_ms"), "ms")),
            ("u of an LED's image", quantity(taken.get("spot_noise_px"), "px")),
            ("Encoder readings a second", stated(taken.get("reading_rate_hz"))),
            ("Scatter of a reading", quantity(taken.get("reading_noise_deg"), "°")),
            ("u of the encoders' clock", known),
            ("LEDs seen from the flange's z", quantity(moved.get("view_angle_deg"), "°", 3)),
            ("Software", software(results.summary)),
        )
    )  # fmt: skip
    return Section(
        "conditions", "Assumptions, files and software", (facts, *provenance(results.summary))
    )


def _drawn(results: Results, name: str) -> Block:
    words = FIGURES[name]
    drawing = PLAN_FIGURES[name](results)
    return drawn_or_said(Figure(name, words.caption, words.alt), drawing, words.otherwise)
