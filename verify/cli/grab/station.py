"""Grasp with a station's real cameras, a MELFA controller and a gripper."""

import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np

from verify.cli.grab.conduct import GraspOptions, GraspRun, conduct, target_name
from verify.cli.terminal import STDIN, terminal
from verify.core.records import StereoPair
from verify.core.rig import Rig
from verify.devices.ports import open_port
from verify.devices.protocols import CameraDevice, EncoderReading, PanDevice
from verify.errors import InputError, defect_text
from verify.grasping import cell as grasping_cell
from verify.grasping.actuators.emulator_check import (
    EmulatorPortOpener,
    is_emulated_gripper,
    is_emulated_melfa,
)
from verify.grasping.actuators.gripper.gripper import GripperDriver
from verify.grasping.actuators.gripper.modbus import GripperSettings
from verify.grasping.actuators.melfa.mover import MelfaMover
from verify.grasping.actuators.melfa.orders import MotionSettings, MoveLimits
from verify.grasping.actuators.protocols import ExecutePermission
from verify.grasping.control.aim import Aim
from verify.grasping.control.arm import SteppedArm
from verify.grasping.control.loop import Actuators, GraspLoop
from verify.grasping.planning.workspace import Workspace, workspace_with_cameras
from verify.grasping.record.record import GraspContext
from verify.grasping.tool_offset.watch import FlangeWatch
from verify.grasping.tracking.track import TargetTracker
from verify.io.results import refuse_existing
from verify.io.toml import key_error
from verify.live.buffers import PanBuffer
from verify.live.intake import PollingThread, readings_step, stop_threads
from verify.live.pairing import FramePair, Pairing
from verify.live.station import file
from verify.live.station.devices import angle_map, melfa_settings
from verify.live.station.keys import StationEncodersTable, StationTable
from verify.live.station.station import Station, open_station
from verify.measurement.chain import warm_up
from verify.simulation.devices.station import SimulatedStation

PAN_UNKNOWN = "a camera base turns, or its angle is not known: its pictures are not used"


class LivePairs:
    """The newest pair of two free-running cameras; none from while a base turns.

    Cameras, left and right, and `pan`, which reads the bases' angles, are closed with this; without
    `pan` they stand as the rig says. `rate`: Hz, of the loop; `began`: s, host's monotonic clock,
    zero of the pairs' times.
    """

    def __init__(
        self,
        cameras: tuple[CameraDevice, CameraDevice],
        pan: PanDevice | None,
        rig: Rig,
        rate: float,
        began: float,
    ) -> None:
        self._standing, self._period, self._began = (rig.left.pan, rig.right.pan), 1 / rate, began
        self._pairing, self._lock = Pairing(1 / rate), threading.Lock()
        self._newest: tuple[FramePair, tuple[float, float]] | None = None
        self._cameras, self._pan, self._angles = cameras, pan, PanBuffer()
        self._frame, self._due = 0, time.monotonic()
        self._warned = False
        steps: dict[str, Callable[[], bool]] = {
            f"{side} camera": partial(self._step, i) for i, side in enumerate(("left", "right"))
        }
        if pan is not None:
            steps["pan bases"] = readings_step(pan, self._angles.add)
        self._threads = [
            PollingThread(
                name,
                step,
                lambda name, error: terminal.warn(f"{name}: {defect_text(error)}"),
                lambda name, n: terminal.warn(f"{name}: reads again; reads that failed: {n}"),
            )
            for name, step in steps.items()
        ]
        for thread in self._threads:
            thread.start()

    def pair(self) -> StereoPair | None:
        """Take the newest pair; None if there is none since the last call."""
        with self._lock:
            taken, self._newest = self._newest, None
        if taken is None:
            return None
        self._frame += 1
        left, right, pans = taken[0].left, taken[0].right, taken[1]
        times = (left.t - self._began, right.t - self._began)
        lossy = left.raw is not None, right.raw is not None
        return StereoPair(self._frame - 1, *times, *pans, left.image, right.image, lossy)

    def wait(self) -> None:
        """Wait until the next cycle is due."""
        self._due = max(self._due + self._period, time.monotonic())
        time.sleep(max(0.0, self._due - time.monotonic()))

    def close(self) -> None:
        """Close the cameras and the bases."""
        stop_threads(self._threads, 1.0)
        for camera in self._cameras:
            camera.close()
        if self._pan is not None:
            self._pan.close()

    def _step(self, side: int) -> bool:
        frame = self._cameras[side].read()
        if frame is None:
            return False
        with self._lock:
            pair = self._pairing.add(side, frame, time.monotonic())
        if pair is not None:
            self._keep(pair)
        return True

    def _keep(self, pair: FramePair) -> None:
        """Keep a pair whose bases stood; in the camera's thread, as their angles may come late."""
        pans = self._standing if self._pan is None else self._angles.of_pair(pair)
        if pans is None:
            if not self._warned:
                terminal.warn(PAN_UNKNOWN)
            self._warned = True
            return
        self._warned = False
        with self._lock:
            if self._newest is None or self._newest[0].left.t < pair.left.t:
                self._newest = (pair, pans)


