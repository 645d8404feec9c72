"""Measure a recorded session, compare it with the encoders, judge, and write the reports.

One recorded session: measured, judged, reported; the end of every `verify run`.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from reports import Results
from reports.session.headline import headline
from verify.analysis.session import analyse
from verify.cli.options import (
    Asked,
    JointTolerance,
    OrientationTolerance,
    PageAddress,
    PagePort,
    PageToken,
    PositionTolerance,
)
from verify.cli.terminal import terminal
from verify.errors import InputError
from verify.io.results import refuse_existing, write_results
from verify.io.session.session import open_session
from verify.live.page.access import DEFAULT_PORT, LOOPBACK

if TYPE_CHECKING:  # imported when the command runs: `--help` answers at once
    from verify.cli.options import Asked
    from verify.cli.watch import PageOptions

EXIT_STATUS = {"conform": 0, None: 0, "nonconform": 1, "undecided": 3}
SEVERITY = [None, "conform", "undecided", "nonconform"]  # of a run with several recordings


def run(
    source: Annotated[
        Path | None,
        typer.Argument(help="A recorded session's folder, or a station file: live cameras."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Where to; default: NAME-report, here.")
    ] = None,
    tolerance: JointTolerance = None,
    position_tolerance: PositionTolerance = None,
    orientation_tolerance: OrientationTolerance = None,
    force: Annotated[
        bool, typer.Option("--force", help="Write into a folder that exists.")
    ] = False,
    new_station: Annotated[
        bool,
        typer.Option("--new-station", help="Write a commented station file, and do nothing else."),
    ] = False,
    duration: Annotated[
        str | None, typer.Option("--for", help="Station: how long to watch: 60s, 10m, 1.5h.")
    ] = None,
    on_alarm: Annotated[
        str | None,
        typer.Option(help="Station: a command for each alarm; JSON on its standard input."),
    ] = None,
    page: Annotated[
        bool, typer.Option("--page", help="Station: serve a page for the browser.")
    ] = False,
    page_port: PagePort = DEFAULT_PORT,
    page_address: PageAddress = LOOPBACK,
    page_token: PageToken = None,
) -> int:
    """Measure a recorded session or a moving robot, compare with the encoders, judge, report.

    A station is watched until Ctrl-C, --for is over, or the robot's program ends; the report is
    made from what was recorded. Nothing in it can command the robot.

    Exit status 0: ran, conforms where a verdict was asked for; 1: does not conform; 2: could not
    run; 3: undecided.

    Example: verify run sample_sessions/multi_joint_fault_6r --tolerance 0.2
    """
    if new_station:
        return _new_station(source)
    if source is None:
        raise typer.BadParameter("name a session's folder or a station file")
    from verify.cli.options import Asked

    asked = Asked(tolerance, position_tolerance, orientation_tolerance)
    if source.is_dir() or source.suffix != ".toml":
        _refuse_live_options(duration, on_alarm, page=page)

        return EXIT_STATUS[measure_and_report(source, out, asked, force=force)]
    from verify.cli.watch import PageOptions

    wish = PageOptions(page_port, page_address, page_token) if page else None
    return _run_live(source, out, asked, duration, on_alarm, wish, force=force)


def _run_live(
    source: Path,
    out: Path | None,
    asked: "Asked",
    duration: str | None,
    on_alarm: str | None,
    page: "PageOptions | None",
    *,
    force: bool,
) -> int:
    from verify.cli.options import parse_duration
    from verify.cli.watch import RunOptions, alarms_csv, watch
    from verify.io.files import write_whole
    from verify.io.results import refuse_existing
    from verify.live.station.station import open_station
    from verify.simulation.devices.station import SimulatedStation

    length = None if duration is None else parse_duration("--for", duration)
    station = open_station(source, partial(SimulatedStation, apart=True))
    if out is not None:
        refuse_existing(out, force=force)
    for warning in station.warnings:
        terminal.warn(warning)
    wish = RunOptions(length, asked.tolerance(station.arm.dof), on_alarm, page)
    watched = watch(station, wish)
    out = out if out is not None else Path(f"{watched.folders[0].name}-report")
    reported = measure_and_report_all(watched.folders, out, asked, force=force)
    write_whole(next(iter(reported)) / "alarms.csv", alarms_csv(watched.alarms))
    return EXIT_STATUS[max(reported.values(), key=SEVERITY.index)]


def _new_station(path: Path | None) -> int:
    """Write the commented station file; nothing is overwritten."""
    from importlib.resources import files

    from verify.io.files import write_whole
    from verify.io.results import refuse_file

    target = path if path is not None else Path("station.toml")
    refuse_file(target, force=False)
    write_whole(target, files("verify.live.station").joinpath("station.toml").read_bytes())
    terminal.say(f"{target} runs as it is, with simulated devices: verify run {target} --for 20s")
    terminal.record({"type": "result", "out": str(target)})
    return 0


def _refuse_live_options(duration: str | None, on_alarm: str | None, *, page: bool) -> None:
    """An option that does nothing must not pass for one that did."""
    from verify.errors import InputError

    given = [
        ("--for", duration is not None),
        ("--on-alarm", on_alarm is not None),
        ("--page", page),
    ]
    for name, asked in given:
        if asked:
            raise InputError(
                name, "was given with a recorded session", "it is for stations",
                "Leave it out, or name a station file.",
            )  # fmt: skip


def measure_and_report(folder: Path, out: Path | None, asked: Asked, *, force: bool) -> str | None:
    """Measure a session, write its reports, say what was found.

    Args:
        folder: the session.
        out: where the reports go; None: NAME-report in the current folder.
        asked: tolerances that replace the session's.
        force: write into a folder that exists.

    Returns:
        The verdict; None where no tolerance was asked for.

    Raises:
        InputError: the session cannot be measured, or the reports cannot be written.
    """
    session = open_session(folder)
    target = out if out is not None else Path(f"{session.name}-report")
    refuse_existing(target, force=force)
    for warning in session.warnings:
        terminal.warn(warning)
    tolerance = asked.tolerance(session.arm.dof)
    with terminal.progress("pairs") as progress:
        results = analyse(session, tolerance=tolerance, progress=progress)
    for warning in results.summary["warnings"]:
        if warning not in session.warnings:
            terminal.warn(warning)
    write_results(results, target, force=force)
    _print_summary(results, target)
    verdict: str | None = results.summary["verdict"]
    return verdict


def measure_and_report_all(
    folders: Sequence[Path], out: Path, asked: Asked, *, force: bool
) -> dict[Path, str | None]:
    """Measure the sessions of one live run, a report each; one that cannot be is no other's harm.

    Args:
        folders: in their order: more than one where the controller's clock began anew.
        out: the first one's report; the others' have a number behind it.
        asked: as for `measure_and_report`.
        force: likewise.

    Returns:
        The verdict of each report, at least one.

    Raises:
        InputError: none can be measured: what the first one lacks.
    """
    verdicts: dict[Path, str | None] = {}
    refusals: list[InputError] = []
    for number, folder in enumerate(folders, start=1):
        target = out if number == 1 else out.with_name(f"{out.name}-{number}")
        try:
            verdicts[target] = measure_and_report(folder, target, asked, force=force)
        except InputError as refusal:
            refusals.append(refusal)
    if not verdicts:
        raise refusals[0]
    for left_out in refusals:
        terminal.warn(str(left_out))
    return verdicts


def _print_summary(results: Results, target: Path) -> None:
    """Tell what was found, briefly; the report has the rest."""
    summary: dict[str, Any] = results.summary
    verdict = headline(results)
    terminal.say(f"{verdict.label}: {verdict.sentence}")
    for joint in summary["joints"]:
        terminal.say(_joint_line(joint))
    for line in _verbose_lines(summary):
        terminal.detail(line)
    terminal.say(f"Report: {target / 'report.html'} and {target / 'report.pdf'}")
    terminal.record({"type": "result", "out": str(target), "summary": summary})


def _verbose_lines(summary: dict[str, Any]) -> list[str]:
    """What --verbose adds: pairs, clock, how LEDs were told apart, detectable errors."""
    pairs, clock = summary["pairs"], summary["clock"]
    lost = ", ".join(f"{n} {status}" for status, n in pairs["rejected"].items()) or "none"
    offset = clock["encoder_offset_s"]
    said = "not shown by the motion" if offset is None else f"{offset:+.6f} s, {clock['source']}"
    told = ", ".join(f"{n} by {how}" for how, n in summary["choices"].items()) or "-"
    smallest = [j["minimum_detectable_error_deg"] for j in summary["joints"]]
    shown = ", ".join("-" if s is None else f"{s:.3f}°" for s in smallest)
    return [
        f"pairs: {pairs['measured']} of {pairs['recorded']} measured; rejected: {lost}",
        f"encoder clock: {said}",
        f"LEDs told apart: {told}",
        f"smallest offset that would be noticed, a joint: {shown}",
    ]


def _joint_line(joint: dict[str, Any]) -> str:
    mean, u = joint["mean_error_deg"], joint["expanded_uncertainty_deg"]
    error = "not determined" if mean is None else f"{mean:+.3f}°"
    doubt = "" if u is None else f" ± {u:.3f}°"
    verdict = "" if joint["verdict"] is None else f"  {joint['verdict']}"
    return f"  joint {joint['joint']}: {error}{doubt}{verdict}"
