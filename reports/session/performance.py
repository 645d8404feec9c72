"""Repeated poses and paths by the indices of ISO 9283, with intervals and deviations."""

from collections.abc import Callable
from typing import Any

from reports.document.blocks import (
    Block,
    Bullets,
    Figure,
    Paragraph,
    Section,
    Table,
    block_or_paragraph,
    row,
)
from reports.document.formatting import (
    DASH,
    count,
    decimals_of,
    finite,
    join_words,
    number,
    quantity,
    with_uncertainty,
)
from reports.results import Results
from reports.session.figures.performance import path_band, pose_clusters

REASONS = {
    "no_holds": (
        "No repeated poses or paths: the arm was not seen standing still, or its readings never "
        "stand."
    ),
    "no_repeats": (
        "No repeated poses or paths: nothing was visited five times or more, so nothing can be "
        "said of repeatability."
    ),
    "poses_not_determined": (
        "No repeated poses or paths: the pose was not wholly determined in every pair."
    ),
}

FIXED_DEVIATIONS = {
    "commanded": (
        "Commanded poses are not known: the mean of what the encoders read stands for them, so an "
        "error of the controller that its encoders see is not part of AP or AT."
    ),
    "registration": (
        "Base or LEDs were registered through the robot's own encoders: AP and AT show only what "
        "that registration could not take up."
    ),
    "load": "The load is not known; 100 % of the rated load is asked for.",
    "speed": (
        "The speed set at the controller is not known; 100 % of the rated speed is asked for."
    ),
    "warm_up": "It is not known whether the arm was warm; warming up is asked for.",
    "settling": (
        "A visit counts from when the encoders stand; the standard waits until the arm has settled."
    ),
    "cube": (
        "It is not known whether the poses lie in the test cube of the standard, and in which of "
        "its planes."
    ),
    "flange": "Positions are of the flange's centre, not of a point at the tool's offset.",
    "point": "Positions are of the point that the instrument measured.",
    "temperature_unknown": "The temperature is not stated; 20 °C ± 2 °C is asked for.",
}


def deviation(entry: dict[str, Any]) -> str:
    """Say one condition that differs from the standard's."""
    kind = str(entry.get("kind"))
    if kind in FIXED_DEVIATIONS:
        return FIXED_DEVIATIONS[kind]
    return DEVIATION_TEXTS[kind](entry) if kind in DEVIATION_TEXTS else kind.replace("_", " ")


def _names(entry: dict[str, Any]) -> str:
    return join_words([str(pose) for pose in entry.get("poses") or [DASH]])


DEVIATION_TEXTS: dict[str, Callable[[dict[str, Any]], str]] = {
    "cycles": lambda e: (
        f"{count(e.get('found'))} visits of the pose seen least; {count(e.get('standard'))} are "
        "asked for."
    ),
    "passages": lambda e: (
        f"{count(e.get('found'))} passages of the path seen least; {count(e.get('standard'))} are "
        "asked for."
    ),
    "poses": lambda e: (
        f"Number of poses: {count(e.get('found'))}; {count(e.get('standard'))} are asked for."
    ),
    "plane": lambda e: (
        f"The five poses lie up to {number(e.get('off_plane_mm'), 1)} mm off one plane; a diagonal "
        "plane of a cube is asked for."
    ),
    "approach": lambda e: (
        "Approached from several poses, where one way is asked for, so that RP holds their "
        f"difference: {_names(e)}."
    ),
    "drift": lambda e: (
        f"Drift was followed for {quantity(_hours(e.get('found_s')), 'h')}; 8 h are asked for."
    ),
    "uncertainty": lambda e: (
        "The expanded uncertainty exceeds a quarter of AP, where a quarter is the most that the "
        f"standard allows: {_names(e)}. The smallest AP that could be stated for all poses is "
        f"{quantity(e.get('smallest_mm'), 'mm')}."
    ),
    "temperature": lambda e: (
        f"The temperature was {number(e.get('found_c'), 1)} °C; 20 °C ± 2 °C is asked for."
    ),
}


def _hours(seconds: Any) -> float | None:
    return float(seconds) / 3600 if isinstance(seconds, int | float) else None


