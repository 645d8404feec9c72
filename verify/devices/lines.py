"""Bytes to lines, and the checksums that lines carry."""

LONGEST = 4096  # bytes: noise without a line end must not fill the memory


class LineBuffer:
    """Collects bytes until a line is whole; never hands out half a line."""

    def __init__(self) -> None:
        self._rest = b""
        self.overlong = 0  # lines dropped because no end came

    def feed(self, data: bytes) -> list[bytes]:
        """Add bytes; get the lines that they complete, without LF, CR LF or blanks about them."""
        *whole, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > LONGEST:
            self._rest = b""
            self.overlong += 1
        return [line for line in map(bytes.strip, whole) if line]

    def clear(self) -> None:
        """Forget a half line, whose other half will not come."""
        self._rest = b""


def xor(data: bytes) -> int:
    """Exclusive or of all bytes, as NMEA 0183 does."""
    total = 0
    for byte in data:
        total ^= byte
    return total


def sum8(data: bytes) -> int:
    """Sum of all bytes, its lowest eight bits."""
    return sum(data) & 0xFF


def crc8(data: bytes) -> int:
    """CRC-8: polynomial 0x07, start 0, not reflected; F4 for "123456789"."""
    return _crc(data, 8, 0x07, 0x00)


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF; 29B1 for "123456789"."""
    return _crc(data, 16, 0x1021, 0xFFFF)


def _crc(data: bytes, bits: int, polynomial: int, start: int) -> int:
    register, top = start, 1 << (bits - 1)
    for byte in data:
        register ^= byte << (bits - 8)
        for _ in range(8):
            register = (register << 1) ^ (polynomial if register & top else 0)
        register &= (1 << bits) - 1
    return register


# width in hexadecimal digits, and the function
CHECKSUMS = {"xor": (2, xor), "sum8": (2, sum8), "crc8": (2, crc8), "crc16": (4, crc16)}
