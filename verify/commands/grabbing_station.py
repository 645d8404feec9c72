"""`verify grab STATION`: real cameras, a MELFA controller and a gripper as the stage of a grab."""

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np

from verify import station_file
from verify.commands.grabbing import STDIN, Stage, Wish, conduct, in_words
from verify.commands.grabbing_page import OnPage
from verify.commands.grabbing_pairs import LivePairs
from verify.devices import EncoderReading
from verify.devices.intake import AngleMap
from verify.devices.ports import host_and_port, open_port
from verify.errors import InputError
from verify.grab import cell_file
from verify.grab.emulated import OnlyEmulators, is_emulated_gripper, is_emulated_melfa
from verify.grab.flange_watch import FlangeWatch
from verify.grab.gripper import GripperDriver
from verify.grab.gripper_reader import GripperSettings
from verify.grab.loop import Loop
from verify.grab.loop_closed import ClosedAim, WatchedSource
from verify.grab.loop_orders import Hands
from verify.grab.loop_steps import SteppedArm
from verify.grab.loop_target import Aim
from verify.grab.melfa_motion import MelfaMover
from verify.grab.melfa_motion_settings import MotionSettings, MoveLimits
from verify.grab.motion_port import ExecuteRight
from verify.grab.plan import Planner
from verify.grab.plan_cameras import among_cameras
from verify.grab.record import Told
from verify.grab.target import Options
from verify.grab.target_tracking import Tracker
from verify.results_folder import refuse_existing
from verify.sim.devices import SimulatedStation
from verify.station import Station, open_station
from verify.station_tables import EncodersTable
from verify.terminal import terminal
from verify.toml_file import fault
from verify.warm_up import warm_up

CELL = "grab.toml"  # beside the station file
HALF_WIDTH = 0.05  # s: within which the controller reads its joints, as far as it tells


@dataclass(frozen=True, slots=True)
class Ports:
    """What moves, as the options name it."""

    cell: Path | None  # grab.toml; None: beside the station file
    gripper: str | None  # port; needed to move


def grab_on_station(path: Path, ports: Ports, wish: Wish, out: Path, *, force: bool) -> bool:
    """Grab with real devices; see `conduct`.

    Args:
        path: the station file; its [encoders] name the controller that moves.
        ports: what else is needed.
        wish: what is asked for.
        out: the folder.
        force: write into a folder that exists.

    Raises:
        InputError: a file, an option, a device or the folder; or the order was not confirmed.
    """
    refuse_existing(out, force=force)
    target, ends = wish.given, wish.ends
    station = open_station(path, SimulatedStation)
    cell_path = ports.cell or path.with_name(CELL)
    cell, warnings = cell_file.read(cell_path, station.arm.dof)
    for warning in (*station.warnings, *warnings):
        terminal.warn(warning)
    rig, turning = station.rig, station.facts.turning
    setup = among_cameras(station.arm, cell, rig, turning=turning)
    tracker = None if target is None else Tracker(rig, target, Options())
    warm_up()  # compiling while the arm waits would look like stale pictures
    with ExitStack() as stack:
        began = time.monotonic()

        def now() -> float:
            return time.monotonic() - began

        joints, hands = _devices(station, setup, ports, wish, stack, began)
        cameras, pan = station.open_cameras(), station.open_pan()
        source = LivePairs(cameras, pan, rig, station.rate, began)
        stack.callback(source.close)
        watch = _watch(station, setup, stack)
        # nothing stands above the target that may not move: there is no hand to look at
        aim = Aim(setup, rig) if hands is None else ClosedAim(setup, rig, watch)
        loop = Loop(setup, tracker, aim, hands, lambda: watch.read(joints()), now, auto=wish.auto)
        started = datetime.now(UTC)
        told = Told(station.robot, in_words(target), station.name, wish.execute, started)
        tables = {"description": f"a grab at {station.name}"}
        facts = replace(station.facts, tables=tables, turning=turning, time_stated=False)
        seen = WatchedSource(source, watch)
        page = None if wish.page is None else OnPage(wish.page, setup, rig, selects=target is None)
        stage = Stage(loop, seen, setup.workspace, facts, told, station.rate, wish.execute, page)
        return conduct(stage, ends, out, force=force)


def _watch(station: Station, setup: Planner, stack: ExitStack) -> FlangeWatch:
    """Measure the flange beside the loop, which waits for nothing."""
    worker = ThreadPoolExecutor(1, "flange")
    stack.callback(worker.shutdown, cancel_futures=True)
    return FlangeWatch(setup.arm, station.rig, station.marker, worker.submit)


