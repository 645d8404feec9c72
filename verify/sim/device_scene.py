"""The one scene that simulated cameras, encoders and bases share: world, clock, events, bases."""

import threading
from dataclasses import replace

import numpy as np

from verify.records import Array
from verify.sim.device_clock import SimClock
from verify.sim.device_motion import Endless
from verify.sim.scenario import Distractor, Scenario
from verify.sim.sessions import START, SimulatedSession
from verify.sim.world import World
from verify.station_sim import SimEvent

SPEED = np.deg2rad(20.0)  # rad/s, of a turning base
LIMIT = np.deg2rad(60.0)  # rad, to either side
LAMP_DN = 200.0  # as bright as an LED
LAMP_ASIDE = (60.0, 40.0, 0.0)  # mm, rig axes, from the middle of the LEDs' way


class Scene:
    """What all simulated devices look at.

    Args:
        session: the played scenario; its motion is made endless.
        clock: the cameras' clock.
        events: what happens when.
    """

    def __init__(
        self, session: SimulatedSession, clock: SimClock, events: tuple[SimEvent, ...]
    ) -> None:
        self.scenario: Scenario = session.scenario
        self.clock, self.renderers = clock, session.renderers
        begin, end = START, max(float(session.t[-1, 0]), START + 1.0)
        endless = Endless(session.world.motion, begin, end)
        self.world: World = replace(session.world, motion=endless)
        middle = self.world.led_points(np.linspace(begin, end, 50)).mean(axis=(0, 1)) * 1e3
        lamp = Distractor(position_mm=tuple(middle + LAMP_ASIDE), peak_dn=LAMP_DN)
        self._lit: World = replace(self.world, lamps=(*self.world.lamps, lamp))
        self._events = events
        self._names = [led.name for led in self.scenario.marker.led]
        self._departure = session.true_pan[0] - session.pan[0]  # rad, of truth from reading
        self._lock = threading.Lock()
        self._ways = [(-np.inf, session.pan[0], session.pan[0])]  # when, from, to

    def happen(self, event: SimEvent) -> None:
        """Let something happen that was not planned; its time counts from the start too."""
        self._events = (*self._events, event)

    def seconds(self, t: float) -> float:
        """Time of the world at an instant of the cameras' clock."""
        return t - self.clock.began + START

    def present(self, t: float | None = None) -> list[SimEvent]:
        """Events that are going on at an instant (now)."""
        elapsed = (self.clock.now() if t is None else t) - self.clock.began
        return [event for event in self._events if event.present(elapsed)]

    def joints(self, t: Array) -> Array:
        """True joint angles at instants of the cameras' clock: (n,) to (n, joints), rad."""
        return self.world.joints(t - self.clock.began + START)

    def world_at(self, seconds: float) -> World:
        """Give the world, with its lamp where that is on."""
        elapsed = seconds - START
        on = any(event.what == "lamp_on" and event.present(elapsed) for event in self._events)
        return self._lit if on else self.world

    def hidden(self, t: float, side: int) -> dict[int, float]:
        """Covered LEDs by index, and by what share."""
        covered: dict[int, float] = {}
        for event in self.present(t):
            if event.what == "leds_covered" and event.strikes(side):
                names = self._names if event.led is None else [event.led]
                covered |= {self._names.index(name): 1.0 for name in names}
        return covered

    def pan_reading(self, t: float) -> tuple[Array, bool]:
        """What the bases' encoders show at an instant, (2,) rad, and whether they move."""
        with self._lock:
            at, start, stop = next(way for way in reversed(self._ways) if way[0] <= t)
        way = stop - start
        gone = np.minimum(np.abs(way), SPEED * min(t - at, 1e3))  # 1e3 s: long since there
        angles: Array = start + np.sign(way) * gone
        return angles, bool(np.any(angles != stop))

    def pan(self, t: float) -> Array:
        """True angles of both bases, (2,), rad."""
        shown: Array = self.pan_reading(t)[0] + self._departure
        return shown

    def turn(self, wanted: Array) -> None:
        """Send both bases to angles (2,), rad, as read."""
        t = self.clock.now()
        here, _ = self.pan_reading(t)
        with self._lock:
            self._ways = [*self._ways[-8:], (t, here, wanted)]  # pictures look back a little
