"""Cameras that OpenCV opens, by index or device path; settings are set and read back.

JPEGs are decoded as the recorded session's reader decodes them, to the last digit: other decoders
differ by a few grey values, and a live result could not be repeated from the recording.
"""

import math
import time
from collections.abc import Callable
from typing import Any

import av
import cv2
import numpy as np

from verify.core.records import Image
from verify.devices.protocols import CameraSettings, CapturedImage, RefusedSetting

JPEG_SIGNATURE = b"\xff\xd8"


class JpegDecoder:
    """Decodes the JPEGs of one camera."""

    def __init__(self) -> None:
        self._codec = av.CodecContext.create("mjpeg", "r")

    def decode(self, data: bytes) -> Image | None:
        """Decode a picture: (h, w) if it is grey, else (h, w, 3) BGR; None if it is damaged."""
        try:
            frames = self._codec.decode(av.Packet(data))
        except av.FFmpegError:
            return None
        return as_image(frames[0]) if frames else None


def one_channel(image: Image, wanted: bool | None) -> Image:
    """Make a picture grey (h, w) where that is wanted."""
    grey = wanted and image.ndim == 3
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if grey else image, dtype=np.uint8)


def as_image(frame: av.VideoFrame) -> Image:
    """Turn a decoded picture into an array, as OpenCV's reader does."""
    form = "gray" if frame.format.name == "gray" else "bgr24"
    return np.asarray(frame.to_ndarray(format=form), dtype=np.uint8)


V4L2_EXPOSURE = 1e-4  # s, its unit of exposure
# by backend: "exposure is not automatic"
MANUAL_EXPOSURE = {"V4L2": 1.0, "DSHOW": 0.25, "MSMF": 0.25}
TOL_SETTING = 0.1  # share by which a camera may round what it is asked for
DEFAULT_RATE = 30.0  # Hz, where the camera tells none
MAX_TIMESTAMP_AGE = 1.0  # s: a time stamp older than that is of another clock


class OpenCvSource:
    """An open camera.

    Raises:
        OSError: there is none, or another program has it.
    """

    def __init__(
        self, settings: CameraSettings, open_capture: Callable[..., Any] = cv2.VideoCapture
    ) -> None:
        self._settings = settings
        self._capture = open_capture(settings.source)
        if not self._capture.isOpened():
            self._capture.release()
            raise OSError("there is no such camera, or another program has it")
        self._backend = self._capture.getBackendName()
        self.refused = tuple(self._configure())
        # JPEGs are handed out as they come, if there are any and they are to be kept
        jpeg = settings.format == "MJPG" and not settings.grey
        jpeg = jpeg and bool(self._capture.set(cv2.CAP_PROP_CONVERT_RGB, 0))
        self._jpeg = JpegDecoder() if jpeg else None
        rate = self._capture.get(cv2.CAP_PROP_FPS)
        self._period = 1.0 / (rate if rate > 0 else settings.rate or DEFAULT_RATE)

    def grab(self) -> CapturedImage | None:
        """Wait for a picture; None: it cannot be decoded; OSError: the camera is gone."""
        if not self._capture.grab():
            raise OSError("no picture came; was it unplugged?")
        t, uncertainty = self._taken(time.monotonic())
        there, data = self._capture.retrieve()
        if not there:
            return None
        image, raw = self._decoded(np.asarray(data, dtype=np.uint8))
        return None if image is None else CapturedImage(t, uncertainty, image, raw)

    def close(self) -> None:
        """Close it."""
        self._capture.release()

    def _taken(self, arrival: float) -> tuple[float, float]:
        """When the picture was taken, and how well that is known, s.

        The kernel's stamp of a V4L2 buffer is on the monotonic clock; whether it means the
        exposure's beginning or the transfer's, drivers do not agree: half a period either way.
        """
        stamp = self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e-3
        delay = self._settings.delay
        if self._backend == "V4L2" and 0.0 <= arrival - stamp < MAX_TIMESTAMP_AGE:
            return stamp - delay, self._period / 2
        return arrival - delay, self._period

    def _decoded(self, data: Image) -> tuple[Image | None, bytes | None]:
        if self._jpeg is None or data[:1, :2].tobytes() != JPEG_SIGNATURE:
            return one_channel(data, self._settings.grey), None
        raw = data.tobytes()
        return self._jpeg.decode(raw), raw

    def _configure(self) -> list[RefusedSetting]:
        """Ask for each setting, read it back, name those that were refused.

        Format first: sizes and rates depend on it.
        """
        wanted, refused = self._settings, []
        width, height = wanted.size or (None, None)
        if wanted.format is not None:
            refused += self._ask_format(wanted.format)
        refused += self._ask("width", cv2.CAP_PROP_FRAME_WIDTH, width, "px", 0.0)
        refused += self._ask("height", cv2.CAP_PROP_FRAME_HEIGHT, height, "px", 0.0)
        refused += self._ask("rate", cv2.CAP_PROP_FPS, wanted.rate, "Hz")
        if wanted.exposure is not None:
            refused += self._ask_exposure(wanted.exposure)
        refused += self._ask("gain", cv2.CAP_PROP_GAIN, wanted.gain, "")
        if wanted.white_balance is not None:
            self._capture.set(cv2.CAP_PROP_AUTO_WB, 0)
        key = cv2.CAP_PROP_WB_TEMPERATURE
        return refused + self._ask("white balance", key, wanted.white_balance, "K")

    def _ask(
        self, name: str, key: int, value: float | None, unit: str, slack: float = TOL_SETTING
    ) -> list[RefusedSetting]:
        if value is None:
            return []
        self._capture.set(key, value)
        got = self._capture.get(key)
        if abs(got - value) <= slack * abs(value):
            return []
        return [RefusedSetting(name, f"{value:g} {unit}".strip(), f"{got:g} {unit}".strip())]

    def _ask_format(self, letters: str) -> list[RefusedSetting]:
        self._capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*letters))
        code = int(self._capture.get(cv2.CAP_PROP_FOURCC))
        got = code.to_bytes(4, "little", signed=code < 0).decode("ascii", errors="replace")
        if got == letters:
            return []
        return [RefusedSetting("format", letters, got.strip("\0") or "unknown")]

    def _ask_exposure(self, seconds: float) -> list[RefusedSetting]:
        manual = MANUAL_EXPOSURE.get(self._backend)
        if manual is None:
            got = f"not settable through {self._backend}"
            return [RefusedSetting("exposure", f"{seconds:g} s", got)]
        self._capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, manual)
        native = seconds / V4L2_EXPOSURE if self._backend == "V4L2" else math.log2(seconds)
        self._capture.set(cv2.CAP_PROP_EXPOSURE, native)
        native = self._capture.get(cv2.CAP_PROP_EXPOSURE)
        taken = native * V4L2_EXPOSURE if self._backend == "V4L2" else 2.0**native
        if abs(taken - seconds) <= TOL_SETTING * seconds:
            return []
        return [RefusedSetting("exposure", f"{seconds:g} s", f"{taken:g} s")]
