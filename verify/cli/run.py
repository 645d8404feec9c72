"""Measure a session, a sample or a moving robot, compare, judge, report; or record alone."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from verify.cli import options as option
from verify.cli.terminal import terminal
from verify.errors import WatchDefectError
from verify.live.page.access import DEFAULT_PORT, LOOPBACK

EXIT_STATUS = {"conform": 0, None: 0, "nonconform": 1, "undecided": 3}
TOLERANCE_DEG = "0.2"  # the fault of joint 2 exceeds it, every other joint keeps it
# in the repository a link into sample_sessions/, in a package its files
SAMPLE = Path(__file__).with_name("samples") / "multi_joint_fault_6r"
SEVERITY = [None, "conform", "undecided", "nonconform"]  # of a run with several recordings


def run(
    source: Annotated[
        Path | None, Argument(help="A recorded session's folder, or a station file: live cameras.")
    ] = None,
    out: Annotated[
        Path | None,
        Option("-o", "--out", help="Folder of the results; default: NAME-report in this folder."),
    ] = None,
    tolerance: option.JointTolerance = None,
    position_tolerance: option.PositionTolerance = None,
    orientation_tolerance: option.OrientationTolerance = None,
    force: option.WriteIntoFolder = False,
    rig: Annotated[
        Path | None,
        Option(
            help="Session: another rig file than its own; of poses, a registered session's folder."
        ),
    ] = None,
    marker: Annotated[
        Path | None, Option(help="Session: another marker file than its own.")
    ] = None,
    new_station: Annotated[
        bool, Option("--new-station", help="Write a commented station file, and do nothing else.")
    ] = False,
    robot: Annotated[
        str | None, Option(help="--new-station: the arm, by name or by its robot file or URDF.")
    ] = None,
    driver: Annotated[
        str | None,
        Option(help="--new-station: how its encoders are read, such as rtde (docs/devices.md)."),
    ] = None,
    duration: Annotated[
        float | None, option.duration_option("Station: how long to watch: 60s, 10m, 1.5h.")
    ] = None,
    on_alarm: Annotated[
        str | None, Option(help="Station: a command for each alarm; JSON on its standard input.")
    ] = None,
    page: Annotated[bool, Option("--page", help="Station: serve a page for the browser.")] = False,
    page_port: option.PagePort = DEFAULT_PORT,
    page_address: option.PageAddress = LOOPBACK,
    page_token: option.PageToken = None,
) -> int:
    """Check an arm's encoders: a recorded session, or as it moves.

    A station is watched until Ctrl-C, --for is over, or the robot's program ends; the report is
    made from what was recorded. Nothing in it can command the robot.

    Exit status 0: ran, conforms where a verdict was asked for; 1: does not conform; 2: could not
    run; 3: undecided.

    Example: verify run sample_sessions/multi_joint_fault_6r --tolerance 0.2
    """
    if new_station:
        return _new_station(source, robot, driver)
    option.refuse_options(
        {"--robot": robot is not None, "--driver": driver is not None},
        "was given without --new-station", "a station file names both", "Leave it out.",
    )  # fmt: skip
    if source is None:
        raise typer.BadParameter("name a session's folder or a station file")
    if source.name == "session.toml":
        source = source.parent
    tolerances = option.ToleranceOptions(tolerance, position_tolerance, orientation_tolerance)
    if source.is_dir() or source.suffix != ".toml":
        option.refuse_options(
            {"--for": duration is not None, "--on-alarm": on_alarm is not None, "--page": page},
            "was given with a recorded session", "it is for stations",
            "Leave it out, or name a station file.",
        )  # fmt: skip
        from verify.cli.measure import measure_and_report

        verdict = measure_and_report(source, out, tolerances, force=force, rig=rig, marker=marker)
        return EXIT_STATUS[verdict]
    option.refuse_options(
        {"--rig": rig is not None, "--marker": marker is not None},
        "was given with a station", "its file names rig and marker", "Name them there.",
    )  # fmt: skip
    shown = option.PageOptions(page_port, page_address, page_token) if page else None
    return _run_live(source, out, tolerances, duration, on_alarm, shown, force=force)


def record(
    station: Annotated[Path, Argument(help="A station file; rig and marker may be missing.")],
    out: Annotated[
        Path | None,
        Option("-o", "--out", help="The session to make; default: as the station names it."),
    ] = None,
    duration: Annotated[
        float | None, option.duration_option("How long to record: 60s, 10m, 1.5h.")
    ] = None,
    page: Annotated[bool, Option("--page", help="Serve a page for the browser.")] = False,
    page_port: option.PagePort = DEFAULT_PORT,
    page_address: option.PageAddress = LOOPBACK,
    page_token: option.PageToken = None,
) -> None:
    """Record pictures and readings of a moving robot; nothing is compared.

    Ends with Ctrl-C, when --for is over, or with the robot's program. Shows what the motion still
    lacks for `verify calibrate register`. Nothing in it can command the robot.

    Exit status 0: recorded; 2: nothing could be, or not to the end.

    Example: verify record station.toml -o first_motion --for 60s
    """
    from verify.cli.recording import record_session

    shown = option.PageOptions(page_port, page_address, page_token) if page else None
    record_session(station, out, duration, shown)


def _run_live(
    source: Path,
    out: Path | None,
    tolerances: option.ToleranceOptions,
    duration: float | None,
    on_alarm: str | None,
    page: option.PageOptions | None,
    *,
    force: bool,
) -> int:
    from verify.cli.measure import measure_and_report_all
    from verify.cli.watch import RunOptions, alarms_table, watch
    from verify.io.files import write_whole
    from verify.io.results import refuse_existing
    from verify.io.series import ALARMS
    from verify.live.station.station import open_station
    from verify.simulation.devices.station import SimulatedStation

    station = open_station(source, partial(SimulatedStation, apart=True))
    if out is not None:
        refuse_existing(out, force=force)
    terminal.warn(*station.warnings)
    options = RunOptions(duration, tolerances.tolerance(station.arm.dof), on_alarm, page)
    watched = watch(station, options)
    out = out if out is not None else Path(f"{watched.folders[0].name}-report")
    text = alarms_table(watched.alarms).to_csv(index=False, lineterminator="\n")
    write_whole(watched.folders[0] / ALARMS, text.encode())  # beside the first recording
    reported = measure_and_report_all(
        watched.folders, out, tolerances, force=force, warnings=watched.warnings
    )
    if watched.defects:
        raise WatchDefectError(" ".join(watched.defects))
    return EXIT_STATUS[max(reported.values(), key=SEVERITY.index)]


def _new_station(path: Path | None, robot: str | None, driver: str | None) -> int:
    """Write the commented station file; nothing is overwritten."""
    from verify.io.files import write_whole
    from verify.io.results import refuse_file
    from verify.live.station.template import SIM_ROBOT, station_template
    from verify.simulation import library

    target = path if path is not None else Path("station.toml")
    refuse_file(target, force=False)
    robot = robot or SIM_ROBOT
    made = station_template(robot, driver, library.scenario_of(robot), target.parent)
    write_whole(target, made.text.encode())
    terminal.say(made.note.replace("{path}", str(target)))
    terminal.record("result", out=str(target))
    return 0


def demo(
    out: Annotated[Path, Option("-o", "--out", help="The report's folder.")] = Path("verify-demo"),
    force: option.WriteIntoFolder = False,
) -> int:
    """Measure a sample session that comes with verify, and report on it.

    The sample is simulated: its truth is known. Exit status 0: it ran; that its robot does not
    conform is its purpose.

    Example: verify demo
    """
    from verify.cli.measure import measure_and_report

    measure_and_report(SAMPLE, out, option.ToleranceOptions(TOLERANCE_DEG, None, None), force=force)
    terminal.say(
        f"Look at page one of {out / 'report.html'}: the verdict, the errors of the six joints and"
        " the cause.\n"
        "The truth: the encoder of joint 2 reads 0.35° too high, and the encoders' clock is 0.085 s"
        f" behind ({SAMPLE / 'README.md'}).\n"
        f"Next: verify run {SAMPLE} --tolerance 0.5, or a session of your own."
    )
    return 0
