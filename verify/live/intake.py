"""One polling thread for each device, so that none can stall another, and the queue of pairs."""

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from verify.devices.protocols import CameraDevice, EncoderDevice, PanDevice
from verify.live.buffers import PanBuffer, ReadingBuffer
from verify.live.pairing import MAX_WAITING, FramePair, Pairing
from verify.live.recording.recorder import SessionRecorder

MAX_QUEUED_PAIRS = 16  # pairs that may wait to be measured: half a second, 30 MB
OVERRUN = "measuring is slower than the cameras"
IDLE_DELAY = 0.005  # s after a read that came back at once with nothing


class PairQueue:
    """Pairs on their way to be measured; the oldest are lost, and counted, when it is full."""

    def __init__(self, pairing: Pairing) -> None:
        self.pairing = pairing
        self._wake = threading.Condition()
        self._pairs: deque[FramePair] = deque()
        self._closed = False

    def add(self, side: int, camera_frame: Any, arrived: float) -> None:
        """Take a picture of the left (0) or right (1) camera."""
        with self._wake:
            pair = self.pairing.add(side, camera_frame, arrived)
            if pair is None:
                return
            self._pairs.append(pair)
            while len(self._pairs) > MAX_QUEUED_PAIRS:
                self._pairs.popleft()
                self.pairing.dropped[OVERRUN] += 1
            self._wake.notify_all()

    def wait_for_room(self, side: int) -> bool:
        """Wait, a moment at most, until a picture of this side would not be lost."""
        with self._wake:
            if not self._room(side):
                self._wake.wait(IDLE_DELAY)
            return self._room(side) or self._closed

    def _room(self, side: int) -> bool:
        return len(self._pairs) < MAX_QUEUED_PAIRS and self.pairing.waiting(side) < MAX_WAITING

    def take(self) -> FramePair | None:
        """Wait for the next pair; None once it is closed and empty."""
        with self._wake:
            while not self._pairs and not self._closed:
                self._wake.wait()
            pair = self._pairs.popleft() if self._pairs else None
            self._wake.notify_all()
            return pair

    def drop(self, reason: str) -> None:
        """Count a pair that was taken and is not measured."""
        with self._wake:
            self.pairing.dropped[reason] += 1

    def dropped(self) -> dict[str, int]:
        """Say how many pictures and pairs were lost, and why."""
        with self._wake:
            return dict(self.pairing.dropped)

    def close(self) -> None:
        """No more pairs; those that are there are still given out."""
        with self._wake:
            self._closed = True
            self._wake.notify_all()


class PollingThread:
    """A thread that calls a function until it is told to stop.

    Args:
        name: of the thread.
        step: reads once, and comes back within a fraction of a second.
        failed: told of a defect, once; the thread goes on.
    """

    def __init__(
        self, name: str, step: Callable[[], bool], failed: Callable[[str, Exception], None]
    ) -> None:
        self._name, self._step, self._failed = name, step, failed
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """Ask it to stop."""
        self._stop.set()

    def join(self, seconds: float) -> None:
        """Wait until it has."""
        self._thread.join(seconds)

    def _run(self) -> None:
        while not self._stop.is_set():
            begin = time.monotonic()
            try:
                gave = self._step()
            except Exception as error:  # a driver promises to raise nothing; others go on
                self._failed(self._name, error)
                gave = False
            if not gave and time.monotonic() - begin < IDLE_DELAY:
                self._stop.wait(IDLE_DELAY)


def camera_step(
    camera: CameraDevice, side: int, queue: PairQueue, *, patient: bool
) -> Callable[[], bool]:
    """Read one picture into the queue; patient: only when there is room for it."""

    def step() -> bool:
        if patient and not queue.wait_for_room(side):
            return False
        frame = camera.read()
        if frame is None:
            return False
        queue.add(side, frame, time.monotonic())
        return True

    return step


def encoders_step(
    encoders: EncoderDevice, recorder: SessionRecorder, book: ReadingBuffer
) -> Callable[[], bool]:
    """Read what has come, record it, and make it known."""

    def step() -> bool:
        readings = encoders.read()
        for reading in readings:
            book.add(recorder.reading(reading))
        return bool(readings)

    return step


def pan_step(
    pan: PanDevice, book: PanBuffer, turn: Callable[[], None] | None = None
) -> Callable[[], bool]:
    """Read how the bases stand; turn them first, where an order waits."""

    def step() -> bool:
        if turn is not None:
            turn()
        readings = pan.read()
        for reading in readings:
            book.add(reading)
        return bool(readings)

    return step
