"""One polling thread for each device, so that none can stall another, and the queue of pairs."""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import numpy as np

from verify.core.records import Image, same_picture
from verify.devices.protocols import (
    CameraDevice,
    CameraFrame,
    CameraState,
    CapturedPair,
    Device,
    DeviceState,
    EncoderReading,
)
from verify.errors import defect_text
from verify.live.buffers import PanBuffer
from verify.live.pairing import MAX_WAITING, FramePair, Pairing
from verify.live.protocols import LiveDevices

MAX_QUEUED_PAIRS = 16  # pairs that may wait to be measured: half a second, 30 MB
OVERRUN = "measuring is slower than the cameras"
REPEATED = "the previous picture again"  # a camera's noise never repeats
BASE_TURNING = "a camera base was turning, or its angle is not known"
IDLE_DELAY = 0.005  # s after a read that came back at once with nothing
JOIN_TIMEOUT = 3.0  # s


Reading = TypeVar("Reading")
State = TypeVar("State")


class PairQueue:
    """Pairs on their way to be measured; the oldest are lost, and counted, when it is full.

    With a size of 1 only the newest is given out.
    """

    def __init__(self, pairing: Pairing, size: int = MAX_QUEUED_PAIRS) -> None:
        self.pairing, self._size = pairing, size
        self._wake = threading.Condition()
        self._pairs: deque[FramePair] = deque()
        self._closed = False

    def add(self, side: int, camera_frame: CameraFrame, arrived: float) -> None:
        """Take a picture of the left (0) or right (1) camera."""
        with self._wake:
            pair = self.pairing.add(side, camera_frame, arrived)
            if pair is None:
                return
            self._pairs.append(pair)
            while len(self._pairs) > self._size:
                self._pairs.popleft()
                self.pairing.dropped[OVERRUN] += 1
            self._wake.notify_all()

    def wait_for_room(self, side: int) -> bool:
        """Wait, a moment at most, until a picture of this side would not be lost."""
        with self._wake:
            return self._wake.wait_for(lambda: self._room(side), IDLE_DELAY) or self._closed

    def _room(self, side: int) -> bool:
        return len(self._pairs) < self._size and self.pairing.waiting(side) < MAX_WAITING

    def take(self, timeout: float | None = None) -> FramePair | None:
        """Wait for the next pair; None once it is closed and empty, or after a time-out, s."""
        with self._wake:
            self._wake.wait_for(lambda: self._pairs or self._closed, timeout)
            pair = self._pairs.popleft() if self._pairs else None
            self._wake.notify_all()
            return pair

    def drop(self, reason: str) -> None:
        """Count a pair that was taken and is not measured."""
        with self._wake:
            self.pairing.dropped[reason] += 1

    def dropped(self) -> dict[str, int]:
        """Counts of the pictures and pairs that were lost, by reason."""
        with self._wake:
            return dict(self.pairing.dropped)

    def close(self) -> None:
        """No more pairs; those that are there are still given out."""
        with self._wake:
            self._closed = True
            self._wake.notify_all()


class PollingThread(threading.Thread):
    """Calls a function until it is stopped.

    A step reads once, within a fraction of a second; False if nothing came. `failed` is called with
    the first error of several in a row, `recovered` with their number once something comes again;
    the thread goes on.
    """

    def __init__(
        self,
        name: str,
        step: Callable[[], bool],
        failed: Callable[[str, Exception], None],
        recovered: Callable[[str, int], None] = lambda *_: None,
    ) -> None:
        super().__init__(name=name, daemon=True)
        self._step, self._failed, self._recovered = step, failed, recovered
        self._over, self._failures = threading.Event(), 0

    def stop(self) -> None:
        """Ask it to stop."""
        self._over.set()

    def run(self) -> None:
        """Call the function; the thread's own work."""
        while not self._over.is_set():
            begin = time.monotonic()
            try:
                gave = self._step()
                if gave and self._failures:
                    self._recovered(self.name, self._failures)
                    self._failures = 0
            except Exception as error:  # a driver promises to raise nothing; others go on
                if not self._failures:
                    self._failed(self.name, error)
                self._failures += 1
                gave = False
            if not gave and time.monotonic() - begin < IDLE_DELAY:
                self._over.wait(IDLE_DELAY)


def stop_threads(threads: Sequence[PollingThread], timeout: float) -> None:
    """Stop threads; each is given so many s to end."""
    for thread in threads:
        thread.stop()
    for thread in threads:
        thread.join(timeout)


