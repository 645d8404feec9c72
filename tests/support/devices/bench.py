"""Steps a device as a control loop does: often, and never held up.

An emulated device on a real port, and the real driver reading it.
"""

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol, TypeVar

import numpy as np

from verify.core.records import Array
from verify.devices.encoders.intake import AngleMap
from verify.devices.ports import SerialLine
from verify.devices.protocols import DeviceState, EncoderReading
from verify.simulation.emulators.endpoints import Endpoint, open_front
from verify.simulation.emulators.server import EmulatorEngine, EmulatorFaults, EmulatorServer

PERIOD = 1 / 200  # s, quicker than a control loop: tests cannot wait
LONGEST_STEP = 0.5  # s: a step waits for nothing; the rest is a machine that does other things
USUAL_STEP = 0.01  # s
Status = TypeVar("Status", covariant=True)
S = TypeVar("S")


class Stepping(Protocol[Status]):
    def step(self) -> Status: ...


def stepped(device: Stepping[S], until: Callable[[S], bool], limit: float = 10.0) -> list[S]:
    """Step until satisfied; every step is quick."""
    end, seen, took = time.monotonic() + limit, [], []
    while True:
        begin = time.monotonic()
        seen.append(device.step())
        took.append(time.monotonic() - begin)
        assert took[-1] < LONGEST_STEP
        if until(seen[-1]):
            assert len(took) < 20 or np.median(took) < USUAL_STEP
            return seen
        assert time.monotonic() < end, seen[-1]
        time.sleep(PERIOD)


R = TypeVar("R", covariant=True)
LONGEST_READ = 0.5  # s: what is promised is 20 ms; the rest is a machine that does other things


class Device(Protocol[R]):
    def read(self) -> list[R]: ...
    def state(self) -> DeviceState: ...
    def close(self) -> None: ...


D = TypeVar("D", bound=Device[object])
opened: list[Device[object]] = []  # a fixture closes them after each test


def same_angles(joints: int) -> AngleMap:
    """Take the controller's angles as they are."""
    return AngleMap(np.ones(joints), np.zeros(joints))


def kept(device: D) -> D:
    """Have the device closed when the test is over."""
    opened.append(device)
    return device


class Emulated:
    """What a test sees of a running emulator."""

    def __init__(self, server: EmulatorServer) -> None:
        self.server = server
        self.start = float("nan")  # s, monotonic: the engine's time 0

    @property
    def address(self) -> str:
        return self.server.front.address

    def now(self) -> float:
        now = time.monotonic()
        if np.isnan(self.start):
            self.start = now
        return now


@contextmanager
def running(
    engine: EmulatorEngine,
    where: str | Endpoint = "tcp:0",
    faults: EmulatorFaults | None = None,
    baud: int | None = None,
) -> Iterator[Emulated]:
    front = open_front(where, SerialLine()) if isinstance(where, str) else where
    server = EmulatorServer(front, engine, faults, baud, seed=3)
    emulated, stop = Emulated(server), threading.Event()
    thread = threading.Thread(target=server.serve, args=(stop.is_set, emulated.now))
    thread.start()
    try:
        yield emulated
    finally:
        stop.set()
        thread.join()
        server.close()


@contextmanager
def emulate_command(*words: str) -> Iterator[str]:
    """Have `verify emulate` run until Ctrl-C, at the end of the block; yields its address."""
    command = "import typer; from verify.cli.emulate import emulate; typer.run(emulate)"
    start = [sys.executable, "-c", command, *words]
    with subprocess.Popen(start, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process.stdout.readline().split(" at ")[1].split(";")[0]
            process.send_signal(signal.SIGINT)
            process.wait(timeout=10)
        finally:  # a test that fails must not wait for it without end
            process.kill()


def gather(device: Device[R], until: Callable[[list[R]], bool], limit: float = 10.0) -> list[R]:
    """Read until satisfied; fails if that takes too long, or one call does."""
    readings: list[R] = []
    end = time.monotonic() + limit
    while not until(readings):
        begin = time.monotonic()
        assert begin < end, f"not within {limit} s: {device.state()}"
        readings += device.read()
        assert time.monotonic() - begin < LONGEST_READ
    return readings


def for_seconds(seconds: float) -> Callable[[list[R]], bool]:
    end = time.monotonic() + seconds
    return lambda _: time.monotonic() > end


class Ramp:
    """Each joint has an angle of its own that tells the time: 0.1 rad/s, joints 0.3 rad apart."""

    SPEED = 0.1

    def __init__(self, joints: int = 6) -> None:
        self._home = 0.3 * np.arange(joints) - 0.7

    def __call__(self, t: float) -> Array:
        return self._home + self.SPEED * t

    def time(self, q: Array) -> float:
        """When the joints stood so; all must agree, or the reading is false."""
        times = (q - self._home) / self.SPEED
        assert np.ptp(times) < 5e-3, times  # 0.01° is 1.7 ms
        return float(np.mean(times))


def require_one_clock(readings: list[EncoderReading], within: float) -> None:
    """Within a segment the readings' time is the ramp's but for a constant, and never too early."""
    for segment in {reading.segment for reading in readings}:
        mine = [reading for reading in readings if reading.segment == segment]
        t = np.array([reading.t for reading in mine])
        true = np.array([Ramp().time(reading.q) for reading in mine])
        assert np.all(np.diff(t) > 0)
        assert np.ptp(t - true) < within
