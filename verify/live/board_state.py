"""What is known right now while board pictures are taken, for whoever looks."""

import threading
from dataclasses import dataclass, field, replace

from verify.board import BoardView
from verify.live.board_goals import Coverage, Goal
from verify.live.board_taken import Standing
from verify.live.state import DeviceLine
from verify.records import Image

SEARCHING = "searching"  # nothing to take
ALIKE = "alike"  # it would repeat a pair; by hand it can be taken
MOVING = "moving"  # likewise
READY = "ready"  # taken by itself


@dataclass(frozen=True, slots=True)
class BoardLook:
    """The newest pair and what was found in it."""

    number: int
    images: tuple[Image, Image]
    views: tuple[BoardView | None, BoardView | None]


@dataclass(frozen=True, slots=True)
class BoardSnapshot:
    """Everything that there is to say, at one moment."""

    pairs: int = 0
    status: str = SEARCHING
    words: str = "waiting for the cameras"
    motion: float | None = None  # px
    last: str = ""  # what became of the last pair that was taken or asked for
    goals: tuple[Goal, ...] = ()
    coverage: tuple[Coverage, ...] = ()  # left, right
    standings: tuple[Standing, ...] = ()  # of the board now: left, right; empty where not seen
    devices: tuple[DeviceLine, ...] = ()
    finished: bool = False
    look: BoardLook | None = None


@dataclass
class BoardState:
    """Shared between the loop, which writes, and lookers-on, who read."""

    _lock: threading.Lock = field(default_factory=threading.Lock)
    _now: BoardSnapshot = BoardSnapshot()

    def change(self, **news: object) -> None:
        """Take what is new: fields of `BoardSnapshot`."""
        with self._lock:
            self._now = replace(self._now, **news)  # type: ignore[arg-type]  # its own fields

    def snapshot(self) -> BoardSnapshot:
        """Say everything."""
        with self._lock:
            return self._now
