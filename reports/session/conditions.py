"""What the measurement was made with, and by which rule it was judged."""

from typing import Any

from reports.document import formatting
from reports.document.blocks import (
    Block,
    Facts,
    Paragraph,
    Section,
    Table,
    provenance,
    row,
    software,
)
from reports.document.formatting import (
    DASH,
    NOT_STATED,
    count,
    exact_number,
    finite,
    number,
    quantity,
    significant,
    text_or_dash,
)
from reports.results import Results
from reports.session import phrases
from reports.session.headline import capitalise

DECISION_RULE = (
    "Conform: |ê| + 1.645 u within the tolerance at every measured pair, no lack of fit, and the "
    "smallest detectable error within the tolerance. Nonconform: |ê| − z u beyond it at some pair. "
    "Else undecided. ê is the resolved error, u its standard uncertainty."
)


def conditions(results: Results) -> Section:
    """Say what the measurement was made with, and by which rule it was judged."""
    setup, summary = results.setup, results.summary
    blocks: list[Block] = []
    blocks += _rig(setup.get("rig") or {})
    blocks += _marker(setup.get("marker") or {})
    blocks += _robot(setup.get("robot") or {})
    rule = summary.get("decision_rule") or DECISION_RULE
    blocks.append(Facts(tuple(_provenance(summary, text_or_dash(rule)))))
    blocks += provenance(summary)
    return Section("conditions", "Rig, marker, robot and rule", tuple(blocks))


def _provenance(summary: dict[str, Any], rule: str) -> list[tuple[str, str]]:
    items = [
        ("Decision rule", rule),
        ("Software", software(summary)),
    ]
    for name, value in (summary.get("thresholds") or {}).items():
        text = str(value) if isinstance(value, str) else exact_number(value)
        items.append((capitalise(text_or_dash(name).replace("_", " ")), text))
    return items


def _or_not_stated(text: str) -> str:
    """Say in words that a session does not state something."""
    return NOT_STATED if text == DASH else text


def _vector(values: Any, decimals: int, unit: str) -> str:
    if not isinstance(values, list | tuple) or not values:
        return DASH
    inner = ", ".join(number(v, decimals) for v in values)
    return f"({inner}){unit}" if unit == "°" else f"({inner}) {unit}"


def _format_component(name: str, value: Any) -> str:
    """Write x_mm or rx_deg with its value: x 0.050 mm, rx 0.050°."""
    stem, _, unit = name.rpartition("_")
    sign = formatting.UNITS.get(unit)
    return f"{stem} {quantity(value, sign)}" if stem and sign else f"{name} {significant(value)}"


def _rig(rig: dict[str, Any]) -> list[Block]:
    if not rig:
        return [Paragraph("The rig is not described in these results.", "note")]
    base = (
        (
            "Robot base found",
            _or_not_stated(formatting.lookup_label(phrases.SOURCES, rig.get("base_source"))),
        ),
        ("Robot base position", _vector(rig.get("base_position_mm"), 2, "mm")),
        ("Robot base rotation vector", _vector(rig.get("base_rotation_vector_deg"), 3, "°")),
        ("Registration", _or_not_stated(text_or_dash(rig.get("registration")))),
    )
    if rig.get("instrument"):
        return [Facts((("Instrument", text_or_dash(rig["instrument"])), *base))]
    rows = []
    for side in ("left", "right"):
        camera = rig.get(side) or {}
        distortion = camera.get("distortion")
        coefficients = distortion if isinstance(distortion, list | tuple) else []
        rows.append(
            row(
                side,
                f"{number(camera.get('fx_px'), 2)}, {number(camera.get('fy_px'), 2)}",
                f"{number(camera.get('cx_px'), 2)}, {number(camera.get('cy_px'), 2)}",
                ", ".join(number(v, 4) for v in coefficients) or DASH,
                ", ".join(number(v, 2) for v in camera.get("pan_center_mm") or []) or DASH,
                f"{number(camera.get('pan_min_deg'), 2)} … {number(camera.get('pan_max_deg'), 2)}",
            )
        )
    size = rig.get("image_size_px")
    size_text = " × ".join(count(v) for v in size) if isinstance(size, list | tuple) else DASH
    facts = (
        ("Image size", f"{size_text} px"),
        ("Baseline", quantity(rig.get("baseline_mm"), "mm", 5)),
        *base,
    )
    table = Table(
        "Cameras on their turning bases.",
        "lrrrrr",
        (
            "Camera",
            "fx, fy [px]",
            "cx, cy [px]",
            "k1, k2, p1, p2, k3",
            "Pan centre [mm]",
            "Pan [°]",
        ),
        tuple(rows),
    )
    return [table, Facts(facts)]