def _devices(
    station: Station,
    setup: Planner,
    ports: Ports,
    wish: Wish,
    stack: ExitStack,
    began: float,
) -> tuple[Callable[[], EncoderReading | None], Hands | None]:
    """Open what reads the joints, and what moves, once that was confirmed."""
    if not wish.execute:
        encoders = station.open_encoders()
        stack.callback(encoders.close)

        def read() -> EncoderReading | None:
            newest = encoders.read()[-1:]
            return replace(newest[0], t_host=newest[0].t_host - began) if newest else None

        return read, None
    table, _ = station_file.read(station.path)
    settings = _controller(station.path, table.encoders)
    if ports.gripper is None:
        expected = "the gripper's port is needed to move"
        raise InputError("--gripper", "is missing", expected, "Example: --gripper /dev/ttyUSB0")
    fingers = GripperSettings(ports.gripper)
    melfa = OnlyEmulators(
        partial(open_port, settings.port, settings.line),
        partial(is_emulated_melfa, terminator=settings.terminator),
    )
    hand = OnlyEmulators(partial(open_port, fingers.port, fingers.line), is_emulated_gripper)
    stack.callback(melfa.close)
    stack.callback(hand.close)
    # a gripper is asked only beside an emulated controller: nothing in a real cell is
    emulated = melfa.there() and hand.there()
    right = _emulators_right() if emulated else confirmed(f"{settings.robot_type} {settings.port}")
    if not emulated:
        melfa.close()
        hand.close()
    limits = np.column_stack([setup.limits.lower, setup.limits.upper])
    angles = _angles(table.encoders, station.arm.dof)
    override = max(1, round(100 * setup.cell.moving.share))
    most = MoveLimits(limits, override=override)
    mover = stack.enter_context(
        MelfaMover(settings, angles, most, right, melfa if emulated else None)
    )
    gripper = GripperDriver(fingers, right, hand if emulated else None)
    stack.callback(gripper.close)

    def joints() -> EncoderReading | None:
        status = mover.step()
        if status.q is None or status.t is None:
            return None
        return EncoderReading(status.t, status.t - began, HALF_WIDTH, 0, status.q)

    return joints, Hands(SteppedArm(setup, mover), gripper)


def _emulators_right() -> ExecuteRight:
    """Take `--execute` for the order that it is: nothing but emulators can be opened with it."""
    terminal.say("Controller and gripper are emulators: nobody has to confirm")
    return ExecuteRight("--execute, and both ends have proved to be emulators")


def confirmed(what: str) -> ExecuteRight:
    """Have the operator type what will move.

    Args:
        what: robot and port.

    Raises:
        InputError: something else was typed.
    """
    terminal.say(f"This moves a robot. Is the emergency stop at hand? Type: {what}")
    typed = _line()
    if typed != what:
        raise InputError("confirmation", f'"{typed}" was typed', f'"{what}" is expected')
    return ExecuteRight(f"--execute, and typed: {typed}")


def _line() -> str:
    """Read one line, and not a byte beyond it: the keys that follow are others' to read."""
    typed = b""
    while (byte := os.read(STDIN, 1)) not in (b"", b"\n"):
        typed += byte
    return typed.decode(errors="replace").strip()


def _controller(path: Path, table: EncodersTable) -> MotionSettings:
    """Take the controller that [encoders] names."""
    if table.driver != "melfa":
        expected = 'only a MELFA controller can be moved: driver = "melfa"'
        raise fault(path, "encoders.driver", f'is "{table.driver}"', expected)
    if table.robot_type is None:
        expected = 'another robot than it names is not moved: robot_type = "RV-3SD"'
        raise fault(path, "encoders.robot_type", "is missing", expected)
    port = table.port or ""
    if not port.startswith("tcp:"):
        expected = 'the controller is moved over the network: port = "tcp:HOST:10001"'
        raise fault(path, "encoders.port", f'is "{port}"', expected)
    host_and_port(port.removeprefix("tcp:"), port)
    settings = MotionSettings(port, table.robot_type)
    return settings if table.pause_ms is None else replace(settings, pause=table.pause_ms * 1e-3)


def _angles(table: EncodersTable, joints: int) -> AngleMap:
    sign, offset = table.sign or [1] * joints, table.offset_deg or [0.0] * joints
    return AngleMap(np.array(sign, dtype=float), np.deg2rad(np.array(offset, dtype=float)))
