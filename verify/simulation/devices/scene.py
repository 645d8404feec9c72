"""The scene that simulated cameras, encoders and bases share: world, clock, events, bases."""

import threading
import time
from collections.abc import Callable

import numpy as np

from verify.core.records import Array
from verify.live.station.keys import SimEvent
from verify.simulation.devices.painting import LocalPainter
from verify.simulation.scenario import Scenario
from verify.simulation.session.simulate import START_OFFSET, SimulatedSession
from verify.simulation.world.motion import move_towards
from verify.simulation.world.world import SimulatedWorld


class SimClock:
    """Runs `speed` times as fast as the host's monotonic clock, and agrees with it at the start."""

    def __init__(
        self,
        speed: float = 1.0,
        now: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._speed, self._now, self._sleep = speed, now, sleep
        self.began = now()

    def now(self) -> float:
        """The simulated instant, s."""
        return self.began + (self._now() - self.began) * self._speed

    def wait_until(self, t: float, limit: float) -> bool:
        """Wait for a simulated instant, for at most `limit` s of the host's; whether it is there.

        The limit is the host's time because it is the caller's patience.
        """
        rest = (t - self.now()) / self._speed
        if rest > 0:
            self._sleep(min(rest, limit))
        return rest <= limit


PAN_SPEED = np.deg2rad(20.0)  # rad/s, of a turning base
MAX_PAN = np.deg2rad(60.0)  # rad, to either side


class DeviceScene:
    """What all simulated devices look at."""

    def __init__(
        self,
        session: SimulatedSession,
        painter: LocalPainter,
        clock: SimClock,
        events: tuple[SimEvent, ...],
    ) -> None:
        self.scenario: Scenario = session.scenario
        self.clock, self.painter = clock, painter
        self.world: SimulatedWorld = painter.worlds[0]
        self._events = events
        self._opened: float | None = None  # s, cameras' clock: when the first device was
        self._names = [led.name for led in self.scenario.marker.led]
        self._departure = session.true_pan[0] - session.pan[0]  # rad, of truth from reading
        self._lock = threading.Lock()
        self._ways = [(-np.inf, session.pan[0], session.pan[0])]  # when, from, to

    def open(self) -> None:
        """Note that a device is opened: from the first one on, the events' times count."""
        if self._opened is None:
            self._opened = self.clock.now()

    def seconds(self, t: float) -> float:
        """Time of the world at an instant of the cameras' clock."""
        return t - self.clock.began + START_OFFSET

    def present(self, t: float | None = None) -> list[SimEvent]:
        """Events that are going on at an instant (now)."""
        elapsed = (self.clock.now() if t is None else t) - self._events_from
        return [event for event in self._events if event.present(elapsed)]

    def resets(self, t: float) -> list[float]:
        """When the controller had started anew by an instant, on the cameras' clock, s."""
        resets = [event.at for event in self.present(t) if event.what == "encoder_reset"]
        return [self._events_from + at for at in resets]

    @property
    def _events_from(self) -> float:
        return self.clock.began if self._opened is None else self._opened

    def happens(self, what: str, t: float) -> bool:
        """Whether an event of a kind is going on at an instant."""
        return any(event.what == what for event in self.present(t))

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
        angles = move_towards(start, stop, PAN_SPEED * (t - at))
        return angles, bool(np.any(angles != stop))

    def pan(self, t: float) -> Array:
        """True angles of both bases, (2,), rad."""
        return np.asarray(self.pan_reading(t)[0] + self._departure)

    def turn(self, wanted: Array) -> None:
        """Send both bases to angles (2,), rad, as read."""
        t = self.clock.now()
        here, _ = self.pan_reading(t)
        with self._lock:
            self._ways = [*self._ways[-8:], (t, here, wanted)]  # pictures look back a little
