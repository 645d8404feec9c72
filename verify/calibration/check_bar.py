"""A bar of two LEDs: which of two like lights is which does not matter, but one must be chosen."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from verify.detection import detect
from verify.marker import Marker
from verify.records import Array, StereoPair
from verify.rig import Rig
from verify.triangulation import triangulate


@dataclass
class BarPoses:
    """Watches pairs go by and proposes where the bar is, ends kept apart by continuity.

    A choice, never a value: identification takes the nearest of its own hypotheses.
    """

    rig: Rig
    marker: Marker  # two LEDs
    _ends: Array | None = None  # (2, 3), m, in the last pair that showed both
    _proposed: dict[float, Array] = field(default_factory=dict)  # the last pair's, by its t_left

    def watch(self, pairs: Iterable[StereoPair]) -> Iterator[StereoPair]:
        """Pass pairs on, each looked at first."""
        for pair in pairs:
            ends = self._look(pair)
            self._proposed = {}
            if ends is not None:
                self._ends = ends
                self._proposed = {pair.t_left: self._pose(ends)}
            yield pair

    def expected(self, t: float) -> Sequence[Array]:
        """What `Setup.expected` asks for."""
        return [self._proposed[t]] if t in self._proposed else []

    def _look(self, pair: StereoPair) -> Array | None:
        """Both ends by the two brightest spots of either image, (2, 3); None: not seen."""
        left, right = detect(pair.left), detect(pair.right)
        if min(len(left), len(right)) < 2:
            return None
        ways = []
        for order in ([0, 1], [1, 0]):
            points, gap = triangulate(
                self.rig.left,
                self.rig.right,
                pair.pan_left,
                pair.pan_right,
                left.centre[:2],
                right.centre[order],
            )
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
        pose = np.eye(4)
        pose[:3, :3] = turn.as_matrix()
        pose[:3, 3] = ends.mean(axis=0) - pose[:3, :3] @ self.marker.leds.mean(axis=0)
        return pose
