"""Lossless video whose bytes depend on nothing but the pictures."""

import hashlib
import re
from collections.abc import Iterable
from pathlib import Path

import cv2

from verify.core.records import Image
from verify.errors import InputError

HEADER = 2048  # bytes: Matroska's facts about the file stand before its first cluster
# EBML identifiers with their lengths, where the muxer puts random numbers: the segment's, the
# track's and the tags' identity; and the checksums of the elements that hold them.
SEGMENT_UID = rb"\x73\xa4\x90"
TRACK_UID = rb"\x73\xc5\x88"
TAG_TRACK_UID = rb"\x63\xc5\x88"
CHECKSUM = rb"(?:\x15\x49\xa9\x66|\x16\x54\xae\x6b|\x12\x54\xc3\x67)[\x40-\xff].??(\xbf\x84.{4})"
VOID = b"\xec\x84\0\0\0\0"  # padding of a checksum's size, which Matroska allows anywhere


def write_video(path: Path, images: Iterable[Image], rate_hz: float) -> None:
    """Write pictures as FFV1 in Matroska.

    Args:
        path: ends in .mkv.
        images: all of one size, all grey (h, w) or all BGR (h, w, 3).
        rate_hz: for players alone; the session's times stand in frames.csv.

    Raises:
        InputError: this machine's OpenCV cannot write such a file there.
    """
    writer: cv2.VideoWriter | None = None
    for image in images:
        if writer is None:
            size = (image.shape[1], image.shape[0])
            code = cv2.VideoWriter.fourcc(*"FFV1")
            writer = cv2.VideoWriter(str(path), code, max(rate_hz, 1.0), size, image.ndim == 3)
            if not writer.isOpened():
                raise InputError(
                    path,
                    "OpenCV cannot write FFV1 video here",
                    remedy='Check the folder, or choose recording.format = "png".',
                )
        writer.write(image)
    if writer is not None:
        writer.release()
        make_reproducible(path)


def make_reproducible(path: Path) -> None:
    """Replace the muxer's random identities by ones made from the pictures themselves."""
    with path.open("r+b") as file:
        header = file.read(HEADER)
        pictures = hashlib.sha256(file.read()).digest()
        header = re.sub(CHECKSUM, lambda m: m[0][: -len(VOID)] + VOID, header, flags=re.DOTALL)
        header = _identify(header, SEGMENT_UID, pictures[:16])
        header = _identify(header, TRACK_UID, pictures[16:24])
        header = _identify(header, TAG_TRACK_UID, pictures[16:24])
        file.seek(0)
        file.write(header)


def _identify(header: bytes, element: bytes, identity: bytes) -> bytes:
    return re.sub(
        element + b".{%d}" % len(identity),
        lambda m: m[0][: -len(identity)] + identity,
        header,
        count=1,
        flags=re.DOTALL,
    )
