"""JPEGs decoded as the recorded session's reader decodes them, to the last digit.

Other decoders differ by a few grey values; then what was measured live could not be found again in
the recording.
"""

import av
import numpy as np

from verify.records import Image

BEGINNING = b"\xff\xd8"


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


def as_image(frame: av.VideoFrame) -> Image:
    """Turn a decoded picture into an array, as OpenCV's reader does."""
    form = "gray" if frame.format.name == "gray" else "bgr24"
    return np.asarray(frame.to_ndarray(format=form), dtype=np.uint8)
