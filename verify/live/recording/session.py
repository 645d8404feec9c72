"""Write one session folder, whole after every pair.

Angles in frames.csv and encoders.csv have nine decimals of a degree. The live measurement uses the
written values too, so that live results and those from the recording agree but for rounding.
"""

import errno
import os
import shutil
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from verify.core.records import Array, Image
from verify.devices.protocols import CapturedPair, EncoderReading
from verify.errors import InputError
from verify.io.files import write_whole
from verify.io.toml import FORMAT, encode
from verify.io.unfinished import NAME as PENDING
from verify.io.unfinished import UnfinishedPairs, ring_bytes
from verify.live.recording import matroska


class CsvWriter(matroska.GrowingFile):
    """A CSV file that grows by whole lines.

    Raises:
        OSError: the system refuses it.
    """

    def __init__(self, path: Path, header: str) -> None:
        super().__init__(path)
        self.count = -1  # rows below the header
        self.add(header)

    def add(self, row: str) -> None:
        """Append a line, or nothing.

        Raises:
            OSError: the system refuses it.
        """
        self.append(f"{row}\n".encode())
        self.count += 1


def pair_as_written(pair: CapturedPair, turning: bool) -> CapturedPair:
    """Give the pair with the angles that its row has."""
    if not turning:
        return pair
    left, right = _as_written([pair.pan_left, pair.pan_right]).tolist()
    return replace(pair, pan_left=left, pan_right=right)


def reading_as_written(reading: EncoderReading) -> EncoderReading:
    """Give the reading with the angles that its row has."""
    return replace(reading, q=_as_written(reading.q.tolist()))


def _as_written(angles: list[float]) -> Array:
    return np.deg2rad([float(_degrees(angle)) for angle in angles])


def _degrees(angle: float) -> str:
    return f"{np.rad2deg(angle):.9f}"


MIN_FREE_BYTES = 1 << 20  # bytes that stay free: to close the session properly
MAX_UNENCODED_PAIRS = 16  # pairs that may wait to be encoded: half a second
MAX_DISK_SHARE = 0.05  # of what the disk has free, that waiting pairs may take


@dataclass(frozen=True, slots=True)
class SessionFacts:
    """What session.toml states, and the files beside it."""

    robot: str  # as session.toml names it
    joints: int
    # by name: rig.toml and marker.toml as far as they are known, the robot's file if it has one
    files: Mapping[str, bytes]
    tables: Mapping[str, Any]  # of session.toml: description, clock, tolerance, …
    turning: bool  # the bases turn: frames.csv has their angles
    time_stated: bool = False  # `tables` states how well the readings' times are known


@dataclass(frozen=True, slots=True)
class CameraFile:
    """One camera's file and what encodes for it."""

    coder: matroska.PictureEncoder
    file: matroska.MatroskaFile

    def attempt(self, image: Image, raw: bytes | None, t: float) -> Exception | None:
        """Encode a picture and append it; returns the error, as both sides must know of it."""
        try:
            self.file.add(self.coder.encode(image, raw), t)
        except Exception as error:
            return error
        return None


