"""A device that is not there: it answers on a port as the real one does, faults included."""

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from verify.terminal import terminal

if TYPE_CHECKING:  # imported when the command runs: `--help` answers at once
    from verify.emulators.server import Engine

COMMON = frozenset({"noise", "half", "double", "lost", "split", "silence", "unplug", "reset"})
ROBOT = "rv_3sd_melfa"  # whose kinematics the emulated controller knows
LABENC = COMMON | {"digit", "jump", "status"}


class Device(StrEnum):
    """What can be emulated."""

    MELFA = "melfa"
    MELFA_REALTIME = "melfa-realtime"
    LABENC = "labenc"
    PAN = "pan"
    GRIPPER = "gripper"


FAULTS = {  # R3 has no checksum: a wrong digit would be a wrong angle, which no reader can see
    Device.MELFA: COMMON - {"double"} | {"alarm"},
    Device.MELFA_REALTIME: COMMON - {"split"} | {"jump"},
    Device.LABENC: LABENC,
    Device.PAN: LABENC,
    Device.GRIPPER: COMMON | {"alarm"},
}
PORTS = {
    Device.MELFA: "tcp:10001",
    Device.MELFA_REALTIME: "udp:10000",
    Device.LABENC: "pty",
    Device.PAN: "pty",
    Device.GRIPPER: "pty",
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
    idle: Annotated[
        bool,
        typer.Option(
            "--idle", help="melfa: no program runs, the servo is off; it waits to be moved by EXEC."
        ),
    ] = False,
    rate: Annotated[int, typer.Option(min=1, help="Samples a second of labenc and pan.")] = 100,
    object_mm: Annotated[
        float | None,
        typer.Option(min=0, max=150, help="Width of what stands between the gripper's fingers."),
    ] = None,
    baud: Annotated[
        int | None, typer.Option(min=300, help="Send as slowly as a serial line of that speed.")
    ] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            help="What goes wrong; repeatable. A share of the messages: noise, half, digit, "
            "double, lost, split=0.05. At an instant: silence, unplug=AT:SECONDS, reset=AT, "
            "jump=AT:SECONDS, alarm=AT:NUMBER (gripper: gFLT), status=AT:BITS."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the faults' chance.")] = 0,
) -> None:
    """Be a robot controller, an encoder board, the turning bases or a gripper, until Ctrl-C.

    Example: verify emulate melfa --port tcp:10001 --motion sweep
    """
    from verify.devices.ports import SerialLine, in_words
    from verify.emulators.faults import parse
    from verify.emulators.fronts import front
    from verify.emulators.server import Server
    from verify.errors import InputError

    if object_mm is not None and device is not Device.GRIPPER:
        raise InputError("--object-mm", f"{device.value} has no fingers", "", "Leave it out.")
    if idle and device is not Device.MELFA:
        raise InputError("--idle", f"{device.value} runs no program", "", "Leave it out.")
    faults = parse(fault or [], FAULTS[device])
    if device is Device.GRIPPER:
        engine: Engine = _gripper(object_mm)
    elif device is Device.MELFA:
        engine = _melfa(motion, joints, idle, seed)
    else:
        engine = _engine(device, motion, joints, rate, baud)
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


def _gripper(object_mm: float | None) -> "Engine":
    from verify.emulators.gripper import GripperEngine, GripperOptions
    from verify.emulators.gripper_hand import contacts_of

    contacts = None if object_mm is None else contacts_of(object_mm)
    return GripperEngine(GripperOptions(contacts=contacts))


def _melfa(motion: str, joints: int, idle: bool, seed: int) -> "Engine":
    import numpy as np

    import robots
    from verify.emulators.melfa import ControllerOptions, MelfaEngine
    from verify.emulators.melfa_arm import MelfaArm
    from verify.emulators.trajectory import load

    known = robots.load(ROBOT)
    arm = known if isinstance(known, robots.DhArm) and known.dof == joints else None
    limits = np.deg2rad(np.tile([-360.0, 360.0], (joints, 1)))
    if idle and arm is not None:  # a recorded motion may be another robot's: nothing limits that
        limits = np.column_stack([arm.lower, arm.upper])
    return MelfaEngine(
        MelfaArm(load(motion, joints), joints, limits, arm=arm, idle=idle),
        ControllerOptions(),
        seed,
    )


def _engine(device: Device, motion: str, joints: int, rate: int, baud: int | None) -> "Engine":
    from verify.emulators.labenc import BoardOptions, LabencEngine
    from verify.emulators.melfa_realtime import RealtimeEngine
    from verify.emulators.pan import PanEngine
    from verify.emulators.trajectory import load

    match device:
        case Device.MELFA_REALTIME:
            return RealtimeEngine(load(motion, joints), joints)
        case Device.LABENC:
            options = BoardOptions(rate=rate, baud=baud or 115200)
            return LabencEngine(load(motion, joints), joints, options)
        case _:
            return PanEngine(BoardOptions(arm="PANBASE", rate=rate, baud=baud or 115200))
