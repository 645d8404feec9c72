"""One session folder while it is being written: whole after every pair."""

import errno
import os
import shutil
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from verify.devices import EncoderReading
from verify.errors import InputError
from verify.pending import NAME as PENDING
from verify.pending import PendingRing, ring_bytes
from verify.recording.matroska import MatroskaFile
from verify.recording.pictures import Coder, Kind, kind_of
from verify.recording.rows import (
    Rows,
    encoders_header,
    encoders_row,
    frames_header,
    frames_row,
)
from verify.records import Image, StereoPair
from verify.toml_file import FORMAT, encode
from verify.writing import write_whole

RESERVE = 1 << 20  # bytes that stay free: to close the session properly
ASIDE = 16  # pairs that may wait to be encoded: half a second
SHARE = 0.05  # of what the disk has free, that waiting pairs may take


@dataclass(frozen=True, slots=True)
class Facts:
    """What a session says beside its series."""

    robot: str  # as session.toml names it
    joints: int
    files: Mapping[str, bytes]  # by name: rig.toml, marker.toml, and the robot's file if it has one
    tables: Mapping[str, Any]  # of session.toml: description, clock, tolerance, …
    turning: bool  # the bases turn: frames.csv tells their angles
    time_stated: bool = False  # `tables` tells how well the readings' times are known


@dataclass(frozen=True, slots=True)
class Side:
    """One camera's file and what encodes for it."""

    coder: Coder
    file: MatroskaFile

    def attempt(self, image: Image, raw: bytes | None, t: float) -> Exception | None:
        """Encode a picture and append it; what went wrong is handed back, for both sides' sake."""
        try:
            self.file.add(self.coder.encode(image, raw), t)
        except Exception as error:
            return error
        return None


