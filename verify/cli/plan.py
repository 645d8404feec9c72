"""Plan the motion of the next session.

What `verify plan` does: an arm before a rig in, a motion and its prediction out.
"""

import math
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import robots
from reports import Results
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


class ObservableChoice(StrEnum):
    """What the motion is to make observable."""

    offsets = "offsets"
    gains = "gains"
    backlash = "backlash"
    eccentricity = "eccentricity"
    kinematics = "kinematics"
    clock = "clock"


def plan(
    robot: Annotated[str, typer.Argument(help="An arm's name, a robot file or a URDF.")],
    rig: Annotated[Path, typer.Argument(help="rig.toml, or a folder that holds one.")],
    marker: Annotated[
        Path | None, typer.Option(help="marker.toml; without it the one beside the rig.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Where the plan goes; ROBOT-plan.")
    ] = None,
    observe: Annotated[
        list[ObservableChoice] | None,
        typer.Option(help="What is to be shown; repeatable. Offsets, gains, backlash, clock."),
    ] = None,
    poses: Annotated[
        int | None, typer.Option(min=4, max=60, help="How many poses; 12 without --duration-s.")
    ] = None,
    duration_s: Annotated[
        float | None, typer.Option(help="As many poses as fit into so many seconds.")
    ] = None,
    hold_s: Annotated[float, typer.Option(min=0.0, help="Seconds of rest at each pose.")] = 0.5,
    speed_deg_s: Annotated[
        float, typer.Option(help="The most of any joint; the arm's own limits hold as well.")
    ] = 30.0,
    near: Annotated[
        str | None, typer.Option(help="A posture to stay about, degrees: 0,-60,45,0,-85,15.")
    ] = None,
    within_deg: Annotated[
        float, typer.Option(help="How far each joint may go from --near.")
    ] = 45.0,
    floor_mm: Annotated[
        float, typer.Option(help="Nothing of the arm goes below; robot's base frame.")
    ] = 0.0,
    view_angle_deg: Annotated[
        float, typer.Option(help="LEDs are seen so far from the flange's z; 180: all round.")
    ] = 60.0,
    rate_hz: Annotated[float, typer.Option(help="Stereo pairs a second.")] = 10.0,
    spot_noise_px: Annotated[
        float, typer.Option(help="Standard uncertainty of an LED's image, each coordinate.")
    ] = 0.05,
    reading_noise_deg: Annotated[
        float, typer.Option(help="Standard deviation of an encoder reading.")
    ] = 0.01,
    skew_ms: Annotated[float, typer.Option(help="Right picture after the left.")] = 0.0,
    clock_uncertainty_ms: Annotated[
        float | None,
        typer.Option(help="Of an encoder clock that will be given; else found from the motion."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the postures that are drawn.")] = 0,
    force: Annotated[bool, typer.Option("--force", help="Replace files that are there.")] = False,
) -> None:
    """Plan a motion that shows what you ask, and predict how well.

    The LEDs stay in view of both cameras, joints within limits and clear of singularities, every
    joint turns both ways. Obstacles are not known: try the motion slowly first.

    Example: verify plan iust_6r rig.toml --observe offsets --observe backlash -o next_session
    """
    asked = PlanOptions(
        observe=tuple(kind.value for kind in observe or ()),
        poses=poses, duration_s=duration_s, hold_s=hold_s, speed_deg_s=speed_deg_s, near=near,
        within_deg=within_deg, floor_mm=floor_mm, view_angle_deg=view_angle_deg, rate_hz=rate_hz,
        spot_noise_px=spot_noise_px, reading_noise_deg=reading_noise_deg, skew_ms=skew_ms,
        clock_uncertainty_ms=clock_uncertainty_ms, seed=seed,
    )  # fmt: skip
    plan_session(robot, rig, marker, out, asked, force=force)


RIG_FILE, MARKER_FILE = "rig.toml", "marker.toml"
DEFAULT_POSES = 12
MIN_DIRECTION_SHARE = 0.1  # share of pairs of one direction of travel: below, worth a warning
MIN_MEASURED_SHARE = 0.8  # share of pairs that are measured: below, worth a warning


@dataclass(frozen=True, slots=True)
class PlanOptions:
    """The options, in users' units."""

    observe: tuple[str, ...]
    poses: int | None
    duration_s: float | None
    hold_s: float
    speed_deg_s: float
    near: str | None
    within_deg: float
    floor_mm: float
    view_angle_deg: float
    rate_hz: float
    spot_noise_px: float
    reading_noise_deg: float
    skew_ms: float
    clock_uncertainty_ms: float | None
    seed: int

    def wish(self, arm: robots.Arm) -> PlanRequest:
        """Turn them into metres and radians.

        Raises:
            InputError: a number that cannot be, or options that exclude each other.
        """
        if self.poses is not None and self.duration_s is not None:
            raise InputError(
                "--duration-s", "is given with --poses", "one of them says how long the plan is",
                "Leave one out.",
            )  # fmt: skip
        for option in ("speed_deg_s", "within_deg", "view_angle_deg", "duration_s"):
            _require(option, getattr(self, option))
        poses = None if self.duration_s is not None else self.poses or DEFAULT_POSES
        return PlanRequest(
            observe=tuple(dict.fromkeys(self.observe)) or DEFAULT_KINDS,
            poses=poses,
            duration=self.duration_s,
            hold=_require("hold_s", self.hold_s, zero=True) or 0.0,
            speed=float(np.deg2rad(self.speed_deg_s)),
            view_angle=float(np.deg2rad(min(self.view_angle_deg, 180.0))),
            floor=self.floor_mm * 1e-3,
            near=None if self.near is None else _parse_posture(self.near, arm),
            within=float(np.deg2rad(self.within_deg)),
            seed=self.seed,
        )

    def conditions(self) -> SessionConditions:
        """Turn the session's into seconds and radians.

        Raises:
            InputError: a number that cannot be.
        """
        for option in ("rate_hz", "spot_noise_px", "reading_noise_deg"):
            _require(option, getattr(self, option))
        given = _require("clock_uncertainty_ms", self.clock_uncertainty_ms, zero=True)
        if not abs(self.skew_ms) * 1e-3 < 1 / self.rate_hz:
            raise InputError(
                "--skew-ms", f"{self.skew_ms:g} ms", "less than the time between two pairs"
            )
        return SessionConditions(
            rate=self.rate_hz,
            skew=self.skew_ms * 1e-3,
            spot_noise=self.spot_noise_px,
            reading_noise=float(np.deg2rad(self.reading_noise_deg)),
            clock_uncertainty=None if given is None else given * 1e-3,
        )


def plan_session(
    robot: str, rig: Path, marker: Path | None, out: Path | None, asked: PlanOptions, *, force: bool
) -> None:
    """Plan the next session; write plan.csv, poses.csv and the reports.

    Args:
        robot: a name, a robot file or a URDF.
        rig: rig.toml or the folder that holds it.
        marker: marker.toml; None: beside the rig.
        out: where the plan goes; None: ROBOT-plan in the current folder.
        asked: the options.
        force: write into a folder that is not empty.

    Raises:
        InputError: a file or an option cannot be used, nothing can be planned, `out` is taken.
    """
    bench, inputs, warnings = _planning_setup(robot, rig, marker)
    wish, conditions = asked.wish(bench.arm), asked.conditions()
    target = out if out is not None else Path(f"{bench.arm.name}-plan")
    refuse_existing(target, force=force)
    with terminal.progress("stages") as progress:
        made = plan_motion(bench, wish, conditions, progress)
    said = (*warnings, *_warnings(made))
    for warning in said:
        terminal.warn(warning)
    written = plan_results(made, PlanProvenance(bench, wish, conditions, inputs, said))
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
    """Refuse what is no size; None passes."""
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
