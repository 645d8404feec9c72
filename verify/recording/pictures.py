"""Pictures to packets: JPEG as the camera delivered it, everything else without loss.

MagicYUV, because it takes 2 ms for any picture of 1280 x 720: a pair is in the file before it is
measured. FFV1 makes dark pictures smaller but takes up to 15 ms, which no alarm should wait for.
"""

import struct
from dataclasses import dataclass
from fractions import Fraction

import av
import cv2
import numpy as np

from verify.recording.matroska import Track
from verify.records import Image

GREY, COLOUR, JPEG = "grey", "colour", "jpeg"
PIXELS = {GREY: ("gray", b"M8G0", 8), COLOUR: ("gbrp", b"M8RG", 24)}  # ffmpeg, fourcc, bits
MILLISECOND = Fraction(1, 1000)


@dataclass(frozen=True, slots=True)
class Kind:
    """What all pictures of one file have in common."""

    coding: str  # grey, colour, jpeg
    width: int  # px
    height: int  # px


def kind_of(image: Image, raw: bytes | None) -> Kind:
    """Say what kind of file a picture belongs to."""
    height, width = image.shape[:2]
    if raw is not None:
        return Kind(JPEG, width, height)
    return Kind(GREY if image.ndim == 2 else COLOUR, width, height)


class Coder:
    """Encodes the pictures of one file.

    Args:
        kind: what they have in common.
    """

    def __init__(self, kind: Kind) -> None:
        self.kind = kind
        self._codec: av.VideoCodecContext | None = None
        if kind.coding == JPEG:
            self.track = Track("V_MJPEG", kind.width, kind.height)
            return
        pixels, fourcc, bits = PIXELS[kind.coding]
        self._codec = av.CodecContext.create("magicyuv", "w")
        self._codec.width, self._codec.height = kind.width, kind.height
        self._codec.pix_fmt, self._codec.time_base = pixels, MILLISECOND
        self._codec.thread_count = 1  # a second core has the other camera's pictures
        self._codec.open()
        extra = self._codec.extradata or b""
        private = _bitmap_header(kind, fourcc, bits, extra)
        self.track = Track("V_MS/VFW/FOURCC", kind.width, kind.height, private)

    def encode(self, image: Image, raw: bytes | None) -> bytes:
        """Encode a picture of this kind; a JPEG goes through as it is."""
        if self._codec is None:
            return raw or b""
        packets = self._codec.encode(_frame(image))
        return b"".join(bytes(packet) for packet in packets)


def _frame(image: Image) -> av.VideoFrame:
    if image.ndim == 2:
        return av.VideoFrame.from_numpy_buffer(np.ascontiguousarray(image), format="gray")
    frame = av.VideoFrame(image.shape[1], image.shape[0], "gbrp")
    for plane, channel in zip(frame.planes, (1, 0, 2), strict=True):  # green, blue, red of BGR
        rows = np.frombuffer(plane, dtype=np.uint8)  # type: ignore[call-overload]  # has a buffer
        room = rows.reshape(-1, plane.line_size)[: image.shape[0], : image.shape[1]]
        np.copyto(room, cv2.extractChannel(image, channel))
    return frame


def _bitmap_header(kind: Kind, fourcc: bytes, bits: int, extra: bytes) -> bytes:
    """Make the BITMAPINFOHEADER by which Matroska carries codecs that it has no name for."""
    size = 40 + len(extra)
    pixels = kind.width * kind.height * bits // 8
    fields = (size, kind.width, kind.height, 1, bits, fourcc, pixels, 0, 0, 0, 0)
    return struct.pack("<IiiHH4sIiiII", *fields) + extra
