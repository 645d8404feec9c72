"""A video file that is whole after every picture: Matroska, one cluster and one write a picture.

A muxer that collects clusters in memory loses what it holds when the program is killed, and leaves
half a picture when the disk is full. Here a picture is in the file or not at all: what a failed
write has left is cut off again.

Source: RFC 8794 (EBML), RFC 9559 (Matroska).
"""

import os
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

from verify import __version__

UNKNOWN_SIZE = b"\x01" + b"\xff" * 7  # of the segment: a reader takes it as "to the end"
TICK = 1_000_000  # ns: times in the file are in ms, for players; the session's are in frames.csv
TRACK = 1
KEY_PICTURE = 0x80  # every picture can be decoded by itself
VIDEO = 1

# identifiers of elements
EBML, SEGMENT, INFO, TRACKS, CLUSTER = 0x1A45DFA3, 0x18538067, 0x1549A966, 0x1654AE6B, 0x1F43B675
CRC_32, TIMESTAMP, SIMPLE_BLOCK = 0xBF, 0xE7, 0xA3


@dataclass(frozen=True, slots=True)
class Track:
    """What the pictures of a file are."""

    codec: str  # Matroska's name of it
    width: int  # px
    height: int  # px
    private: bytes = b""  # what a decoder needs beforehand


class MatroskaFile:
    """Writes pictures that are encoded already.

    Args:
        path: a new file.
        track: what the pictures are.

    Raises:
        OSError: the system refuses it.
    """

    def __init__(self, path: Path, track: Track) -> None:
        self.path = path
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)  # less the umask
        self._length = 0  # bytes that are whole
        self._before = 0  # bytes, without the last picture
        self._last = 0  # ms
        try:
            self._append(_head(track))
        except OSError:
            os.close(self._file)
            raise

    def add(self, picture: bytes, t: float) -> None:
        """Append a picture.

        Args:
            picture: as encoded.
            t: s since the first one, for players.

        Raises:
            OSError: the system refuses it; the file is as before.
        """
        ms = max(round(t * 1e3), self._last)
        self._last = ms
        block = bytes([0x80 | TRACK, 0, 0, KEY_PICTURE]) + picture
        inside = _number(TIMESTAMP, ms) + _element(SIMPLE_BLOCK, block)
        checksum = _element(CRC_32, struct.pack("<I", zlib.crc32(inside)))
        self._append(_element(CLUSTER, checksum + inside))

    def drop_last(self) -> None:
        """Take the last picture out again: its other half could not be written."""
        self._length = self._before
        cut(self._file, self._length)

    def linked(self) -> bool:
        """Whether the file still has a name, or was deleted under our hands."""
        return os.fstat(self._file).st_nlink > 0

    def close(self) -> None:
        """Have the disk hold it, and close it.

        Raises:
            OSError: the system refuses it; it is closed all the same.
        """
        close_for_good(self._file)

    def _append(self, data: bytes) -> None:
        write_all(self._file, data, self._length)
        self._before = self._length
        self._length += len(data)


def write_all(file: int, data: bytes, at: int) -> None:
    """Append to a file of length `at`: all of it, or nothing.

    Raises:
        OSError: the system refuses it; the file is as long as before.
    """
    rest = memoryview(data)
    try:
        while rest:
            rest = rest[os.write(file, rest) :]
    except OSError:
        cut(file, at)
        raise


def close_for_good(file: int) -> None:
    """Have the disk hold a file, and close it.

    Raises:
        OSError: the system refuses it; it is closed all the same.
    """
    try:
        os.fsync(file)
    finally:
        os.close(file)


def cut(file: int, length: int) -> None:
    """Cut a file off and go on writing there."""
    os.ftruncate(file, length)
    os.lseek(file, length, os.SEEK_SET)


def _head(track: Track) -> bytes:
    """What stands before the first picture."""
    writer = f"verify {__version__}"
    ebml = _element(
        EBML,
        _number(0x4286, 1) + _number(0x42F7, 1) + _number(0x42F2, 4) + _number(0x42F3, 8)
        + _text(0x4282, "matroska") + _number(0x4287, 4) + _number(0x4285, 2),
    )  # fmt: skip
    info = _element(INFO, _number(0x2AD7B1, TICK) + _text(0x4D80, writer) + _text(0x5741, writer))
    video = _element(0xE0, _number(0xB0, track.width) + _number(0xBA, track.height))
    private = _element(0x63A2, track.private) if track.private else b""
    entry = _element(
        0xAE,
        _number(0xD7, TRACK) + _number(0x73C5, TRACK) + _number(0x83, VIDEO)
        + _number(0x9C, 0) + _text(0x86, track.codec) + private + video,
    )  # fmt: skip
    return ebml + _identifier(SEGMENT) + UNKNOWN_SIZE + info + _element(TRACKS, entry)


def _element(identifier: int, content: bytes) -> bytes:
    size = (1 << 56 | len(content)).to_bytes(8)  # eight bytes always: simple, and room for all
    return _identifier(identifier) + size + content


def _number(identifier: int, value: int) -> bytes:
    return _element(identifier, value.to_bytes(max(1, (value.bit_length() + 7) // 8)))


def _text(identifier: int, value: str) -> bytes:
    return _element(identifier, value.encode())


def _identifier(identifier: int) -> bytes:
    return identifier.to_bytes((identifier.bit_length() + 7) // 8)
