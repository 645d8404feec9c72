"""Render the LEDs in view of a camera: exposure, lens blur, sensor noise, black level, 8 bits."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from verify.core.records import SIDES, Array, Image
from verify.simulation.scenario import Colour, Occlusion, ScenarioImage
from verify.simulation.world.bench import SimulatedCamera
from verify.simulation.world.motion import RandomStream, generator
from verify.simulation.world.world import SimulatedWorld

# between the instants that make up a motion blur: below the lens blur, so none shows
BLUR_STEP_PX = 0.5


@dataclass(frozen=True, slots=True)
class Light:
    """One glowing disc as one camera sees it."""

    path: Array  # (k, 2), px, where its centre was at k instants spread over the exposure
    disc: Array  # (2, 2), px: carries the unit circle to the disc's rim
    peak: float  # DN of its face, before blur
    colour: Colour
    hidden: float = 0.0  # share of its width that something covers, from the left


def visible_lights(
    world: SimulatedWorld, side: int, t: float, pan: float, hidden: dict[int, float] | None = None
) -> list[Light]:
    """Everything that shines into one exposure of the left (0) or right (1) camera.

    It is at t, s, cameras' clock, mid-exposure of the middle row; pan, rad, is the base's true
    angle. `hidden` gives the covered share of LEDs by their index; reflections and lamps stay.
    """
    camera = world.bench.cameras[side]
    instants = mid_exposures(world, camera, t, pan)
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


def mid_exposures(world: SimulatedWorld, camera: SimulatedCamera, t: float, pan: float) -> Array:
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
    return np.swapaxes(forth - camera.project(points[:, None] - axes, pan), 1, 2) / 2


def _paths(world: SimulatedWorld, camera: SimulatedCamera, pan: float, instants: Array) -> Array:
    """Where each thing was during the exposure, (things, k, 2), px, evenly spread in time."""
    if camera.exposure == 0:
        return camera.project(world.sources(instants), pan)
    ends = camera.project(world.sources(instants + camera.exposure * np.array([-0.5, 0.5])), pan)
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    longest = np.max(lengths[np.isfinite(lengths)], initial=0.0)
    steps = int(np.ceil(longest / BLUR_STEP_PX)) + 1
    shares = (np.arange(steps) + 0.5) / steps - 0.5
    return camera.project(world.sources(instants + camera.exposure * shares), pan)


Picture = NDArray[np.float32]
Glow = tuple[tuple[slice, slice], Picture]

GRAINS_PER_PX = 5  # grains a pixel, with soft rims: widths right to 1 %, as the tests confirm
# standard deviations of blur that a patch keeps: 4e-6 of the rim's light beyond
MAX_BLUR_SIGMAS = 5.0
# share of room pixels at 0 above which the others are drawn alone: far faster
MIN_BLACK_SHARE = 0.99
MAX_LEVELS = 16  # of a sparse room: the next would be some 10 standard deviations of its noise away
PATTERN_SCALE_PX = 24  # scale of the room's pattern: far wider than any spot
BGR: dict[Colour, tuple[float, float, float]] = {  # what a colour sensor makes of each LED
    "white": (1.0, 1.0, 1.0),
    "red": (0.05, 0.12, 1.0),
    "green": (0.15, 1.0, 0.10),
    "blue": (1.0, 0.18, 0.04),
    "infrared": (0.80, 0.75, 0.85),
}


@dataclass(frozen=True)
class Renderer:
    """One camera's lens, sensor and room.

    A pixel is round(clip(s + noise + black level)) with s its light and noise of variance
    read² + s / (electrons per DN); to the 8 bits, quantisation adds its 1/12 DN².
    """

    table: ScenarioImage
    image_size: tuple[int, int]  # width, height
    seed: int
    side: int  # 0 left, 1 right

    @property
    def shape(self) -> tuple[int, ...]:
        """Of a picture: (h, w) or, in colour, (h, w, 3)."""
        size = self.image_size[::-1]
        return (*size, 3) if self.table.colour else size

    def render(self, lights: Sequence[Light], frame: int, turned_px: float = 0.0) -> Image:
        """Take one picture, (h, w) or, in colour, (h, w, 3) BGR; the same frame each time.

        `turned_px` is by how many pixels the camera's turn has shifted the far room.
        """
        rng = generator(self.seed, RandomStream.PIXELS, self.side, frame)
        room = self._view(turned_px)
        if self.table.colour:
            dimmed = (
                [replace(light, peak=light.peak * BGR[light.colour][c]) for light in lights]
                for c in range(3)
            )
            return np.stack([self._expose(room, part, rng) for part in dimmed], axis=-1)
        return self._expose(room, lights, rng)

    def _expose(self, room: Picture, lights: Sequence[Light], rng: np.random.Generator) -> Image:
        glows = [glow for light in lights if (glow := self._glow(light, room.shape)) is not None]
        scene = room.copy()
        for area, light in glows:
            scene[area] += light
        if self._dark[0] < MIN_BLACK_SHARE:
            return self._digitise(scene, rng)
        image = self._sparse(room.shape, rng)
        for area, _ in glows:  # elsewhere it is as dark as it was
            image[area] = self._digitise(scene[area], rng)
        return image

    def _sparse(self, shape: tuple[int, ...], rng: np.random.Generator) -> Image:
        """Draw an even, dark room: how many pixels leave 0 for each level, then which ones.

        The same distribution as noise on every pixel, at a hundredth of the cost.
        """
        image = np.zeros(shape, dtype=np.uint8)
        counts = rng.multinomial(image.size, self._dark)
        levels = np.repeat(np.arange(1, MAX_LEVELS, dtype=np.uint8), counts[1:])
        image.flat[rng.choice(image.size, len(levels), replace=False)] = levels
        return image

    def _digitise(self, scene: Picture, rng: np.random.Generator) -> Image:
        table = self.table
        noise = rng.standard_normal(scene.shape, dtype=np.float32)
        noise *= np.sqrt(scene / table.electrons_per_dn + table.read_noise_dn**2)
        noise += scene
        noise += np.float32(table.black_level_dn)
        np.rint(noise, out=noise)
        return np.clip(noise, 0, 255, out=noise).astype(np.uint8)

    @cached_property
    def _dark(self) -> Array:
        """Probability of each of the lowest levels in an even room, (MAX_LEVELS,)."""
        table = self.table
        if table.texture_dn > 0:
            return np.zeros(MAX_LEVELS)
        sigma = np.sqrt(table.read_noise_dn**2 + table.background_dn / table.electrons_per_dn)
        edges = np.arange(MAX_LEVELS) + 0.5 - table.background_dn - table.black_level_dn
        below = ndtr(edges / max(sigma, 1e-6))  # 1e-6 DN: a noiseless room is certain
        return np.diff(below, prepend=0.0)

    @cached_property
    def _room(self) -> Picture:
        """The far room, (h, w) or (h, 2 w): wraps round, for a turning camera to look round.

        A camera that turns by an angle shifts it by the focal length times that.
        """
        width, height = self.image_size
        table = self.table
        if table.texture_dn == 0:
            return np.full((height, width), table.background_dn, dtype=np.float32)
        rng = generator(self.seed, RandomStream.ROOM, self.side)
        coarse = rng.standard_normal(
            (height // PATTERN_SCALE_PX + 2, 2 * width // PATTERN_SCALE_PX + 2)
        )
        pattern = cv2.resize(coarse, (2 * width, height), interpolation=cv2.INTER_CUBIC)
        pattern *= table.texture_dn / pattern.std()
        return np.asarray(np.maximum(table.background_dn + pattern, 0).astype(np.float32))

    def _view(self, turned_px: float) -> Picture:
        width = self.image_size[0]
        if self._room.shape[1] == width:
            return self._room
        return np.roll(self._room, -round(turned_px), axis=1)[:, :width]

    def _glow(self, light: Light, shape: tuple[int, ...]) -> Glow | None:
        """Which part of a picture one light touches, and what it adds there."""
        (left, top), patch = render_light(light, self.table.blur_px)
        x0, y0 = max(left, 0), max(top, 0)
        x1, y1 = min(left + patch.shape[1], shape[1]), min(top + patch.shape[0], shape[0])
        if x1 <= x0 or y1 <= y0:
            return None
        area = (slice(y0, y1), slice(x0, x1))
        return area, patch[y0 - top : y1 - top, x0 - left : x1 - left]


def render_light(light: Light, blur_px: float) -> tuple[tuple[int, int], Picture]:
    """Render one light: disc, motion, lens blur and the pixels' own area.

    The disc is cut into grains about its own centre, so that it is as symmetric as it should be;
    what each grain sends into each row and column of pixels is the Gaussian's exact integral,
    `blur_px` its standard deviation. Returns the (x, y) of the patch's first pixel, and the patch
    (rows, columns), DN.
    """
    half = np.linalg.norm(light.disc, axis=1)  # of the ellipse's bounding box, along x and y
    fine = max(GRAINS_PER_PX, int(np.ceil(3 / half.min())))  # three grains a radius at least
    x, y = (np.arange(-n, n + 1) / fine for n in np.ceil(half * fine).astype(int).tolist())
    grains = light.peak * _cover(x, y, light, fine) / len(light.path)
    margin = half + MAX_BLUR_SIGMAS * blur_px + 1
    low = np.floor(light.path.min(axis=0) - margin).astype(int)
    high = np.ceil(light.path.max(axis=0) + margin).astype(int)
    columns = _point_spread(low[0], high[0], light.path[:, 0, None] + x, blur_px)
    rows = _point_spread(low[1], high[1], light.path[:, 1, None] + y, blur_px)
    patch = np.sum(rows @ grains @ np.swapaxes(columns, 1, 2), axis=0)
    return (int(low[0]), int(low[1])), patch.astype(np.float32)


def _point_spread(first: int, last: int, places: Array, blur_px: float) -> Array:
    """Say what share of a point's light each pixel of a row gets: (k, pixels, n) of (k, n)."""
    edges = np.arange(first, last + 2) - 0.5
    below = ndtr((edges[:, None] - places[:, None, :]) / blur_px)
    return np.diff(below, axis=1)


