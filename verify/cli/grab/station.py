"""Grasp with a station's real cameras, a MELFA controller and a gripper."""

import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np

from verify.analysis.warm_up import warm_up
from verify.cli.grab.conduct import STDIN, GraspOptions, GraspRun, PageContext, conduct, target_name
from verify.cli.terminal import terminal
from verify.core.records import StereoPair
from verify.core.rig import Rig
from verify.devices.encoders.intake import AngleMap
from verify.devices.ports import host_and_port, open_port
from verify.devices.protocols import CameraDevice, EncoderReading, PanDevice
from verify.errors import InputError
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
from verify.grasping.planning.plan import GraspPlanner, planner_with_cameras
from verify.grasping.record.record import GraspContext
from verify.grasping.tool_offset.watch import FlangeWatch
from verify.grasping.tracking.track import TargetTracker
from verify.io.results import refuse_existing
from verify.io.toml import key_error
from verify.live.buffers import PanBuffer
from verify.live.intake import PollingThread, readings_step
from verify.live.pairing import FramePair, Pairing
from verify.live.station import file
from verify.live.station.keys import StationEncodersTable
from verify.live.station.station import Station, open_station
from verify.simulation.devices.station import SimulatedStation

PAN_UNKNOWN = "a camera base turns, or its angle is not known: its pictures are not used"


class LivePairs:
    """The newest pair of two cameras that run freely; none of a time when a base was turning.

    Args:
        cameras: left and right; closed with this.
        pan: tells how the bases stand; closed with this. None: they stand as the rig says.
        rig: where they stand.
        rate: Hz, of the loop.
        began: s, host's monotonic clock: zero of the pairs' times.
    """

    def __init__(
        self,
        cameras: tuple[CameraDevice, CameraDevice],
        pan: PanDevice | None,
        rig: Rig,
        rate: float,
        began: float,
    ) -> None:
        self._rig, self._period, self._began = rig, 1 / rate, began
        self._pairing, self._lock = Pairing(1 / rate), threading.Lock()
        self._newest: tuple[FramePair, tuple[float, float]] | None = None
        self._cameras, self._pan, self._book = cameras, pan, PanBuffer()
        self._frame, self._due = 0, time.monotonic()
        self._known = True
        self._pumps = [
            PollingThread(f"{name} camera", self._step(side), _report_defect)
            for side, name in enumerate(("left", "right"))
        ]
        if pan is not None:
            self._pumps.append(
                PollingThread("pan bases", readings_step(pan, self._book.add), _report_defect)
            )
        for pump in self._pumps:
            pump.start()

    def pair(self) -> StereoPair | None:
        """Take the newest pair; None where none has come since last time."""
        with self._lock:
            taken, self._newest = self._newest, None
        if taken is None:
            return None
        self._frame += 1
        (left, right), pans = (taken[0].left, taken[0].right), taken[1]
        times = (left.t - self._began, right.t - self._began)
        return StereoPair(self._frame - 1, *times, *pans, left.image, right.image)

    def wait(self) -> None:
        """Wait until the next turn is due."""
        self._due = max(self._due + self._period, time.monotonic())
        time.sleep(max(0.0, self._due - time.monotonic()))

    def close(self) -> None:
        """Let go of the cameras and the bases."""
        for pump in self._pumps:
            pump.stop()
        for pump in self._pumps:
            pump.join(1.0)
        for camera in self._cameras:
            camera.close()
        if self._pan is not None:
            self._pan.close()

    def _step(self, side: int) -> Callable[[], bool]:
        def step() -> bool:
            frame = self._cameras[side].read()
            if frame is None:
                return False
            with self._lock:
                pair = self._pairing.add(side, frame, time.monotonic())
            if pair is not None:
                self._keep(pair)
            return True

        return step

    def _keep(self, pair: FramePair) -> None:
        """Keep a pair whose bases stood; in the camera's thread: word of them may take a moment."""
        pans = self._pans(pair)
        if (pans is not None) != self._known:
            self._known = pans is not None
            if not self._known:
                terminal.warn(PAN_UNKNOWN)
        if pans is None:
            return
        with self._lock:
            if self._newest is None or self._newest[0].left.t < pair.left.t:
                self._newest = (pair, pans)

    def _pans(self, pair: FramePair) -> tuple[float, float] | None:
        """How the bases stood, rad, left and right; each at its own picture's instant."""
        if self._pan is None:
            return self._rig.left.pan, self._rig.right.pan
        left, right = self._book.at(pair.left.t), self._book.at(pair.right.t)
        return None if left is None or right is None else (left[0], right[1])


def _report_defect(name: str, error: Exception) -> None:
    terminal.warn(f"{name}: {error}")


CELL_FILE = "grab.toml"  # beside the station file
READING_HALF_WIDTH = 0.05  # s: within which the controller reads its joints, as far as it tells


@dataclass(frozen=True, slots=True)
class ActuatorPorts:
    """What moves, as the options name it."""

    cell: Path | None  # grab.toml; None: beside the station file
    gripper: str | None  # port; needed to move


