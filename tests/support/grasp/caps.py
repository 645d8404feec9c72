"""Pictures of coloured bottle caps as two cameras would take them; pixels by OpenCV's projection.

A cap is a short cylinder with a lit top, a darker side and a reflection; the picture is blurred,
dimmed and noisy. Its truth is the middle of the cylinder.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tests.support.scene import make_rig, project
from verify.core.records import Array, Image, StereoPair
from verify.core.rig import Camera, Rig

BLUE, GREEN, RED, YELLOW = (190, 90, 25), (60, 165, 50), (40, 40, 200), (30, 200, 220)  # BGR
UP = np.array([0.0, -0.8, -0.6])  # the caps' axis: a table seen from above at 37°
RATE = 30.0  # Hz
SKEW = 0.004  # s by which the right picture is later

Path = Callable[[float], Sequence[float] | None]  # s to m in the rig; None: not there


@dataclass(frozen=True)
class Cap:
    colour: tuple[int, int, int]
    path: Path
    radius: float = 0.02
    height: float = 0.016


@dataclass(frozen=True)
class Slab:
    """An upright grey board that hides what is behind it."""

    path: Path
    width: float = 0.09
    colour: tuple[int, int, int] = (120, 120, 120)


def still(x: float, y: float, z: float) -> Path:
    return lambda _t: (x, y, z)


def small_rig() -> Rig:
    """Half the usual resolution: pictures that are quick to draw."""
    rig = make_rig()

    def halved(camera: Camera) -> Camera:
        matrix = camera.matrix.copy()
        matrix[:2] /= 2
        return replace(camera, matrix=matrix)

    return replace(rig, image_size=(640, 360), left=halved(rig.left), right=halved(rig.right))


def pairs(
    things: Sequence[Cap | Slab],
    rig: Rig,
    seconds: float,
    light: Callable[[float], float] = lambda _t: 1.0,
    noise: float = 2.0,
    seed: int = 1,
) -> Iterator[StereoPair]:
    """Film a scene."""
    rng = np.random.default_rng(seed)
    width, height = rig.image_size
    rooms = [room(width, height, seed + side) for side in (0, 1)]
    grain = rng.normal(0.0, noise, (height + 64, width + 64, 3)).astype(np.float32)
    for frame in range(round(seconds * RATE)):
        t = frame / RATE
        taken = []
        for background, camera, at in ((rooms[0], rig.left, t), (rooms[1], rig.right, t + SKEW)):
            clean = draw(background, things, camera, at)
            dy, dx = rng.integers(0, 64, 2)
            sensed = clean.astype(np.float32) * np.float32(light(at))
            sensed += grain[dy : dy + height, dx : dx + width]
            taken.append(np.clip(np.rint(sensed), 0, 255).astype(np.uint8))
        yield StereoPair(frame, t, t + SKEW, rig.left.pan, rig.right.pan, taken[0], taken[1])


def room(width: int, height: int, seed: int) -> Image:
    """A wooden table, a wall, skin, a green and a blue thing that are no caps but paler."""
    rng = np.random.default_rng(seed)
    coarse = rng.normal(0, 12, (height // 16 + 1, width // 16 + 1, 1)).astype(np.float32)
    pattern = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)[..., None]
    base = np.empty((height, width, 3), np.float32)
    base[: height // 3] = (150, 155, 160)
    base[height // 3 :] = (110, 150, 180)
    picture = np.clip(base + pattern, 0, 255).astype(np.uint8)
    for colour, (x, y) in (
        ((130, 160, 215), (0.1, 0.2)),  # skin
        ((150, 185, 150), (0.9, 0.15)),  # a pale green paper
        ((190, 170, 150), (0.75, 0.9)),  # a pale blue one
    ):
        cv2.circle(picture, (int(x * width), int(y * height)), height // 12, colour, cv2.FILLED)
    return picture


def draw(background: Image, things: Sequence[Cap | Slab], camera: Camera, t: float) -> Image:
    picture = background.copy()
    placed = [
        (np.array(p, dtype=float), thing) for thing in things if (p := thing.path(t)) is not None
    ]
    placed.sort(key=lambda item: -item[0][2])  # far ones first
    for place, thing in placed:
        (_draw_cap if isinstance(thing, Cap) else _draw_slab)(picture, thing, place, camera)
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), 0.7), dtype=np.uint8)


def _draw_cap(picture: Image, cap: Cap, place: Array, camera: Camera) -> None:
    side = np.cross(UP, [1.0, 0.0, 0.0])
    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)[:, None]
    rim = cap.radius * (np.cos(angle) * [1.0, 0.0, 0.0] + np.sin(angle) * side)
    top, bottom = place + UP * cap.height / 2 + rim, place - UP * cap.height / 2 + rim
    colour = np.array(cap.colour, dtype=float)
    _fill(picture, np.vstack([top, bottom]), camera, 0.72 * colour)
    shade = rim[:, 0] > 0  # the lamp stands on the left
    _fill(picture, np.vstack([top[shade], bottom[shade]]), camera, 0.5 * colour)
    _fill(picture, top, camera, colour)
    # a reflection lies where the eye sees it: elsewhere on the cap for either camera
    aside = camera.rig_T_camera(camera.pan)[0, 3] - place[0]
    shift = np.array([2.0 * aside * cap.radius, 0.0, 0.0])
    shine = place + UP * cap.height / 2 + 0.2 * rim + 0.35 * cap.radius * side + shift
    _fill(picture, shine, camera, 0.3 * colour + 0.7 * 255)


def _draw_slab(picture: Image, slab: Slab, place: Array, camera: Camera) -> None:
    half = slab.width / 2
    corners = place + np.array([[-half, -0.2, 0], [half, -0.2, 0], [half, 0.2, 0], [-half, 0.2, 0]])
    _fill(picture, corners, camera, np.array(slab.colour, dtype=float))


def _fill(picture: Image, points: Array, camera: Camera, colour: Array) -> None:
    pixels = project(camera, camera.pan, points)
    outline = cv2.convexHull(np.rint(pixels * 16).astype(np.int32))
    cv2.fillConvexPoly(picture, outline, colour.tolist(), cv2.LINE_AA, shift=4)
