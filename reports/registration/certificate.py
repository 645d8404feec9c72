"""Page one of a registration's report: how well base and LEDs are known, what cannot show."""

from typing import Any

from reports.document import blocks as doc
from reports.document import formatting as fmt
from reports.registration.evidence import METHODS, RegistrationNotes, figure_block
from reports.results import Results
from reports.session.phrases import MAX_HIDDEN_SHARE, MAX_MOSTLY_HIDDEN_SHARE

MAX_HELD_OUT_RATIO = 1.5  # held-out over fitted rms: more says that the model does not carry over
MAX_LEDS = 12  # of the table; the appendix has all
AXES = "xyz"
EXAMPLE_OFFSET = 0.1  # °, of a joint, whose effect on the base is told
MIN_SHIFT = 1e-6  # mm per degree: less is rounding
LATER = (
    "Whether rig, base and LEDs stay where they are: a base or LED that is moved needs a new "
    "registration."
)
ENCODERS = (
    "The encoders themselves: a constant offset that was there already moved base and LEDs with "
    "it, beyond U."
)


def certificate(results: Results) -> doc.Section:
    """Say all that a reader needs who reads one page."""
    summary = results.summary
    fit = summary.get("fit") or {}
    blind = hidden_joints(summary, 0.0, MAX_HIDDEN_SHARE)
    dim = hidden_joints(summary, MAX_HIDDEN_SHARE, MAX_MOSTLY_HIDDEN_SHARE)
    warnings = [fmt.text_or_dash(text) for text in summary.get("warnings") or []]
    label = "The robot is registered"
    if blind or dim:
        label += "; some encoder offsets stay hidden"
    texts = [_accuracy_text(summary), _shift_text(summary), *_hidden_sentences(summary, blind, dim)]
    verdict = doc.Verdict(
        tone="undecided" if blind or dim or warnings or fits_worse(fit) else "conform",
        label=label,
        sentence=" ".join(text for text in texts if text),
        remarks=(
            *warnings,
            *([RegistrationNotes.WORSE] if fits_worse(fit) else []),
            _result_text(summary),
        ),
    )
    blocks: list[doc.Block] = [verdict, doc.Facts(tuple(_identification(summary)), columns=2)]
    blocks.append(figure_block(results, _figure_name(results)))
    if table := _place_table(summary):
        blocks.append(table)
    blocks.append(doc.remedies(_actions(summary, blind, dim), _unchecked(summary)))
    return doc.Section("verdict", "Verdict", tuple(blocks))


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


def fits_worse(fit: dict[str, Any]) -> bool:
    """Tell whether pairs that were held out fit clearly worse than those registered on."""
    fitted, held = fmt.finite(fit.get("fit_rms_px")), fmt.finite(fit.get("held_out_rms_px"))
    return fitted is not None and held is not None and held > MAX_HELD_OUT_RATIO * fitted


def _largest(values: Any) -> float | None:
    """The largest U (k = 2) of some standard uncertainties."""
    known = [u for value in values or () if (u := fmt.expanded(value)) is not None]
    return max(known, default=None)


def _accuracy_text(summary: dict[str, Any]) -> str:
    """Say how well base and LEDs are known, along their worst axis."""
    base, leds = summary.get("base") or {}, summary.get("leds") or []
    parts = []
    place, turn = (_largest(base.get(f"standard_uncertainty_{unit}")) for unit in ("mm", "deg"))
    if base.get("held"):
        parts.append("the base was held as the rig had it")
    elif place is not None:
        angle = "" if turn is None else f" and ±{fmt.quantity(turn, '°')}"
        parts.append(f"the base is known to ±{fmt.quantity(place, 'mm')}{angle}")
    apart = _largest(led.get(f"u_{axis}_mm") for led in leds for axis in AXES)
    if leds and summary.get("leds_held"):
        parts.append("the LEDs were held as the marker had them")
    elif apart is not None:
        noun = "LED" if len(leds) == 1 else "LEDs"
        known = "known " if len(parts) != 1 or base.get("held") else ""
        parts.append(f"the {fmt.count(len(leds))} {noun} {known}to ±{fmt.quantity(apart, 'mm')}")
    if not parts:
        return ""
    factor = " (k = 2, along the worst axis)" if place is not None or apart is not None else ""
    text = f"{fmt.join_words(parts)}{factor}"
    if factor and summary.get("method") != "fixture":
        text = f"if all encoders read right, {text}"
    return fmt.capitalise(f"{text}.")


def _shift_text(summary: dict[str, Any]) -> str:
    """Say how far a joint's own offset moves the base; empty where that is not known."""
    shifts = [fmt.finite(joint.get("base_shift_mm_per_deg"))
              for joint in summary.get("joints") or []]  # fmt: skip
    largest = max((shift for shift in shifts if shift is not None), default=0.0)
    if largest < MIN_SHIFT or (summary.get("base") or {}).get("held"):
        return ""
    moved = fmt.quantity(EXAMPLE_OFFSET * largest, "mm")
    return f"An offset of {EXAMPLE_OFFSET:g}° of one joint moves the base by up to {moved}."


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
    verb = "was" if len(what) == 1 and what[0].startswith("the ") else "were"
    how = fmt.lookup_label(METHODS, summary.get("method"))
    who = fmt.join_words(what) or "the axes of the swept joints"
    unit = "poses" if posed(summary) else "pairs"
    sentence = f"{who} {verb} found {how}, in {fmt.count(pairs.get('used'))} {unit}"
    for key, sign in (("rms_px", "px"), ("rms_mm", "mm")):
        rms = fmt.finite(fit.get(key))
        if rms is not None:
            sentence += f" with an rms of {fmt.quantity(rms, sign)}"
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


