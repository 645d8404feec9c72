"""The last pairs of a recording that was cut off: they are in pending.raw, not in the videos."""

from collections.abc import Generator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from verify.pending import NAME, PendingPair, PendingPicture, pending_pairs
from verify.records import Image
from verify.series import Frames
from verify.video import Images

Sides = tuple[Images, Images]


class Continued(Images):
    """A camera's images up to one, and those that were not encoded any more.

    Args:
        before: the images.
        count: how many of them.
        after: the others.
    """

    def __init__(self, before: Images, count: int, after: Sequence[PendingPicture]) -> None:
        super().__init__(before.path)
        self._before, self._count, self._after = before, count, after

    def count(self, torn: bool = False) -> int:
        """Count the images; none of them is damaged, or it would not be counted here."""
        del torn
        return self._count + len(self._after)

    def images(self) -> Generator[Image]:
        """Decode the images one after the other."""
        yield from islice(self._before.images(), self._count)
        for picture in self._after:
            yield picture.read()


def with_pending(folder: Path, frames: Frames, sides: Sides) -> tuple[Frames, Sides, int]:
    """Add the pairs that were set aside.

    Args:
        folder: the session's.
        frames: the pairs that the videos hold, all of them whole.
        sides: the videos.

    Returns:
        Frames and sides with the others, and how many those are.

    Raises:
        InputError: pending.raw cannot be read.
    """
    count = len(frames)
    pending = pending_pairs(folder / NAME, count)
    if not pending:
        return frames, sides, 0
    left, right = (
        Continued(images, count, [pair.pictures[side] for pair in pending])
        for side, images in enumerate(sides)
    )
    return _joined(frames, pending), (left, right), len(pending)


def _joined(frames: Frames, pending: list[PendingPair]) -> Frames:
    told = np.array([(*pair.t, *pair.pan) for pair in pending])
    before = (frames.t_left, frames.t_right, frames.pan_left, frames.pan_right)
    return Frames(*(np.append(old, new) for old, new in zip(before, told.T, strict=True)))
