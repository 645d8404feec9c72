"""Say what works on this machine: inner loops, codecs, disk, ports, cameras; and of a station."""

from pathlib import Path
from typing import Annotated

from typer import Argument

from verify.cli.terminal import terminal

MARKS = {"works": "works ", "doubt": "doubt ", "fails": "FAILS "}


def doctor(
    station: Annotated[
        Path | None, Argument(help="A station file: its devices are tried too.")
    ] = None,
) -> int:
    """Say what works on this machine, and of a station's devices.

    Exit status 0: all works; 1: something does not; 2: the station file cannot be used.

    Example: verify doctor station.toml
    """
    from verify.cli.doctor import machine
    from verify.cli.doctor.devices import check_devices
    from verify.live.station.station import open_station
    from verify.simulation.devices.station import SimulatedStation

    opened = None if station is None else open_station(station, SimulatedStation)
    findings = [*machine.check_versions(), machine.check_inner_loops(), *machine.check_codecs()]
    if opened is None:
        findings += [machine.check_disk(Path())]
        findings += [*machine.check_serial_ports(), *machine.check_video_devices()]
    else:
        terminal.warn(*opened.warnings)
        findings += [machine.check_disk(opened.recording.folder)]
        findings += check_devices(opened)
    for finding in findings:
        terminal.say(f"{MARKS[finding.outcome]}{finding.what}: {finding.sentence}")
        outcome, text = finding.outcome, finding.sentence
        terminal.record("check", what=finding.what, outcome=outcome, text=text, **finding.figures)
    return int(any(finding.outcome == "fails" for finding in findings))