def camera_step(
    camera: CameraDevice, side: int, queue: PairQueue, *, patient: bool, differ: bool = False
) -> Callable[[], bool]:
    """Read one picture into the queue; patient: only when there is room for it.

    With `differ`, one that equals the picture before is dropped: it shows an earlier instant.
    """
    before: Image = np.empty((0, 0), dtype=np.uint8)

    def step() -> bool:
        nonlocal before
        if patient and not queue.wait_for_room(side):
            return False
        frame = camera.read()
        if frame is None:
            return False
        last, before = before, frame.image
        if differ and same_picture(last, before):
            queue.drop(REPEATED)
        else:
            queue.add(side, frame, time.monotonic())
        return True

    return step


def readings_step(
    device: Device[list[Reading], State],
    add: Callable[[Reading], None],
    before: Callable[[], None] = lambda: None,
) -> Callable[[], bool]:
    """Read encoders or bases, and hand on each reading; `before` is called first."""

    def step() -> bool:
        before()
        readings = device.read()
        for reading in readings:
            add(reading)
        return bool(readings)

    return step


class DeviceIntake:
    """All devices of a run, each read in a thread of its own; pairs of pictures come out.

    Args:
        devices: open; `close` closes them.
        standing: angles of bases that no device reads, left and right, rad.
        take: called with each encoder reading, in the encoders' thread.
        before_pan: called before each read of the bases, in theirs.
    """

    def __init__(
        self,
        devices: LiveDevices,
        standing: tuple[float, float],
        take: Callable[[EncoderReading], None],
        before_pan: Callable[[], None] = lambda: None,
    ) -> None:
        self._devices, self._standing = devices, standing
        self._queue, self._pan = PairQueue(Pairing()), PanBuffer()
        self.troubles: dict[str, str] = {}  # defects of this program, by thread
        self._ran = False
        self.named: dict[str, Device[object, DeviceState | CameraState]] = {
            "left camera": devices.left,
            "right camera": devices.right,
            "encoders": devices.encoders,
        }
        files, queue = devices.files, self._queue
        steps = [
            ("left camera", camera_step(devices.left, 0, queue, patient=files, differ=not files)),
            ("right camera", camera_step(devices.right, 1, queue, patient=files, differ=not files)),
            ("encoders", readings_step(devices.encoders, take)),
        ]
        if devices.pan is not None:
            self.named["pan bases"] = devices.pan
            steps.append(("pan bases", readings_step(devices.pan, self._pan.add, before_pan)))
        self._threads = [PollingThread(name, step, self.fail) for name, step in steps]

    def fail(self, name: str, error: BaseException) -> None:
        """Take note of a defect; the threads go on."""
        self.troubles[name] = defect_text(error)

    def start(self) -> None:
        """Begin to read."""
        for thread in self._threads:
            thread.start()

    def over(self) -> bool:
        """Whether the robot's program has ended, or the pictures have."""
        running = self._devices.encoders.state().program_running
        self._ran = self._ran or running is True
        if self._ran and running is False:
            return True
        return all(camera.state().ended for camera in (self._devices.left, self._devices.right))

    def pairs(self) -> Iterator[tuple[CapturedPair, float, float]]:
        """Pairs of pictures with their bases' angles, until `end_pictures`.

        With each: when it arrived, and within what its times are known, both s, host's monotonic
        clock.
        """
        frame = 0
        while (pair := self._queue.take()) is not None:
            pan = self._standing if self._devices.pan is None else self._pan.of_pair(pair)
            if pan is None:
                self._queue.drop(BASE_TURNING)
                continue
            left, right = pair.left, pair.right
            raws, images = (left.raw, right.raw), (left.image, right.image)
            lossy = (left.raw is not None, right.raw is not None)
            taken = CapturedPair(frame, left.t, right.t, *pan, *images, lossy, *raws)
            frame += 1
            yield taken, pair.arrived, max(left.t_uncertainty, right.t_uncertainty)

    def dropped(self) -> dict[str, int]:
        """Counts of the pictures and pairs that were lost, by reason."""
        return self._queue.dropped()

    def end_pictures(self) -> None:
        """Stop the cameras' threads; pairs that are there are still given out."""
        stop_threads(self._threads[:2], JOIN_TIMEOUT)
        self._queue.close()

    def end_readings(self) -> None:
        """Stop the threads of encoders and bases."""
        stop_threads(self._threads[2:], JOIN_TIMEOUT)

    def close(self) -> None:
        """Close all devices."""
        for device in self.named.values():
            device.close()
