"""Plan the motion of the next session: an arm before a rig in, motion and prediction out."""

import math
from pathlib import Path

import numpy as np

import robots
from reports import Results
from verify.cli.plan.plan import PlanOptions
from verify.cli.terminal import terminal
from verify.core.records import Array
from verify.errors import InputError
from verify.io import fiducials
from verify.io import rig as io_rig
from verify.io.files import digest, write_folder_whole
from verify.io.results import refuse_existing, write_report_folder
from verify.io.session.folder import check_absorption
from verify.planning.plan import SessionPlan, plan_motion
from verify.planning.request import DEFAULT_KINDS, PlanningSetup, PlanRequest, SessionConditions
from verify.planning.results import PlanProvenance, plan_results

RIG_FILE, MARKER_FILE = "rig.toml", "marker.toml"
DEFAULT_POSES = 12
MIN_DIRECTION_SHARE = 0.1  # share of pairs of one direction of travel: below, worth a warning
MIN_MEASURED_SHARE = 0.8  # share of pairs that are measured: below, worth a warning


def plan_session(
    robot: str,
    rig: Path,
    marker: Path | None,
    out: Path | None,
    options: PlanOptions,
    *,
    force: bool,
) -> None:
    """Plan the next session; write plan.csv, poses.csv and the reports.

    Args:
        robot: a name, a robot file or a URDF.
        rig: rig.toml or the folder that holds it.
        marker: marker.toml; None: beside the rig.
        out: where the plan goes; None: ROBOT-plan in the current folder.
        options: as they were typed.
        force: write into a folder that is not empty.

    Raises:
        InputError: a file or an option cannot be used, nothing can be planned, `out` is taken.
    """
    bench, inputs, warnings = _planning_setup(robot, rig, marker)
    request, conditions = plan_request(options, bench.arm), session_conditions(options)
    target = out if out is not None else Path(f"{bench.arm.name}-plan")
    refuse_existing(target, force=force)
    with terminal.progress("stages") as progress:
        made = plan_motion(bench, request, conditions, progress)
    said = (*warnings, *_warnings(made))
    for warning in said:
        terminal.warn(warning)
    written = plan_results(made, PlanProvenance(bench, request, conditions, inputs, said))
    with write_folder_whole(target, force) as folder:
        write_report_folder(written, folder, force=True)
        for name, table in (("plan", "trajectory"), ("poses", "poses")):
            written.tables[table].to_csv(
                folder / f"{name}.csv", index=False, float_format="%.5f", lineterminator="\n"
            )
    _print_summary(written, target)


def _planning_setup(
    robot: str, rig: Path, marker: Path | None
) -> tuple[PlanningSetup, dict[str, str], tuple[str, ...]]:
    try:
        arm = robots.load(robot)
    except robots.RobotError as problem:
        raise InputError(
            problem.place, problem.found, problem.expected, problem.remedy
        ) from problem
    rig_path = rig / RIG_FILE if rig.is_dir() else rig
    marker_path = marker if marker is not None else rig_path.parent / MARKER_FILE
    if marker is None and not marker_path.is_file():
        raise InputError(
            "--marker", f"is not given, and there is no {marker_path}",
            "a plan needs to know where the LEDs sit on the flange", "Give --marker FILE.",
        )  # fmt: skip
    read_rig, said_of_rig = io_rig.read(rig_path)
    read_marker, said_of_marker = fiducials.read_marker(marker_path)
    check_absorption(rig_path, read_rig, arm.dof)
    if len(read_marker) < 3:
        raise InputError(
            marker_path, f"names {len(read_marker)} LED{'' if len(read_marker) == 1 else 's'}",
            "a plan needs 3 or more, which give the whole pose", "Name every LED.",
        )  # fmt: skip
    inputs = {rig_path.name: digest(rig_path), marker_path.name: digest(marker_path)}
    return PlanningSetup(arm, read_rig, read_marker), inputs, (*said_of_rig, *said_of_marker)


