"""What stands and happens in the simulated cell, as data; lengths in m, base frame, times in s."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from verify.core.records import Array

COLOURS = {  # BGR
    "blue": (190, 90, 25),
    "green": (60, 165, 50),
    "red": (40, 40, 200),
    "yellow": (30, 200, 220),
}
# camera_gone: no more pairs come; alarm: the controller stops the arm; taken: somebody takes the
# target away; hidden: a board stands before it; dusk: the light drops by half within a second
EventKind = Literal["camera_gone", "alarm", "taken", "hidden", "dusk"]
DUSK_TIME = 1.0  # s


@dataclass(frozen=True, slots=True)
class Cap:
    """A bottle cap that stands on the table; it may slide, come to rest, and slide back."""

    colour: str  # of COLOURS
    start: tuple[float, float]  # m, x and y of its middle at first
    velocity: tuple[float, float] = (0.0, 0.0)  # m/s, at first
    slides: float = 0.0  # s until it stands, slowing down evenly
    away: float = np.inf  # s that it stands there before it comes back the way it went
    radius: float = 0.015  # m
    height: float = 0.024  # m

    def place(self, t: float) -> Array:
        """Where its middle is, (3,), m; the table's top is at z = 0."""
        way = self._way(t) - self._way(t - self.slides - self.away)
        x, y = np.array(self.start) + np.array(self.velocity) * way
        return np.array([x, y, self.height / 2])

    def _way(self, t: float) -> float:
        """How far it has gone one way, s at its first speed."""
        going = min(max(t, 0.0), self.slides)
        return going - going**2 / (2 * self.slides) if self.slides > 0 else 0.0


@dataclass(frozen=True, slots=True)
class SceneEvent:
    """Something that happens once: at a time, or when the hand first comes near to the target."""

    what: EventKind
    at: float = 0.0  # s after the start
    near: float | None = None  # m between grip point and target; then `at` does not count
    lasts: float = np.inf  # s


@dataclass(frozen=True, slots=True)
class PanTurn:
    """Both camera bases turn by an angle, evenly."""

    at: float  # s
    by: float  # rad
    lasts: float  # s

    def gone(self, t: float) -> float:
        """By how much they have turned at t, s; rad."""
        return self.by * float(np.clip((t - self.at) / self.lasts, 0.0, 1.0))


@dataclass(frozen=True, slots=True)
class CellScene:
    """A run's cell; its first cap is the target."""

    caps: tuple[Cap, ...]
    happenings: tuple[SceneEvent, ...] = ()
    light: float = 1.0  # share of the usual light
    noise: float = 2.0  # DN, standard deviation of a pixel
    hand_error: float = 0.3e-3  # m, standard, a coordinate: the arm is not where it was registered
    joint_errors: tuple[float, ...] = ()  # rad, true less told by the encoders; none: all 0
    encoder_noise: float = 2e-5  # rad, standard
    turns: tuple[PanTurn, ...] = ()  # of the bases; for a cell_setup that says they do
    delay: float = 0.03  # s, from an order to the arm's being there
    seed: int = 0


def draw_scene(seed: int, colour: str = "blue") -> CellScene:
    """Draw a cell: where the target stands or slides to, other caps, the light."""
    rng = np.random.default_rng(seed)
    slides = float(rng.uniform(0.5, 2.5)) if rng.random() < 0.5 else 0.0
    turn, speed = rng.uniform(0, 2 * np.pi), rng.uniform(0.02, 0.08)
    velocity = (float(speed * np.cos(turn)), float(speed * np.sin(turn)))
    goal = rng.uniform((0.43, -0.16), (0.53, 0.16))
    start = goal - np.array(velocity) * slides / 2
    caps = [Cap(colour, (float(start[0]), float(start[1])), velocity, slides)]
    others = [name for name in COLOURS if name != colour]
    for _ in range(int(rng.integers(0, 4))):
        place = _free_place(rng, [*(cap.place(np.inf)[:2] for cap in caps), start])
        if place is not None:
            name = others[int(rng.integers(len(others)))]
            caps.append(Cap(name, (float(place[0]), float(place[1]))))
    light = float(rng.uniform(0.6, 1.15))
    dusk = SceneEvent("dusk", float(rng.uniform(1, 6)))
    happenings = (dusk,) if rng.random() < 0.25 else ()
    return CellScene(tuple(caps), happenings, light, float(rng.uniform(1, 3)), seed=seed)


def add_pan_turns(scene: CellScene) -> CellScene:
    """Let the camera bases turn while the target is followed, and again while the hand is down."""
    turns = (PanTurn(1.0, np.deg2rad(3.0), 0.25), PanTurn(3.6, np.deg2rad(-5.0), 0.2))
    return replace(scene, turns=turns)


def _free_place(rng: np.random.Generator, taken: list[Array]) -> Array | None:
    """A place with room for fingers about what stands there already; None where none was drawn."""
    for _ in range(20):
        place = rng.uniform((0.34, -0.22), (0.56, 0.22))
        if min(float(np.linalg.norm(place - other)) for other in taken) > 0.09:
            return place
    return None
