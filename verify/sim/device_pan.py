"""Simulated turning bases: they read their angles, and go where they are sent."""

from math import ceil, floor

import numpy as np

from verify.devices import DeviceState, PanReading
from verify.sim.device_scene import LIMIT, Scene

RATE = 50.0  # Hz
TRANSFER = 0.001  # s
HALF_WIDTH = 50e-6  # s
WAIT = 0.02  # s, of the host's
ROUNDING = 1e-6  # of a period: an instant that was waited for is there


class SimulatedPan:
    """Both bases.

    Args:
        scene: where they stand, and the clock.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._next = ceil((scene.clock.now() - scene.clock.began) * RATE)
        self._count = 0
        self._last: float | None = None
        self._refusal = ""
        self._closed = False

    def read(self) -> list[PanReading]:
        """Give what has come since the last call, oldest first; waits for at most 20 ms."""
        clock = self._scene.clock
        clock.wait_until(clock.began + self._next / RATE + TRANSFER, WAIT)
        newest = floor((clock.now() - clock.began - TRANSFER) * RATE + ROUNDING)
        numbers, self._next = range(self._next, newest + 1), max(self._next, newest + 1)
        readings = []
        for t in (clock.began + number / RATE for number in numbers):
            if not (self._closed or self._gone(t)):
                angles, moving = self._scene.pan_reading(t)
                readings.append(PanReading(t, t + TRANSFER, HALF_WIDTH, 0, angles, moving))
                self._count, self._last = self._count + 1, t + TRANSFER
        return readings

    def turn_to(self, left: float, right: float) -> bool:
        """Send both bases to angles, rad, as read; False if the line is down."""
        wanted = np.array([left, right])
        self._refusal = ""
        if self._closed or self._gone(self._scene.clock.now()):
            return False
        if not np.all(np.abs(wanted) <= LIMIT):
            self._refusal = "; refused: beyond the limit"
            return True
        self._scene.turn(wanted)
        return True

    def state(self) -> DeviceState:
        """Say how the bases are."""
        now = self._scene.clock.now()
        age = None if self._last is None else now - self._last
        gone = self._gone(now)
        said = "not connected: they were unplugged" if gone else "reading"
        sentence = f"simulated bases: {said}{self._refusal}"
        return DeviceState(not (gone or self._closed), age, self._count, 0, {}, sentence)

    def close(self) -> None:
        """Leave them alone."""
        self._closed = True

    def _gone(self, t: float) -> bool:
        return any(event.what == "pan_gone" for event in self._scene.present(t))
