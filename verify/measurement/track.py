"""The measured poses of a session as arrays in the robot's base frame: the seam to the tables."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from verify.core.records import Array, Measurement, Sighting, take_rows
from verify.core.rig import Rig
from verify.measurement.alignment import MAX_GAP


@dataclass(frozen=True, slots=True)
class Track:
    """n measured pairs. Twists are (translation, rotation vector) in base axes at the flange."""

    frame: Array  # (n,), int
    t: Array  # (n,), s, the left camera's instant
    pan: Array  # (n, 2), rad, as read
    base_T_flange: Array  # (n, 4, 4)
    covariance_pixels: Array  # (n, 6, 6), m and rad
    covariance_alignment: Array  # (n, 6, 6)
    twist: Array  # (n, 6), m/s, rad/s, as the images show it
    acceleration_prior: Array  # (n, 2), m/s², rad/s²
    alignment_error: Array  # (n, 6), what the image accelerations about a pair leave of alignment
    systematic: Array  # (n, 6, p): d measured pose / d parameter of `Systematics`
    determined: tuple[Array, ...]  # n of (6, d)

    def __len__(self) -> int:
        """Count the measured pairs."""
        return len(self.frame)

    @property
    def known_dof(self) -> Array:
        """Degrees of freedom determined in each pair, (n,)."""
        return np.array([b.shape[1] for b in self.determined], dtype=np.int64)


def subset(track: Track, chosen: NDArray[np.int64]) -> Track:
    """Some of the pairs, by their place in the track."""
    determined = tuple(track.determined[i] for i in chosen)
    return replace(take_rows(track, chosen), determined=determined)


def concatenate(tracks: Sequence[Track]) -> Track:
    """Several tracks as one, in their order."""
    if len(tracks) == 1:
        return tracks[0]
    names = [f.name for f in fields(Track) if f.name != "determined"]
    parts = {name: np.concatenate([getattr(t, name) for t in tracks]) for name in names}
    return Track(**parts, determined=tuple(d for t in tracks for d in t.determined))


def collect_track(measurements: list[Measurement], rig: Rig, systematic: list[Array]) -> Track:
    """Gather what was measured; `systematic` holds (6, p) a measured pair, in base axes."""
    measured = [m for m in measurements if m.status == "measured" and m.pose is not None]
    base_T_rig = np.linalg.inv(rig.rig_T_base)
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = base_T_rig[:3, :3]
    n = len(measured)
    poses = [m.pose for m in measured if m.pose is not None]
    return Track(
        frame=np.array([m.frame for m in measured], dtype=np.int64),
        t=np.array([m.t for m in measured]),
        pan=np.array([[_pan(m.left), _pan(m.right)] for m in measured]).reshape(n, 2),
        base_T_flange=np.array([base_T_rig @ p.rig_T_flange for p in poses]).reshape(n, 4, 4),
        covariance_pixels=_rotate_blocks(turn, [p.covariance_pixels for p in poses]),
        covariance_alignment=_rotate_blocks(turn, [p.covariance_alignment for p in poses]),
        twist=np.array([turn @ p.twist for p in poses]).reshape(n, 6),
        acceleration_prior=np.array([p.acceleration_prior for p in poses]).reshape(n, 2),
        alignment_error=_alignment_errors(measurements) @ turn.T,
        systematic=np.array(systematic).reshape(n, 6, -1) if n else np.zeros((0, 6, 0)),
        determined=tuple(turn @ p.determined for p in poses),
    )


def _alignment_errors(measurements: list[Measurement]) -> Array:
    """How far alignment's steady motion puts each measured pose off, (n, 6), rig axes.

    A pair looks back one pair and cannot know its acceleration; once its successor is there, the
    second difference of the spots shows it. The values stay as they are: this goes into the
    judgement, as a term that does not average out when the arm accelerates one way.
    """
    errors = []
    for i, now in enumerate(measurements):
        if now.status != "measured" or now.pose is None:
            continue
        around = measurements[max(i - 1, 0) : i + 2]
        near = len(around) == 3 and all(abs(m.t - now.t) <= MAX_GAP for m in around)
        errors.append(_alignment_error(around[0], now, around[2]) if near else np.zeros(6))
    return np.array(errors).reshape(-1, 6)


def _alignment_error(before: Measurement, now: Measurement, after: Measurement) -> Array:
    if now.pose is None:
        return np.zeros(6)
    shifts, start = [], 0
    for side in ("left", "right"):
        sightings = [getattr(m, side) for m in (before, now, after)]
        if any(sighting is None for sighting in sightings):
            return np.zeros(6)
        count, lever = len(sightings[1]), sightings[1].acceleration_lever
        corrected = now.pose.curvature[start : start + count]
        start += count
        left_over = _second_difference(*sightings, otherwise=corrected) - corrected
        shifts.append(left_over * lever[:, None])
    error: Array = now.pose.gain @ np.concatenate(shifts).reshape(-1)
    return error


def _second_difference(
    before: Sighting, now: Sighting, after: Sighting, *, otherwise: Array
) -> Array:
    """Acceleration of each LED's image, (m, 2), px/s²; `otherwise` where a neighbour lacks it."""
    acceleration = otherwise.copy()
    if not np.any(now.acceleration_lever) or before.pan != now.pan or after.pan != now.pan:
        return acceleration
    leds = np.concatenate([before.led, now.led, after.led]).max() + 1
    there = []
    for sighting in (before, after):
        place = np.full(leds, -1)
        place[sighting.led] = np.arange(len(sighting))
        there.append(place[now.led])
    both = (there[0] >= 0) & (there[1] >= 0)
    early, late = now.t - before.t, after.t - now.t
    first = (now.centre[both] - before.centre[there[0][both]]) / early
    second = (after.centre[there[1][both]] - now.centre[both]) / late
    acceleration[both] = 2 * (second - first) / (early + late)
    return acceleration


def _pan(sighting: Sighting | None) -> float:
    return sighting.pan if sighting is not None else float("nan")


def _rotate_blocks(turn: Array, matrices: list[Array]) -> Array:
    stack = np.array(matrices).reshape(-1, 6, 6)
    turned: Array = turn @ stack @ turn.T
    return turned
