"""Is the board held still? By how far its corners move in both pictures over a while."""

from collections import deque
from collections.abc import Sequence
from functools import reduce

import numpy as np

from verify.board import BoardView

STILL_PX = 0.3  # rms over the corners, about their means; a glimpse's own noise is half at most
STILL_FOR = 0.6  # s
PICTURES = 4  # at least, within it


class Stillness:
    """Watches a board in both pictures.

    Two cameras that run freely take their pictures up to half a period apart. A steady drift that
    passes is 1 px/s at most: 0.02 px in the 17 ms of two cameras at 30 Hz.
    """

    def __init__(self) -> None:
        self._seen: deque[tuple[float, BoardView, BoardView]] = deque()

    def add(self, t: float, left: BoardView | None, right: BoardView | None) -> None:
        """Take what was seen at t, s; a picture without a board begins anew."""
        if left is None or right is None:
            self._seen.clear()
            return
        self._seen.append((t, left, right))
        while len(self._seen) > PICTURES and self._seen[1][0] <= t - STILL_FOR:
            self._seen.popleft()

    @property
    def motion(self) -> float | None:
        """How far the corners move, px: the most of both cameras; None where nothing tells yet."""
        if len(self._seen) < 2:
            return None
        _, left, right = zip(*self._seen, strict=True)
        return max(_motion(left), _motion(right))

    @property
    def still(self) -> bool:
        """Whether they have hardly moved for long enough."""
        if len(self._seen) < PICTURES or self._seen[-1][0] - self._seen[0][0] < STILL_FOR:
            return False
        motion = self.motion
        return motion is not None and motion < STILL_PX


def _motion(views: Sequence[BoardView]) -> float:
    """The farthest that corners, rms over all, stray from their mean places, px."""
    common = reduce(np.intersect1d, [view.corner for view in views])
    if not len(common):
        return float("inf")
    places = np.stack([view.centre[np.isin(view.corner, common)] for view in views])
    astray = np.sum((places - places.mean(axis=0)) ** 2, axis=2)
    return float(np.sqrt(astray.mean(axis=1).max()))
