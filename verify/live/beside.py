"""Both pictures of a pair at once: the right one in a second process, for latency's sake."""

import threading
from collections.abc import Callable

from verify.detection import detect
from verify.helper import Helper, HelperLateError, HelperLostError
from verify.priority import come_soon, keep_apart
from verify.records import Array, Image, Spots
from verify.shared_picture import SharedPicture, picture_of, place_of

PATIENCE = 1.0  # s for a picture, ten times what a whole frame takes; then it is done here
Question = tuple[str, tuple[int, ...], Array | None]  # shared memory, shape, windows


class BesideDetector:
    """Finds the spots of both pictures at once; the same spots as one after the other.

    Both pictures are searched here while the second process is late, and from then on should it be
    lost.

    Args:
        warn: is told if so; the first time, if it is late.

    Raises:
        HelperLostError: the second process does not start.
    """

    def __init__(self, warn: Callable[[str], None]) -> None:
        self._warn, self._told = warn, False
        self._helper: Helper[Question, Spots] | None = Helper(
            _detect_there, "right picture", prepare=come_soon
        )
        self._helper.wait_until_ready()
        self._picture = SharedPicture()
        self._lock = threading.Lock()

    def __call__(
        self, left: Image, right: Image, left_windows: Array | None, right_windows: Array | None
    ) -> tuple[Spots, Spots]:
        """Find the spots of a pair.

        Args:
            left: (h, w) grey or (h, w, 3) BGR.
            right: likewise.
            left_windows: (m, 4) px, where to look; None: everywhere.
            right_windows: likewise.
        """
        helper = self._helper
        if helper is None:
            return detect(left, left_windows), detect(right, right_windows)
        try:
            helper.begin((*(place_of(right) or self._picture.put(right)), right_windows))
            here = detect(left, left_windows)
            return here, helper.finish(PATIENCE)
        except HelperLateError as error:
            if not self._told:
                self._warn(f"pictures are searched one after the other now and then: {error}")
            self._told = True
        except HelperLostError as error:
            self._warn(f"pictures are searched one after the other from now on: {error}")
            self.close()
        return detect(left, left_windows), detect(right, right_windows)

    def spread(self) -> None:
        """Have both pictures searched on processors of their own; moves the calling thread."""
        if self._helper is not None:
            keep_apart(self._helper.pid)

    def close(self) -> None:
        """End the second process."""
        with self._lock:
            if self._helper is not None:
                self._helper.close()
                self._helper = None
            self._picture.close()


def _detect_there(question: Question) -> Spots:
    name, shape, windows = question
    return detect(picture_of(name, shape), windows)