CELL_FILE = "grab.toml"  # beside the station file
READING_HALF_WIDTH = 0.05  # s: within which the controller reads its joints, as far as it tells


def grab_on_station(
    path: Path,
    cell_file: Path | None,
    gripper: str | None,
    options: GraspOptions,
    out: Path,
    *,
    force: bool,
) -> bool:
    """Grasp with real devices; the result is that of `conduct`.

    The station's [encoders] name the controller that moves; grab.toml is beside the station file
    where none is given, and the gripper's port is needed to move. `out`: of film, session and
    report; `force`: write into a folder that exists.

    Raises:
        InputError: a file, an option, a device or the folder; or the order was not confirmed.
    """
    refuse_existing(out, force=force)
    target = options.target
    station = open_station(path, SimulatedStation)
    cell, warnings = grasping_cell.read(cell_file or path.with_name(CELL_FILE), station.arm.dof)
    terminal.warn(*station.warnings, *warnings)
    rig, turning = station.rig, station.facts.turning
    workspace = workspace_with_cameras(station.arm, cell, rig, turning=turning)
    tracker = None if target is None else TargetTracker(rig, target)
    warm_up()  # loading while the arm waits would look like stale pictures
    with ExitStack() as stack:
        began = time.monotonic()

        def now() -> float:
            return time.monotonic() - began

        joints, actuators = _open_devices(station, workspace, gripper, options, stack, began)
        cameras, pan = station.open_cameras(), station.open_pan()
        source = LivePairs(cameras, pan, rig, station.rate, began)
        stack.callback(source.close)
        worker = ThreadPoolExecutor(1, "flange")  # the loop does not wait for it
        stack.callback(worker.shutdown, cancel_futures=True)
        watch = FlangeWatch(workspace.arm, rig, station.watched.marker, worker.submit)
        # without actuators no hand comes above the target to be measured
        aim = Aim(workspace, rig, None if actuators is None else watch)
        loop = GraspLoop(workspace, tracker, aim, actuators, joints, now, auto=options.auto)
        name, execute = target_name(target), options.execute
        context = GraspContext(station.robot, name, station.name, execute, datetime.now(UTC))
        tables = {"description": f"a grab at {station.name}"}
        facts = replace(station.facts, tables=tables, turning=turning, time_stated=False)
        stage = GraspRun(
            loop, source, workspace, rig, facts, context, station.rate, execute, options.page
        )
        return conduct(stage, options.stop_conditions, out, force=force)


