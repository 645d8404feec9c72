"""Simulated encoders: the same world, read on the controller's own clock."""

from math import ceil, floor

import numpy as np

from verify.devices import DeviceState, EncoderReading
from verify.records import Array
from verify.sim.chance import Stream, generator
from verify.sim.device_scene import Scene
from verify.sim.faults import reading_error

TRANSFER = 0.001  # s, from the reading to its last byte in hand
HALF_WIDTH = 50e-6  # s: as a board that latches all axes
WAIT = 0.02  # s, of the host's: the protocol's promise
ROUNDING = 1e-6  # of a period: an instant that was waited for is there
RESET_TO = 1.0  # s: what the controller's clock shows after a reset


class SimulatedEncoders:
    """Joint readings of the simulated arm.

    Args:
        scene: the arm, and the clock.
        rate: Hz; None for the scenario's own.
    """

    def __init__(self, scene: Scene, rate: float | None) -> None:
        self._scene, self._table = scene, scene.scenario.encoders
        self._rate = rate or self._table.rate_hz
        self._chance = generator(scene.scenario.seed, Stream.ENCODERS, 1)
        # number of the next reading: those before nobody has asked for
        self._next = ceil((scene.clock.now() - scene.clock.began) * self._rate)
        self._count = 0
        self._last: float | None = None
        self._closed = False

    def read(self) -> list[EncoderReading]:
        """Give what has come since the last call, oldest first; waits for at most 20 ms."""
        clock, period = self._scene.clock, 1.0 / self._rate
        clock.wait_until(clock.began + self._next * period + TRANSFER, WAIT)
        now = clock.now()
        newest = floor((now - clock.began - TRANSFER) * self._rate + ROUNDING)
        numbers = np.arange(self._next, newest + 1)
        self._next = max(self._next, newest + 1)
        if self._closed or not len(numbers):
            return []
        t = clock.began + numbers * period
        heard = np.array([not self._silent(instant) for instant in t.tolist()])
        return [self._reading(*row) for row in self._rows(t[heard])]

    def state(self) -> DeviceState:
        """Say how the encoders are."""
        now = self._scene.clock.now()
        age = None if self._last is None else now - self._last
        said = "silent" if self._silent(now) else "reading"
        return DeviceState(
            not self._closed, age, self._count, 0, {}, f"simulated encoders: {said}", True
        )

    def close(self) -> None:
        """Leave them alone."""
        self._closed = True

    def _rows(self, t: Array) -> list[tuple[float, Array]]:
        """Instants (cameras' clock) and what the encoders show, faults and noise included."""
        scene, table = self._scene, self._table
        seconds = np.array([scene.seconds(instant) for instant in t.tolist()])
        q = scene.world.joints(seconds)
        q = q + reading_error(q, scene.world.motion.direction(seconds), scene.scenario.fault)
        q = q + np.radians(table.noise_deg) * self._chance.standard_normal(q.shape)
        for row, instant in enumerate(t.tolist()):
            for event in scene.present(instant):
                if event.what == "encoder_jump" and event.joint is not None:
                    q[row, event.joint - 1] += event.angle
        if table.resolution_deg > 0:
            step = np.radians(table.resolution_deg)
            q = np.round(q / step) * step
        return list(zip(t.tolist(), q, strict=True))

    def _reading(self, t: float, q: Array) -> EncoderReading:
        stamp, segment = self._stamp(t)
        self._count, self._last = self._count + 1, t + TRANSFER
        return EncoderReading(stamp, t + TRANSFER, HALF_WIDTH, segment, q)

    def _stamp(self, t: float) -> tuple[float, int]:
        """What the controller's clock shows, s, and how often it was reset."""
        began = self._scene.clock.began
        resets = self._scene.resets(t)
        drift = 1 - self._table.clock_drift_ppm * 1e-6
        if resets:
            return RESET_TO + (t - max(resets)) * drift, len(resets)
        return began + (t - began) * drift - self._table.clock_offset_s, 0

    def _silent(self, t: float) -> bool:
        return any(event.what == "encoder_silent" for event in self._scene.present(t))
