"""What the measurement was made with, and by which rule it was judged."""

from collections.abc import Callable
from typing import Any

from reports.document import blocks as doc
from reports.document import formatting as fmt
from reports.results import Results
from reports.session import phrases
from reports.session.times import FIRST_PAIR

DECISION_RULE = (
    "Conform: |ê| + 1.645 u within the tolerance at every measured pair, no lack of fit, and the "
    "smallest detectable error within the tolerance. Nonconform: |ê| − z u beyond it at some pair. "
    "Else undecided. ê is the resolved error, u its standard uncertainty."
)


def conditions(results: Results) -> doc.Section:
    """Say what the measurement was made with, and by which rule it was judged."""
    setup, summary = results.setup, results.summary
    blocks: list[doc.Block] = []
    for name, describe in (("rig", _rig), ("marker", _marker), ("robot", _robot)):
        if setup.get(name):
            blocks += describe(setup[name])
        else:
            text = f"The {name} is not described in these results."
            blocks.append(doc.Paragraph(text, "note"))
    rule = summary.get("decision_rule") or DECISION_RULE
    blocks.append(doc.Facts(tuple(_provenance(summary, fmt.text_or_dash(rule)))))
    blocks += doc.provenance(summary)
    return doc.Section("conditions", "Rig, marker, robot and rule", tuple(blocks))


def _provenance(summary: dict[str, Any], rule: str) -> list[tuple[str, str]]:
    items = [("Decision rule", rule), ("Software", doc.software(summary))]
    first = fmt.finite(summary.get(FIRST_PAIR))
    if first is not None:
        items.append(("Times", f"from the first pair, t_s = {first:.3f} s in frames.csv"))
    for name, value in (summary.get("thresholds") or {}).items():
        text = str(value) if isinstance(value, str) else fmt.exact_number(value)
        items.append((fmt.capitalise(fmt.text_or_dash(name).replace("_", " ")), text))
    return items


def _or_not_stated(text: str) -> str:
    """Say in words that a session does not state something."""
    return fmt.NOT_STATED if text == fmt.DASH else text


def _list(values: Any, decimals: int) -> str:
    values = values if isinstance(values, list | tuple) else ()
    return ", ".join(fmt.number(value, decimals) for value in values) or fmt.DASH


def _listed(*keys: str, decimals: int = 2, between: str = ", ") -> Callable[[dict[str, Any]], str]:
    """Make the writer of the numbers that an entry holds under several keys."""
    return lambda entry: between.join(fmt.number(entry.get(key), decimals) for key in keys)


def _vector(values: Any, decimals: int, unit: str) -> str:
    inner = _list(values, decimals)
    if inner == fmt.DASH:
        return fmt.DASH
    return f"({inner}){unit}" if unit == "°" else f"({inner}) {unit}"


def _format_component(name: str, value: Any) -> str:
    """Write x_mm or rx_deg with its value: x 0.050 mm, rx 0.050°."""
    stem, _, unit = name.rpartition("_")
    sign = fmt.UNITS.get(unit)
    return (
        f"{stem} {fmt.quantity(value, sign)}"
        if stem and sign
        else f"{name} {fmt.significant(value)}"
    )


def _source(source: Any) -> str:
    return _or_not_stated(fmt.lookup_label(phrases.SOURCES, source))


def _rig(rig: dict[str, Any]) -> list[doc.Block]:
    base = (
        ("Robot base found", _source(rig.get("base_source"))),
        ("Robot base position", _vector(rig.get("base_position_mm"), 2, "mm")),
        ("Robot base rotation vector", _vector(rig.get("base_rotation_vector_deg"), 3, "°")),
        ("Registration", _or_not_stated(fmt.text_or_dash(rig.get("registration")))),
    )
    if rig.get("instrument"):
        return [doc.Facts((("Instrument", fmt.text_or_dash(rig["instrument"])), *base))]
    size = rig.get("image_size_px")
    size_text = (
        " × ".join(fmt.count(v) for v in size) if isinstance(size, list | tuple) else fmt.DASH
    )
    facts = (
        ("Image size", f"{size_text} px"),
        ("Baseline", fmt.quantity(rig.get("baseline_mm"), "mm", 5)),
        *base,
    )
    columns = (
        doc.Column("Camera", "l", doc.field("side")),
        doc.Column("fx, fy [px]", "r", _listed("fx_px", "fy_px")),
        doc.Column("cx, cy [px]", "r", _listed("cx_px", "cy_px")),
        doc.Column("k1, k2, p1, p2, k3", "r", doc.field("distortion", _list, 4)),
        doc.Column("Pan centre [mm]", "r", doc.field("pan_center_mm", _list, 2)),
        doc.Column("Pan [°]", "r", _listed("pan_min_deg", "pan_max_deg", between=" … ")),
    )
    cameras = [{"side": side, **(rig.get(side) or {})} for side in ("left", "right")]
    return [doc.tabulate("Cameras on their turning bases.", columns, cameras), doc.Facts(facts)]


