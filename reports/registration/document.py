"""What the report of a robot's registration says, in which order. Keys: docs/calibration.md."""

from typing import Any

from reports.document import blocks as doc
from reports.document import formatting
from reports.document import formatting as fmt
from reports.registration.evidence import METHODS, RegistrationNotes, axes, figure_block, residuals
from reports.results import Results
from reports.session.phrases import (
    MAX_HIDDEN_SHARE,
    MAX_MOSTLY_HIDDEN_SHARE,
    MAX_PARTLY_HIDDEN_SHARE,
)

MAX_HELD_OUT_RATIO = 1.5  # held-out over fitted rms: more says that the model does not carry over


def document(results: Results) -> doc.Document:
    """Lay out the whole report."""
    summary = results.summary
    registration = fmt.text_or_dash(summary.get("registration"))
    return doc.lay_out(
        title=f"Registration of {fmt.text_or_dash(summary.get('robot'))}",
        subtitle=doc.described(summary, "a recorded session"),
        footer=f"{doc.software(summary)} · registration {registration[:23]}",
        sections=(
            section(results) for section in SECTIONS if not (posed(summary) and section is axes)
        ),
    )


def posed(summary: dict[str, Any]) -> bool:
    """Whether another instrument measured: no picture, no LED, no sweep."""
    return summary.get("method") == "poses"


def hidden_joints(summary: dict[str, Any], least: float, most: float) -> list[Any]:
    """Select the joints whose visible share lies between two bounds."""
    return [
        joint.get("joint")
        for joint in summary.get("joints") or []
        if (share := fmt.finite(joint.get("visible_fraction"))) is not None
        and least <= share < most
    ]


def verdict(results: Results) -> doc.Section:
    """Open with what was found, and what it hides."""
    summary = results.summary
    method, fit = str(summary.get("method")), summary.get("fit") or {}
    blind = hidden_joints(summary, 0.0, MAX_HIDDEN_SHARE)
    dim = hidden_joints(summary, MAX_HIDDEN_SHARE, MAX_MOSTLY_HIDDEN_SHARE)
    label = "The robot is registered"
    if blind or dim:
        label += ", and blind to some of its own errors"
    block = doc.Verdict(
        tone="undecided" if blind or dim or _fits_worse(fit) else "conform",
        label=label,
        sentence=" ".join([_result_text(summary), *_hidden_sentences(summary, blind, dim)]),
        remarks=tuple(_remarks(fit, method, bool(blind or dim))),
    )
    pairs, source = summary.get("pairs") or {}, summary.get("source") or {}
    left = [
        f"{fmt.count(n)}: {fmt.text_or_dash(why)}"
        for why, n in (pairs.get("left_out") or {}).items()
    ]
    what = "Poses" if posed(summary) else "Pairs"
    facts = [
        ("Robot", fmt.text_or_dash(summary.get("robot"))),
        ("Recorded in", fmt.text_or_dash(source.get("path"))),
        ("Base found", formatting.lookup_label(METHODS, method)),
        (f"{what} used", fmt.count(pairs.get("used"))),
        (f"{what} left out", "; ".join(left) or "none"),
        ("Registration", fmt.text_or_dash(summary.get("registration"))),
    ]
    return doc.Section("verdict", "Verdict", (block, doc.Facts(tuple(facts))))


def _result_text(summary: dict[str, Any]) -> str:
    base, pairs = summary.get("base") or {}, summary.get("pairs") or {}
    leds, fit = summary.get("leds") or [], summary.get("fit") or {}
    what = []
    if base and not base.get("held"):
        what.append("the robot's base")
    if leds and not summary.get("leds_held"):
        what.append(f"{fmt.count(len(leds))} LEDs")
    target = summary.get("target") or {}
    if target and not target.get("held"):
        what.append("the target")
    single = len(what) == 1 and what[0].startswith("the ")
    verb = "was" if single else "were"
    how = formatting.lookup_label(METHODS, summary.get("method"))
    who = fmt.join_words(what) or "the axes of the swept joints"
    sentence = f"{who} {verb} found {how}, in {fmt.count(pairs.get('used'))} "
    sentence += "poses" if posed(summary) else "pairs"
    rms = fmt.finite(fit.get("rms_px"))
    if rms is not None:
        sentence += f" with an rms of {fmt.quantity(rms, 'px')}"
    rms = fmt.finite(fit.get("rms_mm"))
    if rms is not None:
        sentence += f" with an rms of {fmt.quantity(rms, 'mm')}"
    return fmt.capitalise(f"{sentence}.")


def _hidden_sentences(summary: dict[str, Any], blind: list[Any], dim: list[Any]) -> list[str]:
    if not summary.get("joints"):
        return ["It hides nothing."] if summary.get("method") == "fixture" else []
    sentences = []
    if blind:
        sentences.append(f"A constant offset of {fmt.joint_names(blind)} cannot show.")
    if dim:
        shares = {j.get("joint"): fmt.finite(j.get("visible_fraction")) for j in summary["joints"]}
        visible = [share for joint in dim if (share := shares[joint]) is not None]
        low, high = fmt.percent(min(visible)), fmt.percent(max(visible))
        amount = low if low == high else f"{low} to {high}"
        sentences.append(f"Of an offset of {fmt.joint_names(dim)}, {amount} shows.")
    return sentences or ["An offset of any joint can show."]


def _fits_worse(fit: dict[str, Any]) -> bool:
    fitted, held = fmt.finite(fit.get("fit_rms_px")), fmt.finite(fit.get("held_out_rms_px"))
    return fitted is not None and held is not None and held > MAX_HELD_OUT_RATIO * fitted


