"""Encode one camera's pictures as a video: lossless, or JPEGs as the camera gave them."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from fractions import Fraction
from pathlib import Path
from typing import Self

import av

from verify.core.records import Image
from verify.errors import InputError

RATE_UNIT = 1000  # denominator of the frame rate: 29.97 Hz is 29970/1000
# FFV1 version 3, each slice with its checksum; bitexact: no version of the encoder in the file
CODEC_OPTIONS = {"level": "3", "slicecrc": "1", "flags": "+bitexact"}


class VideoWriter:
    """Writes one camera's pictures to Matroska: FFV1, or JPEGs as the camera encoded them.

    The bytes depend on nothing but the pictures; the rate is for players alone.

    Raises:
        InputError: such a file cannot be written there.
    """

    def __init__(self, path: Path, rate_hz: float) -> None:
        self._path = path
        self._rate = Fraction(round(max(rate_hz, 1.0) * RATE_UNIT), RATE_UNIT)
        self._stream: av.VideoStream | None = None  # that encodes
        self._jpegs: av.stream.Stream | None = None  # that takes packets
        self._count = 0
        with self._worded():
            # bitexact: no random identities, no version of the muxer in the file
            self._file = av.open(str(path), "w", "matroska", options={"fflags": "+bitexact"})

    def add(self, picture: Image) -> None:
        """Append a picture, grey (h, w) or BGR (h, w, 3); all of a file are of one kind."""
        grey = picture.ndim == 2
        with self._worded():
            if self._stream is None:
                self._stream = self._file.add_stream("ffv1", self._rate, options=CODEC_OPTIONS)
                self._stream.height, self._stream.width = picture.shape[:2]
                self._stream.pix_fmt = "gray" if grey else "bgr0"
            frame = av.VideoFrame.from_ndarray(picture, "gray" if grey else "bgr24")
            self._file.mux(self._stream.encode(frame))

    def add_jpeg(self, data: bytes, size: tuple[int, int]) -> None:
        """Append a picture that is a JPEG already, as it is; size: its width and height, px."""
        with self._worded():
            if self._jpegs is None:
                self._jpegs = self._file.add_mux_stream(
                    "mjpeg", rate=self._rate, width=size[0], height=size[1]
                )
            packet = av.Packet(data)
            packet.stream, packet.time_base = self._jpegs, 1 / self._rate
            packet.pts = packet.dts = self._count
            packet.is_keyframe = True
            self._file.mux(packet)
            self._count += 1

    def close(self) -> None:
        """Write what the encoder still holds, and close the file."""
        with self._worded():
            if self._stream is not None:
                self._file.mux(self._stream.encode())
            self._file.close()

    def __enter__(self) -> Self:
        """Write to it in a block."""
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Close the file; after an error whatever it holds is of no use."""
        if kind is None:
            self.close()
        else:
            with suppress(Exception):
                self._file.close()

    @contextmanager
    def _worded(self) -> Iterator[None]:
        try:
            yield
        except (OSError, av.FFmpegError) as error:
            found = f"a video cannot be written here ({error.strerror})"
            raise InputError(self._path, found, "", "Check the folder and the disk.") from error


def write_video(
    path: Path, images: Iterable[Image], rate_hz: float, done: Callable[[], object] = lambda: None
) -> None:
    """Write pictures, all grey (h, w) or all BGR (h, w, 3), as FFV1; `done` is called after each.

    Raises:
        InputError: such a file cannot be written there.
    """
    with VideoWriter(path, rate_hz) as video:
        for image in images:
            video.add(image)
            done()
