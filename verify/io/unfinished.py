"""pending.raw: pairs of an open session that are on the disk and not yet in its videos.

A ring of slots. Encoding a picture takes longer than an alarm may wait, writing it as it is does
not: so a pair goes into a slot before it is measured, and into the videos afterwards. Whoever
opens a recording that was cut off finds the last pairs here. Little-endian throughout.
"""

import itertools
import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from verify.core.records import Image, StereoPair
from verify.errors import InputError
from verify.io.files import system_refusal

NAME = "pending.raw"
MAGIC = b"verify pending 1"
HEADER = struct.Struct("<16s Q 3Q 3Q")  # magic, slots, shape of left and right: h, w, channels
SLOT = struct.Struct("<q 4d")  # pair's number in the session, t and pan, left and right
PAGE = 4096  # bytes: where slots and pictures begin
EMPTY = -1


class UnfinishedPairs:
    """The file while it is written.

    Args:
        path: a new file.
        left: shape of the left pictures, (h, w) or (h, w, 3).
        right: of the right ones.
        slots: how many pairs it holds.

    Raises:
        OSError: the system refuses it.
    """

    def __init__(
        self, path: Path, left: tuple[int, ...], right: tuple[int, ...], slots: int
    ) -> None:
        self._path, self.slots = path, slots
        self._layout = _RingLayout(left, right)
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)  # less the umask
        head = HEADER.pack(MAGIC, slots, *_pack_shape(left), *_pack_shape(right))
        os.pwrite(self._file, head, 0)
        for slot in range(slots):
            os.pwrite(self._file, SLOT.pack(EMPTY, 0, 0, 0, 0), self._layout.at(slot))
        os.ftruncate(self._file, ring_bytes(left, right, slots))

    def put(self, number: int, pair: StereoPair) -> None:
        """Write a pair into the slot that is its number's; what was there is gone.

        Args:
            number: of the pair in the session, from 0.
            pair: its pictures have the ring's shapes.

        Raises:
            OSError: the system refuses it; the slot is empty then.
        """
        at = self._layout.at(number % self.slots)
        self._write(SLOT.pack(EMPTY, 0, 0, 0, 0), at)
        self._write(np.ascontiguousarray(pair.left).data.cast("B"), at + PAGE)
        self._write(np.ascontiguousarray(pair.right).data.cast("B"), at + self._layout.right_at)
        told = (pair.t_left, pair.t_right, pair.pan_left, pair.pan_right)
        self._write(SLOT.pack(number, *told), at)  # last: a slot that has a number is whole

    def close(self) -> None:
        """Close the file and take it away."""
        os.close(self._file)
        self._path.unlink(missing_ok=True)

    def _write(self, data: bytes | memoryview, at: int) -> None:
        rest = memoryview(data)
        while rest:
            written = os.pwrite(self._file, rest, at)
            rest, at = rest[written:], at + written


@dataclass(frozen=True, slots=True)
class UnfinishedPair:
    """A pair that the videos lack."""

    number: int  # in the session, from 0
    t: tuple[float, float]  # s, cameras' clock, left and right
    pan: tuple[float, float]  # rad, as read
    pictures: "tuple[UnfinishedPicture, UnfinishedPicture]"


@dataclass(frozen=True, slots=True)
class UnfinishedPicture:
    """Where a picture stands in the file."""

    path: Path
    at: int  # bytes
    shape: tuple[int, ...]

    def read(self) -> Image:
        """Read it.

        Raises:
            InputError: the system refuses it.
        """
        count = int(np.prod(self.shape))
        try:
            flat = np.fromfile(self.path, dtype=np.uint8, count=count, offset=self.at)
        except OSError as error:
            raise system_refusal(self.path, error) from error
        return flat.reshape(self.shape)


def pending_pairs(path: Path, first: int) -> list[UnfinishedPair]:
    """List what the videos of a recording that was cut off lack.

    Args:
        path: the file; where there is none, nothing is pending.
        first: number of the pair that is looked for first.

    Returns:
        Pairs whose numbers rise by one from `first` on, until one is missing.

    Raises:
        InputError: the file is no such file, or cannot be read.
    """
    if not path.exists():
        return []
    try:
        with path.open("rb") as file:
            found = _read_slots(path, file)
    except OSError as error:
        raise system_refusal(path, error) from error
    rising = itertools.takewhile(found.__contains__, itertools.count(first))
    return [found[number] for number in rising]


def _read_slots(path: Path, file: BinaryIO) -> dict[int, UnfinishedPair]:
    """Every pair in the file, by its number."""
    head = file.read(HEADER.size)
    if len(head) < HEADER.size or not head.startswith(MAGIC):
        remedy = "Delete it: the pairs in the videos can be measured without it."
        raise InputError(path, "holds no pending pairs", "a recording wrote it", remedy)
    _, slots, *shapes = HEADER.unpack(head)
    layout = _RingLayout(_shape(shapes[:3]), _shape(shapes[3:]))
    length = os.fstat(file.fileno()).st_size
    found = {}
    for at in map(layout.at, range(slots)):
        if at + layout.size > length:
            break  # the file was copied in part
        file.seek(at)
        number, *told = SLOT.unpack(file.read(SLOT.size))
        if number != EMPTY:
            t_left, t_right, pan_left, pan_right = told
            pictures = (
                UnfinishedPicture(path, at + PAGE, layout.left),
                UnfinishedPicture(path, at + layout.right_at, layout.right),
            )
            found[number] = UnfinishedPair(
                number, (t_left, t_right), (pan_left, pan_right), pictures
            )
    return found


@dataclass(frozen=True, slots=True)
class _RingLayout:
    """Where things stand in the file."""

    left: tuple[int, ...]
    right: tuple[int, ...]

    @property
    def right_at(self) -> int:
        """From a slot's begin to its right picture, bytes."""
        return PAGE + _pages(int(np.prod(self.left)))

    @property
    def size(self) -> int:
        """Of a slot, bytes."""
        return self.right_at + _pages(int(np.prod(self.right)))

    def at(self, slot: int) -> int:
        """Begin of a slot."""
        return PAGE + slot * self.size


def ring_bytes(left: tuple[int, ...], right: tuple[int, ...], slots: int) -> int:
    """Size of a ring's file."""
    return _RingLayout(left, right).at(slots)


def _pages(size: int) -> int:
    return -(-size // PAGE) * PAGE


def _pack_shape(shape: tuple[int, ...]) -> tuple[int, int, int]:
    return shape[0], shape[1], shape[2] if len(shape) == 3 else 1


def _shape(three: list[int]) -> tuple[int, ...]:
    return tuple(three) if three[2] > 1 else tuple(three[:2])
