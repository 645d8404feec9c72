"""Simulated encoders, read on the controller's own clock, and simulated turning bases."""

from math import ceil, floor

import numpy as np

from verify.core.records import Array
from verify.devices.protocols import DeviceState, EncoderReading, PanReading
from verify.simulation.devices.scene import MAX_PAN, DeviceScene
from verify.simulation.session.simulate import noisy_readings, quantised
from verify.simulation.world.motion import RandomStream, generator

TRANSFER_TIME = 0.001  # s, from the reading to its last byte in hand
LATCH_HALF_WIDTH = 50e-6  # s: as a board that latches all axes
READ_TIMEOUT = 0.02  # s, of the host's: the protocol's promise
TOL_PERIOD = 1e-6  # of a period: an instant that was waited for is there
RESET_TIME = 1.0  # s: what the controller's clock shows after a reset


class SimulatedEncoders:
    """Joint readings of the simulated arm."""

    def __init__(self, scene: DeviceScene, rate: float | None) -> None:
        self._scene, self._table = scene, scene.scenario.encoders
        self._rate = rate or self._table.rate_hz
        self._chance = generator(scene.scenario.seed, RandomStream.ENCODERS, 1)
        # number of the next reading: those before nobody has asked for
        self._next = ceil((scene.clock.now() - scene.clock.began) * self._rate)
        self._count = 0
        self._last: float | None = None
        self._closed = False

    def read(self) -> list[EncoderReading]:
        """Give what has come since the last call, oldest first; waits for at most 20 ms."""
        clock, period = self._scene.clock, 1.0 / self._rate
        clock.wait_until(clock.began + self._next * period + TRANSFER_TIME, READ_TIMEOUT)
        newest = floor((clock.now() - clock.began - TRANSFER_TIME) * self._rate + TOL_PERIOD)
        numbers = np.arange(self._next, newest + 1)
        self._next = max(self._next, newest + 1)
        if self._closed or not len(numbers):
            return []
        t = clock.began + numbers * period
        audible = np.array([not self._silent(instant) for instant in t.tolist()])
        return [self._reading(*row) for row in self._rows(t[audible])]

    def state(self) -> DeviceState:
        """Say how the encoders are."""
        now = self._scene.clock.now()
        age = None if self._last is None else now - self._last
        condition = "silent" if self._silent(now) else "reading"
        return DeviceState(
            not self._closed, age, self._count, 0, {}, f"simulated encoders: {condition}", True
        )

    def close(self) -> None:
        """Leave them alone."""
        self._closed = True

    def _rows(self, t: Array) -> list[tuple[float, Array]]:
        """Instants (cameras' clock) and what the encoders show, faults and noise included."""
        scene = self._scene
        seconds = np.array([scene.seconds(instant) for instant in t.tolist()])
        q = noisy_readings(scene.scenario, scene.world, seconds, self._chance)
        for row, instant in enumerate(t.tolist()):
            for event in scene.present(instant):
                if event.what == "encoder_jump" and event.joint is not None:
                    q[row, event.joint - 1] += np.deg2rad(event.degrees)
        return list(zip(t.tolist(), quantised(q, self._table.resolution_deg), strict=True))

    def _reading(self, t: float, q: Array) -> EncoderReading:
        stamp, segment = self._stamp(t)
        self._count, self._last = self._count + 1, t + TRANSFER_TIME
        return EncoderReading(stamp, t + TRANSFER_TIME, LATCH_HALF_WIDTH, segment, q)

    def _stamp(self, t: float) -> tuple[float, int]:
        """What the controller's clock shows, s, and how often it was reset."""
        began = self._scene.clock.began
        resets = self._scene.resets(t)
        drift = 1 - self._table.clock_drift_ppm * 1e-6
        if resets:
            return RESET_TIME + (t - max(resets)) * drift, len(resets)
        return began + (t - began) * drift - self._table.clock_offset_s, 0

    def _silent(self, t: float) -> bool:
        return any(event.what == "encoder_silent" for event in self._scene.present(t))


PAN_RATE = 50.0  # Hz


class SimulatedPan:
    """Both bases."""

    def __init__(self, scene: DeviceScene) -> None:
        self._scene = scene
        self._next = ceil((scene.clock.now() - scene.clock.began) * PAN_RATE)
        self._count = 0
        self._last: float | None = None
        self._refusal = ""
        self._closed = False

    def read(self) -> list[PanReading]:
        """Give what has come since the last call, oldest first; waits for at most 20 ms."""
        clock = self._scene.clock
        clock.wait_until(clock.began + self._next / PAN_RATE + TRANSFER_TIME, READ_TIMEOUT)
        newest = floor((clock.now() - clock.began - TRANSFER_TIME) * PAN_RATE + TOL_PERIOD)
        numbers, self._next = range(self._next, newest + 1), max(self._next, newest + 1)
        readings = []
        for t in (clock.began + number / PAN_RATE for number in numbers):
            if not (self._closed or self._gone(t)):
                angles, moving = self._scene.pan_reading(t)
                readings.append(
                    PanReading(t, t + TRANSFER_TIME, LATCH_HALF_WIDTH, 0, angles, moving)
                )
                self._count, self._last = self._count + 1, t + TRANSFER_TIME
        return readings

    def turn_to(self, left: float, right: float) -> bool:
        """Send both bases to angles, rad, as read; False if the line is down."""
        wanted = np.array([left, right])
        self._refusal = ""
        if self._closed or self._gone(self._scene.clock.now()):
            return False
        if not np.all(np.abs(wanted) <= MAX_PAN):
            self._refusal = "; refused: beyond the limit"
            return True
        self._scene.turn(wanted)
        return True

    def state(self) -> DeviceState:
        """Say how the bases are."""
        now = self._scene.clock.now()
        age = None if self._last is None else now - self._last
        gone = self._gone(now)
        condition = "not connected: they were unplugged" if gone else "reading"
        sentence = f"simulated bases: {condition}{self._refusal}"
        return DeviceState(not (gone or self._closed), age, self._count, 0, {}, sentence)

    def close(self) -> None:
        """Leave them alone."""
        self._closed = True

    def _gone(self, t: float) -> bool:
        return any(event.what == "pan_gone" for event in self._scene.present(t))
