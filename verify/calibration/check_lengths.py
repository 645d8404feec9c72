"""Known distances between LEDs, as triangulated through the rig over a session."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from verify.marker import Marker
from verify.pose import MODEL_FLOOR_PX
from verify.records import Array, Measurement, Pose
from verify.regression import autocorrelation
from verify.rig import Rig
from verify.systematics import Systematics, sensitivities
from verify.triangulation import triangulate

ROWS = 6  # linear functionals of the pixels that `sensitivities` carries at a time


@dataclass(frozen=True, slots=True)
class Lengths:
    """k distances; each a mean over the pairs that show both ends in both images."""

    ends: tuple[tuple[str, str], ...]  # k pairs of LED names
    known: Array  # (k,), m
    measured: Array  # (k,), m
    uncertainty: Array  # (k,), m, of the difference, all stated sources included
    pairs: NDArray[np.int64]  # (k,), how many stereo pairs show it


@dataclass(frozen=True, slots=True)
class _Length:
    """One distance in one pair."""

    ends: tuple[int, int]  # LED indices
    value: float  # m
    by_pixels: Array  # (8,), m a px: either end's left and right image
    columns: Array  # (p + 2,), m a unit of each parameter and of the pan readings
    pan: tuple[float, float]  # rad, as read


def lengths(
    measurements: Sequence[Measurement], rig: Rig, marker: Marker, parameters: Systematics
) -> Lengths:
    """Triangulate the marker's own distances.

    Args:
        measurements: pairs with a pose; spots that it refused are left out where it settled.
        rig: the cameras; where the robot stands is not used.
        marker: the known distances.
        parameters: what is stated of rig and marker.
    """
    shown: dict[tuple[int, int], list[_Length]] = defaultdict(list)
    for m in measurements:
        for length in _of_pair(m, rig, marker, parameters):
            shown[length.ends].append(length)
    found = sorted(shown)
    return Lengths(
        ends=tuple((marker.names[a], marker.names[b]) for a, b in found),
        known=np.array([np.linalg.norm(marker.leds[a] - marker.leds[b]) for a, b in found]),
        measured=np.array([np.mean([s.value for s in shown[ends]]) for ends in found]),
        uncertainty=np.array([_sigma(shown[ends], parameters) for ends in found]),
        pairs=np.array([len(shown[ends]) for ends in found], dtype=np.int64),
    )


def _sigma(shown: list[_Length], parameters: Systematics) -> float:
    """Standard uncertainty of a mean length error: scatter, and what all pairs share."""
    columns = np.mean([s.columns for s in shown], axis=0)
    known = columns[: len(parameters.names)]
    variance = float(known @ parameters.covariance @ known)
    by_pixels = np.mean([s.by_pixels for s in shown], axis=0)
    variance += MODEL_FLOOR_PX**2 * float(by_pixels @ by_pixels)
    for side in (0, 1):
        # of many readings each errs by itself, which the scatter shows
        if parameters.pan[side] > 0 and len({s.pan[side] for s in shown}) == 1:
            variance += float(columns[side - 2] * parameters.pan[side]) ** 2
    scatter = np.array([s.value for s in shown])
    if len(scatter) > 1:
        factor = float(autocorrelation(scatter[:, None])[0])
        variance += factor * float(np.var(scatter, ddof=1)) / len(scatter)
    return float(np.sqrt(variance))


def _of_pair(seen: Measurement, rig: Rig, marker: Marker, parameters: Systematics) -> list[_Length]:
    """Each distance that one pair shows."""
    pose, left, right = seen.pose, seen.left, seen.right
    if pose is None or left is None or right is None:
        return []
    good = ~pose.rejected if pose.consistent else np.ones_like(pose.rejected)
    in_left = {int(led): i for i, led in enumerate(left.led) if good[i]}
    in_right = {int(led): i for i, led in enumerate(right.led) if good[len(left) + i]}
    both = sorted(in_left.keys() & in_right.keys())
    lefts, rights = [in_left[led] for led in both], [in_right[led] for led in both]
    points, _ = triangulate(
        rig.left, rig.right, left.pan, right.pan, left.centre[lefts], right.centre[rights]
    )
    spots = np.stack([lefts, np.add(rights, len(left))], axis=1).astype(int)  # (leds, 2)
    found = []
    for a, b in combinations(range(len(both)), 2):
        apart = points[b] - points[a]
        length = float(np.linalg.norm(apart))
        if np.isfinite(length):
            ends = [
                sign * (apart / length) @ _point_by_pixels(pose, spots[end])
                for end, sign in ((a, -1.0), (b, 1.0))
            ]
            found.append(((both[a], both[b]), length, spots[[a, b]], np.concatenate(ends)))
    functionals = np.zeros((len(found), 2 * len(good)))
    for i, (_, _, where, by_pixels) in enumerate(found):
        functionals[i, (2 * where.reshape(-1, 1) + [0, 1]).reshape(-1)] = by_pixels
    columns = _carried(seen, pose, functionals, rig, marker, parameters)
    return [
        _Length(ends, length, by_pixels, column, (left.pan, right.pan))
        for (ends, length, _, by_pixels), column in zip(found, columns, strict=True)
    ]


def _point_by_pixels(pose: Pose, spots: Array) -> Array:
    """How a triangulated point moves with its two images, (3, 4)."""
    by_point = pose.sensitivity[spots].reshape(4, 3)
    moved: Array = np.linalg.pinv(by_point)
    return moved


def _carried(
    seen: Measurement,
    pose: Pose,
    functionals: Array,
    rig: Rig,
    marker: Marker,
    parameters: Systematics,
) -> list[Array]:
    """Derivatives of linear functionals of the pixels by every parameter, (p + 2,) each."""
    at_origin = replace(rig, rig_T_base=np.eye(4))
    columns: list[Array] = []
    for start in range(0, len(functionals), ROWS):
        some = functionals[start : start + ROWS]
        gain = np.zeros((ROWS, functionals.shape[1]))
        gain[: len(some)] = some
        probe = replace(seen, pose=replace(pose, gain=gain))
        columns += list(sensitivities(parameters, probe, at_origin, marker)[: len(some)])
    return columns
