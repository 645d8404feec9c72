"""The measured poses of a session as arrays in the robot's base frame: the seam to the tables."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np

from verify.core.records import Array, Index, Measurement, Sighting, take_rows
from verify.core.rig import Rig
from verify.measurement.alignment import MAX_GAP


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """n measured pairs. Twists are (translation, rotation vector) in base axes at the flange."""

    frame: Array  # (n,), int
    t: Array  # (n,), s, the left camera's instant
    pan: Array  # (n, 2), rad, as read
    base_T_flange: Array  # (n, 4, 4)
    covariance_pixels: Array  # (n, 6, 6), m and rad
    covariance_alignment: Array  # (n, 6, 6)
    acceleration_prior: Array  # (n, 2), m/s², rad/s²
    order: Index  # (n,), of the lowest derivative that alignment misses, from 2
    alignment_error: Array  # (n, 6), what the motion about a pair leaves of alignment
    systematic: Array  # (n, 6, p): d measured pose / d parameter of `Systematics`
    tilt: Array  # (n, 6, k), what a camera that was tilted in the session may have done; k 0 or 2
    determined: tuple[Array, ...]  # n of (6, d)

    def __len__(self) -> int:
        """Count the measured pairs."""
        return len(self.frame)

    @property
    def known_dof(self) -> Array:
        """Degrees of freedom determined in each pair, (n,)."""
        return np.array([b.shape[1] for b in self.determined], dtype=np.int64)


def subset(track: Track, chosen: Index) -> Track:
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
    base_T_rig, turn = _base(rig.rig_T_base.tobytes())
    n = len(measured)
    poses = [m.pose for m in measured if m.pose is not None]
    spread = np.array([[p.covariance_pixels, p.covariance_alignment] for p in poses])
    pixels, alignment = turn @ spread.reshape(n, 2, 6, 6).swapaxes(0, 1) @ turn.T
    return Track(
        frame=np.array([m.frame for m in measured], dtype=np.int64),
        t=np.array([m.t for m in measured]),
        pan=np.array([[_pan(m.left), _pan(m.right)] for m in measured]).reshape(n, 2),
        base_T_flange=np.array([base_T_rig @ p.rig_T_flange for p in poses]).reshape(n, 4, 4),
        covariance_pixels=pixels,
        covariance_alignment=alignment,
        acceleration_prior=np.array([p.acceleration_prior for p in poses]).reshape(n, 2),
        order=np.array([_lowest_order(m) for m in measured], dtype=np.int64),
        alignment_error=_alignment_errors(measurements) @ turn.T
        if len(measurements) > 2  # a second derivative's window
        else np.zeros((n, 6)),
        systematic=np.array(systematic).reshape(n, 6, -1) if n else np.zeros((0, 6, 0)),
        tilt=np.zeros((n, 6, 0)),
        # of all six any basis serves: one array for all pairs
        determined=tuple(turn @ p.determined if p.known_dof < 6 else turn for p in poses),
    )


@lru_cache(maxsize=4)
def _base(rig_T_base: bytes) -> tuple[Array, Array]:
    """Carry poses (4, 4) and twists (6, 6) from the rig to the robot's base, given as bytes."""
    base_T_rig: Array = np.asarray(np.linalg.inv(np.frombuffer(rig_T_base).reshape(4, 4)))
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = base_T_rig[:3, :3]
    return base_T_rig, turn


def _alignment_errors(measurements: list[Measurement]) -> Array:
    """How far the motion that alignment cannot know puts each measured pose off, (n, 6), rig axes.

    The line through two sightings misses the acceleration, the parabola through three the jerk, the
    cubic the snap; differences over windows of pairs show each. The values stay as they are: this
    goes into the judgement, as a term that does not average out when the arm accelerates one way.
    """
    errors, count = [], len(measurements)
    for i, now in enumerate(measurements):
        if now.status != "measured" or now.pose is None:
            continue
        left_over, start = np.zeros_like(now.pose.residual), 0
        for side in ("left", "right"):
            sighting: Sighting | None = getattr(now, side)
            if sighting is None:
                break
            part = left_over[start : start + len(sighting)]
            curvature = now.pose.curvature[start : start + len(sighting)]
            start += len(sighting)
            for order, known in ((2, curvature), (3, 0.0), (4, 0.0)):
                # of neighbours that show this derivative; they hold all that the curve went
                # through: the pair before the one before as well
                earliest, latest = i - min(order, 3), min(i - order + 2, count - order - 1)
                windows = range(max(earliest, 0), latest + 1)
                lever = sighting.lever[:, order - 2, None]
                if windows and lever.any():
                    shown = _image_derivative(measurements, i, side, windows, order) - known
                    part += lever * np.nan_to_num(shown)
        errors.append(now.pose.gain @ left_over.reshape(-1))
    return np.array(errors).reshape(-1, 6)


def _image_derivative(
    measurements: list[Measurement], i: int, side: str, windows: range, order: int
) -> Array:
    """Derivative of each LED's image in pair i, (m, 2), px/s^order; nan where no window shows it.

    The mean over the windows of neighbouring pairs that hold the pair: its noise is the least.
    """
    now: Sighting = getattr(measurements[i], side)
    total, count = np.zeros_like(now.centre), np.zeros((len(now), 1))
    for first in windows:
        window = measurements[first : first + order + 1]
        found = [getattr(m, side) for m in window]
        if any(s is None or s.pan != now.pan or not len(s) for s in found):
            continue
        t = np.array([m.t for m in window])
        if np.diff(t).max() > MAX_GAP:
            continue
        places = np.array([_centres_of(now.led, sighting) for sighting in found])
        there = ~np.isnan(places).any(axis=(0, 2))
        total[there] += np.tensordot(difference_weights(t), places[:, there], axes=1)
        count[there] += 1
    with np.errstate(invalid="ignore"):
        mean: Array = total / count
    return mean


def difference_weights(t: Array) -> Array:
    """Weights (..., k + 1) of values at t, s, in the k-th derivative: a divided difference."""
    apart = t[..., :, None] - t[..., None, :] + np.eye(t.shape[-1])
    weights: Array = math.factorial(t.shape[-1] - 1) / apart.prod(axis=-1)
    return weights


def _centres_of(leds: Index, sighting: Sighting) -> Array:
    """Centres of some LEDs in a sighting, (m, 2), px; nan where they are not in it."""
    row = np.searchsorted(sighting.led, leds, sorter=(order := np.argsort(sighting.led)))
    row = order[np.minimum(row, len(order) - 1)]
    return np.where((sighting.led[row] == leds)[:, None], sighting.centre[row], np.nan)


def _lowest_order(measurement: Measurement) -> int:
    for order in (2, 3, 4):
        for side in (measurement.left, measurement.right):
            if side is not None and np.count_nonzero(side.lever[:, order - 2]):
                return order
    return 2


def _pan(sighting: Sighting | None) -> float:
    return sighting.pan if sighting is not None else float("nan")
