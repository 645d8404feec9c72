"""What a simulated camera sees: painted here, or elsewhere so that a run's threads need not wait.

Threads of one Python process take turns. Painting in them would hold up a measurement that real
cameras, whatever they do inside, do not.

A scenario's motion without end: to its last instant, back to its first, and so on.
"""

import threading
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import ClassVar

import numpy as np

from verify.core import processes
from verify.core.records import Array, Image
from verify.simulation import library
from verify.simulation.scenario import BoardScenario, Distractor
from verify.simulation.session.simulate import START_OFFSET, SimulatedSession, simulate_session
from verify.simulation.world.led_render import Renderer, visible_lights
from verify.simulation.world.motion import MotionProfile, direction_sign
from verify.simulation.world.world import SimulatedWorld


@dataclass(frozen=True, slots=True)
class PeriodicMotion:
    """Goes to and fro through a motion that was planned for a stretch of time.

    The way there and back is a cosine: no joint's speed leaps where the motion turns round, and
    nowhere is it more than π/2 times the planned one.
    """

    motion: MotionProfile
    begin: float  # s, of the stretch
    end: float  # s

    def angles(self, t: Array) -> Array:
        """True joint angles, rad: (...,) to (..., joints)."""
        return self.motion.angles(self._place(t))

    def direction(self, t: Array) -> Array:
        """Last direction of travel, +1 or -1: (...,) to (..., joints)."""
        way = direction_sign(np.sin(self._phase(t)))[..., None]
        return way * self.motion.direction(self._place(t))

    def _phase(self, t: Array) -> Array:
        return np.pi * (np.asarray(t) - self.begin) / (self.end - self.begin)

    def _place(self, t: Array) -> Array:
        half = (self.end - self.begin) / 2
        return self.begin + half * (1 - np.cos(self._phase(t)))


LAMP_DN = 200.0  # as bright as an LED
LAMP_OFFSET_MM = (60.0, 40.0, 0.0)  # mm, rig axes, from the middle of the LEDs' way
# s for a picture painted elsewhere, then it is painted here: less than a camera may be silent for
ANSWER_TIMEOUT = 0.3
LATE_NOTE = "painted by the main process while the other one is late"


@dataclass(frozen=True, slots=True)
class RenderRequest:
    """One picture that is to be taken."""

    side: int  # 0 left, 1 right
    seconds: float  # the world's time, middle of the exposure
    pan: float  # rad, true
    lit: bool  # a lamp is on
    hidden: dict[int, float]  # covered LEDs by index, and by what share
    number: int  # chooses the noise


PaintRequest = tuple[RenderRequest, str, tuple[int, ...]]  # where to: shared memory and shape


@dataclass(frozen=True, slots=True)
class LocalPainter:
    """Paints in the caller's thread."""

    worlds: tuple[SimulatedWorld, SimulatedWorld]  # as it is, and with a lamp on
    renderers: tuple[Renderer, Renderer]
    trouble: ClassVar[str] = ""  # what is wrong with how it paints

    def paint(self, sight: RenderRequest) -> Image:
        """Give the picture, (h, w) grey or (h, w, 3) BGR; the same sight is always the same."""
        world, side = self.worlds[sight.lit], sight.side
        lights = visible_lights(world, side, sight.seconds, sight.pan, sight.hidden)
        turned_px = sight.pan * world.bench.cameras[side].matrix[0, 0]
        return self.renderers[side].render(lights, sight.number, turned_px)

    def close(self) -> None:
        """There is nothing to let go of."""


def build_painter(session: SimulatedSession) -> LocalPainter:
    """Paint a scenario's world, its motion made endless."""
    begin, end = START_OFFSET, max(float(session.t[-1, 0]), START_OFFSET + 1.0)
    endless = PeriodicMotion(session.world.motion, begin, end)
    world: SimulatedWorld = replace(session.world, motion=endless)
    middle = world.led_points(np.linspace(begin, end, 50)).mean(axis=(0, 1)) * 1e3
    lamp = Distractor(position_mm=tuple(middle + LAMP_OFFSET_MM), peak_dn=LAMP_DN)
    lit: SimulatedWorld = replace(world, lamps=(*world.lamps, lamp))
    return LocalPainter((world, lit), session.renderers)


class RemotePainter:
    """Paints in another process, and here until that is ready, while it is late or once it is lost.

    It is late with a picture that takes longer than the timeout, s.
    """

    def __init__(self, scenario: str, near: LocalPainter, timeout: float = ANSWER_TIMEOUT) -> None:
        self._near, self._timeout = near, timeout
        self._process: processes.ChildProcess[PaintRequest, None] | None = processes.ChildProcess(
            processes.answer_requests,
            partial(_paint_remote, scenario),
            partial(_remote_painter, scenario),
            name="simulated cameras",
            background=True,
        )
        self._rooms = (processes.SharedPicture(), processes.SharedPicture())
        self._lock, self._closed = threading.Lock(), 0
        self.trouble = ""

    def paint(self, sight: RenderRequest) -> Image:
        """Give the picture; the same as the one painted here."""
        process, room = self._process, self._rooms[sight.side]
        try:
            if process is not None and process.is_ready():
                name, shape = room.room(self._near.renderers[sight.side].shape)
                process.ask((sight, name, shape), self._timeout)
                self.trouble = ""
                return room.copy(shape)
        except processes.ChildLateError:
            self.trouble = LATE_NOTE
        except processes.ChildLostError as error:
            self.trouble = f"painted by the main process from now on: {error}"
            self._end()
        return self._near.paint(sight)

    def close(self) -> None:
        """End the process, once both cameras are closed."""
        with self._lock:
            self._closed += 1
            last = self._closed == len(self._rooms)
        if last:
            self._end()
            for room in self._rooms:
                room.close()

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.stop()


Painter = LocalPainter | RemotePainter


@lru_cache(maxsize=1)
def _remote_painter(scenario: str) -> LocalPainter:
    """The other process's own painter."""
    loaded = library.load(scenario)
    assert not isinstance(loaded, BoardScenario)  # the station would have refused it
    return build_painter(simulate_session(loaded))


def _paint_remote(scenario: str, request: PaintRequest) -> None:
    sight, name, shape = request
    processes.picture_at(name, shape)[...] = _remote_painter(scenario).paint(sight)
