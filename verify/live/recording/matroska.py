"""Files that are whole after every piece: a Matroska file grows by one cluster a picture.

A muxer that collects clusters in memory loses them when the program is killed, and leaves half a
picture when the disk is full. Here a picture is in the file or not at all: a failed write is cut
off again. JPEGs are stored as the camera delivered them, everything else as MagicYUV, which takes
2 ms for a picture of 1280 x 720; FFV1 makes dark pictures smaller but takes up to 15 ms.

Source: RFC 8794 (EBML), RFC 9559 (Matroska).
"""

import os
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

from verify.core.records import Image
from verify.core.version import __version__
from verify.devices.protocols import CapturedPair

UNKNOWN_SIZE = b"\x01" + b"\xff" * 7  # of the segment: a reader takes it as "to the end"
TIMESTAMP_SCALE = 1_000_000  # ns: players get ms; the session's times are in frames.csv
TRACK_NUMBER = 1
KEYFRAME_FLAG = 0x80  # every picture can be decoded by itself
VIDEO = 1

# identifiers of elements
EBML, SEGMENT, INFO, TRACKS, CLUSTER = 0x1A45DFA3, 0x18538067, 0x1549A966, 0x1654AE6B, 0x1F43B675
CRC_32, TIMESTAMP, SIMPLE_BLOCK = 0xBF, 0xE7, 0xA3


class GrowingFile:
    """A file that grows by whole pieces: each is in it or not at all.

    Raises:
        OSError: the system refuses it.
    """

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)  # less the umask
        self._length = 0  # bytes that are whole

    def append(self, data: bytes) -> None:
        """Append all of it, or nothing and OSError."""
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[os.write(self._file, rest) :]
        except OSError:
            self.truncate(self._length)
            raise
        self._length += len(data)

    def truncate(self, length: int) -> None:
        """Cut it off and go on writing there."""
        self._length = length
        os.ftruncate(self._file, length)
        os.lseek(self._file, length, os.SEEK_SET)

    def close(self) -> None:
        """Have the disk hold it, and close it; also closed where OSError says that it cannot."""
        try:
            os.fsync(self._file)
        finally:
            os.close(self._file)


@dataclass(frozen=True, slots=True)
class MatroskaTrack:
    """What the pictures of a file are."""

    codec: str  # Matroska's name of it
    width: int  # px
    height: int  # px
    private: bytes = b""  # what a decoder needs beforehand


class MatroskaFile(GrowingFile):
    """Writes pictures that are encoded already.

    Raises:
        OSError: the system refuses it.
    """

    def __init__(self, path: Path, track: MatroskaTrack) -> None:
        super().__init__(path)
        self._before = 0  # bytes, without the last picture
        self._last = 0  # ms
        try:
            self.append(_head(track))
        except OSError:
            os.close(self._file)
            raise

    def add(self, picture: bytes, t: float) -> None:
        """Append a picture as encoded, t s after the first one, for players.

        Raises:
            OSError: the system refuses it; the file is as before.
        """
        ms = max(round(t * 1e3), self._last)
        self._last = ms
        block = bytes([0x80 | TRACK_NUMBER, 0, 0, KEYFRAME_FLAG]) + picture
        inside = _element(TIMESTAMP, ms) + _element(SIMPLE_BLOCK, block)
        checksum = _element(CRC_32, struct.pack("<I", zlib.crc32(inside)))
        before = self._length
        self.append(_element(CLUSTER, checksum + inside))
        self._before = before

    def drop_last(self) -> None:
        """Take the last picture out again: its other half could not be written."""
        self.truncate(self._before)

    def linked(self) -> bool:
        """Whether the file still has a name, or was deleted under our hands."""
        return os.fstat(self._file).st_nlink > 0


Values = Mapping[int, int | str | bytes]  # by identifier


