"""A file of a recording that grows by whole pieces, whatever ends the program."""

import os
from pathlib import Path


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
