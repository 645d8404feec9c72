"""Carry the spots of both cameras to one instant along their image velocities.

The pictures of a pair are not simultaneous, and with a rolling shutter each row has its own
instant: t_i = t + (row - (height - 1) / 2) line_time. Model of spot i, with the neighbouring pair
(instant t_i', centre z_i'):

    v_i = (z_i - z_i') / (t_i - t_i')
    z_i(t) = z_i + (t - t_i) v_i + h_i a_i

    symbol  meaning                                                     unit
    z_i     centre, (2,)                                                px
    v_i     image velocity, (2,)                                        px/s
    h_i     acceleration lever: error by one unit of acceleration       s²
    a_i     image acceleration, unknown from two pairs; the pose fit
            takes it as a rigid-body acceleration with a prior          px/s²
"""

from dataclasses import dataclass, replace

import numpy as np

from verify.core.records import Array, Sighting
from verify.core.rig import Camera
from verify.measurement.kernels.alignment import carry_to_instant

# Beyond such a gap between two pairs the motion at either is unknown: single visits, at rest.
MAX_GAP = 1.5  # s
TOL_INSTANT = 1e-9  # s, closer than any camera's clock


@dataclass(frozen=True, slots=True)
class RawSighting:
    """One camera's LEDs, each at its own instant."""

    sighting: Sighting
    taken: Array  # (m,), s, the instant of each spot (differs by row with a rolling shutter)
    depth: Array  # (m,), m, rough distance along the optical axis


def spot_instants(t: float, centre: Array, camera: Camera, height: int) -> Array:
    """Instants of the spots, (m,), s, by their rows; `t` is the middle row's instant."""
    rows: Array = centre[:, 1] - (height - 1) / 2
    return t + rows * camera.line_time


def align(
    now: RawSighting,
    neighbour: RawSighting | None,
    t: float,
    camera: Camera,
    *,
    alone: bool = False,
) -> Sighting | None:
    """Carry one camera's spots to the instant `t`.

    Args:
        now: the sighting to carry.
        neighbour: the same camera's sighting in the pair before (for the first pair: after);
            None where there is none, or none with an LED in it.
        t: s, the pair's instant.
        camera: the camera that saw both.
        alone: the pair is a single visit, far in time from its neighbours: taken as standing still.

    Returns:
        The sighting at `t`, or None where it has to be moved and no neighbour shows how.
    """
    if alone:
        return replace(now.sighting, t=t)
    moved = _along_image_velocity(now, neighbour, t, camera) if neighbour is not None else None
    if moved is None and np.all(np.abs(t - now.taken) < TOL_INSTANT):
        return replace(now.sighting, t=t)
    return moved


def _along_image_velocity(
    now: RawSighting, neighbour: RawSighting, t: float, camera: Camera
) -> Sighting | None:
    """Spots at the common instant, from the line through this sighting and its neighbour."""
    sighting, before = now.sighting, neighbour.sighting
    centres = sighting.centre, _pan_compensated(neighbour, sighting.pan, camera)
    matched, centre, covariance, velocity, lever = carry_to_instant(
        (sighting.led, before.led),
        (np.ascontiguousarray(centres[0]), np.ascontiguousarray(centres[1])),
        (np.ascontiguousarray(sighting.covariance), np.ascontiguousarray(before.covariance)),
        (now.taken, neighbour.taken),
        t,
    )
    if not matched:
        return None
    moved = replace(sighting, centre=centre, covariance=covariance, t=t)
    return replace(moved, velocity=velocity, acceleration_lever=lever)


def _pan_compensated(raw: RawSighting, pan: float, camera: Camera) -> Array:
    """The neighbour's spots as the present pan angle would show them, (m, 2), px."""
    sighting = raw.sighting
    if sighting.pan == pan:
        return sighting.centre
    one = np.ones((len(sighting), 1))
    rays = np.concatenate([camera.normalise(sighting.centre), one], axis=1)
    points = np.concatenate([rays * raw.depth[:, None], one], axis=1)
    now_T_then = camera.camera_T_rig(pan) @ camera.rig_T_camera(sighting.pan)
    return camera.project((points @ now_T_then.T)[:, :3])
