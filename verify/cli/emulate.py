"""A device that is not there: it answers on a port as the real one does, faults included."""

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from verify.cli.terminal import terminal

if TYPE_CHECKING:  # imported when the command runs: `--help` answers at once
    from verify.simulation.emulators.server import EmulatorEngine

COMMON_FAULTS = frozenset(
    {"noise", "half", "double", "lost", "split", "silence", "unplug", "reset"}
)
MELFA_ROBOT = "rv_3sd_melfa"  # whose kinematics the emulated controller knows
LABENC_FAULTS = COMMON_FAULTS | {"digit", "jump", "status"}


class EmulatedDevice(StrEnum):
    """What can be emulated."""

    MELFA = "melfa"
    MELFA_REALTIME = "melfa-realtime"
    LABENC = "labenc"
    PAN = "pan"
    GRIPPER = "gripper"


FAULTS = {  # R3 has no checksum: a wrong digit would be a wrong angle, which no reader can see
    EmulatedDevice.MELFA: COMMON_FAULTS - {"double"} | {"alarm"},
    EmulatedDevice.MELFA_REALTIME: COMMON_FAULTS - {"split"} | {"jump"},
    EmulatedDevice.LABENC: LABENC_FAULTS,
    EmulatedDevice.PAN: LABENC_FAULTS,
    EmulatedDevice.GRIPPER: COMMON_FAULTS | {"alarm"},
}
DEFAULT_PORTS = {
    EmulatedDevice.MELFA: "tcp:10001",
    EmulatedDevice.MELFA_REALTIME: "udp:10000",
    EmulatedDevice.LABENC: "pty",
    EmulatedDevice.PAN: "pty",
    EmulatedDevice.GRIPPER: "pty",
}


def emulate(
    device: Annotated[EmulatedDevice, typer.Argument(help="What to be.")],
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
    rate: Annotated[int, typer.Option(min=1, help="Samples per second of labenc and pan.")] = 100,
    object_mm: Annotated[
        float | None,
        typer.Option(min=0, max=150, help="Width of the object between the gripper's fingers."),
    ] = None,
    baud: Annotated[
        int | None, typer.Option(min=300, help="Send as slowly as a serial line of so many baud.")
    ] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            help="Faults to simulate; repeatable. A share of the messages: noise, half, digit, "
            "double, lost, split=0.05. At an instant: silence, unplug=AT:SECONDS, reset=AT, "
            "jump=AT:SECONDS, alarm=AT:NUMBER (gripper: gFLT), status=AT:BITS."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random faults.")] = 0,
) -> None:
    """Be a controller, an encoder board or a gripper, until Ctrl-C.

    Example: verify emulate melfa --port tcp:10001 --motion sweep
    """
    from verify.devices.ports import SerialLine, describe_port_error
    from verify.errors import InputError
    from verify.simulation.emulators.gripper import GripperEngine, GripperOptions
    from verify.simulation.emulators.hand import contact_positions
    from verify.simulation.emulators.server import EmulatorServer, open_front, parse_faults

    if object_mm is not None and device is not EmulatedDevice.GRIPPER:
        raise InputError("--object-mm", f"{device.value} has no fingers", "", "Leave it out.")
    if idle and device is not EmulatedDevice.MELFA:
        raise InputError("--idle", f"{device.value} runs no program", "", "Leave it out.")
    faults = parse_faults(fault or [], FAULTS[device])
    if device is EmulatedDevice.GRIPPER:
        contacts = None if object_mm is None else contact_positions(object_mm)
        engine: EmulatorEngine = GripperEngine(GripperOptions(contacts=contacts))
    elif device is EmulatedDevice.MELFA:
        engine = _melfa(motion, joints, idle, seed)
    else:
        engine = _engine(device, motion, joints, rate, baud)
    line = SerialLine(baud or 115200)
    server = EmulatorServer(
        open_front(port or DEFAULT_PORTS[device], line), engine, faults, baud, seed
    )
    address = server.front.address
    terminal.say(f"{device.value} listens at {address}; Ctrl-C ends it")
    terminal.record({"type": "listening", "device": device.value, "address": address})
    try:
        server.serve(lambda: False)
    except OSError as error:  # only a serial device goes away under an emulator
        raise InputError(address, describe_port_error(error)) from error
    finally:
        server.close()


def _melfa(motion: str, joints: int, idle: bool, seed: int) -> "EmulatorEngine":
    import numpy as np

    import robots
    from verify.simulation.emulators.arm import MelfaArm
    from verify.simulation.emulators.melfa import ControllerOptions, MelfaEngine
    from verify.simulation.emulators.trajectory import load

    loaded = robots.load(MELFA_ROBOT)
    arm = loaded if isinstance(loaded, robots.DhArm) and loaded.dof == joints else None
    limits = np.deg2rad(np.tile([-360.0, 360.0], (joints, 1)))
    if idle and arm is not None:  # a recorded motion may be another robot's: nothing limits that
        limits = np.column_stack([arm.lower, arm.upper])
    return MelfaEngine(
        MelfaArm(load(motion, joints), joints, limits, arm=arm, idle=idle),
        ControllerOptions(),
        seed,
    )


def _engine(
    device: EmulatedDevice, motion: str, joints: int, rate: int, baud: int | None
) -> "EmulatorEngine":
    from verify.simulation.emulators.encoders import LabencEngine, LabencOptions, PanEngine
    from verify.simulation.emulators.melfa import RealtimeEngine
    from verify.simulation.emulators.trajectory import load

    match device:
        case EmulatedDevice.MELFA_REALTIME:
            return RealtimeEngine(load(motion, joints), joints)
        case EmulatedDevice.LABENC:
            options = LabencOptions(rate=rate, baud=baud or 115200)
            return LabencEngine(load(motion, joints), joints, options)
        case _:
            return PanEngine(LabencOptions(arm="PANBASE", rate=rate, baud=baud or 115200))
