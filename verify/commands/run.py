"""Measure a recorded session, compare it with the encoders, judge, and write the reports."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from verify.commands.options import (
    JointTolerance,
    OrientationTolerance,
    PageAddress,
    PagePort,
    PageToken,
    PositionTolerance,
)
from verify.page.access import LOOPBACK, USUAL_PORT
from verify.terminal import terminal

if TYPE_CHECKING:  # imported when the command runs: `--help` answers at once
    from verify.commands.asked import Asked
    from verify.commands.watching import PageWish

STATUS = {"conform": 0, None: 0, "nonconform": 1, "undecided": 3}
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
    page_port: PagePort = USUAL_PORT,
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
    from verify.commands.asked import Asked

    asked = Asked(tolerance, position_tolerance, orientation_tolerance)
    if source.is_dir() or source.suffix != ".toml":
        _refuse_live_options(duration, on_alarm, page=page)
        from verify.commands.measuring import measure_recorded

        return STATUS[measure_recorded(source, out, asked, force=force)]
    from verify.commands.watching import PageWish

    wish = PageWish(page_port, page_address, page_token) if page else None
    return _watch(source, out, asked, duration, on_alarm, wish, force=force)


def _watch(
    source: Path,
    out: Path | None,
    asked: "Asked",
    duration: str | None,
    on_alarm: str | None,
    page: "PageWish | None",
    *,
    force: bool,
) -> int:
    from verify.commands.asked import seconds
    from verify.commands.measuring import measure_parts
    from verify.commands.watching import Wish, alarms_table, watch
    from verify.results_folder import refuse_existing
    from verify.sim.devices import SimulatedStation
    from verify.station import open_station
    from verify.writing import write_whole

    length = None if duration is None else seconds("--for", duration)
    station = open_station(source, partial(SimulatedStation, apart=True))
    if out is not None:
        refuse_existing(out, force=force)
    for warning in station.warnings:
        terminal.warn(warning)
    wish = Wish(length, asked.tolerance(station.arm.dof), on_alarm, page)
    watched = watch(station, wish)
    out = out if out is not None else Path(f"{watched.folders[0].name}-report")
    reported = measure_parts(watched.folders, out, asked, force=force)
    write_whole(next(iter(reported)) / "alarms.csv", alarms_table(watched.alarms))
    return STATUS[max(reported.values(), key=SEVERITY.index)]


def _new_station(path: Path | None) -> int:
    """Write the commented station file; nothing is overwritten."""
    from importlib.resources import files

    from verify.results_folder import refuse_file
    from verify.writing import write_whole

    target = path if path is not None else Path("station.toml")
    refuse_file(target, force=False)
    write_whole(target, files("verify").joinpath("station.toml").read_bytes())
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
