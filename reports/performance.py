"""Repeated poses and paths, by the indices of ISO 9283: what they are and how sure."""

from collections.abc import Callable
from typing import Any

from reports.blocks import Block, Bullets, Figure, Paragraph, Section, Table, drawn_or_said, row
from reports.formatting import DASH, count, decimals_of, finite, measured, number
from reports.performance_figures import path_band, pose_clusters
from reports.performance_words import REASONS, deviation
from reports.results import Results

TITLE = "Repeated poses and paths (ISO 9283-style)"
AXES = ("rx", "ry", "rz")
INTERVALS = "Numbers in brackets are 95 % intervals."
BIAS = (
    "AP is a length, so noise can only make it longer: the column beside it says how long noise "
    "and stated doubts alone make it, the next what is left without that."
)
FLOOR = (
    "The floor is what the instrument's own noise would show as RP, from its scatter while the "
    "arm stood still; the robot's share is RP with the floor taken off in quadrature, and an "
    "upper bound (≤) where the interval reaches down to the floor."
)
STATED_FLOOR = (
    "The floor is what the instrument's own noise would show as RP, as the poses state it: the "
    "arm was not seen standing still often enough to measure it. The robot's share is RP with the "
    "floor taken off in quadrature, and an upper bound (≤) where the interval reaches down to the "
    "floor."
)
ANGLES = (
    "Small turns about the base's axes, from the mean orientation that the encoders read; ± and "
    "brackets are 95 % intervals."
)
NO_DRIFT = (
    "Noise alone: what the same visits in any other order stay under in 95 % of cases. A change "
    "below it is no sign of drift."
)
LARGEST = (
    "AT and RT are the largest of many places along the path, and noise alone makes the largest of "
    "many large: AT below the column beside it is no sign of an error."
)
CLUSTERS = (
    "Where each visit of a pose ended, about the position that the encoders read (cross-hairs); "
    "the dot is the barycentre, the circle about it has the radius RP."
)
CLUSTERS_ALT = (
    "Panels a pose, seen along z and along y: points of the visits in millimetres about the "
    "origin, with a circle about their barycentre."
)
BAND = (
    "How far the mean of the passages lies off the path that the encoders read, along the path; "
    "the band is RT about it."
)
NOT_KEPT = "The single visits were not kept."
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
        clusters = Figure("pose_clusters", CLUSTERS, CLUSTERS_ALT)
        blocks += [Paragraph(_answer(poses)), _positions(entry)]
        blocks.append(drawn_or_said(clusters, pose_clusters(results), NOT_KEPT))
        blocks += _optional(poses, _orientations, _variation, _drift)
    blocks += _optional(entry.get("distances") or [], _distances)
    if paths:
        band = Figure("path_band", BAND, BAND_ALT)
        blocks += [Paragraph(_answer_paths(paths)), _paths(paths)]
        blocks.append(drawn_or_said(band, path_band(results), NOT_KEPT))
    blocks.append(
        Paragraph(
            "These figures are named ISO 9283-style because the test differs from the standard's, "
            "or is not known to agree, in this:"
        )
    )
    blocks.append(Bullets(tuple(deviation(d) for d in entry.get("deviations") or [])))
    return Section("performance", TITLE, tuple(blocks))


def _optional(entries: list[Any], *tables: Callable[[list[Any]], Table | None]) -> list[Block]:
    return [table for make in tables if entries and (table := make(entries)) is not None]


def _answer(poses: list[dict[str, Any]]) -> str:
    visits = [int(p["visits"]) for p in poses]
    accuracy = max(poses, key=lambda p: finite(p.get("ap_mm")) or 0.0)
    scatter = max(poses, key=lambda p: finite(p.get("rp_mm")) or 0.0)
    often = count(min(visits)) if min(visits) == max(visits) else f"{min(visits)} to {max(visits)}"
    return (
        f"{count(len(poses))} poses, each visited {often} times. "
        f"Largest pose accuracy: AP {_interval(accuracy, 'ap', 'mm')} mm, at {accuracy['pose']}. "
        f"Largest pose repeatability: RP {_interval(scatter, 'rp', 'mm')} mm, at "
        f"{scatter['pose']}, of which the robot's share is {_robot(scatter, 'rp', 'mm')} mm."
    )


def _answer_paths(paths: list[dict[str, Any]]) -> str:
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


def _robot(entry: dict[str, Any], name: str, unit: str) -> str:
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
            _robot(p, "rp", "mm"),
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
        (INTERVALS, BIAS, FLOOR if measured_floor else STATED_FLOOR),
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
                *(_turned(p, axis) for axis in AXES),
                *(_interval(p, f"rp_{axis}", "deg") for axis in AXES),
            )
            for p in poses
        ),
        (ANGLES,),
    )


def _turned(entry: dict[str, Any], axis: str) -> str:
    low, high = (finite(entry.get(f"ap_{axis}_{end}_deg")) for end in ("low", "high"))
    half = None if low is None or high is None else (high - low) / 2
    return measured(entry.get(f"ap_{axis}_deg"), half)


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
        (NO_DRIFT,),
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
        (INTERVALS, "No registration of the base enters a distance."),
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
                _robot(p, "rt", "mm"),
            )
            for p in paths
        ),
        (INTERVALS, LARGEST),
    )
