"""Carry the spots of both cameras to one instant along their image motion.

The pictures of a pair are not simultaneous, and with a rolling shutter each row has its own
instant: t_i = t + (row - (height - 1) / 2) line_time. Model of spot i, with its LED's sightings in
n of the pairs before, after and before the one before:

    z_i(t) = polynomial of order n through the n + 1 sightings + h_i a_i

    symbol  meaning                                                     unit
    z_i     centre, (2,)                                                px
    n       number of those pairs: 1 gives a line, 2 a parabola         1
    a_i     derivative of order n + 1 of the image motion, which the
            sightings do not show: acceleration, jerk, snap. The pose
            fit takes it as a rigid body's with a prior                 px/s^(n+1)
    h_i     its lever: error by one unit                                s^(n+1)
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from verify.core.records import Array, Sighting, Spots
from verify.core.rig import Camera
from verify.measurement.kernels.entries import SpotView, carry_to_instant

# Beyond such a gap between two pairs the motion at either is unknown: single visits, at rest.
MAX_GAP = 1.5  # s
TOL_INSTANT = 1e-9  # s, closer than any camera's clock
NOTHING: SpotView = (np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0))


@dataclass(frozen=True, slots=True)
class RawSighting:
    """One camera's LEDs, each at its own instant."""

    sighting: Sighting
    taken: Array  # (m,), s, the instant of each spot (differs by row with a rolling shutter)
    depth: Array  # (m,), m, rough distance along the optical axis
    width: Array  # (m,), px, full width at half height; nan where it may not be the LED's alone


def spot_instants(t: float, centre: Array, camera: Camera, height: int) -> Array:
    """Instants of the spots, (m,), s, by their rows; `t` is the middle row's instant."""
    rows: Array = centre[:, 1] - (height - 1) / 2
    return t + rows * camera.line_time


def raw_sighting(
    spots: Spots,
    led: NDArray[np.int64],
    index: NDArray[np.int64],
    camera: Camera,
    instant: tuple[float, float, int],
    depth: Array,
) -> RawSighting:
    """Gather one camera's assigned spots, by their index, each at its own instant.

    `instant`: the middle row's, s, the pan reading, rad, and the picture's height, px.
    """
    (t, pan, height), centre = instant, spots.centre[index]
    still = np.zeros((len(index), 2)), np.zeros((len(index), 3))  # velocity and lever
    sighting = Sighting(led, centre, spots.covariance[index], t, pan, spots.peak[index], *still)
    width = np.where(spots.merged[index], np.nan, spots.diameter[index])
    return RawSighting(sighting, spot_instants(t, centre, camera, height), depth, width)


def align(
    now: RawSighting,
    around: Sequence[RawSighting | None],
    t: float,
    camera: Camera,
    *,
    alone: bool = False,
) -> Sighting | None:
    """Carry one camera's spots, as sighted `now`, to the instant `t`, s, of the pair.

    `around`: the same camera's sightings in the pairs before, after, and before the one before;
    None where there is none. `alone`: the pair is a single visit, far in time from its neighbours:
    taken as standing still. Gives None where the sighting has to be moved and no neighbour shows
    how.
    """
    if alone:
        return replace(now.sighting, t=t)
    sighting = now.sighting
    views = [_view(other, sighting.pan, camera) for other in around]
    matched, centre, covariance, velocity, lever = carry_to_instant(
        _view(now, sighting.pan, camera), (views[0], views[1], views[2]), t
    )
    if matched:
        return Sighting(
            sighting.led, centre, covariance, t, sighting.pan, sighting.peak, velocity, lever
        )
    at_once = np.all(np.abs(t - now.taken) < TOL_INSTANT)
    return replace(sighting, t=t) if at_once else None


def _view(raw: RawSighting | None, pan: float, camera: Camera) -> SpotView:
    """A sighting as the kernel takes it, as the pan angle `pan` would show it."""
    if raw is None:
        return NOTHING
    sighting, centre = raw.sighting, raw.sighting.centre
    if sighting.pan != pan:
        one = np.ones((len(sighting), 1))
        rays = np.concatenate([camera.normalise(centre), one], axis=1)
        points = np.concatenate([rays * raw.depth[:, None], one], axis=1)
        now_T_then = camera.camera_T_rig(pan) @ camera.rig_T_camera(sighting.pan)
        centre = camera.project((points @ now_T_then.T)[:, :3])
    return sighting.led, centre, sighting.covariance, raw.taken
