"""Plan the motion of the next session: an arm before a rig in, motion and prediction out."""

import math
from pathlib import Path

import numpy as np

import robots
from reports import Results
from reports.plan.summary import plan_lines, plan_warnings
from verify.cli.terminal import report_files, terminal
from verify.core.records import Array
from verify.errors import InputError
from verify.io import fiducials
from verify.io import rig as io_rig
from verify.io.files import digest, write_folder_whole
from verify.io.results import refuse_existing, write_report_folder
from verify.io.session.folder import check_absorption
from verify.planning.plan import plan_motion
from verify.planning.request import PlanningSetup
from verify.planning.results import PlanProvenance, plan_results

RIG_FILE, MARKER_FILE = "rig.toml", "marker.toml"


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
    results = plan_results(plan, provenance)
    results.summary["warnings"].extend(plan_warnings(results.summary))
    terminal.warn(*results.summary["warnings"])
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


def _print_summary(results: Results, target: Path) -> None:
    terminal.say(*plan_lines(results.summary))
    tables = f"{target / 'plan.csv'} and {target / 'poses.csv'}"
    terminal.say(f"Written: {tables}; report: {report_files(target)}")
    terminal.record("result", out=str(target), summary=results.summary)
