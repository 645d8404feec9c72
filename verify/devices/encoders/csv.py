"""A CSV that another program is writing: what is appended is read, as `tail -f` would show it."""

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from verify.devices.encoders.intake import AngleMap
from verify.devices.encoders.text import FieldMap, LineEncoders, TextIntake
from verify.devices.ports import MAX_LINE_BYTES, PortLink, wait_until

POLL_PERIOD = 0.005  # s: how often a file at rest is asked whether it has grown
MAX_READ_BYTES = 1 << 20  # bytes at once: a program may flush much
_NAME = re.compile(r"q([1-9][0-9]?)_(deg|rad)")
_LETTER = re.compile(rb"[A-DF-Za-df-z_]")  # e and E stand in numbers too


@dataclass(frozen=True, slots=True)
class CsvSettings:
    """Which file is followed."""

    path: Path
    fields: FieldMap | None = None  # None: the first line names t_s and q1_deg, q2_deg, …
    latency: float = 0.1  # s, by which a row may come late; used only where rows have no time


class CsvEncoders(LineEncoders):
    """Joint readings from a file that grows.

    What stood there before is not read: when it came is not known. A file that is cut, replaced or
    made later is read from its beginning.
    """

    def __init__(self, settings: CsvSettings, angles: AngleMap) -> None:
        super().__init__(PortLink(str(settings.path), self._open))
        self._settings, self._angles = settings, angles
        self._from_start = False
        self._header = b""

    def _open(self) -> "FilePort":
        try:
            port = FilePort(self._settings.path, from_start=self._from_start)
        except FileNotFoundError as error:
            self._from_start = True  # whatever appears there later is new
            raise OSError("the file does not exist yet") from error
        self._from_start = True
        self._header = port.header
        return port

    def _begin(self) -> None:
        fields = self._settings.fields or _field_map(self._header, self._angles.joints)
        self._intake, self._fault = None, ""
        if isinstance(fields, str):
            self._fault = fields
            return
        self._intake = TextIntake(
            fields, self._angles, self._settings.latency, self.counts, in_lumps=True
        )  # programs write in lumps, some of many seconds


def _field_map(header: bytes, joints: int) -> FieldMap | str:
    """Make a field map of a first line; a complaint, where it does not name what is needed."""
    names = [name.strip() for name in header.decode("utf-8-sig", errors="replace").split(",")]
    units = {match[2] for name in names if (match := _NAME.fullmatch(name))}
    unit = units.pop() if len(units) == 1 else "deg"
    wanted = ["t_s", *(f"q{joint}_{unit}" for joint in range(1, joints + 1))]
    if missing := [name for name in wanted if names.count(name) != 1]:
        return f"its first line has no (or two) {', '.join(missing)}; name the columns in `columns`"
    columns = tuple(name.partition("_")[0] if name in wanted else "_" for name in names)
    return FieldMap(joints, columns, time_unit="s", angle_unit=unit)


class FilePort:
    """Follows one file, as a port.

    Raises:
        OSError: it cannot be opened, or has no first line yet.
    """

    def __init__(self, path: Path, *, from_start: bool) -> None:
        self._path = path
        self._file: BinaryIO = path.open("rb", buffering=0)
        self.header = self._file.read(MAX_LINE_BYTES) or b""
        first, end, _ = self.header.partition(b"\n")
        if not end:
            self._file.close()
            raise OSError("has no first line yet")
        self.header = first
        self._at = len(first) + 1 if _LETTER.search(first) else 0
        self._partial = False  # the next bytes end a line whose beginning was not read
        if not from_start:
            self._at = self._file.seek(-1, os.SEEK_END) + 1
            self._partial = self._file.read(1) != b"\n"

    def wait(self, seconds: float) -> bool:
        """Wait until the file has grown; OSError: it is another file now, or a shorter one."""
        return wait_until(self._grown, seconds, POLL_PERIOD)

    def take(self) -> bytes:
        """Take what was appended, without the end of a line that had begun before."""
        self._file.seek(self._at)
        data = self._file.read(MAX_READ_BYTES) or b""
        self._at += len(data)
        if self._partial:
            _, end, data = data.partition(b"\n")
            self._partial = not end
        return data

    def send(self, data: bytes) -> None:  # noqa: ARG002  a port has this verb
        """Refuse: the file belongs to the other program."""
        raise OSError("a file that is followed is not written to")

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _grown(self) -> bool:
        size = self._file.seek(0, os.SEEK_END)
        if size > self._at:
            return True
        if size < self._at:
            raise OSError("the file was truncated; it is read again from its beginning")
        if not os.path.samestat(self._path.stat(), os.fstat(self._file.fileno())):
            raise OSError("another file has taken its place")
        return False