class Part:
    """A session folder that is open.

    Args:
        folder: is made.
        facts: what session.toml says.
        started: when.
        kinds: of pictures, left and right.

    Raises:
        OSError, InputError: the system refuses it.
    """

    def __init__(
        self, folder: Path, facts: Facts, started: datetime, kinds: tuple[Kind, Kind]
    ) -> None:
        self.folder, self.kinds = folder, kinds
        self._facts, self._started = facts, started
        self._begin: float | None = None
        self._last_t = float("-inf")
        self._half_widths = 0.0  # s², sum of squares
        folder.mkdir(parents=True)
        for name, data in facts.files.items():
            write_whole(folder / name, data)
        self._say("open")
        coders = [Coder(kind) for kind in kinds]
        self._sides = tuple(
            Side(coder, MatroskaFile(folder / f"{name}.mkv", coder.track))
            for name, coder in zip(("left", "right"), coders, strict=True)
        )
        self._frames = Rows(folder / "frames.csv", frames_header(facts.turning))
        self._encoders = Rows(folder / "encoders.csv", encoders_header(facts.joints))
        self._other = ThreadPoolExecutor(max_workers=1, thread_name_prefix="record")
        self._ring: PendingRing | None = None
        self._aside = 0

    @property
    def pairs(self) -> int:
        """How many pairs it holds."""
        return self._frames.count

    @property
    def room(self) -> bool:
        """Whether one more pair may be set aside."""
        return self._aside < ASIDE

    def set_aside(self, pair: StereoPair, raws: tuple[bytes | None, bytes | None]) -> bool:
        """Put a pair on the disk as it is; `add_pair` encodes it, in its turn, when there is time.

        Returns:
            False where that is no help: it is to be added at once. The first pair is, so that
            every file holds something; JPEGs are, which need no encoding.

        Raises:
            OSError: the system refuses it.
        """
        if not self.pairs or raws != (None, None):
            return False
        if self._ring is None:
            shapes = (pair.left.shape, pair.right.shape)
            if ring_bytes(*shapes, ASIDE) > SHARE * shutil.disk_usage(self.folder).free:
                return False
            self._ring = PendingRing(self.folder / PENDING, *shapes, ASIDE)
        self._ring.put(self.pairs + self._aside, pair)
        self._aside += 1
        return True

    @property
    def readings(self) -> int:
        """How many readings it holds."""
        return self._encoders.count

    def fits(self, raws: tuple[bytes | None, bytes | None], pair: StereoPair) -> bool:
        """Whether a pair's pictures are of the kind that its files hold."""
        return self.kinds == (kind_of(pair.left, raws[0]), kind_of(pair.right, raws[1]))

    def add_pair(self, pair: StereoPair, raws: tuple[bytes | None, bytes | None]) -> None:
        """Append both pictures, then the row that makes them count.

        Raises:
            OSError: the system refuses it; the session is as before.
        """
        self._check_disk(pair)
        if self._begin is None:
            self._begin = pair.t_left
        t = pair.t_left - self._begin
        left, right = self._sides
        of_right = self._other.submit(right.attempt, pair.right, raws[1], t)
        failures = (left.attempt(pair.left, raws[0], t), of_right.result())
        try:
            if (refused := next(filter(None, failures), None)) is not None:
                raise refused
            self._frames.add(frames_row(self.pairs, pair, self._facts.turning))
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
        self._encoders.add(encoders_row(reading))
        self._last_t = reading.t
        self._half_widths += reading.half_width**2
        return True

    def close(self) -> None:
        """Close every file, and say in session.toml that the session is whole.

        Raises:
            OSError, InputError: the system refuses it; the session stays "open" and can be read.
        """
        self._other.shutdown(wait=True)
        failure: OSError | None = None
        files: list[MatroskaFile | Rows] = [side.file for side in self._sides]
        for file in (*files, self._frames, self._encoders):
            try:
                file.close()
            except OSError as error:
                failure = error
        if failure is not None:
            raise failure
        if self._ring is not None:
            self._ring.close()
        self._say("closed")

    def _say(self, recording: str) -> None:
        """Write session.toml."""
        tables = dict(self._facts.tables)
        if not self._facts.time_stated and recording == "closed" and self.readings:
            # uniform within ± half-width: its standard deviation
            spread = float(np.sqrt(self._half_widths / self.readings / 3.0))
            told = {"time_standard_uncertainty_s": float(f"{spread:.3g}")}
            tables["encoder_readings"] = {**tables.get("encoder_readings", {}), **told}
        names = {key: f"{key}.mkv" for key in ("left", "right")}
        names |= {key: f"{key}.csv" for key in ("frames", "encoders")}
        head = {"format": FORMAT, "robot": self._facts.robot, "started": self._started}
        files = {"recording": recording, "rig": "rig.toml", "marker": "marker.toml", **names}
        write_whole(self.folder / "session.toml", encode({**head, **files, **tables}))

    def _check_disk(self, pair: StereoPair) -> None:
        """Stop before it is too late.

        Raises:
            OSError: hardly anything is free, or the folder was deleted.
        """
        if not self._sides[0].file.linked():
            raise FileNotFoundError(errno.ENOENT, "the folder was deleted", str(self.folder))
        if shutil.disk_usage(self.folder).free < RESERVE + pair.left.nbytes + pair.right.nbytes:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.folder))


def new_folder(parent: Path, name: str) -> Path:
    """Find a name that nothing in the folder has: name, name-2, and so on."""
    folder, number = parent / name, 1
    while folder.exists():
        number += 1
        folder = parent / f"{name}-{number}"
    return folder


def discard(folder: Path) -> None:
    """Take a folder away that could not be begun."""
    with suppress(OSError):
        for file in folder.iterdir():
            file.unlink()
        folder.rmdir()


def worded(folder: Path, error: OSError | InputError) -> str:
    """Say why the system refused to write."""
    if isinstance(error, InputError):
        return f"{error.place}: {error.found}"
    return f"{folder}: {(error.strerror or str(error)).lower()}"