def _marker(marker: dict[str, Any]) -> list[Block]:
    if not marker:
        return [Paragraph("The marker is not described in these results.", "note")]
    if "point_mm" in marker:
        found = _or_not_stated(formatting.lookup_label(phrases.SOURCES, marker.get("source")))
        point = _vector(marker["point_mm"], 2, "mm")
        return [Facts((("Measured point on the flange", point), ("Measured point found", found)))]
    rows = tuple(
        row(
            text_or_dash(led.get("name")),
            *(number(led.get(f"{axis}_mm"), 2) for axis in "xyz"),
            text_or_dash(led.get("colour")),
        )
        for led in marker.get("leds") or []
    )
    body = marker.get("body_standard_uncertainty")
    body_text = NOT_STATED
    if isinstance(body, dict):
        body_text = ", ".join(
            _format_component(text_or_dash(name), value) for name, value in body.items()
        )
    facts = (
        ("LED diameter", quantity(marker.get("led_diameter_mm"), "mm")),
        (
            "LED positions",
            _or_not_stated(formatting.lookup_label(phrases.SOURCES, marker.get("source"))),
        ),
        ("Datum", _or_not_stated(text_or_dash(marker.get("datum")))),
        ("u of the body", body_text),
        (
            "u of each LED",
            _or_not_stated(quantity(marker.get("led_standard_uncertainty_mm"), "mm")),
        ),
        (
            "u of the apparent centre",
            _or_not_stated(quantity(marker.get("centre_shift_standard_uncertainty_mm"), "mm")),
        ),
    )
    table = Table(
        "LEDs in the flange frame.",
        "lrrrl",
        ("LED", "x [mm]", "y [mm]", "z [mm]", "Colour"),
        rows,
    )
    return [table, Facts(facts)]


def _robot(robot: dict[str, Any]) -> list[Block]:
    if not robot:
        return [Paragraph("The robot is not described in these results.", "note")]
    rows = []
    for joint in robot.get("joints") or []:
        name = str(joint.get("name") or "")
        index = text_or_dash(joint.get("joint"))
        lower, upper = number(joint.get("lower_deg"), 1), number(joint.get("upper_deg"), 1)
        rows.append(
            row(
                index
                if name in ("", index, f"q{index}", f"joint {index}")
                else f"{index} ({name})",
                number(joint.get("a_mm"), 2),
                number(joint.get("d_mm"), 2),
                number(joint.get("alpha_deg"), 1),
                number(joint.get("sign"), 0, signed=True),
                number(joint.get("offset_deg"), 2),
                f"{lower} … {upper}",
            )
        )
    facts = (
        ("Robot", text_or_dash(robot.get("name"))),
        ("Family", formatting.lookup_label({}, robot.get("family"))),
        ("Source of its numbers", _or_not_stated(text_or_dash(robot.get("source")))),
        ("Fingerprint", text_or_dash(robot.get("fingerprint"))),
    )
    table = Table(
        "The arm's joints (standard Denavit-Hartenberg; θ = sign · q + offset).",
        "lrrrrrr",
        ("Joint", "a [mm]", "d [mm]", "α [°]", "Sign", "Offset [°]", "Limits [°]"),
        tuple(rows),
        () if any(finite(j.get("a_mm")) is not None for j in robot.get("joints") or [])
        else ("The arm is described by a URDF, which has no Denavit-Hartenberg table.",),
    )  # fmt: skip
    return [table, Facts(facts)]
