"""Decode sensor_msgs Image and CompressedImage: every encoding to 8 bits grey or BGR.

JPEGs are not decoded: a session holds them as the camera gave them, and measuring then knows that
they are lossy. Samples of 16 bits lose their low bits: a session has 8.

Source: ROS, sensor_msgs/image_encodings.h (names of encodings); OpenCV, cv::ColorConversionCodes.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from verify.core.records import Image
from verify.errors import InputError
from verify.io.bags.bag import COMPRESSED, BagMessage
from verify.io.video import png_intact

JPEG, JPEG_END, PNG = b"\xff\xd8\xff", b"\xff\xd9", b"\x89PNG\r\n\x1a\n"
PNG_DEPTH = 24  # byte of a PNG that holds its bits a sample
DEPTHS = (8, 10, 12, 14, 16)  # bits a sample that cameras deliver


@dataclass(frozen=True, slots=True)
class PictureEncoding:
    """How an encoding of ROS is stored, and what makes it grey or BGR."""

    dtype: str
    channels: int
    conversion: int | None = None  # of OpenCV; None: it is grey or BGR already


ENCODINGS = {
    **dict.fromkeys(("mono8", "8uc1"), PictureEncoding("u1", 1)),
    **dict.fromkeys(("mono16", "16uc1"), PictureEncoding("u2", 1)),
    **dict.fromkeys(("bgr8", "8uc3"), PictureEncoding("u1", 3)),
    "rgb8": PictureEncoding("u1", 3, cv2.COLOR_RGB2BGR),
    **dict.fromkeys(("bgra8", "8uc4"), PictureEncoding("u1", 4, cv2.COLOR_BGRA2BGR)),
    "rgba8": PictureEncoding("u1", 4, cv2.COLOR_RGBA2BGR),
    "bgr16": PictureEncoding("u2", 3),
    "rgb16": PictureEncoding("u2", 3, cv2.COLOR_RGB2BGR),
    **dict.fromkeys(("yuv422", "uyvy"), PictureEncoding("u1", 2, cv2.COLOR_YUV2BGR_UYVY)),
    **dict.fromkeys(("yuv422_yuy2", "yuyv"), PictureEncoding("u1", 2, cv2.COLOR_YUV2BGR_YUYV)),
} | {
    f"bayer_{order}{bits}": PictureEncoding(dtype, 1, conversion)
    for bits, dtype in ((8, "u1"), (16, "u2"))
    for order, conversion in (
        ("rggb", cv2.COLOR_BayerRGGB2BGR),
        ("bggr", cv2.COLOR_BayerBGGR2BGR),
        ("gbrg", cv2.COLOR_BayerGBRG2BGR),
        ("grbg", cv2.COLOR_BayerGRBG2BGR),
    )
}


def jpeg_of(message: BagMessage, place: str) -> bytes | None:
    """Take the JPEG out of a CompressedImage; None: the message is no JPEG.

    Raises:
        InputError: the JPEG is cut off.
    """
    if not _is_compressed(message):
        return None
    data = bytes(message.content.data)
    if not data.startswith(JPEG):
        return None
    if not data.rstrip(b"\0").endswith(JPEG_END):
        raise InputError(place, "is a JPEG that was cut off", "", "Record it again.")
    return data


def jpeg_size(data: bytes, place: str) -> tuple[int, int]:
    """Width and height of a JPEG, px; raises InputError: it cannot be decoded."""
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise InputError(place, "is a JPEG that cannot be decoded", "", "Record it again.")
    return image.shape[1], image.shape[0]


def greatest_sample(message: BagMessage, place: str) -> int:
    """The greatest sample of a picture of 16 bits; 0: its samples have 8 bits."""
    if _is_compressed(message):
        data = bytes(message.content.data[: PNG_DEPTH + 1])
        if not data.startswith(PNG) or data[PNG_DEPTH : PNG_DEPTH + 1] != b"\x10":
            return 0
    elif _encoding(message, place).dtype == "u1":
        return 0
    return int(_samples(message, place).max())


def decode_message(message: BagMessage, place: str, depth: int = 8) -> Image:
    """Decode a picture to (h, w) grey or (h, w, 3) BGR, 8 bits.

    `depth` is the number of bits of deeper samples; all but the highest 8 are dropped.

    Raises:
        InputError: an encoding that is not known, or fewer bytes than the picture has.
    """
    samples = _samples(message, place)
    if samples.dtype != np.uint8:
        samples = (samples >> (depth - 8)).astype(np.uint8)
    if not _is_compressed(message):
        conversion = _encoding(message, place).conversion
        if conversion is not None:
            samples = np.asarray(cv2.cvtColor(samples, conversion), dtype=np.uint8)
    return np.ascontiguousarray(samples, dtype=np.uint8)


def _is_compressed(message: BagMessage) -> bool:
    return str(message.content.__msgtype__) == COMPRESSED


def _encoding(message: BagMessage, place: str) -> PictureEncoding:
    name = str(message.content.encoding)
    encoding = ENCODINGS.get(name.lower())
    if encoding is None:
        expected = f"known are {', '.join(ENCODINGS)}"
        remedy = "Record the picture in one of them."
        raise InputError(place, f'is encoded as "{name}"', expected, remedy)
    return encoding


def _samples(message: BagMessage, place: str) -> NDArray[Any]:
    """The samples as they are stored, (h, w) or (h, w, channels)."""
    content = message.content
    if _is_compressed(message):
        return _decode_png(bytes(content.data), place)
    encoding = _encoding(message, place)
    height, width, step = int(content.height), int(content.width), int(content.step)
    kind = np.dtype(encoding.dtype).newbyteorder(">" if content.is_bigendian else "<")
    row = width * encoding.channels * kind.itemsize
    if min(height, width) < 1 or step < row or len(content.data) < step * height:
        found = f"has {len(content.data)} bytes for {width} x {height} px, {step} a row"
        raise InputError(place, found, f"{content.encoding} needs {row} a row", "Record it again.")
    rows = np.frombuffer(bytes(content.data), np.uint8, step * height).reshape(height, step)
    samples = np.ascontiguousarray(rows[:, :row]).view(kind)
    samples = samples.astype(kind.newbyteorder("="), copy=False)
    if encoding.channels == 1:
        return samples
    return samples.reshape(height, width, encoding.channels)


def _decode_png(data: bytes, place: str) -> NDArray[Any]:
    image = None
    if png_intact(data):  # libpng fills a hole without an error
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        expected = "pictures compressed as JPEG or PNG are expected"
        raise InputError(place, "cannot be decoded", expected, "Record it again.")
    return np.asarray(image[..., :3] if image.ndim == 3 else image)