def _marker(marker: dict[str, Any]) -> list[doc.Block]:
    if "point_mm" in marker:
        point = _vector(marker["point_mm"], 2, "mm")
        source = _source(marker.get("source"))
        return [
            doc.Facts((("Measured point on the flange", point), ("Measured point found", source)))
        ]
    body = marker.get("body_standard_uncertainty")
    body_text = fmt.NOT_STATED
    if isinstance(body, dict):
        body_text = ", ".join(
            _format_component(fmt.text_or_dash(name), value) for name, value in body.items()
        )
    led, shift = (
        _or_not_stated(fmt.quantity(marker.get(f"{name}_standard_uncertainty_mm"), "mm"))
        for name in ("led", "centre_shift")
    )
    facts = (
        ("LED diameter", fmt.quantity(marker.get("led_diameter_mm"), "mm")),
        ("LED positions", _source(marker.get("source"))),
        ("Datum", _or_not_stated(fmt.text_or_dash(marker.get("datum")))),
        ("u of the body", body_text),
        ("u of each LED", led),
        ("u of the apparent centre", shift),
    )
    columns = (
        doc.Column("LED", "l", doc.field("name")),
        *(
            doc.Column(f"{axis} [mm]", "r", doc.field(f"{axis}_mm", fmt.number, 2))
            for axis in "xyz"
        ),
        doc.Column("Colour", "l", doc.field("colour")),
    )
    table = doc.tabulate("LEDs in the flange frame.", columns, marker.get("leds") or [])
    return [table, doc.Facts(facts)]


def _robot(robot: dict[str, Any]) -> list[doc.Block]:
    facts = (
        ("Robot", fmt.text_or_dash(robot.get("name"))),
        ("Family", fmt.lookup_label({}, robot.get("family"))),
        ("Source of its numbers", _or_not_stated(fmt.text_or_dash(robot.get("source")))),
        ("Fingerprint", fmt.text_or_dash(robot.get("fingerprint"))),
    )
    joints = robot.get("joints") or []
    urdf = all(fmt.finite(joint.get("a_mm")) is None for joint in joints)
    columns = (
        doc.Column("Joint", "l", _joint_name),
        doc.Column("a [mm]", "r", doc.field("a_mm", fmt.number, 2)),
        doc.Column("d [mm]", "r", doc.field("d_mm", fmt.number, 2)),
        doc.Column("α [°]", "r", doc.field("alpha_deg", fmt.number, 1)),
        doc.Column("Sign", "r", doc.field("sign", fmt.number, 0, signed=True)),
        doc.Column("Offset [°]", "r", doc.field("offset_deg", fmt.number, 2)),
        doc.Column("Limits [°]", "r", _listed("lower_deg", "upper_deg", decimals=1, between=" … ")),
    )
    title = "The arm's joints (standard Denavit-Hartenberg; θ = sign · q + offset)."
    shown = (columns[0], columns[-1]) if urdf else columns
    title = "The arm's joints." if urdf else title
    note = "The arm is described by a URDF, which has no Denavit-Hartenberg table."
    return [doc.tabulate(title, shown, joints, *[note] * urdf), doc.Facts(facts)]


def _joint_name(joint: dict[str, Any]) -> str:
    name, index = str(joint.get("name") or ""), fmt.text_or_dash(joint.get("joint"))
    return index if name in ("", index, f"q{index}", f"joint {index}") else f"{index} ({name})"
