"""What the report of a grab says, in which order. Keys: docs/grab.md."""

from functools import partial

from reports.document import blocks as doc
from reports.document import formatting as fmt
from reports.document.charts import column, records, texts
from reports.grasp import figures
from reports.grasp.certificate import as_sentence, certificate
from reports.results import Results

STATE_ORDER = ("idle", "following", "approaching", "closing", "lifting", "lifted", "missed")
FIGURES = {
    "states": doc.FigurePlan(
        figures.states,
        "The states over time.",
        "A bar for each state's time",
        "It was too short to draw.",
    ),
    "track": doc.FigurePlan(
        figures.track,
        "Track of the target and path of the grip point, in the robot's base frame.",
        "Lines in space: target and grip point",
        "The target was not seen by both cameras.",
    ),
    "camshift": doc.FigurePlan(
        figures.windows,
        "CAMSHIFT in both pictures: centre and size of the target's box, quality.",
        "Strips over time: centre, size, quality",
        "CAMSHIFT found nothing of the target's colours.",
    ),
    "joints": doc.FigurePlan(
        figures.joints,
        "Joint angles, read and ordered.",
        "Six strips of joint angles",
        "No joint angles were read.",
    ),
    "margins": doc.FigurePlan(
        figures.margins,
        "Expanded uncertainty U (k = 2) of the target's position in the base frame, and the "
        "clearance that the gripper leaves. From the descent on, the hand hides part of the "
        "target.",
        "Three lines over time, and the gripper's clearance",
        "The target's position was not measured.",
    ),
}

_figure_block = partial(doc.figure_or_text, FIGURES)


def document(results: Results) -> doc.Document:
    """Lay out the whole report."""
    summary = results.summary
    cell = fmt.text_or_dash(summary.get("cell"))
    return doc.lay_out(
        title=f"Grab with {fmt.text_or_dash(summary.get('robot'))}",
        subtitle=f"{fmt.text_or_dash(summary.get('target'))}, {cell} cell",
        footer=f"{doc.software(summary)} · grab",
        sections=doc.answer_and_evidence(results, certificate, EVIDENCE),
    )


def _track(results: Results) -> doc.Section:
    return doc.Section("track", "Track", (_figure_block(results, "track"),))


def _camshift(results: Results) -> doc.Section:
    return doc.Section("camshift", "CAMSHIFT over time", (_figure_block(results, "camshift"),))


def _states(results: Results) -> doc.Section:
    columns = (
        doc.Column("t [s]", "r", doc.field("t_s", fmt.number, 2)),
        doc.Column("From", "l", doc.field("from_state", str)),
        doc.Column("To", "l", doc.field("to_state", str)),
        doc.Column("Event", "l", doc.field("event", str)),
        doc.Column("Because", "l", doc.field("reason", str), wide=True),
    )
    passages = records(results.table("passages"))
    table = doc.tabulate("Every change of state.", columns, passages)
    return doc.Section("states", "States over time", (_figure_block(results, "states"), table))


def _joints(results: Results) -> doc.Section:
    blocks: list[doc.Block] = [_figure_block(results, "joints")]
    table = results.table("cycles")
    names, t = texts(table, "state"), column(table, "t_s")
    rows = []
    for stage in STATE_ORDER:
        if stage in names:
            first = names.index(stage)
            angles = [column(table, f"q{n}_deg")[first] for n in range(1, figures.N_JOINTS + 1)]
            rows.append(
                doc.row(stage, fmt.number(t[first], 2), *(fmt.number(q, 2) for q in angles))
            )
    if rows:
        numbers = range(1, figures.N_JOINTS + 1)
        head = ("Beginning of", "t [s]", *(f"Joint {n} [°]" for n in numbers))
        caption = "Joint angles, read, at the beginning of each stage."
        blocks.append(doc.Table(caption, "l" + "r" * (len(head) - 1), head, tuple(rows)))
    return doc.Section("joints", "Joint angles", tuple(blocks))


def _tool_offset_section(results: Results) -> doc.Section:
    """Compare the hand's position by the LEDs on its flange with the ordered one."""
    hand = results.summary.get("hand")
    if not hand:
        text = "The hand was not measured: there was no descent, or the arm was not to move."
        return doc.Section("hand", "Position of the hand by its LEDs", (doc.Paragraph(text),))
    blocks: list[doc.Block] = [doc.Paragraph(as_sentence(hand["reason"]))]
    rows = [
        doc.row(what, *(fmt.number(v, 2) for v in hand[f"{key}_mm"] or (None,) * 3))
        for what, key in (
            ("grip point above the object, as ordered", "told"),
            ("the same, by the encoders", "read"),
            ("the same, by the LEDs", "seen"),
            ("at the object: by the LEDs less ordered", "off"),
            ("its expanded uncertainty (k = 2)", "off_expanded_uncertainty"),
        )
    ]
    head = ("Place", "x [mm]", "y [mm]", "z [mm]")
    caption = f"{hand['measured']} of {hand['pictures']} pairs of pictures showed the flange."
    blocks.append(doc.Table(caption, "lrrr", head, tuple(rows)))
    return doc.Section("hand", "Position of the hand by its LEDs", tuple(blocks))


def _margins(results: Results) -> doc.Section:
    plan = results.summary.get("plan")
    blocks: list[doc.Block] = [_figure_block(results, "margins")]
    if plan:
        margin = plan["margin"]
        rows = tuple(
            doc.row(
                what, fmt.number(margin[f"{key}_mm"], 1), fmt.number(margin[f"{key}_needed_mm"], 1)
            )
            for what, key in (("sideways", "across"), ("along the approach", "along"))
        )
        head = ("Direction", "Clearance [mm]", "Needed [mm]")
        blocks.append(doc.Table("Margins of the planned grasp.", "lrr", head, rows))
        raised = fmt.number(margin["raised_mm"], 1)
        text = (
            f"The grip point is {raised} mm above the object's centre, so that the tips stay "
            "clear of the table."
        )
        blocks.append(doc.Paragraph(text))
    return doc.Section("margins", "Margins", tuple(blocks))


def _plan(results: Results) -> doc.Section:
    plan, refusal = results.summary.get("plan"), results.summary.get("refusal")
    figure = doc.Figure("planned", "Joint angles as planned.", "Six strips of planned joint angles")
    otherwise = "There is no plan."
    if refusal:
        otherwise = f"Refused ({refusal['kind']}): {refusal['reason']}."
    blocks = [doc.block_or_paragraph(figure, figures.planned_motion(results), otherwise)]
    chosen = plan or refusal or {}
    rows = [doc.row(entry["branch"], entry["reason"]) for entry in chosen.get("rejected") or []]
    if plan:
        parts = ", ".join(f"{key} {fmt.significant(value)}" for key, value in plan["parts"].items())
        taken = f"taken: score {fmt.significant(plan['score'])} ({parts})"
        rows.insert(0, doc.row(plan["branch"], taken))
    if rows:
        head = ("Posture", "Reason")
        blocks.append(doc.Table("The arm's postures.", "ll", head, tuple(rows), wide=(1,)))
    return doc.Section("plan", "Plan", tuple(blocks))


EVIDENCE = (_states, _tool_offset_section, _track, _margins, _camshift, _joints, _plan)
