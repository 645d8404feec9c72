"""A device that is not there: it answers on a port as the real one does, faults included."""

from dataclasses import replace
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from verify.cli.terminal import terminal

if TYPE_CHECKING:  # imported when the command runs: `--help` answers at once
    from verify.simulation.emulators.opcua import OpcUaEmulator
    from verify.simulation.emulators.server import EmulatorEngine, EmulatorFaults

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
    RTDE = "rtde"
    ROSBRIDGE = "rosbridge"
    OPCUA = "opcua"


FAULTS = {  # R3 has no checksum: a wrong digit would be a wrong angle, which no reader can see
    EmulatedDevice.MELFA: COMMON_FAULTS - {"double"} | {"alarm"},
    EmulatedDevice.MELFA_REALTIME: COMMON_FAULTS - {"split"} | {"jump"},
    EmulatedDevice.LABENC: LABENC_FAULTS,
    EmulatedDevice.PAN: LABENC_FAULTS,
    EmulatedDevice.GRIPPER: COMMON_FAULTS | {"alarm"},
    # TCP brings no half packages, and no bytes that nobody sent
    EmulatedDevice.RTDE: COMMON_FAULTS - {"noise", "half"} | {"jump", "alarm", "version"},
    EmulatedDevice.ROSBRIDGE: COMMON_FAULTS - {"split"} | {"jump"},
    EmulatedDevice.OPCUA: frozenset({"silence", "unplug", "jump", "status"}),
}
# devices whose protocol is that of one kind of line
ONLY_LINES = {
    EmulatedDevice.MELFA_REALTIME: "udp",
    EmulatedDevice.RTDE: "tcp",
    EmulatedDevice.ROSBRIDGE: "tcp",
    EmulatedDevice.OPCUA: "tcp",
}
DEFAULT_PORTS = dict.fromkeys(EmulatedDevice, "pty") | {
    EmulatedDevice.MELFA: "tcp:10001",
    EmulatedDevice.MELFA_REALTIME: "udp:10000",
    EmulatedDevice.RTDE: "tcp:30004",
    EmulatedDevice.ROSBRIDGE: "tcp:9090",
    EmulatedDevice.OPCUA: "tcp:4840",
}
MOTION, JOINTS, RATE = "sines", 6, 100  # unless others are given
ARMS = frozenset(EmulatedDevice) - {EmulatedDevice.PAN, EmulatedDevice.GRIPPER}
BYTEWISE = frozenset(EmulatedDevice) - {EmulatedDevice.OPCUA}  # its server sends as it likes
RATED = frozenset(map(EmulatedDevice, ("labenc", "pan", "rosbridge", "opcua")))


