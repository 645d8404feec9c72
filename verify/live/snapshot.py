"""A snapshot that a loop writes and displays read, and what the pages of such snapshots share."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from verify.core.records import Image
from verify.live.page.scene import image_size, small_jpeg

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

SnapshotT = TypeVar("SnapshotT", bound="DataclassInstance")
FoundT = TypeVar("FoundT")

MAX_TEXT_LENGTH = 2000  # characters of a description


class SharedSnapshot(Generic[SnapshotT]):
    """Holds a frozen dataclass; the loop changes its fields, displays read it whole."""

    def __init__(self, first: SnapshotT) -> None:
        self._lock, self._now = threading.Lock(), first

    def change(self, **news: object) -> None:
        """Take what is new: fields of the dataclass."""
        with self._lock:
            self._now = replace(self._now, **news)

    def snapshot(self) -> SnapshotT:
        """Give the whole."""
        with self._lock:
            return self._now


@dataclass(frozen=True, slots=True)
class PairLook:
    """A pair that can be shown."""

    number: int  # of the pair
    images: tuple[Image, Image]  # left, right


class SnapshotPageSource(Generic[SnapshotT]):
    """Gives a page what is new in a snapshot; nothing waits for it."""

    def __init__(self, state: SharedSnapshot[SnapshotT]) -> None:
        self._state = state
        self._shown = -1  # number of the pair that was given last
        self._last_row: dict[str, Any] = {}

    def alarms(self) -> Sequence[dict[str, Any]]:
        """There are none: nothing is compared."""
        return ()

    def news(self, row: dict[str, Any]) -> list[dict[str, Any]]:
        """Give a row unless it is the last one again."""
        same, self._last_row = row == self._last_row, row
        return [] if same else [row]

    def new_pictures(
        self,
        look: PairLook | None,
        found: Sequence[FoundT],
        fields: Callable[[FoundT], dict[str, Any]],
    ) -> list[tuple[int, dict[str, Any], bytes]]:
        """Both images of a pair with what was `found` in each; nothing if it was given already."""
        if look is None or look.number == self._shown:
            return []
        self._shown = look.number
        return [
            (side, image_size(image) | fields(one), small_jpeg(image))
            for side, (image, one) in enumerate(zip(look.images, found, strict=True))
        ]
