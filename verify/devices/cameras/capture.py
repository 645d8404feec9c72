"""Open a camera by its settings, and read it in a thread that opens it again when it is lost."""

import threading
import time
from collections import deque
from collections.abc import Callable
from functools import partial

from verify.devices import protocols
from verify.devices.cameras.opencv import OpenCvSource
from verify.devices.cameras.replay import ReplaySource
from verify.devices.cameras.stream import StreamSource
from verify.errors import defect_text

MAX_QUEUED = 4  # pictures that wait for a slow reader; the oldest goes first
MIN_RETRY_DELAY, MAX_RETRY_DELAY = 0.25, 4.0  # s: doubled from the one to the other
SILENCE_TIMEOUT = 2.0  # s
JOIN_TIMEOUT = 1.0  # s; a driver that hangs is left behind


def open_camera(settings: protocols.CameraSettings) -> protocols.CameraDevice:
    """Open a camera: index or device path through OpenCV, URL through ffmpeg, or a file.

    A camera that is not there is looked for until it is.

    Raises:
        InputError: a file that does not exist.
    """
    source = settings.source
    if is_file(source):
        return ReplaySource(settings)
    if isinstance(source, str) and "://" in source:
        return CameraCapture(source, partial(StreamSource, settings), settings.size)
    name = source if isinstance(source, str) else f"camera {source}"
    return CameraCapture(name, partial(OpenCvSource, settings), settings.size)


def is_file(source: int | str) -> bool:
    """Whether a camera's source is a video file or a folder of pictures."""
    return isinstance(source, str) and "://" not in source and not source.startswith("/dev/")


CameraSource = OpenCvSource | StreamSource


class CameraCapture:
    """Keeps a camera open, and its newest pictures at hand.

    To open it may raise OSError while that is not possible. Pictures must have the size, width and
    height, px: a calibration holds for one.
    """

    def __init__(
        self,
        name: str,
        open_source: Callable[[], CameraSource],
        size: tuple[int, int] | None = None,
    ) -> None:
        self._name, self._open_source, self._wanted = name, open_source, size
        self._frames: deque[protocols.CameraFrame] = deque()
        self._here = threading.Condition()
        self._closed = threading.Event()
        self._connected = False
        self._fault = "being opened"
        self._refused: tuple[protocols.RefusedSetting, ...] = ()
        self._count = self._lost = self._spoilt = 0
        self._size: tuple[int, int] | None = None
        self._arrival: float | None = None  # s, of the last picture
        self._thread = threading.Thread(target=self._run, name=f"camera {name}", daemon=True)
        self._thread.start()

    def read(self) -> protocols.CameraFrame | None:
        """Give the oldest picture that was not read yet; None after READ_TIMEOUT without one."""
        with self._here:
            if not self._frames:
                self._here.wait(protocols.READ_TIMEOUT)
            return self._frames.popleft() if self._frames else None

    def state(self) -> protocols.CameraState:
        """Say how the camera is."""
        age = None if self._arrival is None else time.monotonic() - self._arrival
        return protocols.CameraState(
            self._connected, age, self._lost, self._sentence(age), self._refused
        )

    def close(self) -> None:
        """Let go of the camera."""
        self._closed.set()
        self._thread.join(JOIN_TIMEOUT)

    def _sentence(self, age: float | None) -> str:
        if not self._connected:
            return f"{self._name}: not connected: {self._fault}"
        status = "reading"
        if age is None or age > SILENCE_TIMEOUT:
            status = "connected, no picture yet" if age is None else f"silent for {age:.1f} s"
        parts = [status]
        if self._size is not None and not self._fits(self._size):
            wanted = "{} x {}".format(*self._wanted or ())
            parts = ["gives pictures of {} x {} px".format(*self._size) + f"; {wanted} are needed"]
        parts += map(str, self._refused)
        parts += [f"{self._spoilt} pictures could not be decoded"] if self._spoilt else []
        parts += [f"{self._lost} pictures that nobody read in time"] if self._lost else []
        return f"{self._name}: {'; '.join(parts)}"

    def _fits(self, size: tuple[int, int]) -> bool:
        return self._wanted is None or size == tuple(self._wanted)

    def _run(self) -> None:
        retry = MIN_RETRY_DELAY
        while not self._closed.is_set():
            before = self._count
            try:
                self._drain(self._open_source())
            except OSError as error:
                self._fault = str(error)
            except Exception as error:  # a defect must not leave a camera without its thread
                self._fault = defect_text(error)
            self._connected = False
            retry = MIN_RETRY_DELAY if self._count > before else min(2 * retry, MAX_RETRY_DELAY)
            self._closed.wait(retry)

    def _drain(self, source: CameraSource) -> None:
        """Take pictures until the camera is gone or not wanted."""
        self._refused, self._connected = source.refused, True
        try:
            while not self._closed.is_set():
                shot = source.grab()
                if shot is None:
                    self._spoilt += 1
                else:
                    self._take(shot)
        finally:
            source.close()

    def _take(self, shot: protocols.CapturedImage) -> None:
        height, width = shot.image.shape[:2]
        with self._here:
            self._size = (width, height)
            if not self._fits(self._size):
                return
            frame = protocols.CameraFrame(
                shot.t, shot.t_uncertainty, shot.image, shot.raw, self._count
            )
            self._frames.append(frame)
            self._count += 1
            self._arrival = time.monotonic()
            if len(self._frames) > MAX_QUEUED:
                self._frames.popleft()
                self._lost += 1
            self._here.notify()