def _head(track: MatroskaTrack) -> bytes:
    """Encode what stands before the first picture."""
    writer = f"verify {__version__}"
    ebml: Values = {0x4286: 1, 0x42F7: 1, 0x42F2: 4, 0x42F3: 8}  # versions, longest id and size
    content: Values = {0x4282: "matroska", 0x4287: 4, 0x4285: 2}  # and its versions
    info: Values = {0x2AD7B1: TIMESTAMP_SCALE, 0x4D80: writer, 0x5741: writer}
    numbers: Values = {0xD7: TRACK_NUMBER, 0x73C5: TRACK_NUMBER, 0x83: VIDEO, 0x9C: 0}
    private = {0x63A2: track.private} if track.private else {}
    video = {0xE0: _elements({0xB0: track.width, 0xBA: track.height})}
    tracks = _element(0xAE, _elements({**numbers, 0x86: track.codec, **private}) + _elements(video))
    head = (
        _element(EBML, _elements(ebml) + _elements(content)) + _identifier(SEGMENT) + UNKNOWN_SIZE
    )
    return head + _element(INFO, _elements(info)) + _element(TRACKS, tracks)


def _elements(values: Values) -> bytes:
    return b"".join(_element(identifier, value) for identifier, value in values.items())


def _element(identifier: int, value: int | str | bytes) -> bytes:
    if isinstance(value, int):
        value = value.to_bytes(max(1, (value.bit_length() + 7) // 8))
    content = value.encode() if isinstance(value, str) else value
    size = (1 << 56 | len(content)).to_bytes(8)  # eight bytes always: simple, and room for all
    return _identifier(identifier) + size + content


def _identifier(identifier: int) -> bytes:
    return identifier.to_bytes((identifier.bit_length() + 7) // 8)


GREY, COLOUR, JPEG = "grey", "colour", "jpeg"
PIXEL_FORMATS = {GREY: ("gray", b"M8G0", 8), COLOUR: ("gbrp", b"M8RG", 24)}  # ffmpeg, fourcc, bits
MILLISECOND = Fraction(1, 1000)


@dataclass(frozen=True, slots=True)
class PictureFormat:
    """What all pictures of one file have in common."""

    coding: str  # grey, colour, jpeg
    width: int  # px
    height: int  # px


def picture_format(image: Image, raw: bytes | None) -> PictureFormat:
    """Say what kind of file a picture belongs to."""
    coding = JPEG if raw is not None else GREY if image.ndim == 2 else COLOUR
    return PictureFormat(coding, image.shape[1], image.shape[0])


def picture_formats(pair: CapturedPair) -> tuple[PictureFormat, PictureFormat]:
    """Say what kinds of file a pair's pictures belong to, left and right."""
    return picture_format(pair.left, pair.left_raw), picture_format(pair.right, pair.right_raw)


class PictureEncoder:
    """Encodes the pictures of one file."""

    def __init__(self, kind: PictureFormat) -> None:
        self._codec: av.VideoCodecContext | None = None
        if kind.coding == JPEG:
            self.track = MatroskaTrack("V_MJPEG", kind.width, kind.height)
            return
        pixels, fourcc, bits = PIXEL_FORMATS[kind.coding]
        self._codec = av.CodecContext.create("magicyuv", "w")
        self._codec.width, self._codec.height = kind.width, kind.height
        self._codec.pix_fmt, self._codec.time_base = pixels, MILLISECOND
        self._codec.thread_count = 1  # a second core has the other camera's pictures
        self._codec.open()
        # the BITMAPINFOHEADER by which Matroska carries codecs that it has no name for
        extra, size = self._codec.extradata or b"", kind.width * kind.height * bits // 8
        fields = (40 + len(extra), kind.width, kind.height, 1, bits, fourcc, size, 0, 0, 0, 0)
        private = struct.pack("<IiiHH4sIiiII", *fields) + extra
        self.track = MatroskaTrack("V_MS/VFW/FOURCC", kind.width, kind.height, private)

    def encode(self, image: Image, raw: bytes | None) -> bytes:
        """Encode a picture of this kind; a JPEG goes through as it is."""
        if self._codec is None:
            return raw or b""
        return b"".join(map(bytes, self._codec.encode(_frame(image))))


def _frame(image: Image) -> av.VideoFrame:
    if image.ndim == 2:
        return av.VideoFrame.from_numpy_buffer(np.ascontiguousarray(image), format="gray")
    frame = av.VideoFrame(image.shape[1], image.shape[0], "gbrp")
    for plane, channel in zip(frame.planes, (1, 0, 2), strict=True):  # green, blue, red of BGR
        rows = np.frombuffer(plane, dtype=np.uint8)  # type: ignore[call-overload]  # has a buffer
        room = rows.reshape(-1, plane.line_size)[: image.shape[0], : image.shape[1]]
        np.copyto(room, cv2.extractChannel(image, channel))
    return frame
