"""Pictures of another board than the stated one name the board they show."""

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.support.boards.board_images import HALF_CAMERA, HALF_SIZE, picture, placed
from tests.support.recorded import refusal
from verify.calibration.corners.folder import find_boards
from verify.core.fiducials import Board
from verify.errors import InputError
from verify.io.board.folder import open_board_folder

PLAIN = Board(columns=7, rows=5, square=0.04)
CHARUCO = replace(PLAIN, markers="DICT_5X5_100", marker=0.03)
OTHER = replace(PLAIN, markers="DICT_4X4_50", marker=0.03)


def complaint(folder: Path, shown: Board, stated: Board) -> InputError:
    """What is said of one pair of pictures of a board when another is stated."""
    for i, side in enumerate(("left", "right")):
        (folder / side).mkdir()
        rng = np.random.default_rng(i)
        camera_T_board = placed((0.2, 0.1, 0.0), (0.0, 0.0, 0.6), shown)
        image = picture(shown, HALF_CAMERA, camera_T_board, rng, size=HALF_SIZE)
        cv2.imwrite(str(folder / side / "0.png"), image)
    return refusal(find_boards, open_board_folder(folder, stated), lambda _done, _of: None)


@pytest.mark.parametrize(
    ("shown", "stated", "found", "expected"),
    [
        (PLAIN, CHARUCO, "no marker was found.*a plain board of 7 x 5 inner corners", "ChArUco"),
        pytest.param(
            CHARUCO, PLAIN, "with markers, as in DICT_5X5_250",
            "a plain one of 7 x 5 inner corners", marks=pytest.mark.long,
        ),
        (OTHER, CHARUCO, "markers as in DICT_4X4_250", "DICT_5X5_100"),
        (replace(PLAIN, columns=8), PLAIN, "8 x 5 inner corners", ""),
    ],
    ids=["plain for charuco", "charuco for plain", "another dictionary", "other counts"],
)  # fmt: skip
def test_another_board_is_named_from_one_pair_on(
    shown: Board, stated: Board, found: str, expected: str, tmp_path: Path
) -> None:
    error = complaint(tmp_path, shown, stated)
    assert re.search(found, error.found)
    assert expected in error.expected
