"""Write pairs of board pictures to a folder, each pair whole or not at all."""

import shutil
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from verify.core.fiducials import Board
from verify.core.records import SIDES, Image, StereoPair
from verify.errors import InputError
from verify.io import fiducials
from verify.io.files import refused_as_input_error, write_whole

FRAMES_FILE = "frames.csv"
HEADER = "frame,t_left_s,t_right_s,pan_left_deg,pan_right_deg"
PAIR_PREFIX = ".pair-"  # of a folder with a pair that is whole but not in place
PARTIAL_SUFFIX = ".under-way"  # a pair that is not whole yet


class BoardPictures:
    """A folder that `verify calibrate boards` reads, filled pair by pair.

    A pair's files are written into a folder of their own, and one rename makes them count. If the
    program is stopped after that, `complete_pairs` moves them into place.

    Raises:
        InputError: the folder holds something, or the system refuses it.
    """

    def __init__(self, folder: Path, board: Board, *, turning: bool) -> None:
        self.folder, self._board, self._turning = folder, board, turning
        self._rows = [HEADER]
        with refused_as_input_error(folder):
            if folder.exists() and any(folder.iterdir()):
                expected = "nothing is added to pictures that are there"
                remedy = "Name another folder with --pictures, or calibrate from this one."
                raise InputError(folder, "is not empty", expected, remedy)

    def __len__(self) -> int:
        """Count the pairs."""
        return len(self._rows) - 1

    def keep(self, pair: StereoPair) -> None:
        """Write a pair; on the disk when this returns.

        Raises:
            InputError: no room, or no permission; the pairs before are whole.
        """
        number = len(self)
        name = f"{number:06d}.png"
        under_way, whole = self.folder / PARTIAL_SUFFIX, self.folder / f"{PAIR_PREFIX}{number:06d}"
        rows, pictures = [*self._rows, _row(number, pair)], (_png(pair.left), _png(pair.right))
        with refused_as_input_error(self.folder):
            shutil.rmtree(under_way, ignore_errors=True)
            for side, picture in zip(SIDES, pictures, strict=True):
                (under_way / side).mkdir(parents=True)
                write_whole(under_way / side / name, picture)
            if number == 0:
                fiducials.write_board(under_way / "board.toml", self._board)
            if self._turning:
                write_whole(under_way / FRAMES_FILE, ("\n".join(rows) + "\n").encode())
            under_way.rename(whole)
        complete_pairs(self.folder)
        self._rows = rows


def complete_pairs(folder: Path) -> None:
    """Put pairs in place that are whole but were interrupted on their way; may be called any time.

    Raises:
        InputError: the system refuses it.
    """
    with refused_as_input_error(folder):
        for whole in sorted(folder.glob(f"{PAIR_PREFIX}*")):
            for file in sorted(f for f in whole.rglob("*") if f.is_file()):
                place = folder / file.relative_to(whole)
                place.parent.mkdir(exist_ok=True)
                file.replace(place)
            shutil.rmtree(whole)


def _row(number: int, pair: StereoPair) -> str:
    pans: Sequence[float] = np.rad2deg([pair.pan_left, pair.pan_right]).tolist()
    cells = [f"{v:.6f}" for v in (pair.t_left, pair.t_right)] + [f"{v:.9f}" for v in pans]
    return ",".join([str(number), *cells])


def _png(image: Image) -> bytes:
    done, data = cv2.imencode(".png", image)
    if not done:
        raise ValueError("OpenCV could not encode a picture as PNG")
    return data.tobytes()