def emulate(
    device: Annotated[EmulatedDevice, Argument(help="What to be.")],
    port: Annotated[
        str | None,
        Option(help="tcp:PORT, tcp:HOST:PORT, udp:PORT, pty, pty:LINK, or a serial device's path."),
    ] = None,
    motion: Annotated[
        str, Option(help="hold, sweep, sines, or a CSV like a session's encoders.csv.")
    ] = MOTION,
    joints: Annotated[int, Option(min=1, max=8, help="How many joints the arm has.")] = JOINTS,
    idle: Annotated[
        bool,
        Option(
            "--idle", help="melfa: no program runs, the servo is off; it waits to be moved by EXEC."
        ),
    ] = False,
    robot: Annotated[
        str | None,
        Option(help="rosbridge: whose joints the messages name; else joint_1, joint_2, …"),
    ] = None,
    rate: Annotated[
        int, Option(min=1, help="Samples per second of labenc, pan, rosbridge and opcua.")
    ] = RATE,
    object_mm: Annotated[
        float | None,
        Option(min=0, max=150, help="Width of the object between the gripper's fingers."),
    ] = None,
    baud: Annotated[
        int | None,
        Option(min=300, max=20_000_000, help="Send as slowly as a serial line of so many baud."),
    ] = None,
    fault: Annotated[
        list[str] | None,
        Option(
            help="Faults to simulate; repeatable. A share of the messages: noise, half, digit, "
            "double, lost, split=0.05. At an instant: silence, unplug=AT:SECONDS, reset=AT, "
            "jump=AT:SECONDS, alarm=AT:NUMBER (gripper: gFLT), status=AT:BITS, version=AT:NUMBER "
            "(rtde: no later one is accepted)."
        ),
    ] = None,
    seed: Annotated[int, Option(min=0, help="Seed of the random faults.")] = 0,
) -> None:
    """Be a controller, an encoder board or a gripper, until Ctrl-C.

    Example: verify emulate melfa --port tcp:10001 --motion sweep
    """
    import robots
    from verify.devices.encoders.rtde import RTDE_JOINTS
    from verify.devices.ports import SerialLine, describe_port_error
    from verify.errors import InputError
    from verify.io.files import restated
    from verify.live.station.template import joint_names
    from verify.simulation.emulators.encoders import LabencEngine, LabencOptions, PanEngine
    from verify.simulation.emulators.endpoints import TcpEndpoint, open_front
    from verify.simulation.emulators.gripper import MAX_FAULT, GripperEngine, GripperOptions
    from verify.simulation.emulators.hand import contact_positions
    from verify.simulation.emulators.melfa import RealtimeEngine
    from verify.simulation.emulators.rosbridge import (
        RosbridgeEngine,
        RosbridgeOptions,
        WebSocketEndpoint,
    )
    from verify.simulation.emulators.rtde import RtdeEngine
    from verify.simulation.emulators.server import MAX_ALARM, EmulatorServer, parse_faults
    from verify.simulation.emulators.trajectory import load

    gripper = device is EmulatedDevice.GRIPPER
    for name, given, owners, why in (
        ("--object-mm", object_mm is not None, {EmulatedDevice.GRIPPER}, "has no fingers"),
        ("--idle", idle, {EmulatedDevice.MELFA}, "runs no program"),
        ("--robot", robot is not None, {EmulatedDevice.ROSBRIDGE}, "names no joints"),
        ("--motion", motion != MOTION, ARMS, "has no motion of its own"),
        ("--joints", joints != JOINTS, ARMS, "has no joints"),
        ("--rate", rate != RATE, RATED, "sends at a rate of its own"),
        ("--baud", baud is not None, BYTEWISE, "is no serial line"),
        ("--seed", seed != 0, BYTEWISE, "has no random faults"),
        ("--joints", joints != JOINTS and robot is not None, (), "has the joints of --robot"),
    ):
        if given and device not in owners:
            raise InputError(name, f"{device.value} {why}", "", "Leave it out.")
    if device is EmulatedDevice.RTDE and joints != RTDE_JOINTS:
        expected = f"every arm that speaks RTDE has {RTDE_JOINTS} joints"
        raise InputError("--joints", f"is {joints}", expected, "Leave it out.")
    where, kind = port or DEFAULT_PORTS[device], ONLY_LINES.get(device)
    if kind is not None and where.partition(":")[0] != kind:
        expected = f"{device.value} is reached at {kind}:PORT or {kind}:HOST:PORT"
        raise InputError(f"--port {where}", "is another kind of line", expected)
    faults = parse_faults(fault or [], FAULTS[device], MAX_FAULT if gripper else MAX_ALARM)
    board = LabencOptions(rate=rate, baud=baud or 115200)
    engine: EmulatorEngine | None = None
    match device:
        case EmulatedDevice.MELFA:
            engine = _melfa(motion, joints, idle, seed)
        case EmulatedDevice.MELFA_REALTIME:
            engine = RealtimeEngine(load(motion, joints), joints)
        case EmulatedDevice.LABENC:
            engine = LabencEngine(load(motion, joints), joints, board)
        case EmulatedDevice.PAN:
            engine = PanEngine(replace(board, arm="PANBASE"))
        case EmulatedDevice.GRIPPER:
            contacts = None if object_mm is None else contact_positions(object_mm)
            engine = GripperEngine(GripperOptions(contacts=contacts))
        case EmulatedDevice.RTDE:
            engine = RtdeEngine(load(motion, joints))
        case EmulatedDevice.ROSBRIDGE:
            with restated(robots.RobotError, place="--robot"):
                names = joint_names(joints if robot is None else robots.load(robot))
            engine = RosbridgeEngine(load(motion, len(names)), RosbridgeOptions(names, rate=rate))
    server: EmulatorServer | OpcUaEmulator
    if engine is None:
        server = _opcua(where, motion, joints, rate, faults)
    else:
        kind_of = WebSocketEndpoint if device is EmulatedDevice.ROSBRIDGE else TcpEndpoint
        front = open_front(where, SerialLine(baud or 115200), kind_of)
        server = EmulatorServer(front, engine, faults, baud, seed)
    terminal.say(f"{device.value} listens at {server.address}; Ctrl-C ends it")
    terminal.record("listening", device=device.value, address=server.address)
    try:
        server.serve(lambda: False)
    except OSError as error:  # only a serial device goes away under an emulator
        raise InputError(server.address, describe_port_error(error)) from error
    finally:
        server.close()


def _opcua(
    where: str, motion: str, joints: int, rate: int, faults: "EmulatorFaults"
) -> "OpcUaEmulator":
    from verify.devices.encoders.opcua import require_asyncua
    from verify.simulation.emulators.endpoints import listening_at, opening
    from verify.simulation.emulators.trajectory import load

    require_asyncua()
    from verify.simulation.emulators.opcua import OpcUaEmulator

    trajectory = load(motion, joints)
    with opening(where):
        host, port = listening_at(where)
        return OpcUaEmulator(host, port, trajectory, joints, rate, faults)


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
    moved = MelfaArm(load(motion, joints), limits, arm=arm, idle=idle)
    return MelfaEngine(moved, ControllerOptions(axes=max(joints, 6)), seed)
