"""Lossless video whose bytes depend on nothing but the pictures."""

from collections.abc import Callable, Iterable
from fractions import Fraction
from pathlib import Path

import av

from verify.core.records import Image
from verify.errors import InputError

RATE_UNIT = 1000  # denominator of the frame rate: 29.97 Hz is 29970/1000
# FFV1 version 3, each slice with its checksum; bitexact: no version of the encoder in the file
CODEC_OPTIONS = {"level": "3", "slicecrc": "1", "flags": "+bitexact"}


def write_video(
    path: Path, images: Iterable[Image], rate_hz: float, done: Callable[[], object] = lambda: None
) -> None:
    """Write pictures, all grey (h, w) or all BGR (h, w, 3), as FFV1 in Matroska.

    The rate is for players alone; `done` is called after each picture.

    Raises:
        InputError: such a file cannot be written there.
    """
    rate = Fraction(round(max(rate_hz, 1.0) * RATE_UNIT), RATE_UNIT)
    try:
        # bitexact: no random identities, no version of the muxer in the file
        with av.open(str(path), "w", options={"fflags": "+bitexact"}) as file:
            stream = None
            for image in images:
                grey = image.ndim == 2
                if stream is None:
                    stream = file.add_stream("ffv1", rate, options=CODEC_OPTIONS)
                    stream.height, stream.width = image.shape[:2]
                    stream.pix_fmt = "gray" if grey else "bgr0"
                frame = av.VideoFrame.from_ndarray(image, "gray" if grey else "bgr24")
                file.mux(stream.encode(frame))
                done()
            if stream is not None:
                file.mux(stream.encode())
    except (OSError, av.FFmpegError) as error:
        raise InputError(
            path,
            f"FFV1 video cannot be written here ({error.strerror})",
            remedy='Check the folder, or choose recording.format = "png".',
        ) from error
