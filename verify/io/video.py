"""One camera's images in their order, out of a video or a folder of numbered PNGs.

Is an image as it was recorded? The checksums that PNG and FFV1 carry, which decoders ignore.

OpenCV hands out a damaged FFV1 picture without a word (the decoder fills the hole with what the
picture before showed there), so an LED would stand where it no longer is.
"""

import os
import re
import zlib
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from verify.core.records import Image
from verify.errors import InputError
from verify.io.files import read_bytes, require_file, system_refusal

_SLICE_FOOTER = 8  # bytes: slice size (3), error status (1), CRC-32 (4)
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_CHUNK_FRAME = 12  # bytes: length (4), type (4), CRC-32 (4)
_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))  # each byte's bits reversed


def ffv1_intact(packet: bytes) -> bool:
    """Check the CRC of every slice of one FFV1 picture (version 3 with error detection on).

    FFV1's CRC-32 takes bits from the high end and starts at 0; zlib's takes them from the low end
    and starts inverted. Turning each byte's bits makes them one; over data and CRC it is then 0.

    Source: RFC 9043, sections 4.9 and 4.9.3.
    """
    end = len(packet)
    reversed_bits = memoryview(packet.translate(_REVERSED))
    while end >= _SLICE_FOOTER:
        size = int.from_bytes(packet[end - 8 : end - 5], "big") + _SLICE_FOOTER
        data = reversed_bits[max(end - size, 0) : end]
        if size > end or zlib.crc32(data, 0xFFFFFFFF) != 0xFFFFFFFF:
            return False
        end -= size
    return end == 0


def png_intact(data: bytes) -> bool:
    """Check that a PNG is whole and that each chunk's CRC fits.

    Source: W3C, Portable Network Graphics, third edition, section 5.3.
    """
    if not data.startswith(_PNG_SIGNATURE):
        return False
    at = len(_PNG_SIGNATURE)
    while at + _CHUNK_FRAME <= len(data):
        kind = data[at + 4 : at + 8]
        end = at + _CHUNK_FRAME + int.from_bytes(data[at : at + 4], "big")
        if zlib.crc32(data[at + 4 : end - 4]) != int.from_bytes(data[end - 4 : end], "big"):
            return False
        if kind == b"IEND":
            return True
        at = end
    return False


# a bad file gets our one line, not a dozen of ffmpeg's; read when OpenCV opens its first video
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # AV_LOG_QUIET
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)

BATCH_IMAGES = 8  # images decoded at once on either side where no thread does it; 1280 x 720: 15 MB
PREFETCH_IMAGES = (
    4  # images decoded in advance on either side: hides a slow one, holds a few megabytes
)

_NUMBERED = re.compile(r"\d+\.png")
_GREY = b"Y800"  # ffmpeg's names of pixel formats, as OpenCV hands them out
_DEEP_GREY = b"Y1\0"  # followed by the number of bits
_REMEDY = "Record or copy it again."


class Images(ABC):
    """The images of one camera, numbered from 0."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @abstractmethod
    def count(self, torn: bool = False) -> int:
        """Count the images.

        Args:
            torn: the recording was cut off: count those before the first that is missing or
                damaged, instead of complaining of it. Decodes them all.

        Raises:
            InputError: it cannot be opened; unless `torn`, an image is missing or damaged.
        """

    @abstractmethod
    def images(self) -> Generator[Image]:
        """Decode the images one after the other: (h, w) grey or (h, w, 3) BGR.

        Raises:
            InputError: one cannot be decoded.
        """


class Video(Images):
    """A video file."""

    def count(self, torn: bool = False) -> int:
        """Count the images without decoding them; FFV1's checksums are checked as they pass."""
        intact = [ffv1_intact(packet) for packet in self._packets()]
        # a stream written without checksums fits by chance once in four thousand million packets
        first_bad = intact.index(False) if any(intact) and not all(intact) else len(intact)
        if torn:
            return min(first_bad, sum(1 for _ in self.images()))
        if first_bad < len(intact):
            found = f"image {first_bad} of {len(intact)} is damaged"
            raise InputError(self.path, found, "its checksum does not fit", _REMEDY)
        return len(intact)

    def images(self) -> Generator[Image]:
        """Decode the images; grey where the stream is grey, else BGR."""
        with self._opened() as capture:
            form = int(capture.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT)).to_bytes(4, "little")
            if form.startswith(_DEEP_GREY):
                raise _depth_refusal(self.path, form[3])
            if form == _GREY:
                capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)  # one channel instead of three equal ones
            while (taken := capture.read())[0]:
                yield np.asarray(taken[1], dtype=np.uint8)

    def _packets(self) -> Iterator[bytes]:
        """Yield the images as they are encoded."""
        with self._opened(cv2.CAP_PROP_FORMAT, -1) as capture:
            while (taken := capture.read())[0]:
                yield taken[1].tobytes()

    @contextmanager
    def _opened(self, *options: int) -> Iterator[cv2.VideoCapture]:
        require_file(self.path)
        if cv2.getNumThreads() == 1:
            options = (*options, cv2.CAP_PROP_N_THREADS, 1)
        # the full path, which no protocol of ffmpeg's (http:, concat:) can be mistaken for
        capture = cv2.VideoCapture(str(self.path.resolve()), cv2.CAP_FFMPEG, options)
        try:
            if not capture.isOpened():
                raise InputError(self.path, "is no video that can be decoded", "", _REMEDY)
            yield capture
        finally:
            capture.release()


