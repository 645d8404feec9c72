"""Is an image as it was recorded? The checksums that PNG and FFV1 carry, which decoders ignore.

OpenCV hands out a damaged FFV1 picture without a word (the decoder fills the hole with what the
picture before showed there), so an LED would stand where it no longer is.
"""

import zlib

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
