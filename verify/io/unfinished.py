"""pending.raw: the last pairs of a recording that was cut off, not yet encoded in its videos.

Encoding a picture takes longer than an alarm may wait; writing its raw pixels does not. So each
pair is written here before it is measured, and into the videos afterwards. Opening the session
appends the pairs that the videos lack.

The file is a ring of slots, little-endian, each part on a page of its own:

    header                  magic, number of slots, shapes (h, w, channels) of left and right
    slot 0, 1, …            pair's number in the session (-1: empty), t and pan, left and right
                            left pixels, then right pixels
"""

import itertools
import os
import struct
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from verify.core.records import Image, StereoPair
from verify.errors import InputError
from verify.io.files import MAX_TABLE_BYTES, refused_as_input_error, require_file
from verify.io.series import FrameSeries
from verify.io.video import Images

NAME = "pending.raw"
MAGIC = b"verify pending 1"
HEADER = struct.Struct("<16s Q 3Q 3Q")
SLOT = struct.Struct("<q 4d")
PAGE = 4096  # bytes
EMPTY = -1
MAX_SIDE = 100_000  # px; more is no picture
_REMEDY = "Delete it: the pairs in the videos can be measured without it."

Shape = tuple[int, ...]  # of a picture: (h, w) or (h, w, 3)
Sides = tuple[Images, Images]


@dataclass(frozen=True, slots=True)
class _RingLayout:
    """Offsets in the file, in bytes."""

    left: Shape
    right: Shape

    @property
    def right_at(self) -> int:
        """From a slot's begin to its right picture."""
        return PAGE + _full_pages(self.left)

    @property
    def size(self) -> int:
        """Of a slot."""
        return self.right_at + _full_pages(self.right)

    def at(self, slot: int) -> int:
        """Begin of a slot."""
        return PAGE + slot * self.size


def _full_pages(shape: Shape) -> int:
    """Bytes of the pages that a picture fills."""
    return -(-int(np.prod(shape)) // PAGE) * PAGE


def ring_bytes(left: Shape, right: Shape, slots: int) -> int:
    """Size of a ring's file, bytes."""
    return _RingLayout(left, right).at(slots)


class UnfinishedPairs:
    """The file while it is written, pictures (h, w) or (h, w, 3); OSError: the system refuses."""

    def __init__(self, path: Path, left: Shape, right: Shape, slots: int) -> None:
        self._path, self.slots = path, slots
        self._layout = _RingLayout(left, right)
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)  # less the umask
        shapes = [(*shape, 1)[:3] for shape in (left, right)]
        os.pwrite(self._file, HEADER.pack(MAGIC, slots, *shapes[0], *shapes[1]), 0)
        for slot in range(slots):
            os.pwrite(self._file, SLOT.pack(EMPTY, 0, 0, 0, 0), self._layout.at(slot))
        os.ftruncate(self._file, ring_bytes(left, right, slots))

    def put(self, number: int, pair: StereoPair) -> None:
        """Write a pair into its number's slot, over an older one; on OSError the slot is empty."""
        at = self._layout.at(number % self.slots)
        self._write(SLOT.pack(EMPTY, 0, 0, 0, 0), at)
        self._write(np.ascontiguousarray(pair.left).data.cast("B"), at + PAGE)
        self._write(np.ascontiguousarray(pair.right).data.cast("B"), at + self._layout.right_at)
        times_and_pans = (pair.t_left, pair.t_right, pair.pan_left, pair.pan_right)
        self._write(SLOT.pack(number, *times_and_pans), at)  # last: a numbered slot is whole

    def close(self, *, keep: bool = False) -> None:
        """Close the file, and delete it unless pairs in it are to be kept."""
        os.close(self._file)
        if not keep:
            self._path.unlink(missing_ok=True)

    def _write(self, data: bytes | memoryview, at: int) -> None:
        rest = memoryview(data)
        while rest:
            written = os.pwrite(self._file, rest, at)
            rest, at = rest[written:], at + written