def _open_devices(
    station: Station,
    workspace: Workspace,
    gripper_port: str | None,
    options: GraspOptions,
    stack: ExitStack,
    began: float,
) -> tuple[Callable[[], EncoderReading | None], Actuators | None]:
    """Open the encoders, and with --execute the actuators, once that is confirmed."""
    if not options.execute:
        encoders = station.open_encoders()
        stack.callback(encoders.close)

        def read() -> EncoderReading | None:
            newest = encoders.read()[-1:]
            return replace(newest[0], t_host=newest[0].t_host - began) if newest else None

        return read, None
    table, _ = file.read(station.path, StationTable)
    settings = motion_settings(station.path, table.encoders)
    if gripper_port is None:
        expected = "the gripper's port is needed to move"
        raise InputError("--gripper", "is missing", expected, "Example: --gripper /dev/ttyUSB0")
    gripping = GripperSettings(gripper_port)
    melfa = EmulatorPortOpener(
        partial(open_port, settings.port, settings.line),
        partial(is_emulated_melfa, terminator=settings.terminator),
    )
    hand = EmulatorPortOpener(partial(open_port, gripping.port, gripping.line), is_emulated_gripper)
    stack.callback(melfa.close)
    stack.callback(hand.close)
    # the gripper is identified only beside an emulated controller, never in a real cell
    emulated = melfa.there() and hand.there()
    if emulated:
        terminal.say("Controller and gripper are emulators: nobody has to confirm")
        permission = ExecutePermission("--execute, and both ends have proved to be emulators")
    else:
        permission = confirm_execution(f"{settings.robot_type} {settings.port}")
        melfa.close()
        hand.close()
    override = max(1, round(100 * workspace.cell.moving.share))
    limits = MoveLimits(
        np.column_stack([workspace.limits.lower, workspace.limits.upper]), override=override
    )
    angles = angle_map(station.path, "encoders", table.encoders, station.arm.dof)
    mover = MelfaMover(settings, angles, limits, permission, melfa if emulated else None)
    stack.callback(mover.close)
    gripper = GripperDriver(gripping, permission, hand if emulated else None)
    stack.callback(gripper.close)

    def joints() -> EncoderReading | None:
        status = mover.step()
        if status.q is None or status.t is None:
            return None
        return EncoderReading(status.t, status.t - began, READING_HALF_WIDTH, 0, status.q)

    return joints, Actuators(SteppedArm(workspace, mover), gripper)


def confirm_execution(robot: str) -> ExecutePermission:
    """Have the operator type name and port of the robot that will move; else InputError."""
    terminal.say(f"This moves a robot. Is the emergency stop at hand? Type: {robot}")
    typed = _read_line()
    if typed != robot:
        remedy = "Start again; nothing has moved."
        raise InputError("confirmation", f'"{typed}" was typed', f'"{robot}" is expected', remedy)
    return ExecutePermission(f"--execute, and typed: {typed}")


def _read_line() -> str:
    """Read one line and not a byte beyond it: what follows are the operator's keys."""
    typed = b""
    while (byte := os.read(STDIN, 1)) not in (b"", b"\n"):
        typed += byte
    return typed.decode(errors="replace").strip()


def motion_settings(path: Path, table: StationEncodersTable) -> MotionSettings:
    """Settings of the controller that [encoders] names; InputError: it is none that is moved."""
    if table.driver != "melfa":
        expected = 'only a MELFA controller can be moved: driver = "melfa"'
        raise key_error(path, "encoders.driver", f'is "{table.driver}"', expected)
    if table.robot_type is None:
        expected = 'another robot than it names is not moved: robot_type = "RV-3SD"'
        raise key_error(path, "encoders.robot_type", "is missing", expected)
    read = melfa_settings(path, table)
    if not read.port.startswith("tcp:"):
        expected = 'the controller is moved over the network: port = "tcp:HOST:10001"'
        raise key_error(path, "encoders.port", f'is "{read.port}"', expected)
    return MotionSettings(
        read.port, table.robot_type, read.line, read.terminator, read.pause, read.timeout
    )
