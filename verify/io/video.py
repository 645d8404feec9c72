"""Decode one camera's images in order, from a video or a folder of numbered PNGs, and check them.

PNG and FFV1 carry checksums, which decoders ignore: OpenCV returns a damaged FFV1 picture without
an error, its hole filled from the picture before, so an LED would appear where it no longer is.
They are checked here.
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
from verify.io import files

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


def _has_footers(packet: bytes) -> bool:
    """Whether slices with footers fill an FFV1 picture, whatever they hold."""
    end = len(packet)
    while end >= _SLICE_FOOTER:
        start = end - _SLICE_FOOTER
        end = start - int.from_bytes(packet[start : start + 3], "big")
    return end == 0


def png_intact(data: bytes) -> bool:
    """Whether a PNG is whole and each chunk's CRC fits (W3C, PNG, third edition, section 5.3)."""
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


# a bad file is refused in one line, without ffmpeg's own; read when OpenCV opens its first video
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # AV_LOG_QUIET
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)

BATCH_IMAGES = 8  # a side, decoded at once where no thread does it; 1280 x 720: 15 MB
MAX_HEAD_BYTES = 500_000_000  # of a video's head and its first image
PREFETCH_IMAGES = 4  # a side, decoded in advance by a thread: hides a slow one

_NUMBERED = re.compile(r"\d+\.png")
_GREY = b"Y800"  # ffmpeg's names of pixel formats, as OpenCV hands them out
_DEEP_GREY = b"Y1\0"  # followed by the number of bits
_REMEDY = "Record or copy it again."
_FLAGS = (
    cv2.IMREAD_ANYCOLOR
    | cv2.IMREAD_ANYDEPTH
    | cv2.IMREAD_IGNORE_ORIENTATION  # a calibration holds for the sensor's own rows and columns
)


class Images(ABC):
    """The images of one camera, numbered from 0."""

    def __init__(self, path: Path) -> None:
        self.path = path
        # they come from JPEGs, known once counted; of other lossy streams no law of noise is known
        self.lossy = False

    @abstractmethod
    def count(self, torn: bool = False) -> int:
        """Count the images.

        Where the recording was cut off (`torn`), those before the first that is missing or damaged,
        found by decoding them all.

        Raises:
            InputError: it cannot be opened; unless `torn`, an image is missing or damaged.
        """

    @abstractmethod
    def images(self) -> Generator[Image]:
        """Decode the images in order: (h, w) grey or (h, w, 3) BGR; InputError: one cannot be."""


class Video(Images):
    """A video file."""

    def count(self, torn: bool = False) -> int:
        """Count the images without decoding them; FFV1's checksums are checked as they pass."""
        if torn:
            try:
                return min(self._intact()[0], sum(1 for _ in self.images()))
            except InputError as error:
                refused = isinstance(error.__cause__, OSError)
                if refused or not self.path.is_file() or self.path.stat().st_size > MAX_HEAD_BYTES:
                    raise
                return 0  # cut within its head or its first image
        first_bad, count = self._intact()
        if first_bad < count:
            found = f"image {first_bad} of {count} is damaged"
            raise InputError(self.path, found, "its checksum does not fit", _REMEDY)
        return count

    def _intact(self) -> tuple[int, int]:
        """Count the images before the first damaged one, and all."""
        checked, intact = False, []
        for packet in self.packets():
            # checksums stand in the slices' footers; without them a footer is the size alone
            checked = checked or _has_footers(packet)
            intact.append(ffv1_intact(packet))
        return intact.index(False) if checked and not all(intact) else len(intact), len(intact)

    def images(self) -> Generator[Image]:
        """Decode the images; grey where the stream is grey, else BGR."""
        with self._opened() as capture:
            pixels = int(capture.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT))
            if pixels < 0:  # cut off before the first image
                raise _decoder_refusal(self.path, "holds no image that can be decoded")
            form = pixels.to_bytes(4, "little")
            if form.startswith(_DEEP_GREY):
                raise _depth_refusal(self.path, form[3])
            if form == _GREY:
                capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)  # one channel instead of three equal ones
            while (taken := capture.read())[0]:
                yield np.asarray(taken[1], dtype=np.uint8)

    def packets(self) -> Iterator[bytes]:
        """Yield the images as they are encoded."""
        with self._opened(cv2.CAP_PROP_FORMAT, -1) as capture:
            self.lossy = int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little") == b"MJPG"
            while (taken := capture.read())[0]:
                yield taken[1].tobytes()

    @contextmanager
    def _opened(self, *options: int) -> Iterator[cv2.VideoCapture]:
        files.require_file(self.path)
        if cv2.getNumThreads() == 1:
            options = (*options, cv2.CAP_PROP_N_THREADS, 1)
        with files.named_for_library(self.path) as name:
            capture = cv2.VideoCapture(name, cv2.CAP_FFMPEG, options)
            try:
                if not capture.isOpened():
                    raise _decoder_refusal(self.path, "is not a video that can be decoded")
                yield capture
            finally:
                capture.release()