def plan_request(options: PlanOptions, arm: robots.Arm) -> PlanRequest:
    """Turn the options into metres and radians.

    Raises:
        InputError: a number that cannot be, or options that exclude each other.
    """
    if options.poses is not None and options.duration_s is not None:
        raise InputError(
            "--duration-s", "is given with --poses", "one of them says how long the plan is",
            "Leave one out.",
        )  # fmt: skip
    for option in ("speed_deg_s", "within_deg", "view_angle_deg", "duration_s"):
        _require(option, getattr(options, option))
    poses = None if options.duration_s is not None else options.poses or DEFAULT_POSES
    return PlanRequest(
        observe=tuple(dict.fromkeys(options.observe)) or DEFAULT_KINDS,
        poses=poses,
        duration=options.duration_s,
        hold=_require("hold_s", options.hold_s, zero=True) or 0.0,
        speed=float(np.deg2rad(options.speed_deg_s)),
        view_angle=float(np.deg2rad(min(options.view_angle_deg, 180.0))),
        floor=options.floor_mm * 1e-3,
        near=None if options.near is None else _parse_posture(options.near, arm),
        within=float(np.deg2rad(options.within_deg)),
        seed=options.seed,
    )


def session_conditions(options: PlanOptions) -> SessionConditions:
    """Turn the session's options into seconds and radians.

    Raises:
        InputError: a number that cannot be.
    """
    for option in ("rate_hz", "spot_noise_px", "reading_noise_deg"):
        _require(option, getattr(options, option))
    given = _require("clock_uncertainty_ms", options.clock_uncertainty_ms, zero=True)
    if not abs(options.skew_ms) * 1e-3 < 1 / options.rate_hz:
        raise InputError(
            "--skew-ms", f"{options.skew_ms:g} ms", "less than the time between two pairs"
        )
    return SessionConditions(
        rate=options.rate_hz,
        skew=options.skew_ms * 1e-3,
        spot_noise=options.spot_noise_px,
        reading_noise=float(np.deg2rad(options.reading_noise_deg)),
        clock_uncertainty=None if given is None else given * 1e-3,
    )


def _parse_posture(text: str, arm: robots.Arm) -> Array:
    """Read --near, degrees."""
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if len(values) != arm.dof or not all(map(math.isfinite, values)):
        raise InputError(
            "--near", f'"{text}" is no posture of {arm}',
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


def _require(option: str, value: float | None, *, zero: bool = False) -> float | None:
    """Refuse a number that is not positive (or 0, with `zero`); None passes."""
    if value is not None and not (math.isfinite(value) and (value > 0 or (zero and value == 0))):
        raise InputError(
            f"--{option.replace('_', '-')}", f"{value:g}",
            f"a number above {'or at ' if zero else ''}0 is needed",
        )  # fmt: skip
    return value


def _warnings(made: SessionPlan) -> list[str]:
    said = []
    seen = made.prediction.session
    exact = seen.systematics.uncounted
    if exact:
        said.append(
            f"No uncertainty is stated for {', '.join(exact)}: taken as exact; the predicted "
            "uncertainties hold on that condition."
        )
    upward = np.mean(seen.comparison.direction > 0, axis=0)
    one_way = [
        f"{j + 1}"
        for j in np.flatnonzero(np.abs(upward - 0.5) > 0.5 - MIN_DIRECTION_SHARE).tolist()
    ]
    if one_way:
        said.append(
            f"Joint {', '.join(one_way)} turns one way nearly all the time; with --observe "
            "backlash every pose is visited from either side."
        )
    share = len(seen.track) / len(seen.t)
    if share < MIN_MEASURED_SHARE:
        said.append(f"Only {share:.0%} of the pairs would be measured.")
    return said


def _print_summary(made: Results, target: Path) -> None:
    summary = made.summary
    motion, pairs = summary["motion"], summary["pairs"]
    terminal.say(
        f"{motion['poses']} poses, {motion['duration_s']:.0f} s; {pairs['measured']} of "
        f"{pairs['recorded']} pairs would be measured"
    )
    for joint in summary["joints"]:
        terminal.say(_joint_line(joint))
    terminal.say("Obstacles are not known to the plan: try it slowly first.")
    terminal.say(
        f"Written: {target / 'plan.csv'} and {target / 'poses.csv'}; report: "
        f"{target / 'report.html'} and {target / 'report.pdf'}"
    )
    terminal.record({"type": "result", "out": str(target), "summary": summary})


def _joint_line(joint: dict[str, float | None]) -> str:
    u, smallest = joint["standard_uncertainty_deg"], joint["minimum_detectable_error_deg"]
    if u is None or smallest is None:
        return f"  joint {joint['joint']}: a constant offset cannot show"
    return (
        f"  joint {joint['joint']}: mean error ± {2 * u:.3f}° (k = 2); an offset of "
        f"{smallest:.3f}° would be noticed"
    )
