"""Rows of frames.csv and encoders.csv as they come; what they say is what is measured with.

Angles are written in degrees with nine decimals, and both the file's reader and the live
measurement take them from there: so the two cannot differ, not even in the last digit.
"""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from verify.cameras import TakenPair
from verify.devices import EncoderReading
from verify.recording.matroska import close_for_good, write_all
from verify.records import StereoPair


class Rows:
    """A CSV file that grows by whole lines.

    Args:
        path: a new file.
        header: names of its columns.

    Raises:
        OSError: the system refuses it.
    """

    def __init__(self, path: Path, header: str) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)  # less the umask
        self._length = 0
        self.count = -1  # rows below the header
        self.add(header)

    def add(self, row: str) -> None:
        """Append a line, or nothing.

        Raises:
            OSError: the system refuses it.
        """
        data = f"{row}\n".encode()
        write_all(self._file, data, self._length)
        self._length += len(data)
        self.count += 1

    def close(self) -> None:
        """Have the disk hold it, and close it.

        Raises:
            OSError: the system refuses it; it is closed all the same.
        """
        close_for_good(self._file)


def frames_header(turning: bool) -> str:
    """Name the columns of frames.csv; with `turning` the bases' angles have theirs."""
    pan = ",pan_left_deg,pan_right_deg" if turning else ""
    return f"frame,t_left_s,t_right_s{pan}"


def frames_row(frame: int, pair: StereoPair, turning: bool) -> str:
    """Word a pair's row."""
    pan = f",{_degrees(pair.pan_left)},{_degrees(pair.pan_right)}" if turning else ""
    return f"{frame},{pair.t_left!r},{pair.t_right!r}{pan}"


def encoders_header(joints: int) -> str:
    """Name the columns of encoders.csv; when a reading came is kept too, for later doubts."""
    angles = ",".join(f"q{joint}_deg" for joint in range(1, joints + 1))
    return f"t_s,{angles},t_host_s"


def encoders_row(reading: EncoderReading) -> str:
    """Word a reading's row."""
    angles = ",".join(map(_degrees, reading.q.tolist()))
    return f"{reading.t!r},{angles},{reading.t_host:.6f}"


def pair_as_written(pair: TakenPair | StereoPair, turning: bool) -> TakenPair | StereoPair:
    """Give the pair with the angles that its row has."""
    if not turning:
        return pair
    return replace(pair, pan_left=_as_read(pair.pan_left), pan_right=_as_read(pair.pan_right))


def reading_as_written(reading: EncoderReading) -> EncoderReading:
    """Give the reading with the angles that its row has."""
    text = [float(_degrees(angle)) for angle in reading.q.tolist()]
    return replace(reading, q=np.deg2rad(np.array(text)))


def _degrees(angle: float) -> str:
    return f"{np.rad2deg(angle):.9f}"


def _as_read(angle: float) -> float:
    return float(np.deg2rad(float(_degrees(angle))))