@dataclass(frozen=True, slots=True)
class _Picture:
    """Where a picture stands in the file."""

    path: Path
    at: int  # bytes
    shape: Shape

    def read(self) -> Image:
        count = int(np.prod(self.shape))
        with refused_as_input_error(self.path):
            flat = np.fromfile(self.path, dtype=np.uint8, count=count, offset=self.at)
        return flat.reshape(self.shape)


# t left, right, s, cameras' clock, and pan left, right, rad; the pictures, left and right
_Pair = tuple[tuple[float, ...], tuple[_Picture, _Picture]]


class _ExtendedImages(Images):
    """The first `count` images of a video, then some that were never encoded."""

    def __init__(self, video: Images, count: int, rest: Sequence[_Picture]) -> None:
        super().__init__(video.path)
        self._video, self._count, self._rest = video, count, rest

    def count(self, torn: bool = False) -> int:  # noqa: ARG002  # damaged ones are not in `count`
        """Count the images."""
        return self._count + len(self._rest)

    def images(self) -> Generator[Image]:
        """Decode the images one after the other."""
        yield from itertools.islice(self._video.images(), self._count)
        for picture in self._rest:
            yield picture.read()


def append_unfinished(
    folder: Path, frames: FrameSeries, sides: Sides
) -> tuple[FrameSeries, Sides, int]:
    """Append the pairs of pending.raw, where there is one, to those of the videos, all whole.

    Gives frames and sides with the others, and how many those are. Pairs that neither holds are
    left out; the numbers of those after them are lower by as many.

    Raises:
        InputError: pending.raw is no such file, cannot be read, or its times do not rise.
    """
    if not (folder / NAME).exists():
        return frames, sides, 0
    count = len(frames)
    pairs = [pair for number, pair in sorted(_read_slots(folder / NAME).items()) if number >= count]
    if not pairs:
        return frames, sides, 0
    left, right = (
        _ExtendedImages(video, count, [pictures[side] for _, pictures in pairs])
        for side, video in enumerate(sides)
    )
    before = (frames.t_left, frames.t_right, frames.pan_left, frames.pan_right)
    after = np.array([times_and_pans for times_and_pans, _ in pairs]).T
    series = [np.append(*both) for both in zip(before, after, strict=True)]
    if not np.isfinite(after).all() or any((np.diff(t) <= 0).any() for t in series[:2]):
        found = "holds pairs whose times do not rise after those of frames.csv"
        raise InputError(folder / NAME, found, "one after the other is expected", _REMEDY)
    return FrameSeries(*series), (left, right), len(pairs)


def _read_slots(path: Path) -> dict[int, _Pair]:
    """Every pair in the file, by its number; the pixels stay on the disk."""
    pairs: dict[int, _Pair] = {}
    if path.is_file() and not path.stat().st_size:
        return pairs
    require_file(path, MAX_TABLE_BYTES)
    with refused_as_input_error(path), path.open("rb") as file:
        head = file.read(HEADER.size).ljust(HEADER.size, b"\0")
        if not any(head):  # the power went before the disk had it
            return pairs
        magic, slots, *sizes = HEADER.unpack(head)
        if magic != MAGIC or max(sizes) > MAX_SIDE:
            raise InputError(path, "holds no pending pairs", "a recording wrote it", _REMEDY)
        left, right = (tuple(size if size[2] > 1 else size[:2]) for size in (sizes[:3], sizes[3:]))
        layout = _RingLayout(left, right)
        length = os.fstat(file.fileno()).st_size
        for at in map(layout.at, range(slots)):
            if at + layout.size > length:
                break  # the file was copied in part
            file.seek(at)
            number, *times_and_pans = SLOT.unpack(file.read(SLOT.size))
            pictures = _Picture(path, at + PAGE, left), _Picture(path, at + layout.right_at, right)
            if number != EMPTY:
                pairs[number] = tuple(times_and_pans), pictures
    return pairs
