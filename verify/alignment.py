"""Left and right sightings, brought to the left camera's instant.

The two pictures of a pair are not taken together, and with a rolling shutter not even one
picture is: each spot has its own instant. It is carried to the pair's along its own image
velocity, taken between this pair and its neighbour in time; what an acceleration would add is
not known from two pairs and goes into the uncertainty (see pose.py).
"""

from dataclasses import dataclass, replace

import numpy as np

from verify.records import Array, Sighting
from verify.rig import Camera

# A longer gap between two pairs says nothing about the motion at either: single visits, at rest.
LONGEST_GAP = 1.5  # s
SAME_INSTANT = 1e-9  # s, closer than any camera's clock


@dataclass(frozen=True, slots=True)
class RawSighting:
    """One camera's LEDs as seen, each at its own instant."""

    sighting: Sighting
    taken: Array  # (m,), s, the instant of each spot (differs by row with a rolling shutter)
    depth: Array  # (m,), m, rough distance along the optical axis


def spot_instants(t: float, centre: Array, camera: Camera, height: int) -> Array:
    """When each spot was taken, (m,) s: `t` is the middle row's instant."""
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
        The sighting at `t`, or None where it has to be moved and nothing says how.
    """
    if alone:
        return replace(now.sighting, t=t)
    shift = t - now.taken
    motion = _motion(now, neighbour, shift, camera) if neighbour is not None else None
    if motion is None:
        at_rest = bool(np.all(np.abs(shift) < SAME_INSTANT))
        return replace(now.sighting, t=t) if at_rest else None
    return motion


def _motion(
    now: RawSighting, neighbour: RawSighting, shift: Array, camera: Camera
) -> Sighting | None:
    """Spots at the common instant, from the line through this sighting and its neighbour."""
    seen, before = now.sighting, neighbour.sighting
    index = {int(led): i for i, led in enumerate(before.led)}
    match = np.array([index.get(int(led), -1) for led in seen.led], dtype=np.int64)
    known = match >= 0
    if not known.any():
        return None
    there = _with_the_base_turned(neighbour, seen.pan, camera)[match]
    interval = np.where(known, now.taken - neighbour.taken[match], np.inf)
    share = shift / interval  # 0 where the neighbour did not see the LED
    velocity = np.where(known[:, None], (seen.centre - there) / interval[:, None], 0.0)
    covariance = ((1 + share) ** 2)[:, None, None] * seen.covariance
    covariance = covariance + (share**2)[:, None, None] * before.covariance[match]
    if not known.all():  # LEDs new to this pair move like the others, give or take their spread
        velocity[~known] = velocity[known].mean(axis=0)
        spread = _spread(velocity[known])
        covariance[~known] += (shift[~known] ** 2)[:, None, None] * spread
    typical = float(np.median(interval[known]))
    span = np.where(known, interval, typical)
    return replace(
        seen,
        centre=seen.centre + velocity * shift[:, None],
        covariance=covariance,
        t=float(now.sighting.t if not len(shift) else now.taken[0] + shift[0]),
        velocity=velocity,
        acceleration_lever=-0.5 * shift * (shift + span),
    )


def _spread(velocity: Array) -> Array:
    """Covariance of one LED's velocity about the mean of the others, (2, 2), (px/s)²."""
    if len(velocity) < 2:
        return np.diag(velocity[0] ** 2)  # nothing better is known than its size
    deviation = velocity - velocity.mean(axis=0)
    covariance: Array = deviation.T @ deviation / (len(velocity) - 1) * (1 + 1 / len(velocity))
    return covariance


def _with_the_base_turned(raw: RawSighting, pan: float, camera: Camera) -> Array:
    """Where the neighbour's spots would have been, had the base stood as it does now; (m, 2) px."""
    seen = raw.sighting
    if seen.pan == pan:
        return seen.centre
    rays = np.concatenate([camera.normalise(seen.centre), np.ones((len(seen), 1))], axis=1)
    points = np.concatenate([rays * raw.depth[:, None], np.ones((len(seen), 1))], axis=1)
    now_T_then = camera.camera_T_rig(pan) @ camera.rig_T_camera(seen.pan)
    return camera.project((points @ now_T_then.T)[:, :3])