def _remarks(fit: dict[str, Any], method: str, partly: bool) -> list[str]:
    remarks = []
    if _fits_worse(fit):
        remarks.append(RegistrationNotes.WORSE)
    if partly:
        notes = {"motion": RegistrationNotes.FREED, "poses": RegistrationNotes.POSES}
        remarks.append(notes.get(method, RegistrationNotes.LEDS))
    return remarks


def base_and_leds(results: Results) -> doc.Section:
    """Say where the robot stands, and where its LEDs sit."""
    summary = results.summary
    entry = summary.get("base") or {}
    blocks: list[doc.Block] = []
    if entry:
        place = "in the instrument's frame" if posed(summary) else "in the rig"
        encoders = summary.get("method") in ("motion", "poses")
        blocks.append(_pose_table(entry, f"Robot base {place}", through_encoders=encoders))
    else:
        blocks.append(doc.Paragraph("The robot's base was not found."))
    if summary.get("target"):
        blocks.append(_pose_table(summary["target"], "Target in the flange frame"))
    if summary.get("leds"):
        blocks.append(_led_table(summary["leds"], bool(summary.get("leds_held"))))
    blocks.append(doc.Facts(tuple(_times(summary))))
    blocks += doc.decisions(summary)
    title = "Base and target" if posed(summary) else "Base and LEDs"
    return doc.Section("base", title, tuple(blocks))


def _pose_table(entry: dict[str, Any], what: str, *, through_encoders: bool = False) -> doc.Table:
    empty = [None] * 3
    rows = [
        doc.row(
            f"{name}, {axis} [{sign}]", fmt.with_uncertainty(value, fmt.expanded(u), signed=False)
        )
        for name, key, u_key, sign in (
            ("Position", "position_mm", "standard_uncertainty_mm", "mm"),
            ("Rotation vector", "rotation_vector_deg", "standard_uncertainty_deg", "°"),
        )
        for axis, value, u in zip("xyz", entry.get(key) or empty, entry.get(u_key) or empty,
                                  strict=True)
    ]  # fmt: skip
    title = f"{what}, with expanded uncertainties (k = 2)."
    note = (
        (RegistrationNotes.HELD,)
        if entry.get("held")
        else (RegistrationNotes.THROUGH,) * through_encoders
    )
    return doc.Table(title, "lr", ("Quantity", "Value ± U"), tuple(rows), note)


def _led_table(leds: list[dict[str, Any]], held: bool) -> doc.Table:
    columns = [doc.Column("LED", "l", doc.field("name"))]
    columns += [
        doc.Column(
            f"{a} ± U [mm]", "r", doc.uncertain_field(f"{a}_mm", f"u_{a}_mm", signed=False, k=2)
        )
        for a in "xyz"
    ]
    title = "LEDs in the flange frame, with expanded uncertainties (k = 2)."
    return doc.tabulate(title, columns, leds, *[RegistrationNotes.HELD_LEDS] * held)


def _times(summary: dict[str, Any]) -> list[tuple[str, str]]:
    items = []
    for label, key in (
        ("Encoder clock offset", "clock"),
        ("Right camera's stamps early by", "skew"),
    ):
        entry = summary.get(key)
        if entry:
            u = entry.get("standard_uncertainty_s")
            text = fmt.with_uncertainty(entry.get("offset_s"), fmt.expanded(u), "s")
            why = " (k = 2)" if u is not None else ", held: the motion does not show it"
            items.append((label, f"{text}{why}"))
    return items


def visibility(results: Results) -> doc.Section:
    """Say what the registration hides of each joint's offset."""
    summary = results.summary
    joints = summary.get("joints") or []
    if not joints:
        fixture = summary.get("method") == "fixture"
        text = RegistrationNotes.NOTHING_HIDDEN if fixture else RegistrationNotes.NOT_KNOWN
        return doc.Section("visibility", "What the registration hides", (doc.Paragraph(text),))
    columns = (
        doc.Column("Joint", "c", doc.field("joint")),
        doc.Column("Visible", "r", doc.field("visible_fraction", fmt.percent)),
        doc.Column("In words", "l", _share_text, wide=True),
    )
    title = "What this registration leaves visible of a constant offset that was there already."
    table = doc.tabulate(title, columns, joints, RegistrationNotes.VISIBLE)
    blocks = table, figure_block(results, "visible")
    return doc.Section("visibility", "What the registration hides", blocks)


def _share_text(joint: dict[str, Any]) -> str:
    share = fmt.finite(joint.get("visible_fraction"))
    name = f"joint {fmt.text_or_dash(joint.get('joint'))}"
    if share is None:
        return "Not determined."
    if share < MAX_HIDDEN_SHARE:
        return f"A constant offset of {name} cannot show, however large."
    if share < MAX_MOSTLY_HIDDEN_SHARE:
        return f"Mostly hidden: only {fmt.percent(share)} of an offset of {name} shows."
    if share < MAX_PARTLY_HIDDEN_SHARE:
        return f"Partly hidden: {fmt.percent(share)} of an offset of {name} shows."
    return f"An offset of {name} shows in full."


def conditions(results: Results) -> doc.Section:
    """Say what the registration was made from."""
    registration = ("Registration", fmt.text_or_dash(results.summary.get("registration")))
    return doc.files_and_software(results.summary, registration)


SECTIONS = (verdict, base_and_leds, visibility, residuals, axes, conditions)
