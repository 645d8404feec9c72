"""A video file, or a folder of numbered PNGs, in place of a camera."""

import time
from pathlib import Path

import cv2

from verify.devices.cameras.opencv import one_channel
from verify.devices.protocols import READ_TIMEOUT, CameraFrame, CameraSettings, CameraState
from verify.errors import InputError
from verify.io.files import named_for_library, require_file
from verify.io.video import open_images

DEFAULT_RATE = 30.0  # Hz, of a folder of pictures


class ReplaySource:
    """Gives a file's pictures at its rate, another rate, or (rate 0) as fast as they are read.

    Raises:
        InputError: no such file.
    """

    def __init__(self, settings: CameraSettings) -> None:
        self._settings, path = settings, Path(str(settings.source))
        self._name = path.name
        if not path.is_dir():
            require_file(path)
        self._images = open_images(path).images()
        own = _rate(path) if path.is_file() else DEFAULT_RATE
        self._waits = settings.rate != 0
        self._period = 1.0 / (settings.rate or own)
        self._began: float | None = None
        self._next: CameraFrame | None = None
        self._number = 0
        self._arrival: float | None = None  # s, of the last picture
        self._fault, self._ended = "", False

    def read(self) -> CameraFrame | None:
        """Give the next picture; None after READ_TIMEOUT, or when the file is over."""
        if self._next is None:
            self._next = self._decoded()
        if self._next is None:
            time.sleep(READ_TIMEOUT / 10)  # who asks again and again must not spin
            return None
        rest = self._next.t - time.monotonic() if self._waits else 0.0
        if rest > 0:
            time.sleep(min(rest, READ_TIMEOUT))
            if rest > READ_TIMEOUT:
                return None
        frame, self._next = self._next, None
        self._arrival = time.monotonic()
        return frame

    def state(self) -> CameraState:
        """Say how far the file is."""
        status = self._fault or (
            f"over after {self._number} pictures" if self._ended else "reading"
        )
        return CameraState(
            connected=not self._ended,
            age=None if self._arrival is None else time.monotonic() - self._arrival,
            lost=0,
            sentence=f"{self._name}: {status}",
            ended=self._ended,
        )

    def close(self) -> None:
        """Close the file."""
        self._ended = True
        self._images.close()

    def _decoded(self) -> CameraFrame | None:
        if self._ended:
            return None
        try:
            image = next(self._images, None)
        except InputError as error:
            image, self._fault = None, error.found
        if image is None:
            self._ended = True
            return None
        size = (image.shape[1], image.shape[0])
        if self._settings.size not in (None, size):
            wanted = "{} x {}".format(*self._settings.size or ())
            self._fault = "has pictures of {} x {} px".format(*size) + f"; {wanted} are needed"
            self._ended = True
            return None
        if self._began is None:
            self._began = time.monotonic()
        image = one_channel(image, self._settings.grey)
        t = self._began + self._number * self._period
        frame = CameraFrame(t, 0.0, image, None, self._number)
        self._number += 1
        return frame


def _rate(path: Path) -> float:
    with named_for_library(path) as name:
        capture = cv2.VideoCapture(name, cv2.CAP_FFMPEG)
        rate = capture.get(cv2.CAP_PROP_FPS)
        capture.release()
    return rate if 0 < rate < 1e4 else DEFAULT_RATE
