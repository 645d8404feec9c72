"""Repeated poses and paths by the indices of ISO 9283, with intervals and deviations."""

from functools import partial
from typing import Any

from reports.document import blocks as doc
from reports.document import formatting as fmt
from reports.results import Results
from reports.session.figures.performance import path_band, pose_clusters
from reports.session.outliers import outlier_notes

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

# conditions that differ from the standard's, with the figures of an entry
DEVIATIONS = {
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
    "cycles": "{found} visits of the pose seen least; {standard} are asked for.",
    "passages": "{found} passages of the path seen least; {standard} are asked for.",
    "poses": "Number of poses: {found}; {standard} are asked for.",
    "plane": (
        "The five poses lie up to {off_plane} mm off one plane; a diagonal plane of a cube is "
        "asked for."
    ),
    "approach": (
        "Approached from several poses, where one way is asked for, so that RP holds their "
        "difference: {names}."
    ),
    "drift": "Drift was followed for {hours}; 8 h are asked for.",
    "uncertainty": (
        "The expanded uncertainty exceeds a quarter of AP, where a quarter is the most that the "
        "standard allows: {names}. The smallest AP that could be stated for all poses is "
        "{smallest}."
    ),
    "temperature": "The temperature was {celsius} °C; 20 °C ± 2 °C is asked for.",
}


def deviation(entry: dict[str, Any]) -> str:
    """Say one condition that differs from the standard's."""
    kind, seconds = str(entry.get("kind")), fmt.finite(entry.get("found_s"))
    return DEVIATIONS.get(kind, kind.replace("_", " ")).format(
        found=fmt.count(entry.get("found")),
        standard=fmt.count(entry.get("standard")),
        names=fmt.join_words([str(pose) for pose in entry.get("poses") or [fmt.DASH]]),
        off_plane=fmt.number(entry.get("off_plane_mm"), 1),
        hours=fmt.quantity(None if seconds is None else seconds / 3600, "h"),
        smallest=fmt.quantity(entry.get("smallest_mm"), "mm"),
        celsius=fmt.number(entry.get("found_c"), 1),
    )


