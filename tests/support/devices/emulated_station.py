"""A station whose encoders are an emulator on a real port that follows the simulated arm.

The emulator runs in a process of its own; both processes know the instant at which the world began.

python -m tests.support.devices.emulated_station STATION BEGAN SECONDS PAGE     watches, JSON lines
"""

import multiprocessing
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from verify.core.records import Array
from verify.devices.ports import SerialLine
from verify.live.station.keys import SimSettings
from verify.simulation.devices.scene import SimClock
from verify.simulation.devices.station import SimulatedStation
from verify.simulation.emulators.arm import MelfaArm
from verify.simulation.emulators.encoders import LabencEngine, LabencOptions
from verify.simulation.emulators.endpoints import open_front
from verify.simulation.emulators.melfa import ControllerOptions, MelfaEngine
from verify.simulation.emulators.opcua import OpcUaEmulator
from verify.simulation.emulators.rosbridge import (
    RosbridgeEngine,
    RosbridgeOptions,
    WebSocketEndpoint,
)
from verify.simulation.emulators.rtde import RtdeEngine
from verify.simulation.emulators.server import EmulatorEngine, EmulatorFaults, EmulatorServer

SCENARIO = "multi_joint_rv_3sd"
UR_JOINTS = (
    *("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"),
    *("wrist_1_joint", "wrist_2_joint", "wrist_3_joint"),
)
PATIENCE = 60.0  # s until an emulator's process has imported what it needs


def _clock(began: float) -> SimClock:
    """The world's time, the same in every process: the monotonic clock is the machine's."""
    clock = SimClock()
    clock.began = began
    return clock


class Followed:
    """The simulated arm's own motion, as an emulator plays it."""

    def __init__(self, began: float, scenario: str = SCENARIO) -> None:
        self._scene = SimulatedStation(SimSettings(scenario), _clock(began)).scene
        self.start = began

    def __call__(self, t: float) -> Array:
        """Joint angles, (joints,), rad, at t seconds after the emulator's start."""
        q: Array = self._scene.world.joints(self._scene.seconds(np.array([self.start + t])))[0]
        return q


def _server(
    kind: str, port: str, followed: Followed, faults: EmulatorFaults
) -> EmulatorServer | OpcUaEmulator:
    if kind == "opcua":
        return OpcUaEmulator("127.0.0.1", 0, followed, 6, faults=faults)
    if kind == "rosbridge":
        engine: EmulatorEngine = RosbridgeEngine(followed, RosbridgeOptions(UR_JOINTS))
        return EmulatorServer(WebSocketEndpoint("127.0.0.1", 0), engine, faults, None, 0)
    if kind == "rtde":
        engine = RtdeEngine(followed)
    elif kind == "labenc":
        engine = LabencEngine(followed, 6, LabencOptions(rate=100))
    else:
        limits = np.deg2rad(np.tile([-360.0, 360.0], (6, 1)))
        # what the cameras see is the arm itself: no lag behind it
        arm = MelfaArm(followed, limits, follows="command")
        engine = MelfaEngine(arm, ControllerOptions(), 0)
    return EmulatorServer(open_front(port, SerialLine()), engine, faults, None, 0)


def emulate(
    kind: str, port: str, began: float, faults: EmulatorFaults, scenario: str, output: Connection
) -> None:
    """Be the device, in a process of its own, from the word on until killed; faults count from it.

    Its address is told before.
    """
    followed = Followed(began, scenario)
    server = _server(kind, port, followed, faults)
    output.send(server.address)
    output.recv()
    followed.start = time.monotonic()
    first = iter([followed.start])
    server.serve(lambda: False, lambda: next(first, None) or time.monotonic())


@contextmanager
def emulator(
    kind: str,
    port: str,
    began: float,
    faults: EmulatorFaults | None = None,
    scenario: str = SCENARIO,
) -> Iterator[tuple[str, Callable[[], None]]]:
    """Run one; gives its address, and what lets it answer there."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    args = (kind, port, began, faults or EmulatorFaults(), scenario, theirs)
    process = context.Process(target=emulate, args=args, daemon=True)
    process.start()
    try:
        assert ours.poll(PATIENCE), "the emulator does not start"
        yield ours.recv(), lambda: ours.send(None)
    finally:
        process.terminate()
        process.join()


def start_beside(
    path: Path, began: float, seconds: float, *, page: bool = True
) -> "subprocess.Popen[str]":
    """Start `watch` in a process of its own."""
    words = [sys.executable, "-m", __name__, str(path), str(began), str(seconds), str(int(page))]
    return subprocess.Popen(words, stdout=subprocess.PIPE, text=True)


def watch(path: str, began: float, seconds: float, *, page: bool) -> None:
    """`verify run PATH --for … --json`, in a world that began at a given instant."""
    from verify.cli.options import PageOptions, ToleranceOptions
    from verify.cli.terminal import terminal
    from verify.cli.watch import RunOptions
    from verify.cli.watch import watch as run
    from verify.live.station.station import open_station

    terminal.as_json = True
    station = open_station(path, lambda s: SimulatedStation(s, _clock(began), apart=True))
    nothing = ToleranceOptions(None, None, None).tolerance(6)
    shown = PageOptions(0, "127.0.0.1", None) if page else None
    run(station, RunOptions(seconds, nothing, None, shown))


if __name__ == "__main__":
    watch(sys.argv[1], float(sys.argv[2]), float(sys.argv[3]), page=sys.argv[4] == "1")
