"""A device that is not there: it answers on a port as the real one does, faults included."""

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from verify.terminal import terminal

if TYPE_CHECKING:  # imported when the command runs: `--help` answers at once
    from verify.emulators.server import Engine

COMMON = frozenset({"noise", "half", "double", "lost", "split", "silence", "unplug", "reset"})
LABENC = COMMON | {"digit", "jump", "status"}


class Device(StrEnum):
    """What can be emulated."""

    MELFA = "melfa"
    MELFA_REALTIME = "melfa-realtime"
    LABENC = "labenc"
    PAN = "pan"


FAULTS = {  # R3 has no checksum: a wrong digit would be a wrong angle, which no reader can see
    Device.MELFA: COMMON - {"double"} | {"alarm"},
    Device.MELFA_REALTIME: COMMON - {"split"} | {"jump"},
    Device.LABENC: LABENC,
    Device.PAN: LABENC,
}
PORTS = {
    Device.MELFA: "tcp:10001",
    Device.MELFA_REALTIME: "udp:10000",
    Device.LABENC: "pty",
    Device.PAN: "pty",
}


def emulate(
    device: Annotated[Device, typer.Argument(help="What to be.")],
    port: Annotated[
        str | None,
        typer.Option(
            help="tcp:PORT, tcp:HOST:PORT, udp:PORT, pty, pty:LINK, or a serial device's path."
        ),
    ] = None,
    motion: Annotated[
        str, typer.Option(help="hold, sweep, sines, or a CSV like a session's encoders.csv.")
    ] = "sines",
    joints: Annotated[int, typer.Option(min=1, max=8, help="How many joints the arm has.")] = 6,
    rate: Annotated[int, typer.Option(min=1, help="Samples a second of labenc and pan.")] = 100,
    baud: Annotated[
        int | None, typer.Option(min=300, help="Send as slowly as a serial line of that speed.")
    ] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            help="What goes wrong; repeatable. A share of the messages: noise, half, digit, "
            "double, lost, split=0.05. At an instant: silence, unplug=AT:SECONDS, reset=AT, "
            "jump=AT:SECONDS, alarm=AT:NUMBER, status=AT:BITS."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the faults' chance.")] = 0,
) -> None:
    """Be a robot controller, an encoder board or the turning bases, until Ctrl-C.

    Example: verify emulate melfa --port tcp:10001 --motion sweep
    """
    from verify.devices.ports import SerialLine, in_words
    from verify.emulators.faults import parse
    from verify.emulators.fronts import front
    from verify.emulators.server import Server
    from verify.errors import InputError

    faults = parse(fault or [], FAULTS[device])
    engine = _engine(device, motion, joints, rate, baud, seed)
    line = SerialLine(baud or 115200)
    server = Server(front(port or PORTS[device], line), engine, faults, baud, seed)
    terminal.say(f"{device.value} listens at {server.front.address}; Ctrl-C ends it")
    terminal.record(
        {"type": "listening", "device": device.value, "address": server.front.address}
    )  # fmt: skip
    try:
        server.serve(lambda: False)
    except OSError as error:  # only a serial device goes away under an emulator
        raise InputError(server.front.address, in_words(error)) from error
    finally:
        server.close()


def _engine(
    device: Device, motion: str, joints: int, rate: int, baud: int | None, seed: int
) -> "Engine":
    import numpy as np

    from verify.emulators.labenc import BoardOptions, LabencEngine
    from verify.emulators.melfa import ControllerOptions, MelfaEngine
    from verify.emulators.melfa_arm import MelfaArm
    from verify.emulators.melfa_realtime import RealtimeEngine
    from verify.emulators.pan import PanEngine
    from verify.emulators.trajectory import load

    trajectory = load(motion, joints)
    match device:
        case Device.MELFA:
            limits = np.deg2rad(np.tile([-360.0, 360.0], (joints, 1)))
            return MelfaEngine(MelfaArm(trajectory, joints, limits), ControllerOptions(), seed)
        case Device.MELFA_REALTIME:
            return RealtimeEngine(trajectory, joints)
        case Device.LABENC:
            return LabencEngine(trajectory, joints, BoardOptions(rate=rate, baud=baud or 115200))
        case Device.PAN:
            return PanEngine(BoardOptions(arm="PANBASE", rate=rate, baud=baud or 115200))