class SessionWriter:
    """A session folder that is open; it is made here.

    The files hold the kinds of pictures that the first pair has; it is not written yet.

    Raises:
        OSError, InputError: the system refuses it.
    """

    def __init__(
        self, folder: Path, facts: SessionFacts, started: datetime, first: CapturedPair
    ) -> None:
        self._folder, self._kinds = folder, matroska.picture_formats(first)
        self._facts, self._started = facts, started
        self._begin = first.t_left
        self._last_t = float("-inf")
        self._half_widths = 0.0  # s², sum of squares
        folder.mkdir(parents=True)
        for name, data in facts.files.items():
            write_whole(folder / name, data)
        self._write_header("open")
        coders = [matroska.PictureEncoder(kind) for kind in self._kinds]
        self._sides = tuple(
            CameraFile(coder, matroska.MatroskaFile(folder / f"{name}.mkv", coder.track))
            for name, coder in zip(("left", "right"), coders, strict=True)
        )
        pan = ",pan_left_deg,pan_right_deg" if facts.turning else ""
        self._frames = CsvWriter(folder / "frames.csv", f"frame,t_left_s,t_right_s{pan}")
        angles = ",".join(f"q{joint}_deg" for joint in range(1, facts.joints + 1))
        self._encoders = CsvWriter(folder / "encoders.csv", f"t_s,{angles},t_host_s")
        self._other = ThreadPoolExecutor(max_workers=1, thread_name_prefix="record")
        self._ring: UnfinishedPairs | None = None
        self._aside = 0

    @property
    def pairs(self) -> int:
        """How many pairs it holds."""
        return self._frames.count

    @property
    def readings(self) -> int:
        """How many readings it holds."""
        return self._encoders.count

    @property
    def room(self) -> bool:
        """Whether one more pair may be set aside."""
        return self._aside < MAX_UNENCODED_PAIRS

    def set_aside(self, pair: CapturedPair) -> bool:
        """Put a pair on the disk as it is; `add_pair` encodes it, in its turn, when there is time.

        False where it is to be added at once: the first pair, so that every file holds something;
        JPEGs, which need no encoding; and where the disk has little room.

        Raises:
            OSError: the system refuses it.
        """
        if not self.pairs or (pair.left_raw, pair.right_raw) != (None, None):
            return False
        if self._ring is None:
            shapes = (pair.left.shape, pair.right.shape)
            room = MAX_DISK_SHARE * shutil.disk_usage(self._folder).free
            if ring_bytes(*shapes, MAX_UNENCODED_PAIRS) > room:
                return False
            self._ring = UnfinishedPairs(self._folder / PENDING, *shapes, MAX_UNENCODED_PAIRS)
        self._ring.put(self.pairs + self._aside, pair)
        self._aside += 1
        return True

    def fits(self, pair: CapturedPair) -> bool:
        """Whether a pair's pictures are of the kind that its files hold."""
        return self._kinds == matroska.picture_formats(pair)

    def add_pair(self, pair: CapturedPair) -> None:
        """Append both pictures, then the row that makes them count.

        Raises:
            OSError: the system refuses it; the session is as before.
        """
        self._check_disk(pair)
        t = pair.t_left - self._begin
        left, right = self._sides
        of_right = self._other.submit(right.attempt, pair.right, pair.right_raw, t)
        failures = (left.attempt(pair.left, pair.left_raw, t), of_right.result())
        pan = ""
        if self._facts.turning:
            pan = f",{_degrees(pair.pan_left)},{_degrees(pair.pan_right)}"
        try:
            if (failure := next(filter(None, failures), None)) is not None:
                raise failure
            self._frames.add(f"{self.pairs},{pair.t_left!r},{pair.t_right!r}{pan}")
            self._aside = max(self._aside - 1, 0)
        except Exception:  # whatever it was: neither side keeps a picture that has no row
            for side, failure in zip(self._sides, failures, strict=True):
                if failure is None:
                    side.file.drop_last()
            raise

    def add_reading(self, reading: EncoderReading) -> bool:
        """Append a reading; False if its time is not after the last one's.

        Raises:
            OSError: the system refuses it; the session is as before.
        """
        if reading.t <= self._last_t:
            return False
        angles = ",".join(map(_degrees, reading.q.tolist()))
        self._encoders.add(f"{reading.t!r},{angles},{reading.t_host:.6f}")
        self._last_t = reading.t
        self._half_widths += reading.half_width**2
        return True

    def close(self) -> None:
        """Close every file, and mark the session as closed in session.toml.

        With pairs that are set aside it stays "open": whoever reads it appends them.

        Raises:
            OSError, InputError: the system refuses it; the session stays "open" and can be read.
        """
        self._other.shutdown(wait=True)
        with ExitStack() as stack:  # all are closed, whatever the disk says of one
            for file in (self._encoders, self._frames, *(side.file for side in self._sides)):
                stack.callback(file.close)
        if self._ring is not None:
            self._ring.close(keep=self._aside > 0)
        if not self._aside:
            self._write_header("closed")

    def _write_header(self, recording: str) -> None:
        """Write session.toml; recording: "open" or "closed"."""
        tables = dict(self._facts.tables)
        if not self._facts.time_stated and recording == "closed" and self.readings:
            # uniform within ± half-width: its standard deviation
            spread = float(np.sqrt(self._half_widths / self.readings / 3.0))
            stated = {"time_standard_uncertainty_s": float(f"{spread:.3g}")}
            tables["encoder_readings"] = {**tables.get("encoder_readings", {}), **stated}
        names = {key: f"{key}.mkv" for key in ("left", "right")}
        names |= {key: f"{key}.csv" for key in ("frames", "encoders")}
        head = {"format": FORMAT, "robot": self._facts.robot, "started": self._started}
        given = {key: f"{key}.toml" for key in ("rig", "marker")}  # neither may be known yet
        given = {key: name for key, name in given.items() if name in self._facts.files}
        files = {"recording": recording, **given, **names}
        write_whole(self._folder / "session.toml", encode({**head, **files, **tables}))

    def _check_disk(self, pair: CapturedPair) -> None:
        """Refuse a pair after which there would be no room to close the session.

        Raises:
            OSError: hardly anything is free, or the folder was deleted.
        """
        if not self._sides[0].file.linked():
            raise FileNotFoundError(errno.ENOENT, "the folder was deleted", str(self._folder))
        needed = MIN_FREE_BYTES + pair.left.nbytes + pair.right.nbytes
        if shutil.disk_usage(self._folder).free < needed:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self._folder))


def new_folder(parent: Path, name: str) -> Path:
    """Find a name that nothing in the folder has: name, name-2, and so on."""
    folder, number = parent / name, 1
    while folder.exists():
        number += 1
        folder = parent / f"{name}-{number}"
    return folder


def write_error_text(folder: Path, error: OSError | InputError) -> str:
    """Say why the system refused to write."""
    if isinstance(error, InputError):
        return f"{error.place}: {error.found}"
    return f"{folder}: {(error.strerror or str(error)).lower()}"
