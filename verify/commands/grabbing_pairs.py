"""Pairs of a station's cameras for a grab: the newest, with the angles of their bases."""

import threading
import time
from collections.abc import Callable

from verify.cameras import Camera
from verify.devices import Pan
from verify.live.intake import Pump, pan_step
from verify.live.pairing import FramePair, Pairing
from verify.live.pan_book import PanBook
from verify.records import StereoPair
from verify.rig import Rig
from verify.terminal import terminal

UNKNOWN = "a camera base turns, or its angle is not known: its pictures are not used"


class LivePairs:
    """The newest pair of two cameras that run freely; none of a time when a base was turning.

    Args:
        cameras: left and right; closed with this.
        pan: tells how the bases stand; closed with this. None: they stand as the rig says.
        rig: where they stand.
        rate: Hz, of the loop.
        began: s, host's monotonic clock: zero of the pairs' times.
    """

    def __init__(
        self, cameras: tuple[Camera, Camera], pan: Pan | None, rig: Rig, rate: float, began: float
    ) -> None:
        self._rig, self._period, self._began = rig, 1 / rate, began
        self._pairing, self._lock = Pairing(1 / rate), threading.Lock()
        self._newest: tuple[FramePair, tuple[float, float]] | None = None
        self._cameras, self._pan, self._book = cameras, pan, PanBook()
        self._frame, self._due = 0, time.monotonic()
        self._known = True
        self._pumps = [
            Pump(f"{name} camera", self._step(side), _defect)
            for side, name in enumerate(("left", "right"))
        ]
        if pan is not None:
            self._pumps.append(Pump("pan bases", pan_step(pan, self._book), _defect))
        for pump in self._pumps:
            pump.start()

    def pair(self) -> StereoPair | None:
        """Take the newest pair; None where none has come since last time."""
        with self._lock:
            taken, self._newest = self._newest, None
        if taken is None:
            return None
        self._frame += 1
        (left, right), pans = (taken[0].left, taken[0].right), taken[1]
        times = (left.t - self._began, right.t - self._began)
        return StereoPair(self._frame - 1, *times, *pans, left.image, right.image)

    def wait(self) -> None:
        """Wait until the next turn is due."""
        self._due = max(self._due + self._period, time.monotonic())
        time.sleep(max(0.0, self._due - time.monotonic()))

    def close(self) -> None:
        """Let go of the cameras and the bases."""
        for pump in self._pumps:
            pump.stop()
        for pump in self._pumps:
            pump.join(1.0)
        for camera in self._cameras:
            camera.close()
        if self._pan is not None:
            self._pan.close()

    def _step(self, side: int) -> Callable[[], bool]:
        def step() -> bool:
            frame = self._cameras[side].read()
            if frame is None:
                return False
            with self._lock:
                pair = self._pairing.add(side, frame, time.monotonic())
            if pair is not None:
                self._keep(pair)
            return True

        return step

    def _keep(self, pair: FramePair) -> None:
        """Keep a pair whose bases stood; in the camera's thread: word of them may take a moment."""
        pans = self._pans(pair)
        if (pans is not None) != self._known:
            self._known = pans is not None
            if not self._known:
                terminal.warn(UNKNOWN)
        if pans is None:
            return
        with self._lock:
            if self._newest is None or self._newest[0].left.t < pair.left.t:
                self._newest = (pair, pans)

    def _pans(self, pair: FramePair) -> tuple[float, float] | None:
        """How the bases stood, rad, left and right; each at its own picture's instant."""
        if self._pan is None:
            return self._rig.left.pan, self._rig.right.pan
        left, right = self._book.at(pair.left.t), self._book.at(pair.right.t)
        return None if left is None or right is None else (left[0], right[1])


def _defect(name: str, error: Exception) -> None:
    terminal.warn(f"{name}: {error}")