TITLE = "Repeated poses and paths (ISO 9283-style)"
AXES = ("rx", "ry", "rz")
INTERVAL_NOTE = "Numbers in brackets are 95 % intervals."
BIAS_NOTE = (
    "AP is a length, so noise can only make it longer: the column beside it says how long noise "
    "and stated doubts alone make it, the next what is left without that."
)
FLOOR_NOTE = (
    "The floor is what the instrument's own noise would show as RP, from its scatter while the "
    "arm stood still; the robot's share is RP with the floor taken off in quadrature, and an "
    "upper bound (≤) where the interval reaches down to the floor."
)
STATED_FLOOR_NOTE = (
    "The floor is what the instrument's own noise would show as RP, as the poses state it: the "
    "arm was not seen standing still often enough to measure it. The robot's share is RP with the "
    "floor taken off in quadrature, and an upper bound (≤) where the interval reaches down to the "
    "floor."
)
ANGLE_NOTE = (
    "Small turns about the base's axes, from the mean orientation that the encoders read; ± and "
    "brackets are 95 % intervals."
)
DRIFT_NOTE = (
    "Noise alone: what the same visits in any other order stay under in 95 % of cases. A change "
    "below it is no sign of drift."
)
MAXIMUM_NOTE = (
    "AT and RT are the largest of many places along the path, and noise alone makes the largest of "
    "many large: AT below the column beside it is no sign of an error."
)
CLUSTER_CAPTION = (
    "Where each visit of a pose ended, about the position that the encoders read (cross-hairs); "
    "the dot is the barycentre, the circle about it has the radius RP."
)
CLUSTERS_ALT = (
    "Panels a pose, seen along z and along y: points of the visits in millimetres about the "
    "origin, with a circle about their barycentre."
)
BAND_CAPTION = (
    "How far the mean of the passages lies off the path that the encoders read, along the path; "
    "the band is RT about it."
)
NO_VISITS = "The single visits were not kept."
BAND_ALT = "A curve a path in millimetres over the way travelled, with a band about it."


def performance(results: Results) -> Section:
    """Give every index with its interval, its noise and the conditions it was found under."""
    entry = results.summary.get("performance")
    if not entry:
        reason = str(results.summary.get("performance_reason"))
        said = REASONS.get(reason, REASONS["no_repeats"])
        return Section("performance", TITLE, (Paragraph(said, "note"),))
    poses, paths = entry.get("poses") or [], entry.get("paths") or []
    blocks: list[Block] = []
    if poses:
        clusters = Figure("pose_clusters", CLUSTER_CAPTION, CLUSTERS_ALT)
        blocks += [Paragraph(_pose_summary(poses)), _positions(entry)]
        blocks.append(block_or_paragraph(clusters, pose_clusters(results), NO_VISITS))
        blocks += _optional_tables(poses, _orientations, _variation, _drift)
    blocks += _optional_tables(entry.get("distances") or [], _distances)
    if paths:
        band = Figure("path_band", BAND_CAPTION, BAND_ALT)
        blocks += [Paragraph(_path_summary(paths)), _paths(paths)]
        blocks.append(block_or_paragraph(band, path_band(results), NO_VISITS))
    blocks.append(
        Paragraph(
            "These figures are named ISO 9283-style because the test differs from the standard's, "
            "or is not known to agree, in this:"
        )
    )
    blocks.append(Bullets(tuple(deviation(d) for d in entry.get("deviations") or [])))
    return Section("performance", TITLE, tuple(blocks))


def _optional_tables(
    entries: list[Any], *tables: Callable[[list[Any]], Table | None]
) -> list[Block]:
    return [table for make in tables if entries and (table := make(entries)) is not None]


def _pose_summary(poses: list[dict[str, Any]]) -> str:
    visits = [int(p["visits"]) for p in poses]
    accuracy = max(poses, key=lambda p: finite(p.get("ap_mm")) or 0.0)
    scatter = max(poses, key=lambda p: finite(p.get("rp_mm")) or 0.0)
    often = count(min(visits)) if min(visits) == max(visits) else f"{min(visits)} to {max(visits)}"
    return (
        f"{count(len(poses))} poses, each visited {often} times. "
        f"Largest pose accuracy: AP {_interval(accuracy, 'ap', 'mm')} mm, at {accuracy['pose']}. "
        f"Largest pose repeatability: RP {_interval(scatter, 'rp', 'mm')} mm, at "
        f"{scatter['pose']}, of which the robot's share is "
        f"{_format_robot_share(scatter, 'rp', 'mm')} mm."
    )


def _path_summary(paths: list[dict[str, Any]]) -> str:
    accuracy = max(paths, key=lambda p: finite(p.get("at_mm")) or 0.0)
    scatter = max(paths, key=lambda p: finite(p.get("rt_mm")) or 0.0)
    return (
        f"{count(len(paths))} paths. "
        f"Largest path accuracy: AT {_interval(accuracy, 'at', 'mm')} mm, on {accuracy['path']}. "
        f"Largest path repeatability: RT {_interval(scatter, 'rt', 'mm')} mm, on "
        f"{scatter['path']}."
    )


def _interval(entry: dict[str, Any], name: str, unit: str, signed: bool = False) -> str:
    """A figure with its interval in brackets, to the digits that the interval leaves."""
    value, low, high = (finite(entry.get(f"{name}{part}_{unit}")) for part in ("", "_low", "_high"))
    if value is None or low is None or high is None:
        return number(value)
    decimals = decimals_of((high - low) / 4)
    return (
        f"{number(value, decimals, signed)} "
        f"({number(low, decimals, signed)} – {number(high, decimals, signed)})"
    )


def _format_robot_share(entry: dict[str, Any], name: str, unit: str) -> str:
    """The robot's share of a repeatability, or the bound below which it lies."""
    low, high = (finite(entry.get(f"{name}_{end}_{unit}")) for end in ("low", "high"))
    decimals = 3 if low is None or high is None else decimals_of((high - low) / 4)
    found = finite(entry.get(f"{name}_robot_{unit}"))
    if found is not None:
        return number(found, decimals)
    return f"≤ {number(entry.get(f'{name}_robot_at_most_{unit}'), decimals)}"


