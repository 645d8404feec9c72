"""What of the world shines into one camera during one exposure, in pixels."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from verify.records import Array
from verify.sim.bench import SimulatedCamera
from verify.sim.scenario import Colour, Occlusion
from verify.sim.world import World

STEP_PX = 0.5  # between the instants that make up a motion blur: below the lens blur, so none shows
SIDES = ("left", "right")


@dataclass(frozen=True, slots=True)
class Light:
    """One glowing disc as one camera sees it."""

    path: Array  # (k, 2), px, where its centre was at k instants spread over the exposure
    disc: Array  # (2, 2), px: carries the unit circle to the disc's rim
    peak: float  # DN of its face, before blur
    colour: Colour
    hidden: float = 0.0  # share of its width that something covers, from the left


def spots(world: World, side: int, t: float, pan: float) -> Array:
    """Image of every LED's centre, (leds, 2), px; NaN where it faces away or leaves the picture.

    Args:
        world: what is looked at.
        side: 0 left, 1 right.
        t: s, cameras' clock, mid-exposure of the middle row.
        pan: rad, the base's true angle.
    """
    camera, n = world.bench.cameras[side], len(world.leds)
    centres = camera.project(world.sources(_instants(world, camera, t, pan))[:n, 0], pan)
    lit = world.brightness(camera.rig_T_camera(pan)[:3, 3], t)[:n] > 0
    limit = np.array(camera.image_size) - 1
    inside = np.all((centres >= 0) & (centres <= limit), axis=1)  # NaN compares as outside
    centres[~(lit & inside)] = np.nan
    return centres


def lights(
    world: World, side: int, t: float, pan: float, hidden: dict[int, float] | None = None
) -> list[Light]:
    """Everything that shines into one exposure; arguments as in `spots`.

    `hidden` gives the covered share of LEDs by their index; reflections and lamps stay.
    """
    camera = world.bench.cameras[side]
    instants = _instants(world, camera, t, pan)
    eye = camera.rig_T_camera(pan)[:3, 3]
    discs = _discs(camera, pan, world.sources(instants)[:, 0], world.radii)
    peaks, colours = world.brightness(eye, t), world.colours
    paths = _paths(world, camera, pan, instants)
    covered = hidden or {}
    in_field = np.all(np.isfinite(paths), axis=(1, 2)) & np.all(np.isfinite(discs), axis=(1, 2))
    return [
        Light(paths[i], discs[i], float(peaks[i]), colours[i], covered.get(i, 0.0))
        for i in range(len(peaks))
        if peaks[i] > 0 and in_field[i] and covered.get(i, 0.0) < 1
    ]


def hidden_leds(
    occlusions: Sequence[Occlusion], names: Sequence[str], side: int, frame: int
) -> dict[int, float]:
    """Say which LEDs (by index) are covered in one frame of one camera, and by what share."""
    return {
        names.index(o.led): o.share
        for o in occlusions
        if o.first <= frame <= o.last and o.camera in ("both", SIDES[side])
    }


def _instants(world: World, camera: SimulatedCamera, t: float, pan: float) -> Array:
    """Mid-exposure of each shining thing's own row, (things, 1), s.

    Rows pass in microseconds, so the row of the last round settles within three; the rows'
    differences within one spot shear it a little and leave its centre where it is.
    """
    instants = np.full((len(world.colours), 1), t)
    for _ in range(3 if camera.line_time else 0):
        rows = camera.project(world.sources(instants)[:, 0], pan)[:, 1]
        delay = camera.line_time * (rows - (camera.image_size[1] - 1) / 2)
        instants = t + np.nan_to_num(delay)[:, None]
    return instants


def _discs(camera: SimulatedCamera, pan: float, points: Array, radii: Array) -> Array:
    """Carry the unit circle to the rims of discs that face the camera: (things, 2, 2), px.

    First order only; what a disc of 5 mm at half a metre adds at second is below 0.003 px.
    """
    toward = camera.rig_T_camera(pan)[:3, 3] - points
    toward = toward / np.linalg.norm(toward, axis=1, keepdims=True)
    aside = np.cross(toward, [0.0, 1.0, 0.0])  # no light stands straight above a level camera
    aside = aside / np.linalg.norm(aside, axis=1, keepdims=True)
    axes = np.stack([aside, np.cross(toward, aside)], axis=1) * radii[:, None, None]
    forth = camera.project(points[:, None] + axes, pan)
    back = camera.project(points[:, None] - axes, pan)
    return np.swapaxes(forth - back, 1, 2) / 2


def _paths(world: World, camera: SimulatedCamera, pan: float, instants: Array) -> Array:
    """Where each thing was during the exposure, (things, k, 2), px, evenly spread in time."""
    if camera.exposure == 0:
        return camera.project(world.sources(instants), pan)
    ends = camera.project(world.sources(instants + camera.exposure * np.array([-0.5, 0.5])), pan)
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    longest = np.max(lengths[np.isfinite(lengths)], initial=0.0)
    steps = int(np.ceil(longest / STEP_PX)) + 1
    shares = (np.arange(steps) + 0.5) / steps - 0.5
    return camera.project(world.sources(instants + camera.exposure * shares), pan)