class NumberedImages(Images):
    """A folder of 000000.png, 000001.png, …; other files in it are left alone."""

    def count(self, torn: bool = False) -> int:
        """Count the images; none may be missing in between."""
        try:
            names = sorted(e.name for e in self.path.iterdir() if _NUMBERED.fullmatch(e.name))
        except OSError as error:
            raise system_refusal(self.path, error) from error
        if torn:
            return sum(1 for _ in self._readable())
        for number in range(max(len(names), 1)):
            if _name(number) not in names:
                found = f"has no {_name(number)}"
                expected = f"it holds {len(names)} numbered images" + (
                    f" up to {names[-1]}" if names else ""
                )
                remedy = "Number them from 000000.png on, without a gap."
                raise InputError(self.path, found, expected, remedy)
        return len(names)

    def images(self) -> Generator[Image]:
        """Decode the images; grey where the file is grey, else BGR without alpha."""
        number = 0
        while (file := self.path / _name(number)).exists():
            yield _decode(file)
            number += 1

    def _readable(self) -> Iterator[Image]:
        with suppress(InputError):
            yield from self.images()


def open_images(path: Path) -> Images:
    """Open a video, or a folder of numbered PNGs."""
    return NumberedImages(path) if path.is_dir() else Video(path)


def decode_in_step(left: Images, right: Images, count: int) -> Generator[tuple[Image, Image]]:
    """Decode both sides in step, either in a thread of its own and a few images ahead.

    Where this process has but one processor's time, threads would only take it from each other;
    but several images after each other, and then what is done with them, take less time than turn
    and turn about, for each finds its own code and tables in the processor's cache.

    Args:
        left: one side.
        right: the other.
        count: how many images are asked of both.

    Raises:
        InputError: a side ends early or an image of it cannot be decoded.
    """
    draw = _in_batches if cv2.getNumThreads() == 1 else _prefetched
    with closing(draw(left, count)) as lefts, closing(draw(right, count)) as rights:
        yield from zip(lefts, rights, strict=True)


def _in_batches(side: Images, count: int) -> Generator[Image]:
    """Draw images when they are asked for, `BATCH_IMAGES` at once."""
    with closing(side.images()) as images:
        for number in range(0, count, BATCH_IMAGES):
            wanted = min(BATCH_IMAGES, count - number)
            drawn = deque(islice(images, wanted))
            got = len(drawn)
            while drawn:
                yield drawn.popleft()  # not held here any longer
            if got < wanted:
                raise _length_refusal(side, number + got, count)


def _length_refusal(side: Images, number: int, count: int) -> InputError:
    return InputError(side.path, f"only {number} of {count} images can be decoded", "", _REMEDY)


def _prefetched(side: Images, count: int) -> Generator[Image]:
    """Draw images in a thread (OpenCV releases the interpreter's lock), `PREFETCH_IMAGES` of the caller."""
    images = side.images()
    pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="decode")
    try:
        drawn = deque(pool.submit(next, images, None) for _ in range(min(PREFETCH_IMAGES, count)))
        for number in range(count):
            image = drawn.popleft().result()
            if image is None:
                raise _length_refusal(side, number, count)
            if number + PREFETCH_IMAGES < count:
                drawn.append(pool.submit(next, images, None))
            yield image
    finally:  # also when the caller stops early: no thread and no open file outlives the loop
        pool.shutdown(wait=True, cancel_futures=True)
        images.close()


def _name(number: int) -> str:
    return f"{number:06d}.png"


def _decode(file: Path) -> Image:
    data = read_bytes(file)
    image = None
    if png_intact(data):  # else libpng would print a line of its own
        flags = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    if image is None:
        raise InputError(file, "is damaged or no PNG", "", _REMEDY)
    if image.dtype != np.uint8:
        raise _depth_refusal(file, 8 * image.dtype.itemsize)
    return np.asarray(image, dtype=np.uint8)


def _depth_refusal(path: Path, bits: int) -> InputError:
    remedy = "Convert it, or set the camera to 8 bits."
    return InputError(path, f"has {bits} bits a sample", "8 are expected", remedy)