TITLE = "Repeated poses and paths (ISO 9283-style)"
AXES = ("rx", "ry", "rz")
INTERVAL_NOTE = "Numbers in brackets are 95 % intervals."
BIAS_NOTE = (
    "AP is a length, so noise can only make it longer: the column beside it says how long noise "
    "and stated uncertainties alone make it, the next what is left without that."
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
NO_VISITS = "The single visits were not kept."
FIGURES = {
    "pose_clusters": doc.FigurePlan(
        pose_clusters,
        "Where each visit of a pose ended, about the position that the encoders read "
        "(cross-hairs); the dot is the barycentre, the circle about it has the radius RP.",
        "Panels a pose, seen along z and along y: points of the visits in millimetres about the "
        "origin, with a circle about their barycentre.",
        NO_VISITS,
    ),
    "path_band": doc.FigurePlan(
        path_band,
        "How far the mean of the passages lies off the path that the encoders read, along the "
        "path; the band is RT about it.",
        "A curve a path in millimetres over the way travelled, with a band about it.",
        NO_VISITS,
    ),
}


def performance(results: Results) -> doc.Section:
    """Give every index with its interval, its noise and the conditions it was found under."""
    entry = results.summary.get("performance")
    if not entry:
        reason = str(results.summary.get("performance_reason"))
        text = REASONS.get(reason, REASONS["no_repeats"])
        return doc.Section("performance", TITLE, (doc.Paragraph(text, "note"),))
    poses, paths = entry.get("poses") or [], entry.get("paths") or []
    blocks: list[doc.Block] = []
    if poses:
        blocks += [doc.Paragraph(_pose_summary(poses)), _positions(entry)]
        blocks[1:1] = [doc.Paragraph(note, "note") for note in outlier_notes(entry)]
        blocks.append(doc.figure_or_text(FIGURES, results, "pose_clusters"))
        tables = (make(poses) for make in (_orientations, _variation, _drift))
        blocks += [table for table in tables if table is not None]
    if entry.get("distances"):
        blocks.append(_distances(entry["distances"]))
    if paths:
        blocks += [doc.Paragraph(_path_summary(paths)), _paths(paths)]
        blocks.append(doc.figure_or_text(FIGURES, results, "path_band"))
    text = (
        "These figures are named ISO 9283-style because the test differs from the standard's, "
        "or is not known to agree, in this:"
    )
    deviations = doc.Bullets(tuple(deviation(d) for d in entry.get("deviations") or []))
    blocks += [doc.Paragraph(text), deviations]
    return doc.Section("performance", TITLE, tuple(blocks))


def _pose_summary(poses: list[dict[str, Any]]) -> str:
    visits = [int(p["visits"]) for p in poses]
    accuracy = max(poses, key=lambda p: fmt.finite(p.get("ap_mm")) or 0.0)
    scatter = max(poses, key=lambda p: fmt.finite(p.get("rp_mm")) or 0.0)
    often = (
        fmt.count(min(visits)) if min(visits) == max(visits) else f"{min(visits)} to {max(visits)}"
    )
    return (
        f"{fmt.count(len(poses))} poses, each visited {often} times. "
        f"Largest pose accuracy: AP {_interval(accuracy, 'ap', 'mm')} mm, at {accuracy['pose']}. "
        f"Largest pose repeatability: RP {_interval(scatter, 'rp', 'mm')} mm, at "
        f"{scatter['pose']}, of which the robot's share is "
        f"{_format_robot_share(scatter, 'rp')} mm."
    )


def _path_summary(paths: list[dict[str, Any]]) -> str:
    accuracy = max(paths, key=lambda p: fmt.finite(p.get("at_mm")) or 0.0)
    scatter = max(paths, key=lambda p: fmt.finite(p.get("rt_mm")) or 0.0)
    return (
        f"{fmt.count(len(paths))} paths. "
        f"Largest path accuracy: AT {_interval(accuracy, 'at', 'mm')} mm, on {accuracy['path']}. "
        f"Largest path repeatability: RT {_interval(scatter, 'rt', 'mm')} mm, on "
        f"{scatter['path']}."
    )


def _interval(entry: dict[str, Any], name: str, unit: str, signed: bool = False) -> str:
    """A figure with its interval in brackets, to the digits that the interval leaves."""
    value, low, high = (
        fmt.finite(entry.get(f"{name}{part}_{unit}")) for part in ("", "_low", "_high")
    )
    if value is None or low is None or high is None:
        return fmt.number(value)
    decimals = fmt.decimals_of((high - low) / 4)
    return (
        f"{fmt.number(value, decimals, signed)} "
        f"({fmt.number(low, decimals, signed)} – {fmt.number(high, decimals, signed)})"
    )


def _format_robot_share(entry: dict[str, Any], name: str) -> str:
    """The robot's share of a repeatability, mm, or the bound below which it lies."""
    low, high = (fmt.finite(entry.get(f"{name}_{end}_mm")) for end in ("low", "high"))
    decimals = 3 if low is None or high is None else fmt.decimals_of((high - low) / 4)
    found = fmt.finite(entry.get(f"{name}_robot_mm"))
    if found is not None:
        return fmt.number(found, decimals)
    return f"≤ {fmt.number(entry.get(f'{name}_robot_at_most_mm'), decimals)}"


def _positions(entry: dict[str, Any]) -> doc.Table:
    measured_floor = (entry.get("noise_floor") or {}).get("source") == "holds"
    columns = (
        doc.Column("Pose", "l", doc.field("pose", str)),
        doc.Column("Visits", "r", doc.field("visits", fmt.count)),
        doc.Column("AP [mm]", "r", lambda p: _interval(p, "ap", "mm")),
        doc.Column("Of noise [mm]", "r", doc.field("ap_of_noise_mm", fmt.number)),
        doc.Column("Without bias [mm]", "r", doc.field("ap_less_bias_mm", fmt.number)),
        doc.Column("RP [mm]", "r", lambda p: _interval(p, "rp", "mm")),
        doc.Column("Floor [mm]", "r", doc.field("rp_floor_mm", fmt.number)),
        doc.Column("Robot's RP [mm]", "r", lambda p: _format_robot_share(p, "rp")),
    )
    notes = INTERVAL_NOTE, BIAS_NOTE, FLOOR_NOTE if measured_floor else STATED_FLOOR_NOTE
    title = "Pose accuracy AP and pose repeatability RP of positions."
    return doc.tabulate(title, columns, entry["poses"], *notes)


def _orientations(poses: list[dict[str, Any]]) -> doc.Table | None:
    if not any("ap_rx_deg" in p for p in poses):
        return None
    columns = (
        doc.Column("Pose", "l", doc.field("pose", str)),
        *(doc.Column(f"AP {axis} [°]", "r", partial(_format_angle, axis)) for axis in AXES),
        *(
            doc.Column(f"RP {axis} [°]", "r", partial(_interval, name=f"rp_{axis}", unit="deg"))
            for axis in AXES
        ),
    )
    title = "Pose accuracy and pose repeatability of orientations."
    return doc.tabulate(title, columns, poses, ANGLE_NOTE)


def _format_angle(axis: str, entry: dict[str, Any]) -> str:
    low, high = (fmt.finite(entry.get(f"ap_{axis}_{end}_deg")) for end in ("low", "high"))
    half = None if low is None or high is None else (high - low) / 2
    return fmt.with_uncertainty(entry.get(f"ap_{axis}_deg"), half)


def _entries_with(poses: list[dict[str, Any]], key: str) -> list[dict[str, Any]]:
    """What poses hold under a key, each with its pose."""
    return [{"pose": pose["pose"], **pose[key]} for pose in poses if pose.get(key)]


def _variation(poses: list[dict[str, Any]]) -> doc.Table | None:
    columns = (
        doc.Column("Pose", "l", doc.field("pose", str)),
        doc.Column("Ways", "r", doc.field("ways", fmt.count)),
        doc.Column("vAP [mm]", "r", lambda v: _interval(v, "vap", "mm")),
        doc.Column("Noise alone up to [mm]", "r", doc.field("vap_of_noise_mm", fmt.number)),
        doc.Column("Largest angle [°]", "r", doc.field("vap_deg", fmt.number)),
    )
    entries = _entries_with(poses, "variation")
    title = "Multi-directional variation vAP: barycentres of one pose, approached from other poses."
    return doc.tabulate(title, columns, entries) if entries else None


def _drift(poses: list[dict[str, Any]]) -> doc.Table | None:
    columns = (
        doc.Column("Pose", "l", doc.field("pose", str)),
        doc.Column("Blocks", "r", doc.field("blocks", fmt.count)),
        doc.Column("dAP [mm]", "r", doc.field("dap_mm", fmt.number)),
        doc.Column("Noise alone up to [mm]", "r", doc.field("dap_of_noise_mm", fmt.number)),
        doc.Column("dRP [mm]", "r", doc.field("drp_mm", fmt.number)),
        doc.Column("Noise alone up to [mm]", "r", doc.field("drp_of_noise_mm", fmt.number)),
    )
    entries = _entries_with(poses, "drift")
    title = "Drift: largest change of AP and RP from the first visits to later ones."
    return doc.tabulate(title, columns, entries, DRIFT_NOTE) if entries else None


def _distances(distances: list[dict[str, Any]]) -> doc.Table:
    columns = (
        doc.Column("From", "l", lambda d: str((d.get("poses") or (fmt.DASH, fmt.DASH))[0])),
        doc.Column("To", "l", lambda d: str((d.get("poses") or (fmt.DASH, fmt.DASH))[1])),
        doc.Column("Distance [mm]", "r", doc.field("commanded_mm", fmt.number, 1)),
        doc.Column("Visits", "r", doc.field("visits", fmt.count)),
        doc.Column("AD [mm]", "r", lambda d: _interval(d, "ad", "mm", signed=True)),
        doc.Column("RD [mm]", "r", lambda d: _interval(d, "rd", "mm")),
    )
    notes = INTERVAL_NOTE, "No registration of the base enters a distance."
    title = "Distance accuracy AD and distance repeatability RD."
    return doc.tabulate(title, columns, distances, *notes)


def _paths(paths: list[dict[str, Any]]) -> doc.Table:
    columns = (
        doc.Column("Path", "l", doc.field("path", str)),
        doc.Column("Passages", "r", doc.field("passages", fmt.count)),
        doc.Column("Length [mm]", "r", doc.field("length_mm", fmt.number, 1)),
        doc.Column("Speed [mm/s]", "r", doc.field("speed_mm_s", fmt.number, 1)),
        doc.Column("AT [mm]", "r", lambda p: _interval(p, "at", "mm")),
        doc.Column("Noise alone up to [mm]", "r", doc.field("at_largest_of_noise_mm", fmt.number)),
        doc.Column("RT [mm]", "r", lambda p: _interval(p, "rt", "mm")),
        doc.Column("Robot's RT [mm]", "r", lambda p: _format_robot_share(p, "rt")),
    )
    title = "Path accuracy AT and path repeatability RT of positions."
    return doc.tabulate(title, columns, paths, INTERVAL_NOTE, MAXIMUM_NOTE)
