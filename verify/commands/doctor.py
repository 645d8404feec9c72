"""Say what works on this machine: versions, codecs, disk, ports, cameras; and of a station."""

from pathlib import Path
from typing import Annotated

import typer

from verify.terminal import terminal

MARKS = {"works": "works ", "doubt": "doubt ", "fails": "FAILS "}


def doctor(
    station: Annotated[
        Path | None, typer.Argument(help="A station file: its devices are tried too.")
    ] = None,
) -> int:
    """Say what works on this machine and, with a station file, what of the station.

    Exit status 0: all works; 1: something does not; 2: the station file cannot be used.

    Example: verify doctor station.toml
    """
    from verify.commands import doctor_devices, doctor_machine
    from verify.sim.devices import SimulatedStation
    from verify.station import open_station

    known = None if station is None else open_station(station, SimulatedStation)
    findings = [*doctor_machine.versions(), *doctor_machine.codecs()]
    if known is None:
        findings += [doctor_machine.disk(Path())]
        findings += [*doctor_machine.serial_ports(), *doctor_machine.video_devices()]
    else:
        for warning in known.warnings:
            terminal.warn(warning)
        findings += [doctor_machine.disk(known.recording.folder)]
        findings += doctor_devices.devices(known)
    for finding in findings:
        terminal.say(f"{MARKS[finding.outcome]}{finding.what}: {finding.sentence}")
        terminal.record(
            {
                "type": "check",
                "what": finding.what,
                "outcome": finding.outcome,
                "text": finding.sentence,
                **finding.figures,
            }
        )
    return int(any(finding.outcome == "fails" for finding in findings))