def _positions(entry: dict[str, Any]) -> Table:
    rows = tuple(
        row(
            str(p["pose"]),
            count(p["visits"]),
            _interval(p, "ap", "mm"),
            number(p.get("ap_of_noise_mm"), 3),
            number(p.get("ap_less_bias_mm"), 3),
            _interval(p, "rp", "mm"),
            number(p.get("rp_floor_mm"), 3),
            _format_robot_share(p, "rp", "mm"),
        )
        for p in entry["poses"]
    )
    measured_floor = (entry.get("noise_floor") or {}).get("source") == "holds"
    return Table(
        "Pose accuracy AP and pose repeatability RP of positions.",
        "lrrrrrrr",
        (
            "Pose",
            "Visits",
            "AP [mm]",
            "of noise [mm]",
            "without bias [mm]",
            "RP [mm]",
            "floor [mm]",
            "robot's RP [mm]",
        ),
        rows,
        (INTERVAL_NOTE, BIAS_NOTE, FLOOR_NOTE if measured_floor else STATED_FLOOR_NOTE),
    )


def _orientations(poses: list[dict[str, Any]]) -> Table | None:
    if not any("ap_rx_deg" in p for p in poses):
        return None
    return Table(
        "Pose accuracy and pose repeatability of orientations.",
        "lrrrrrr",
        (
            "Pose",
            *(f"AP {axis} [°]" for axis in AXES),
            *(f"RP {axis} [°]" for axis in AXES),
        ),
        tuple(
            row(
                str(p["pose"]),
                *(_format_angle(p, axis) for axis in AXES),
                *(_interval(p, f"rp_{axis}", "deg") for axis in AXES),
            )
            for p in poses
        ),
        (ANGLE_NOTE,),
    )


def _format_angle(entry: dict[str, Any], axis: str) -> str:
    low, high = (finite(entry.get(f"ap_{axis}_{end}_deg")) for end in ("low", "high"))
    half = None if low is None or high is None else (high - low) / 2
    return with_uncertainty(entry.get(f"ap_{axis}_deg"), half)


def _variation(poses: list[dict[str, Any]]) -> Table | None:
    found = [(p["pose"], p["variation"]) for p in poses if p.get("variation")]
    if not found:
        return None
    return Table(
        "Multi-directional variation vAP: barycentres of one pose, approached from other poses.",
        "lrrrr",
        ("Pose", "Ways", "vAP [mm]", "noise alone up to [mm]", "largest angle [°]"),
        tuple(
            row(
                str(pose),
                count(v.get("ways")),
                _interval(v, "vap", "mm"),
                number(v.get("vap_of_noise_mm")),
                number(v.get("vap_deg")),
            )
            for pose, v in found
        ),
    )


def _drift(poses: list[dict[str, Any]]) -> Table | None:
    found = [(p["pose"], p["drift"]) for p in poses if p.get("drift")]
    if not found:
        return None
    return Table(
        "Drift: largest change of AP and RP from the first visits to later ones.",
        "lrrrrr",
        (
            "Pose",
            "Blocks",
            "dAP [mm]",
            "noise alone up to [mm]",
            "dRP [mm]",
            "noise alone up to [mm]",
        ),
        tuple(
            row(
                str(pose),
                count(d.get("blocks")),
                number(d.get("dap_mm")),
                number(d.get("dap_of_noise_mm")),
                number(d.get("drp_mm")),
                number(d.get("drp_of_noise_mm")),
            )
            for pose, d in found
        ),
        (DRIFT_NOTE,),
    )


def _distances(distances: list[dict[str, Any]]) -> Table:
    return Table(
        "Distance accuracy AD and distance repeatability RD.",
        "llrrrr",
        ("From", "To", "Distance [mm]", "Visits", "AD [mm]", "RD [mm]"),
        tuple(
            row(
                *(str(name) for name in d.get("poses") or (DASH, DASH)),
                number(d.get("commanded_mm"), 1),
                count(d.get("visits")),
                _interval(d, "ad", "mm", signed=True),
                _interval(d, "rd", "mm"),
            )
            for d in distances
        ),
        (INTERVAL_NOTE, "No registration of the base enters a distance."),
    )


def _paths(paths: list[dict[str, Any]]) -> Table:
    return Table(
        "Path accuracy AT and path repeatability RT of positions.",
        "lrrrrrrr",
        (
            "Path",
            "Passages",
            "Length [mm]",
            "Speed [mm/s]",
            "AT [mm]",
            "noise alone up to [mm]",
            "RT [mm]",
            "robot's RT [mm]",
        ),
        tuple(
            row(
                str(p["path"]),
                count(p.get("passages")),
                number(p.get("length_mm"), 1),
                number(p.get("speed_mm_s"), 1),
                _interval(p, "at", "mm"),
                number(p.get("at_largest_of_noise_mm")),
                _interval(p, "rt", "mm"),
                _format_robot_share(p, "rt", "mm"),
            )
            for p in paths
        ),
        (INTERVAL_NOTE, MAXIMUM_NOTE),
    )