def _identification(summary: dict[str, Any]) -> list[tuple[str, str]]:
    pairs, source = summary.get("pairs") or {}, summary.get("source") or {}
    left = [
        f"{fmt.count(n)}: {fmt.text_or_dash(why)}"
        for why, n in (pairs.get("left_out") or {}).items()
    ]
    unit = "Poses" if posed(summary) else "Pairs"
    return [
        ("Robot", fmt.text_or_dash(summary.get("robot"))),
        ("Recorded in", fmt.text_or_dash(source.get("path"))),
        ("Base found", fmt.lookup_label(METHODS, summary.get("method"))),
        ("Registration", fmt.text_or_dash(summary.get("registration"))[:23]),
        (f"{unit} used", fmt.count(pairs.get("used"))),
        (f"{unit} left out", "; ".join(left) or "none"),
    ]


def _figure_name(results: Results) -> str:
    """The picture of page one: what is hidden, else the pairs of a fixture, else the axes."""
    if results.summary.get("joints"):
        return "visible"
    return "fixture" if len(results.table("pairs")) else "linearity"


def _place_table(summary: dict[str, Any]) -> doc.Table | None:
    """Base, target and LEDs, one row each."""
    base, leds = summary.get("base") or {}, summary.get("leds") or []
    frame = "the instrument's frame" if posed(summary) else "the rig"
    rows = _pose_rows("Base", frame, base)
    rows += _pose_rows("Target", "the flange frame", summary.get("target") or {})
    for led in leds[:MAX_LEDS]:
        cells = [
            fmt.with_uncertainty(
                led.get(f"{a}_mm"), fmt.expanded(led.get(f"u_{a}_mm")), signed=False
            )
            for a in AXES
        ]
        rows.append(doc.row(f"LED {fmt.text_or_dash(led.get('name'))} on the flange [mm]", *cells))
    if not rows:
        return None
    notes = []
    held = [key for key in ("base", "target") if (summary.get(key) or {}).get("held")]
    if held:
        notes.append(f"{fmt.capitalise(fmt.join_words(held))}: {RegistrationNotes.HELD}")
    if not base.get("held") and summary.get("method") != "fixture":
        notes.append(RegistrationNotes.THROUGH)
    if leds and summary.get("leds_held"):
        notes.append(RegistrationNotes.HELD_LEDS)
    if len(leds) > MAX_LEDS:
        notes.append(f"{fmt.count(len(leds) - MAX_LEDS)} more LEDs are in the marker file.")
    what = "Base and target" if posed(summary) else "Base and LEDs" if leds else "Base"
    caption = f"{what}, with expanded uncertainties (k = 2)."
    head = ("Place", *(f"{axis} ± U" for axis in AXES))
    return doc.Table(caption, "lrrr", head, tuple(rows), tuple(notes))


def _pose_rows(name: str, frame: str, pose: dict[str, Any]) -> list[tuple[doc.Cell, ...]]:
    """Two rows of a pose: position and rotation vector, each axis ± U (k = 2)."""
    rows = []
    for what, key, u_key in (
        (f"{name} in {frame} [mm]", "position_mm", "standard_uncertainty_mm"),
        (f"{name}, rotation vector [°]", "rotation_vector_deg", "standard_uncertainty_deg"),
    ):
        if pose:
            places = zip(pose.get(key) or [None] * 3, pose.get(u_key) or [None] * 3, strict=True)
            cells = [fmt.with_uncertainty(v, fmt.expanded(u), signed=False) for v, u in places]
            rows.append(doc.row(what, *cells))
    return rows


def _actions(summary: dict[str, Any], blind: list[Any], dim: list[Any]) -> list[str]:
    """List what to do: free what hides, mend what does not fit, else measure."""
    actions = []
    if fits_worse(summary.get("fit") or {}):
        actions.append(
            "Find out what moved between the pairs (base, LEDs, cameras), or register on a richer "
            "motion."
        )
    if blind or dim:
        where = "a base from a fixture and " if summary.get("method") == "motion" else ""
        freed = (
            f"To make such offsets visible, register with {where}LEDs from a jig. Without that, "
            "the registration serves to find errors that arise later: they show in full."
        )
        actions.append(RegistrationNotes.POSES if posed(summary) else freed)
    return actions or ["Measure: nothing needs to be done."]


def _unchecked(summary: dict[str, Any]) -> list[str]:
    through = summary.get("method") != "fixture"
    return [
        *([ENCODERS] if through else []),
        *([] if summary.get("leds") or posed(summary) else ["Where the LEDs sit on the flange."]),
        LATER,
    ]
