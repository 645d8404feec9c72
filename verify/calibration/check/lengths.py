"""Measure known distances between LEDs through the rig, over a session.

`BarTracker` keeps the two like ends of a bar apart by continuity.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from verify.analysis.least_squares import autocorrelation
from verify.core.fiducials import Marker
from verify.core.records import Array, Index, Measurement, StereoPair, rigid_transform
from verify.core.rig import Rig
from verify.measurement.chain import detect_in_turn
from verify.measurement.pose import MODEL_ERROR_PX
from verify.measurement.systematics import PAN_READINGS, Systematics, pixel_sensitivities
from verify.measurement.triangulation import triangulate


@dataclass(frozen=True, slots=True)
class Lengths:
    """k distances; each a mean over the pairs that show both ends in both images."""

    ends: tuple[tuple[str, str], ...]  # k pairs of LED names
    known: Array  # (k,), m
    measured: Array  # (k,), m
    uncertainty: Array  # (k,), m, of the difference, all stated sources included
    pairs: Index  # (k,), how many stereo pairs show it


@dataclass(frozen=True, slots=True)
class _PairLength:
    """One distance in one pair."""

    ends: tuple[int, int]  # LED indices
    value: float  # m
    by_pixels: Array  # (8,), m a px: either end's left and right image
    columns: Array  # (p + 2,), m a unit of each parameter and of the pan readings
    pan: tuple[float, float]  # rad, as read


def measured_lengths(
    measurements: Sequence[Measurement], rig: Rig, marker: Marker, parameters: Systematics
) -> Lengths:
    """Triangulate the marker's own distances; the robot's base is not used.

    Spots that a pair's pose refused are left out where the pose settled.
    """
    shown: dict[tuple[int, int], list[_PairLength]] = defaultdict(list)
    for m in measurements:
        for length in _pair_lengths(m, rig, marker, parameters):
            shown[length.ends].append(length)
    found = sorted(shown)
    return Lengths(
        ends=tuple((marker.names[a], marker.names[b]) for a, b in found),
        known=np.array([np.linalg.norm(marker.leds[a] - marker.leds[b]) for a, b in found]),
        measured=np.array([np.mean([s.value for s in shown[ends]]) for ends in found]),
        uncertainty=np.array([_length_uncertainty(shown[ends], parameters) for ends in found]),
        pairs=np.array([len(shown[ends]) for ends in found], dtype=np.int64),
    )


def _length_uncertainty(shown: list[_PairLength], parameters: Systematics) -> float:
    """Standard uncertainty of a mean length error: scatter, and what all pairs share."""
    columns = np.mean([s.columns for s in shown], axis=0)
    known = columns[: len(parameters.names)]
    variance = float(known @ parameters.covariance @ known)
    by_pixels = np.mean([s.by_pixels for s in shown], axis=0)
    variance += MODEL_ERROR_PX**2 * float(by_pixels @ by_pixels)
    for side in (0, 1):
        # of many readings each errs by itself, which the scatter shows
        if parameters.pan[side] > 0 and len({s.pan[side] for s in shown}) == 1:
            variance += float(columns[side - 2] * parameters.pan[side]) ** 2
    scatter = np.array([s.value for s in shown])
    if len(scatter) > 1:
        factor = float(autocorrelation(scatter[:, None])[0])
        variance += factor * float(np.var(scatter, ddof=1)) / len(scatter)
    return float(np.sqrt(variance))


def _pair_lengths(
    measurement: Measurement, rig: Rig, marker: Marker, parameters: Systematics
) -> list[_PairLength]:
    """Each distance that one pair shows."""
    pose, left, right = measurement.pose, measurement.left, measurement.right
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
            # how either point moves with its two images, (3, 4)
            slopes = (np.linalg.pinv(pose.sensitivity[spots[end]].reshape(4, 3)) for end in (a, b))
            ends = [
                s * (apart / length) @ slope for s, slope in zip((-1.0, 1.0), slopes, strict=True)
            ]
            found.append(((both[a], both[b]), length, spots[[a, b]], np.concatenate(ends)))
    functionals = np.zeros((len(found), 2 * len(good)))
    for i, (_, _, where, by_pixels) in enumerate(found):
        functionals[i, (2 * where.reshape(-1, 1) + [0, 1]).reshape(-1)] = by_pixels
    names = (*parameters.names, *PAN_READINGS)
    columns = -functionals @ pixel_sensitivities(names, measurement, rig, marker)
    return [
        _PairLength(ends, length, by_pixels, column, (left.pan, right.pan))
        for (ends, length, _, by_pixels), column in zip(found, columns, strict=True)
    ]


@dataclass
class BarTracker:
    """Proposes the bar's pose in each pair; correspondence takes its own nearest hypothesis."""

    rig: Rig
    marker: Marker  # two LEDs
    _ends: Array | None = None  # (2, 3), m, in the last pair that showed both
    _proposed: dict[float, Array] = field(default_factory=dict)  # the last pair's, by its t_left

    def watch(self, pairs: Iterable[StereoPair]) -> Iterator[StereoPair]:
        """Pass pairs on, after locating the bar in each."""
        for pair in pairs:
            ends = self._locate(pair)
            self._proposed = {}
            if ends is not None:
                self._ends = ends
                self._proposed = {pair.t_left: self._pose(ends)}
            yield pair

    def expected(self, t: float) -> Sequence[Array]:
        """Expected poses at an instant, as `Setup.expected` takes them."""
        return [self._proposed[t]] if t in self._proposed else []

    def _locate(self, pair: StereoPair) -> Array | None:
        """Triangulate the two brightest spots of either image, (2, 3); None: not visible."""
        left, right = detect_in_turn(pair, None, None)
        if min(len(left), len(right)) < 2:
            return None
        ways = []
        for order in ([0, 1], [1, 0]):
            points, gap = triangulate(
                self.rig.left, self.rig.right, pair.pan_left, pair.pan_right,
                left.centre[:2], right.centre[order],
            )  # fmt: skip
            if np.isfinite(points).all():
                ways.append((float(np.sum(gap)), points))
        if not ways:
            return None
        ends = min(ways, key=lambda way: way[0])[1]
        before = self._ends if self._ends is not None else ends[np.argsort(ends[:, 0])]
        crossed = np.sum((ends[::-1] - before) ** 2) < np.sum((ends - before) ** 2)
        return np.asarray(ends[::-1] if crossed else ends, dtype=np.float64)

    def _pose(self, ends: Array) -> Array:
        known = self.marker.leds[1] - self.marker.leds[0]
        turn, _ = Rotation.align_vectors((ends[1] - ends[0])[None], known[None])
        place = ends.mean(axis=0) - turn.as_matrix() @ self.marker.leds.mean(axis=0)
        return rigid_transform(turn.as_matrix(), place)