def grab_on_station(
    path: Path, ports: ActuatorPorts, wish: GraspOptions, out: Path, *, force: bool
) -> bool:
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
    cell_path = ports.cell or path.with_name(CELL_FILE)
    cell, warnings = grasping_cell.read(cell_path, station.arm.dof)
    for warning in (*station.warnings, *warnings):
        terminal.warn(warning)
    rig, turning = station.rig, station.facts.turning
    setup = planner_with_cameras(station.arm, cell, rig, turning=turning)
    tracker = None if target is None else TargetTracker(rig, target)
    warm_up()  # compiling while the arm waits would look like stale pictures
    with ExitStack() as stack:
        began = time.monotonic()

        def now() -> float:
            return time.monotonic() - began

        joints, hands = _open_devices(station, setup, ports, wish, stack, began)
        cameras, pan = station.open_cameras(), station.open_pan()
        source = LivePairs(cameras, pan, rig, station.rate, began)
        stack.callback(source.close)
        watch = _open_flange_watch(station, setup, stack)
        # nothing stands above the target that may not move: there is no hand to measure
        aim = Aim(setup, rig, None if hands is None else watch)
        loop = GraspLoop(setup, tracker, aim, hands, joints, now, auto=wish.auto)
        started = datetime.now(UTC)
        told = GraspContext(station.robot, target_name(target), station.name, wish.execute, started)
        tables = {"description": f"a grab at {station.name}"}
        facts = replace(station.facts, tables=tables, turning=turning, time_stated=False)
        page = (
            None
            if wish.page is None
            else PageContext(wish.page, setup, rig, selects=target is None)
        )
        stage = GraspRun(
            loop, source, setup.workspace, facts, told, station.rate, wish.execute, page
        )
        return conduct(stage, ends, out, force=force)


def _open_flange_watch(station: Station, setup: GraspPlanner, stack: ExitStack) -> FlangeWatch:
    """Measure the flange beside the loop, which waits for nothing."""
    worker = ThreadPoolExecutor(1, "flange")
    stack.callback(worker.shutdown, cancel_futures=True)
    return FlangeWatch(setup.arm, station.rig, station.marker, worker.submit)


def _open_devices(
    station: Station,
    setup: GraspPlanner,
    ports: ActuatorPorts,
    wish: GraspOptions,
    stack: ExitStack,
    began: float,
) -> tuple[Callable[[], EncoderReading | None], Actuators | None]:
    """Open what reads the joints, and what moves, once that was confirmed."""
    if not wish.execute:
        encoders = station.open_encoders()
        stack.callback(encoders.close)

        def read() -> EncoderReading | None:
            newest = encoders.read()[-1:]
            return replace(newest[0], t_host=newest[0].t_host - began) if newest else None

        return read, None
    table, _ = file.read(station.path)
    settings = _motion_settings(station.path, table.encoders)
    if ports.gripper is None:
        expected = "the gripper's port is needed to move"
        raise InputError("--gripper", "is missing", expected, "Example: --gripper /dev/ttyUSB0")
    fingers = GripperSettings(ports.gripper)
    melfa = EmulatorPortOpener(
        partial(open_port, settings.port, settings.line),
        partial(is_emulated_melfa, terminator=settings.terminator),
    )
    hand = EmulatorPortOpener(partial(open_port, fingers.port, fingers.line), is_emulated_gripper)
    stack.callback(melfa.close)
    stack.callback(hand.close)
    # a gripper is asked only beside an emulated controller: nothing in a real cell is
    emulated = melfa.there() and hand.there()
    right = (
        _emulator_permission()
        if emulated
        else confirm_execution(f"{settings.robot_type} {settings.port}")
    )
    if not emulated:
        melfa.close()
        hand.close()
    limits = np.column_stack([setup.limits.lower, setup.limits.upper])
    angles = _angle_map(table.encoders, station.arm.dof)
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
        return EncoderReading(status.t, status.t - began, READING_HALF_WIDTH, 0, status.q)

    return joints, Actuators(SteppedArm(setup, mover), gripper)


def _emulator_permission() -> ExecutePermission:
    """Take `--execute` for the order that it is: nothing but emulators can be opened with it."""
    terminal.say("Controller and gripper are emulators: nobody has to confirm")
    return ExecutePermission("--execute, and both ends have proved to be emulators")


def confirm_execution(what: str) -> ExecutePermission:
    """Have the operator type what will move.

    Args:
        what: robot and port.

    Raises:
        InputError: something else was typed.
    """
    terminal.say(f"This moves a robot. Is the emergency stop at hand? Type: {what}")
    typed = _read_line()
    if typed != what:
        raise InputError("confirmation", f'"{typed}" was typed', f'"{what}" is expected')
    return ExecutePermission(f"--execute, and typed: {typed}")


def _read_line() -> str:
    """Read one line, and not a byte beyond it: the keys that follow are others' to read."""
    typed = b""
    while (byte := os.read(STDIN, 1)) not in (b"", b"\n"):
        typed += byte
    return typed.decode(errors="replace").strip()


def _motion_settings(path: Path, table: StationEncodersTable) -> MotionSettings:
    """Take the controller that [encoders] names."""
    if table.driver != "melfa":
        expected = 'only a MELFA controller can be moved: driver = "melfa"'
        raise key_error(path, "encoders.driver", f'is "{table.driver}"', expected)
    if table.robot_type is None:
        expected = 'another robot than it names is not moved: robot_type = "RV-3SD"'
        raise key_error(path, "encoders.robot_type", "is missing", expected)
    port = table.port or ""
    if not port.startswith("tcp:"):
        expected = 'the controller is moved over the network: port = "tcp:HOST:10001"'
        raise key_error(path, "encoders.port", f'is "{port}"', expected)
    host_and_port(port.removeprefix("tcp:"), port)
    settings = MotionSettings(port, table.robot_type)
    return settings if table.pause_ms is None else replace(settings, pause=table.pause_ms * 1e-3)


def _angle_map(table: StationEncodersTable, joints: int) -> AngleMap:
    sign, offset = table.sign or [1] * joints, table.offset_deg or [0.0] * joints
    return AngleMap(np.array(sign, dtype=float), np.deg2rad(np.array(offset, dtype=float)))
