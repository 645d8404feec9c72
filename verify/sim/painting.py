"""What a simulated camera sees: painted here, or elsewhere so that a run's threads need not wait.

Threads of one Python process take turns. Painting in them would hold up a measurement that real
cameras, whatever they do inside, do not.
"""

import threading
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Protocol

import numpy as np

from verify.helper import Helper, HelperLateError, HelperLostError
from verify.records import Image
from verify.shared_picture import SharedPicture, picture_of
from verify.sim import library
from verify.sim.board_scenario import BoardScenario
from verify.sim.device_motion import Endless
from verify.sim.lights import lights
from verify.sim.render import Renderer
from verify.sim.scenario import Distractor
from verify.sim.sessions import START, SimulatedSession, simulate
from verify.sim.world import World

LAMP_DN = 200.0  # as bright as an LED
LAMP_ASIDE = (60.0, 40.0, 0.0)  # mm, rig axes, from the middle of the LEDs' way
# s for a picture painted elsewhere, then it is painted here: less than a camera may be silent for
PATIENCE = 0.3
LATE = "painted by the main process while the other one is late"


@dataclass(frozen=True, slots=True)
class Sight:
    """One picture that is to be taken."""

    side: int  # 0 left, 1 right
    seconds: float  # the world's time, middle of the exposure
    pan: float  # rad, true
    lit: bool  # a lamp is on
    hidden: dict[int, float]  # covered LEDs by index, and by what share
    number: int  # chooses the noise


class Painter(Protocol):
    """Paints what a camera sees."""

    @property
    def trouble(self) -> str:
        """What is wrong with how it does; empty: nothing."""

    def paint(self, sight: Sight) -> Image:
        """Give the picture, (h, w) grey or (h, w, 3) BGR."""

    def close(self) -> None:
        """Let go of what it needs."""


@dataclass(frozen=True, slots=True)
class NearPainter:
    """Paints in the caller's thread."""

    worlds: tuple[World, World]  # as it is, and with a lamp on
    renderers: tuple[Renderer, Renderer]

    @property
    def trouble(self) -> str:
        """Nothing can be."""
        return ""

    def paint(self, sight: Sight) -> Image:
        """Give the picture; the same sight comes out the same every time."""
        world, side = self.worlds[sight.lit], sight.side
        seen = lights(world, side, sight.seconds, sight.pan, sight.hidden)
        turned_px = sight.pan * world.bench.cameras[side].matrix[0, 0]
        return self.renderers[side].render(seen, sight.number, turned_px)

    def close(self) -> None:
        """There is nothing to let go of."""


def near_painter(session: SimulatedSession) -> NearPainter:
    """Paint a scenario's world, its motion made endless."""
    begin, end = START, max(float(session.t[-1, 0]), START + 1.0)
    endless = Endless(session.world.motion, begin, end)
    world: World = replace(session.world, motion=endless)
    middle = world.led_points(np.linspace(begin, end, 50)).mean(axis=(0, 1)) * 1e3
    lamp = Distractor(position_mm=tuple(middle + LAMP_ASIDE), peak_dn=LAMP_DN)
    lit: World = replace(world, lamps=(*world.lamps, lamp))
    return NearPainter((world, lit), session.renderers)


class DistantPainter:
    """Paints in another process, and here until that is ready, while it is late or once it is lost.

    Args:
        scenario: as the station names it.
        near: paints the same here.
        patience: s for a picture.
    """

    def __init__(self, scenario: str, near: NearPainter, patience: float = PATIENCE) -> None:
        self._near, self._patience = near, patience
        self._helper: Helper[tuple[Sight, str, tuple[int, ...]], None] | None = Helper(
            partial(_paint_there, scenario), "simulated cameras",
            aside=True, prepare=partial(_there, scenario),
        )  # fmt: skip
        self._rooms = (SharedPicture(), SharedPicture())
        self._lock, self._closed = threading.Lock(), 0
        self.trouble = ""

    def paint(self, sight: Sight) -> Image:
        """Give the picture; the same as the one painted here."""
        helper, room = self._helper, self._rooms[sight.side]
        try:
            if helper is not None and helper.is_ready():
                name, shape = room.room(self._near.renderers[sight.side].shape)
                helper.ask((sight, name, shape), self._patience)
                self.trouble = ""
                return room.copy(shape)
        except HelperLateError:
            self.trouble = LATE
        except HelperLostError as error:
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
        helper, self._helper = self._helper, None
        if helper is not None:
            helper.close()


@lru_cache(maxsize=1)
def _there(scenario: str) -> NearPainter:
    """The other process's own painter."""
    loaded = library.load(scenario)
    assert not isinstance(loaded, BoardScenario)  # the station would have refused it
    return near_painter(simulate(loaded))


def _paint_there(scenario: str, question: tuple[Sight, str, tuple[int, ...]]) -> None:
    sight, name, shape = question
    picture_of(name, shape)[...] = _there(scenario).paint(sight)