class NumberedImages(Images):
    """A folder of 000000.png, 000001.png, …; other files in it are left alone."""

    def count(self, torn: bool = False) -> int:
        """Count the images; none may be missing in between."""
        with files.refused_as_input_error(self.path):
            names = sorted(e.name for e in self.path.iterdir() if _NUMBERED.fullmatch(e.name))
        if torn:
            count = 0
            with suppress(InputError):
                for _ in self.images():
                    count += 1
            return count
        for number in range(max(len(names), 1)):
            if picture_name(number) not in names:
                last = f" up to {names[-1]}" if names else ""
                expected = f"it holds {len(names)} numbered images{last}"
                remedy = "Number them from 000000.png on, without a gap."
                raise InputError(self.path, f"has no {picture_name(number)}", expected, remedy)
        return len(names)

    def images(self) -> Generator[Image]:
        """Decode the images; grey where the file is grey, else BGR without alpha."""
        number = 0
        while (file := self.path / picture_name(number)).exists():
            yield decode_picture(file, "PNG", _REMEDY)
            number += 1


def open_images(path: Path) -> Images:
    """Open a video, or a folder of numbered PNGs."""
    return NumberedImages(path) if path.is_dir() else Video(path)


def decode_in_step(left: Images, right: Images, count: int) -> Generator[tuple[Image, Image]]:
    """Decode both sides in step, each in a thread of its own, a few images ahead.

    In a process of one thread a few images of a side are decoded at once instead: code and tables
    of the decoder then stay in the processor's cache.

    Raises:
        InputError: a side ends early or an image of it cannot be decoded.
    """
    decode = _in_batches if cv2.getNumThreads() == 1 else _prefetched
    with closing(decode(left, count)) as lefts, closing(decode(right, count)) as rights:
        yield from zip(lefts, rights, strict=True)


def _in_batches(side: Images, count: int) -> Generator[Image]:
    """Decode `BATCH_IMAGES` at once, when the first of them is needed."""
    with closing(side.images()) as images:
        for number in range(0, count, BATCH_IMAGES):
            size = min(BATCH_IMAGES, count - number)
            batch = deque(islice(images, size))
            decoded = len(batch)
            while batch:
                yield batch.popleft()  # no longer referenced here
            if decoded < size:
                raise _length_refusal(side, number + decoded, count)


def _prefetched(side: Images, count: int) -> Generator[Image]:
    """Decode in a thread, `PREFETCH_IMAGES` ahead; OpenCV releases the interpreter's lock."""
    images = side.images()
    pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="decode")
    try:
        ahead = deque(pool.submit(next, images, None) for _ in range(min(PREFETCH_IMAGES, count)))
        for number in range(count):
            image = ahead.popleft().result()
            if image is None:
                raise _length_refusal(side, number, count)
            if number + PREFETCH_IMAGES < count:
                ahead.append(pool.submit(next, images, None))
            yield image
    finally:  # also when the caller stops early: no thread and no open file outlives the loop
        pool.shutdown(wait=True, cancel_futures=True)
        images.close()


def _length_refusal(side: Images, number: int, count: int) -> InputError:
    return _decoder_refusal(side.path, f"only {number} of {count} images can be decoded")


def _decoder_refusal(path: Path, found: str) -> InputError:
    """Word what a decoder, which gives no reason, does not take."""
    files.require_memory(path)
    return InputError(path, found, "", _REMEDY)


def picture_name(number: int) -> str:
    """Name the file of an image in a folder of numbered ones."""
    return f"{number:06d}.png"


def decode_picture(file: Path, kind: str, remedy: str) -> Image:
    """Decode a picture file: (h, w) grey where the file is grey, else (h, w, 3) BGR.

    Raises:
        InputError: it cannot be read, is damaged, no picture, or deeper than 8 bits.
    """
    data = files.read_bytes(file)
    image = None
    if file.suffix.lower() != ".png" or png_intact(data):  # libpng fills a hole without an error
        with suppress(cv2.error):  # more pixels than OpenCV decodes
            image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), _FLAGS)
    if image is None:
        files.require_memory(file)
        raise InputError(file, f"is damaged or no {kind}", "", remedy)
    if image.dtype != np.uint8:
        raise _depth_refusal(file, 8 * image.dtype.itemsize)
    return np.asarray(image, dtype=np.uint8)


def _depth_refusal(path: Path, bits: int) -> InputError:
    remedy = "Convert it, or set the camera to 8 bits."
    return InputError(path, f"has {bits} bits a sample", "8 are expected", remedy)
