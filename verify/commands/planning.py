"""What `verify plan` does: an arm before a rig in, a motion and its prediction out."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import robots
from reports import Results
from verify import marker_file, rig_file
from verify.errors import InputError
from verify.files import digest
from verify.planning.plan import Plan, plan
from verify.planning.results import Origin, results
from verify.planning.wishes import USUAL, Bench, Conditions, Wish
from verify.records import Array
from verify.results_folder import refuse_existing, write_reported
from verify.session_folder import check_absorption
from verify.terminal import terminal
from verify.writing import folder_written_whole

RIG, MARKER = "rig.toml", "marker.toml"
USUAL_POSES = 12
SELDOM = 0.1  # share of pairs of one direction of travel: below, worth a warning
ENOUGH = 0.8  # share of pairs that are measured: below, worth a warning


@dataclass(frozen=True, slots=True)
class Asked:
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

    def wish(self, arm: robots.Arm) -> Wish:
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
        poses = None if self.duration_s is not None else self.poses or USUAL_POSES
        return Wish(
            observe=tuple(dict.fromkeys(self.observe)) or USUAL,
            poses=poses,
            duration=self.duration_s,
            hold=_require("hold_s", self.hold_s, zero=True) or 0.0,
            speed=float(np.deg2rad(self.speed_deg_s)),
            view_angle=float(np.deg2rad(min(self.view_angle_deg, 180.0))),
            floor=self.floor_mm * 1e-3,
            near=None if self.near is None else _posture(self.near, arm),
            within=float(np.deg2rad(self.within_deg)),
            seed=self.seed,
        )

    def conditions(self) -> Conditions:
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
        return Conditions(
            rate=self.rate_hz,
            skew=self.skew_ms * 1e-3,
            spot_noise=self.spot_noise_px,
            reading_noise=float(np.deg2rad(self.reading_noise_deg)),
            clock_uncertainty=None if given is None else given * 1e-3,
        )


def plan_session(
    robot: str, rig: Path, marker: Path | None, out: Path | None, asked: Asked, *, force: bool
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
    bench, inputs, warnings = _bench(robot, rig, marker)
    wish, conditions = asked.wish(bench.arm), asked.conditions()
    target = out if out is not None else Path(f"{bench.arm.name}-plan")
    refuse_existing(target, force=force)
    with terminal.progress("stages") as progress:
        made = plan(bench, wish, conditions, progress)
    said = (*warnings, *_warnings(made))
    for warning in said:
        terminal.warn(warning)
    written = results(made, Origin(bench, wish, conditions, inputs, said))
    with folder_written_whole(target, force) as folder:
        write_reported(written, folder, force=True)
        for name, table in (("plan", "trajectory"), ("poses", "poses")):
            written.tables[table].to_csv(
                folder / f"{name}.csv", index=False, float_format="%.5f", lineterminator="\n"
            )
    _say(written, target)


def _bench(
    robot: str, rig: Path, marker: Path | None
) -> tuple[Bench, dict[str, str], tuple[str, ...]]:
    try:
        arm = robots.load(robot)
    except robots.RobotError as problem:
        raise InputError(
            problem.place, problem.found, problem.expected, problem.remedy
        ) from problem
    rig_path = rig / RIG if rig.is_dir() else rig
    marker_path = marker if marker is not None else rig_path.parent / MARKER
    if marker is None and not marker_path.is_file():
        raise InputError(
            "--marker", f"is not given, and there is no {marker_path}",
            "a plan needs to know where the LEDs sit on the flange", "Give --marker FILE.",
        )  # fmt: skip
    read_rig, said_of_rig = rig_file.read(rig_path)
    read_marker, said_of_marker = marker_file.read(marker_path)
    check_absorption(rig_path, read_rig, arm.dof)
    if len(read_marker) < 3:
        raise InputError(
            marker_path, f"names {len(read_marker)} LED{'' if len(read_marker) == 1 else 's'}",
            "a plan needs 3 or more, which give the whole pose", "Name every LED.",
        )  # fmt: skip
    inputs = {rig_path.name: digest(rig_path), marker_path.name: digest(marker_path)}
    return Bench(arm, read_rig, read_marker), inputs, (*said_of_rig, *said_of_marker)


def _posture(text: str, arm: robots.Arm) -> Array:
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


def _warnings(made: Plan) -> list[str]:
    said = []
    seen = made.prediction.foreseen
    exact = seen.systematics.uncounted
    if exact:
        said.append(
            f"No uncertainty is stated for {', '.join(exact)}: taken as exact; the predicted "
            "uncertainties hold on that condition."
        )
    upward = np.mean(seen.comparison.direction > 0, axis=0)
    one_way = [f"{j + 1}" for j in np.flatnonzero(np.abs(upward - 0.5) > 0.5 - SELDOM).tolist()]
    if one_way:
        said.append(
            f"Joint {', '.join(one_way)} turns one way nearly all the time; with --observe "
            "backlash every pose is visited from either side."
        )
    share = len(seen.track) / len(seen.t)
    if share < ENOUGH:
        said.append(f"Only {share:.0%} of the pairs would be measured.")
    return said


def _say(made: Results, target: Path) -> None:
    summary = made.summary
    motion, pairs = summary["motion"], summary["pairs"]
    terminal.say(
        f"{motion['poses']} poses, {motion['duration_s']:.0f} s; {pairs['measured']} of "
        f"{pairs['recorded']} pairs would be measured"
    )
    for joint in summary["joints"]:
        terminal.say(_line(joint))
    terminal.say("Obstacles are not known to the plan: try it slowly first.")
    terminal.say(
        f"Written: {target / 'plan.csv'} and {target / 'poses.csv'}; report: "
        f"{target / 'report.html'} and {target / 'report.pdf'}"
    )
    terminal.record({"type": "result", "out": str(target), "summary": summary})


def _line(joint: dict[str, float | None]) -> str:
    u, smallest = joint["standard_uncertainty_deg"], joint["minimum_detectable_error_deg"]
    if u is None or smallest is None:
        return f"  joint {joint['joint']}: a constant offset cannot show"
    return (
        f"  joint {joint['joint']}: mean error ± {2 * u:.3f}° (k = 2); an offset of "
        f"{smallest:.3f}° would be noticed"
    )