def _cover(x: Array, y: Array, light: Light, fine: int) -> Array:
    """Say how much disc each grain of side 1/fine px holds, (len(y), len(x)), px².

    The rim is soft by one grain: the share of a grain beyond a straight edge, to first order;
    the whole is scaled to the ellipse's exact area.
    """
    to_circle = np.linalg.inv(light.disc)
    u = to_circle[0, 0] * x + to_circle[0, 1] * y[:, None]
    v = to_circle[1, 0] * x + to_circle[1, 1] * y[:, None]
    rho = np.hypot(u, v)
    safe = np.maximum(rho, 1e-9)  # the very centre has no slope; it is inside whatever it is
    slope_x = (u * to_circle[0, 0] + v * to_circle[1, 0]) / safe
    slope_y = (u * to_circle[0, 1] + v * to_circle[1, 1]) / safe
    slope = np.maximum(np.hypot(slope_x, slope_y), 1e-9)  # likewise
    cover: Array = np.clip(0.5 + (1 - rho) / slope * fine, 0.0, 1.0)
    cover *= np.pi * abs(np.linalg.det(light.disc)) / cover.sum()
    if light.hidden > 0:  # a straight edge, upright in the picture, comes over it from the left
        edge = (2 * light.hidden - 1) * float(np.linalg.norm(light.disc[0]))
        cover *= np.clip(0.5 + (x - edge) * fine, 0.0, 1.0)
    return cover
