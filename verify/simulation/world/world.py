"""The one world that the simulated cameras and encoders look at."""

from dataclasses import dataclass

import numpy as np

import robots
from verify.core.records import Array
from verify.simulation.scenario import Colour, Distractor, Mirror, ScenarioLed
from verify.simulation.world.bench import Bench
from verify.simulation.world.motion import MotionProfile


@dataclass(frozen=True, slots=True)
class SimulatedWorld:
    """The true arm, its motion, cameras and everything that shines.

    The shining things always come in one order: the LEDs, the LEDs once more for each mirror,
    the lamps.
    """

    arm: robots.Arm
    motion: MotionProfile
    bench: Bench
    # brightness, colour and direction; where they truly are is in the bench
    leds: tuple[ScenarioLed, ...]
    led_diameter: float  # m
    mirrors: tuple[Mirror, ...] = ()
    lamps: tuple[Distractor, ...] = ()

    def joints(self, t: Array) -> Array:
        """True joint angles, rad: (...,) s to (..., joints)."""
        return self.motion.angles(np.asarray(t, dtype=float))

    def rig_T_flange(self, t: Array) -> Array:
        """True flange poses in the rig: (...,) s to (..., 4, 4)."""
        return self.bench.rig_T_base @ robots.forward(self.arm, self.joints(t))

    def led_points(self, t: Array) -> Array:
        """True LED centres in the rig: (...,) s to (..., leds, 3), m."""
        rig_T_flange = self.rig_T_flange(t)
        turned = self.bench.leds @ np.swapaxes(rig_T_flange[..., :3, :3], -1, -2)
        return turned + rig_T_flange[..., None, :3, 3]

    def led_normals(self, t: Array) -> Array:
        """Directions in which the LEDs shine, unit vectors in the rig: (...,) to (..., leds, 3)."""
        normals = np.array([led.normal for led in self.leds], dtype=float)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return normals @ np.swapaxes(self.rig_T_flange(t)[..., :3, :3], -1, -2)

    @property
    def colours(self) -> list[Colour]:
        """Colour of each shining thing."""
        colours = [led.colour for led in self.leds] * (1 + len(self.mirrors))
        return colours + [lamp.colour for lamp in self.lamps]

    @property
    def radii(self) -> Array:
        """Radius of each shining disc, m."""
        of_leds = [self.led_diameter / 2] * (len(self.leds) * (1 + len(self.mirrors)))
        return np.array(of_leds + [lamp.diameter_mm / 2000 for lamp in self.lamps])

    def sources(self, t: Array) -> Array:
        """Where the shining things are: (things, k) s, an instant each, to (things, k, 3) m."""
        n = len(self.leds)
        # Each LED at its own instants: from (n, k, leds, 3) only LED i at the i-th row's instants.
        own = np.arange(n)
        parts = [self.led_points(t[:n])[own, :, own]]
        for index, mirror in enumerate(self.mirrors, start=1):
            track = self.led_points(t[n * index : n * (index + 1)])[own, :, own]
            normal = unit(mirror.normal)
            height = (track - np.asarray(mirror.point_mm) / 1000) @ normal
            parts.append(track - 2 * height[..., None] * normal)
        for index, lamp in enumerate(self.lamps, start=n * (1 + len(self.mirrors))):
            drift = t[index, :, None] * np.asarray(lamp.velocity_mm_s)
            parts.append(((np.asarray(lamp.position_mm) + drift) / 1000)[None])
        return np.concatenate(parts)

    def brightness(self, eye: Array, t: float) -> Array:
        """Peak of each shining thing as seen from `eye` (3,) m, DN; 0 for those turned away."""
        points, normals = self.led_points(np.array(t)), self.led_normals(np.array(t))
        peaks = np.array([led.peak_dn for led in self.leds])
        falloff = np.array([led.falloff for led in self.leds])

        def direct(seen_from: Array) -> Array:
            toward = seen_from - points
            cosine = np.sum(toward * normals, axis=1) / np.linalg.norm(toward, axis=1)
            return np.where(cosine > 0, peaks * np.maximum(cosine, 0) ** falloff, 0.0)

        parts = [direct(eye)]
        for mirror in self.mirrors:  # looking into a mirror is looking from the eye's own image
            normal, foot = unit(mirror.normal), np.asarray(mirror.point_mm) / 1000
            before = ((points - foot) @ normal > 0) & ((eye - foot) @ normal > 0)
            image_of_eye = eye - 2 * ((eye - foot) @ normal) * normal
            parts.append(np.where(before, mirror.reflectance * direct(image_of_eye), 0.0))
        parts.append(np.array([lamp.peak_dn for lamp in self.lamps]))
        return np.concatenate(parts)


def unit(direction: tuple[float, float, float]) -> Array:
    """Scale a direction to length 1."""
    vector = np.asarray(direction, dtype=float)
    return vector / float(np.linalg.norm(vector))
