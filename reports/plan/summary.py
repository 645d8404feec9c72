"""A plan's summary in the lines of a terminal, and a table of rigs that are compared."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

from reports.document.formatting import DASH, expanded, significant

MIN_DIRECTION_SHARE = 0.1  # share of pairs of one direction of travel: below, worth a warning
MIN_MEASURED_SHARE = 0.8  # share of pairs that are measured: below, worth a warning


def plan_lines(summary: dict[str, Any]) -> Iterator[str]:
    """Say what a plan's session would show: motion, rig, each joint, flange."""
    motion, pairs = summary["motion"], summary["pairs"]
    yield (
        f"{motion['poses']} poses, {motion['duration_s']:.0f} s; {pairs['measured']} of "
        f"{pairs['recorded']} pairs would be measured"
    )
    if (rig := summary["rig"]) is not None:
        width, height = rig["image_size"]
        yield (
            f"rig to be built: {width}x{height} pixels, {rig['field_of_view_deg']:g}°; baseline "
            f"{rig['baseline_m']:g} m, distance {rig['distance_m']:g} m, each camera turned "
            f"inwards by {rig['vergence_deg']:.1f}°; {rig['leds']} LEDs on a circle of "
            f"{rig['led_circle_mm']:g} mm"
        )
    yield "Uncertainty of each joint's mean error (k = 2), and what it comes from:"
    yield from _joint_table(summary["joints"])
    for joint in summary["joints"]:
        if joint["tolerance_deg"] is not None:
            yield _tolerance_line(joint)
    flange = summary["flange"]
    yield (
        f"Flange, one pair: ± {_expanded(flange['standard_uncertainty_mm'])} mm, "
        f"± {_expanded(flange['standard_uncertainty_deg'])}° (k = 2, worst direction)"
    )
    if exact := summary["uncounted"]:
        yield f"Taken as exact: {', '.join(exact)}"
    yield "The plan does not know obstacles: try the motion slowly first."


def plan_warnings(summary: dict[str, Any]) -> Iterator[str]:
    """Say on what a prediction rests, and what the motion leaves out."""
    if exact := summary["uncounted"]:
        yield (
            f"No uncertainty is stated for {', '.join(exact)}: taken as exact; the predicted "
            "uncertainties hold on that condition."
        )
    upward = {joint["joint"]: joint["upward_share"] for joint in summary["joints"]}
    least = 0.5 - MIN_DIRECTION_SHARE
    if one_way := [str(joint) for joint, share in upward.items() if abs(share - 0.5) > least]:
        yield (
            f"Joint {', '.join(one_way)} turns one way nearly all the time; with --observe "
            "backlash every pose is visited from either side."
        )
    share = summary["pairs"]["measured_share"]
    if share < MIN_MEASURED_SHARE:
        yield f"Only {share:.0%} of the pairs would be measured."


def _joint_table(joints: list[dict[str, Any]]) -> list[str]:
    """Lines of a table, a joint each; U with k = 2."""
    groups = list(joints[0]["parts_deg"])
    heads = ["joint", "mean error", "at the flange", *groups, "detectable"]
    rows = [["LED places" if head == "leds" else head for head in heads]]
    for joint in joints:
        u, lever = joint["standard_uncertainty_deg"], joint["lever_mm"]
        at_flange = None if u is None else math.radians(u) * lever
        parts = [f"{_expanded(joint['parts_deg'][group])}°" for group in groups]
        rows.append([
            str(joint["joint"]), f"± {_expanded(u)}°", f"± {_expanded(at_flange)} mm", *parts,
            f"{significant(joint['minimum_detectable_error_deg'])}°",
        ])  # fmt: skip
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [
        "  "
        + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]


def _tolerance_line(joint: dict[str, Any]) -> str:
    limit, name = joint["conform_limit_deg"], f"joint {joint['joint']}"
    tolerance = f"tolerance {joint['tolerance_deg']:g}°"
    if limit is None:
        return f"  {name}, {tolerance}: undecided, however small the error"
    return f"  {name}, {tolerance}: an error up to {significant(limit)}° would conform"


def _expanded(u: float | None) -> str:
    """Write U, k = 2, of a standard uncertainty to two digits."""
    return significant(expanded(u))


def rig_lines(rows: Sequence[dict[str, str | float | None]], joints: int) -> list[str]:
    """A table of rigs in Markdown: ± ° / ± mm a joint, k = 2."""
    names = ["camera", "LEDs", "baseline", "distance", "flange ° / mm"]
    names += [f"q{j + 1} ° / mm" for j in range(joints)]
    pairs = ["flange", *(f"q{j + 1}" for j in range(joints))]
    cells = [
        [
            *(str(row[key]) for key in ("camera", "leds", "baseline", "distance")),
            *(_both(row.get(f"{name}_deg"), row.get(f"{name}_mm")) for name in pairs),
        ]
        for row in rows
    ]
    return [_line(names), _line(["---"] * len(names)), *map(_line, cells)]


def _line(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _both(degrees: object, millimetres: object) -> str:
    if degrees is None:
        return DASH
    return f"{significant(degrees)} / {significant(millimetres)}"
