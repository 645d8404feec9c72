"""Plan the motion of the next session: an arm before a rig in, motion and prediction out."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import robots
from reports import Results
from reports.document.formatting import expanded, significant
from verify.cli.terminal import report_files, terminal
from verify.core.records import Array
from verify.errors import InputError
from verify.io import fiducials
from verify.io import rig as io_rig
from verify.io.files import digest, write_folder_whole
from verify.io.results import refuse_existing, write_report_folder
from verify.io.session.folder import check_absorption
from verify.planning.plan import SessionPlan, plan_motion
from verify.planning.request import PlanningSetup
from verify.planning.results import PlanProvenance, plan_results

RIG_FILE, MARKER_FILE = "rig.toml", "marker.toml"
MIN_DIRECTION_SHARE = 0.1  # share of pairs of one direction of travel: below, worth a warning
MIN_MEASURED_SHARE = 0.8  # share of pairs that are measured: below, worth a warning


def plan_session(provenance: PlanProvenance, out: Path | None, *, force: bool) -> None:
    """Plan the next session; write plan.csv, poses.csv and the reports.

    The provenance holds the warnings of the files it comes from. `out` None is ROBOT-plan in the
    current folder; `force`: it need not be empty.

    Raises:
        InputError: nothing can be planned, or `out` is taken.
    """
    setup, request, conditions = provenance.setup, provenance.request, provenance.conditions
    target = out if out is not None else Path(f"{setup.arm.name}-plan")
    refuse_existing(target, force=force)
    with terminal.progress("stages") as progress:
        plan = plan_motion(setup, request, conditions, progress)
    warnings = (*provenance.warnings, *_warnings(plan))
    terminal.warn(*warnings)
    results = plan_results(plan, replace(provenance, warnings=warnings))
    with write_folder_whole(target, force) as folder:
        write_report_folder(results, folder, force=True)
        for name, table in (("plan", "trajectory"), ("poses", "poses")):
            results.tables[table].to_csv(
                folder / f"{name}.csv", index=False, float_format="%.5f", lineterminator="\n"
            )
    _print_summary(results, target)


def planning_setup(
    arm: robots.Arm, rig: Path, marker: Path | None
) -> tuple[PlanningSetup, dict[str, str], tuple[str, ...]]:
    """Read rig and LEDs of an arm; the files' digests, and warnings.

    `rig` is a rig.toml or its folder; `marker` None is the marker.toml beside it.

    Raises:
        InputError: a file cannot be used.
    """
    rig_path = rig / RIG_FILE if rig.is_dir() else rig
    marker_path = marker if marker is not None else rig_path.parent / MARKER_FILE
    if marker is None and not marker_path.is_file():
        raise InputError(
            "--marker", f"is not given, and there is no {marker_path}",
            "a plan needs to know where the LEDs sit on the flange", "Give --marker FILE.",
        )  # fmt: skip
    cameras, rig_warnings = io_rig.read(rig_path)
    leds, marker_warnings = fiducials.read_marker(marker_path)
    check_absorption(rig_path, cameras, arm.dof)
    if len(leds) < 3:
        raise InputError(
            marker_path, f"names {len(leds)} LED{'' if len(leds) == 1 else 's'}",
            "a plan needs 3 or more, which give the whole pose", "Name every LED.",
        )  # fmt: skip
    inputs = {rig_path.name: digest(rig_path), marker_path.name: digest(marker_path)}
    return PlanningSetup(arm, cameras, leds), inputs, (*rig_warnings, *marker_warnings)


def parse_posture(text: str, arm: robots.Arm) -> Array:
    """Read --near: degrees with commas between; returns (j,), rad.

    Raises:
        InputError: not a number a joint, or outside the arm's limits.
    """
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if len(values) != arm.dof or not all(map(math.isfinite, values)):
        raise InputError(
            "--near", f'"{text}" is not a posture of {arm}',
            f"{arm.dof} numbers of degrees with commas between are expected",
            "Example: --near 0,-60,45,0,-85,15",
        )  # fmt: skip
    q: Array = np.deg2rad(values)
    outside = np.flatnonzero((q < arm.lower) | (q > arm.upper))
    if len(outside):
        j = int(outside[0])
        low, high = np.degrees([arm.lower[j], arm.upper[j]])
        raise InputError(
            "--near", f"joint {j + 1} stands at {values[j]:g}°",
            f"its limits are {low:g}° and {high:g}°", "Give a posture within them.",
        )  # fmt: skip
    return q


def _warnings(plan: SessionPlan) -> list[str]:
    warnings = []
    session = plan.prediction.session
    exact = session.systematics.uncounted
    if exact:
        warnings.append(
            f"No uncertainty is stated for {', '.join(exact)}: taken as exact; the predicted "
            "uncertainties hold on that condition."
        )
    upward = np.mean(session.comparison.direction > 0, axis=0)
    one_way = [
        f"{j + 1}"
        for j in np.flatnonzero(np.abs(upward - 0.5) > 0.5 - MIN_DIRECTION_SHARE).tolist()
    ]
    if one_way:
        warnings.append(
            f"Joint {', '.join(one_way)} turns one way nearly all the time; with --observe "
            "backlash every pose is visited from either side."
        )
    share = len(session.track) / len(session.t)
    if share < MIN_MEASURED_SHARE:
        warnings.append(f"Only {share:.0%} of the pairs would be measured.")
    return warnings


def _print_summary(results: Results, target: Path) -> None:
    summary = results.summary
    motion, pairs = summary["motion"], summary["pairs"]
    terminal.say(
        f"{motion['poses']} poses, {motion['duration_s']:.0f} s; {pairs['measured']} of "
        f"{pairs['recorded']} pairs would be measured"
    )
    if (rig := summary["rig"]) is not None:
        width, height = rig["image_size"]
        terminal.say(
            f"rig to be built: {width}x{height} pixels, {rig['field_of_view_deg']:g}°; baseline "
            f"{rig['baseline_m']:g} m, distance {rig['distance_m']:g} m, each camera turned "
            f"inwards by {rig['vergence_deg']:.1f}°; {rig['leds']} LEDs on a circle of "
            f"{rig['led_circle_mm']:g} mm"
        )
    terminal.say("Uncertainty of each joint's mean error (k = 2), and what it comes from:")
    terminal.say(*_joint_table(summary["joints"]))
    for joint in summary["joints"]:
        if joint["tolerance_deg"] is not None:
            terminal.say(_tolerance_line(joint))
    flange = summary["flange"]
    terminal.say(
        f"Flange, one pair: ± {_expanded(flange['standard_uncertainty_mm'])} mm, "
        f"± {_expanded(flange['standard_uncertainty_deg'])}° (k = 2, worst direction)"
    )
    if exact := summary["uncounted"]:
        terminal.say(f"Taken as exact: {', '.join(exact)}")
    terminal.say("The plan does not know obstacles: try the motion slowly first.")
    tables = f"{target / 'plan.csv'} and {target / 'poses.csv'}"
    terminal.say(f"Written: {tables}; report: {report_files(target)}")
    terminal.record("result", out=str(target), summary=summary)


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
