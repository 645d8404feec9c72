"""Simulated encoders, read on the controller's own clock, and simulated turning bases."""

from math import ceil, floor

import numpy as np

from verify.core.records import Array
from verify.devices.protocols import DeviceState, EncoderReading, PanReading
from verify.simulation.devices.scene import MAX_PAN, DeviceScene, SimClock
from verify.simulation.session.simulate import noisy_readings, quantised
from verify.simulation.world.motion import RandomStream, generator

TRANSFER_TIME = 0.001  # s, from the reading to its last byte in hand
LATCH_HALF_WIDTH = 50e-6  # s: as a board that latches all axes
READ_TIMEOUT = 0.02  # s, of the host's: the protocol's promise
TOL_PERIOD = 1e-6  # of a period: an instant that was waited for is there
RESET_TIME = 1.0  # s: what the controller's clock shows after a reset


class SimulatedReadings:
    """What simulated encoders and bases have in common: readings at a rate, Hz."""

    def __init__(self, clock: SimClock, rate: float) -> None:
        self._clock, self._rate = clock, rate
        # number of the next reading: those before nobody has asked for
        self._next = ceil((clock.now() - clock.began) * rate)
        self._last: float | None = None  # s, when the last one was in hand
        self._closed = False

    def close(self) -> None:
        """Leave them alone."""
        self._closed = True

    def _due(self) -> list[float]:
        """Instants since the last call, s; waits for at most 20 ms."""
        clock, period = self._clock, 1.0 / self._rate
        clock.wait_until(clock.began + self._next * period + TRANSFER_TIME, READ_TIMEOUT)
        newest = floor((clock.now() - clock.began - TRANSFER_TIME) * self._rate + TOL_PERIOD)
        numbers, self._next = range(self._next, newest + 1), max(self._next, newest + 1)
        return [] if self._closed else [clock.began + number * period for number in numbers]

    def _came(self, t: float) -> float:
        """When a reading of an instant, s, is in hand, s; it is the last one then."""
        self._last = t + TRANSFER_TIME
        return self._last

    def _state(self, sentence: str, *, there: bool = True, runs: bool | None = None) -> DeviceState:
        age = None if self._last is None else self._clock.now() - self._last
        connected = there and not self._closed
        return DeviceState(connected, age, 0, {}, sentence, runs)


class SimulatedEncoders(SimulatedReadings):
    """Joint readings of the simulated arm."""

    def __init__(self, scene: DeviceScene, rate: float | None) -> None:
        self._scene, self._table = scene, scene.scenario.encoders
        super().__init__(scene.clock, rate or self._table.rate_hz)
        self._chance = generator(scene.scenario.seed, RandomStream.ENCODERS, 1)

    def read(self) -> list[EncoderReading]:
        """Give what has come since the last call, oldest first; waits for at most 20 ms."""
        t = [t for t in self._due() if not self._scene.happens("encoder_silent", t)]
        return [self._reading(*row) for row in self._rows(np.array(t))] if t else []

    def state(self) -> DeviceState:
        """Say how the encoders are."""
        silent = self._scene.happens("encoder_silent", self._scene.clock.now())
        return self._state(f"simulated encoders: {'silent' if silent else 'reading'}", runs=True)

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
        """A reading with what the controller's clock shows, and how often that was reset."""
        began, resets = self._scene.clock.began, self._scene.resets(t)
        drift = 1 - self._table.clock_drift_ppm * 1e-6
        stamp = began + (t - began) * drift - self._table.clock_offset_s
        if resets:
            stamp = RESET_TIME + (t - max(resets)) * drift
        return EncoderReading(stamp, self._came(t), LATCH_HALF_WIDTH, len(resets), q)


PAN_RATE = 50.0  # Hz


class SimulatedPan(SimulatedReadings):
    """Both bases."""

    def __init__(self, scene: DeviceScene) -> None:
        super().__init__(scene.clock, PAN_RATE)
        self._scene, self._refusal = scene, ""

    def read(self) -> list[PanReading]:
        """Give what has come since the last call, oldest first; waits for at most 20 ms."""
        readings = []
        for t in self._due():
            if self._scene.happens("pan_gone", t):
                continue
            angles, moving = self._scene.pan_reading(t)
            readings.append(PanReading(t, self._came(t), LATCH_HALF_WIDTH, 0, angles, moving))
        return readings

    def turn_to(self, left: float, right: float) -> bool:
        """Send both bases to angles, rad, as read; False if the line is down."""
        wanted = np.array([left, right])
        self._refusal = ""
        if self._closed or self._scene.happens("pan_gone", self._scene.clock.now()):
            return False
        if not np.all(np.abs(wanted) <= MAX_PAN):
            self._refusal = "; refused: beyond the limit"
            return True
        self._scene.turn(wanted)
        return True

    def state(self) -> DeviceState:
        """Say how the bases are."""
        gone = self._scene.happens("pan_gone", self._scene.clock.now())
        condition = "not connected: they were unplugged" if gone else "reading"
        return self._state(f"simulated bases: {condition}{self._refusal}", there=not gone)
