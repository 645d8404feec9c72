"""Pictures of the simulated cell: polygons, far ones first, on a background that is drawn once."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from robots.transforms import carry, invert
from verify.core.fiducials import Marker
from verify.core.records import Array, Image
from verify.core.rig import Camera
from verify.grasping.cell import GripperGeometry
from verify.simulation.cell.scene import COLOURS, Cap

ARM_COLOUR, PALM_COLOUR, FINGER_COLOUR = (206, 210, 212), (70, 70, 72), (150, 152, 155)  # BGR
COLLAR_COLOUR, LED = (24, 24, 25), 220.0
TABLE_COLOUR, FLOOR_COLOUR = (110, 150, 180), (150, 155, 160)
TABLE_CORNERS = ((0.24, -0.42), (0.74, -0.42), (0.74, 0.42), (0.24, 0.42))  # m, corners of its top
LINK_RADIUS, FINGER_RADIUS = 0.045, 0.008  # m, radii as drawn: the links' own, not their safety's
# m: a black collar about the palm, with the LEDs on it, from one z of the flange to another
COLLAR_RANGE, COLLAR_RADIUS = (0.04, 0.07), 0.052
BLUR_PX = 0.6  # px
NOISE_SHIFT_PX = 64  # px by which the noise pattern may be shifted
CIRCLE_ANGLES = np.linspace(0.0, 2 * np.pi, 20, endpoint=False)
RIM_ANGLES = np.linspace(0.0, 2 * np.pi, 40, endpoint=False)


class Shape(NamedTuple):
    """What is drawn in one go: the convex hull of some points, or an LED at the one point."""

    points: Array  # (n, 3), m, base frame
    colour: Array | tuple[float, ...]  # BGR
    led_radius: float = 0.0  # px; 0: no LED


Part = tuple[float, list[Shape]]  # m, how far from the camera, and what hides what is behind it


@dataclass(frozen=True, slots=True)
class RenderedArm:
    """The arm as it stands."""

    joints: Array  # (k, 3), m, base frame: points that the links go through
    base_T_flange: Array  # (4, 4)
    opening: float  # m between the fingers


class CellCamera:
    """Draws what one camera sees in pictures of a size, px."""

    def __init__(
        self,
        camera: Camera,
        rig_T_base: Array,
        size: tuple[int, int],
        hand: GripperGeometry,
        marker: Marker,
        seed: int,
    ) -> None:
        self._rig_T_base = rig_T_base
        self._camera, self._size, self._hand, self._marker = camera, size, hand, marker
        self._rng = np.random.default_rng(seed)
        coarse = self._rng.normal(0, 9, (size[1] // 16 + 1, size[0] // 16 + 1)).astype(np.float32)
        self._pattern = cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)[..., None]
        self.turn(camera.pan)
        shape = (size[1] + NOISE_SHIFT_PX, size[0] + NOISE_SHIFT_PX, 3)
        self._grain = self._rng.normal(0.0, 1.0, shape).astype(np.float32)

    def turn(self, pan: float) -> None:
        """Turn its base to where a reading would be pan, rad."""
        self._camera_T_base = self._camera.camera_T_rig(pan) @ self._rig_T_base
        self._eye = invert(self._camera_T_base)[:3, 3]
        self._rotation = cv2.Rodrigues(self._camera_T_base[:3, :3])[0]
        across = np.linalg.inv(self._camera_T_base[:3, :3])[:, :2]  # a circle faces the camera
        self._disc = np.stack([np.cos(CIRCLE_ANGLES), np.sin(CIRCLE_ANGLES)], axis=1) @ across.T
        self._background = self._table()

    def picture(
        self,
        caps: Sequence[tuple[Cap, Array]],
        posed: RenderedArm,
        light: float,
        noise: float,
        board: Array | None = None,
    ) -> Image:
        """Draw the cell: the arm, caps that stand about, a board that hides what is behind it.

        With each cap comes base_T_cap (4, 4), z along its axis. The light is a share of the usual
        one, the noise a pixel's standard deviation, DN, the board its corners, (4, 3), m.
        """
        picture = self._background.copy()
        parts = [(self._away(pose[:3, 3]), self._cap(cap, pose)) for cap, pose in caps]
        parts += self._arm(posed)
        if board is not None:
            parts.append((self._away(board.mean(axis=0)), [Shape(board, FINGER_COLOUR)]))
        far_first = sorted(parts, key=lambda part: -part[0])
        self._draw(picture, [shape for _, part in far_first for shape in part])
        cv2.GaussianBlur(picture, (0, 0), BLUR_PX, dst=picture)
        dy, dx = self._rng.integers(0, NOISE_SHIFT_PX, 2)
        height, width = picture.shape[:2]
        grain = self._grain[dy : dy + height, dx : dx + width]
        sensed = cv2.addWeighted(picture, light, grain, noise, 0, dtype=cv2.CV_8U)
        return np.asarray(sensed, dtype=np.uint8)

    def _table(self) -> Image:
        """The table, a floor, a pale blue and a pale green paper."""
        width, height = self._size
        picture = np.empty((height, width, 3), np.uint8)
        picture[:] = FLOOR_COLOUR
        top = np.array([(*corner, 0.0) for corner in TABLE_CORNERS])
        shapes = [Shape(top, TABLE_COLOUR)]
        for x, y, colour in ((0.66, -0.34, (190, 170, 150)), (0.62, 0.33, (150, 185, 150))):
            paper = np.array([(x + a, y + b, 0.0) for a, b in ((0, 0), (0.06, 0), (0.06, 0.05))])
            shapes.append(Shape(np.vstack([paper, [x, y + 0.05, 0.0]]), colour))
        self._draw(picture, shapes)
        return np.asarray(np.clip(picture + self._pattern, 0, 255).astype(np.uint8))

    def _arm(self, posed: RenderedArm) -> list[Part]:
        parts: list[Part] = []

        def capsule(a: Array, b: Array, radius: float, colour: tuple[int, int, int]) -> None:
            # an outline by two circles that face the camera, and a lighter streak along it
            disc, lit = self._disc, 0.55 * radius * self._disc + [0.0, 0.0, 0.25 * radius]
            rim = np.vstack([a + radius * disc, b + radius * disc])
            outline = Shape(rim, np.array(colour) * 0.8)
            streak = Shape(np.vstack([a + lit, b + lit]), colour)
            parts.append((self._away((a + b) / 2), [outline, streak]))

        for a, b in zip(posed.joints[:-1], posed.joints[1:], strict=True):
            capsule(a, b, LINK_RADIUS, ARM_COLOUR)
        hand, flange = self._hand, posed.base_T_flange
        grip = flange @ hand.flange_T_grip
        palm = hand.finger_length - hand.tips
        capsule(flange[:3, 3], carry(grip, np.array([0.0, 0.0, -palm])), 0.035, PALM_COLOUR)
        top, bottom = (carry(flange, np.array([0.0, 0.0, z])) for z in COLLAR_RANGE)
        capsule(top, bottom, COLLAR_RADIUS, COLLAR_COLOUR)
        for angle in np.deg2rad([90.0, 210.0, 330.0]).tolist():
            out = np.array([np.cos(angle), np.sin(angle), 0.0])
            root = carry(grip, 0.03 * out - [0.0, 0.0, palm])
            inside = posed.opening / 2 + FINGER_RADIUS
            knee = carry(grip, (inside + 0.006) * out - [0.0, 0.0, palm / 2])
            tip = carry(grip, inside * out + [0.0, 0.0, hand.tips - FINGER_RADIUS])
            capsule(root, knee, FINGER_RADIUS, FINGER_COLOUR)
            capsule(knee, tip, FINGER_RADIUS, FINGER_COLOUR)
        nearest = self._away(grip[:3, 3] - 0.05 * grip[:3, 2]) - 0.08
        parts.append((nearest, self._leds(flange)))
        return parts

    def _leds(self, flange: Array) -> list[Shape]:
        """Those that face the camera."""
        found = []
        eye = self._eye
        for led in self._marker.leds:
            at = carry(flange, led)
            outwards = flange[:3, :3] @ np.array([led[0], led[1], 0.0])
            if outwards @ (eye - at) > 0.3 * np.linalg.norm(outwards) * np.linalg.norm(eye - at):
                radius = self._camera.matrix[0, 0] * self._marker.led_diameter / 2 / self._away(at)
                found.append(Shape(at[None], (LED,), radius))
        return found

    def _cap(self, cap: Cap, base_T_cap: Array) -> list[Shape]:
        """A short cylinder: a lit top, a darker side, darker still to the right, a reflection."""
        circle = np.cos(RIM_ANGLES), np.sin(RIM_ANGLES), np.zeros_like(RIM_ANGLES)
        ring = cap.radius * np.stack(circle, axis=1)
        up = np.array([0.0, 0.0, cap.height / 2])
        top, bottom = carry(base_T_cap, ring + up), carry(base_T_cap, ring - up)
        colour = np.array(COLOURS[cap.colour], dtype=float)
        shade = ring[:, 1] > 0.3 * cap.radius
        aside = carry(invert(base_T_cap), self._eye)[1]
        shift = np.array([0.3 * cap.radius, 0.5 * aside * cap.radius, 0.0])
        shine = carry(base_T_cap, 0.18 * ring + up + shift)
        return [
            Shape(np.vstack([top, bottom]), 0.72 * colour),
            Shape(np.vstack([top[shade], bottom[shade]]), 0.55 * colour),
            Shape(top, colour),
            Shape(shine, 0.4 * colour + 0.6 * 255),
        ]

    def _away(self, point: Array) -> float:
        """How far a point (3,) of the base is from the camera, m."""
        return float(np.linalg.norm(carry(self._camera_T_base, point)))

    def _pixels(self, points: Array) -> Array:
        """Image (n, 2), px, of points (n, 3) of the base."""
        placed = self._camera_T_base[:3, 3]
        found, _ = cv2.projectPoints(
            points, self._rotation, placed, self._camera.matrix, self._camera.distortion
        )
        return np.asarray(found[:, 0], dtype=float)

    def _draw(self, picture: Image, shapes: Sequence[Shape]) -> None:
        """Draw one after the other."""
        pixels = self._pixels(np.concatenate([shape.points for shape in shapes]))
        corners = np.rint(np.clip(pixels, -4e3, 4e3) * 16).astype(np.int32)
        end = 0
        for shape in shapes:
            begin, end = end, end + len(shape.points)
            if shape.led_radius > 0.0:
                _draw_led(picture, pixels[begin], shape.led_radius)
                continue
            outline = cv2.convexHull(corners[begin:end])
            shade = np.asarray(shape.colour, dtype=float).tolist()
            cv2.fillConvexPoly(picture, outline, shade, cv2.LINE_AA, shift=4)


def _draw_led(picture: Image, centre: Array, radius: float) -> None:
    """Light an LED: a disc about a place (2,), px, true to a small part of a pixel."""
    reach = int(np.ceil(radius)) + 1
    x, y = (int(v) for v in np.rint(centre))
    height, width = picture.shape[:2]
    if not (reach <= x < width - reach and reach <= y < height - reach):
        return
    rows, columns = np.mgrid[y - reach : y + reach + 1, x - reach : x + reach + 1]
    away = np.hypot(columns - centre[0], rows - centre[1])
    share = np.clip(radius + 0.5 - away, 0.0, 1.0)[..., None]
    patch = picture[y - reach : y + reach + 1, x - reach : x + reach + 1]
    patch[:] = np.rint((1 - share) * patch + share * LED).astype(np.uint8)
