"""Where the LEDs of a simulated session truly are in its pictures."""

import numpy as np

from verify.core.records import Array
from verify.simulation.session.simulate import SimulatedSession
from verify.simulation.world.led_render import mid_exposures
from verify.simulation.world.world import SimulatedWorld


def true_spots(session: SimulatedSession, side: int) -> Array:
    """True LED images of the left (0) or right (1) camera, (pairs, leds, 2), px; NaN unseen."""
    taken = zip(session.t[:, side], session.true_pan[:, side], strict=True)
    return np.array([led_images(session.world, side, t, pan) for t, pan in taken])


def led_images(world: SimulatedWorld, side: int, t: float, pan: float) -> Array:
    """Image of every LED's centre, (leds, 2), px; NaN where it faces away or leaves the picture.

    The side is 0 left, 1 right; t, s, cameras' clock, mid-exposure of the middle row; pan, rad, the
    base's true angle.
    """
    camera, n = world.bench.cameras[side], len(world.leds)
    centres = camera.project(world.sources(mid_exposures(world, camera, t, pan))[:n, 0], pan)
    lit = world.brightness(camera.rig_T_camera(pan)[:3, 3], t)[:n] > 0
    limit = np.array(camera.image_size) - 1
    inside = np.all((centres >= 0) & (centres <= limit), axis=1)  # NaN compares as outside
    centres[~(lit & inside)] = np.nan
    return centres
