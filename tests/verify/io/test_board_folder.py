from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.support.recorded import images, replace, require_shared, write_video
from verify.core.fiducials import Board
from verify.core.records import Image
from verify.errors import InputError
from verify.io.board.folder import BoardFolder, open_board_folder

BOARD = Board(9, 7, 0.04)
LEFT, RIGHT = images(3), images(3)[::-1]
FRAMES = "frame,pan_left_deg,pan_right_deg\n0,5.0,-5.0\n1,10.0,-5.0\n2,0.0,2.5\n"


def put(folder: Path, names: list[str], pictures: list[Image]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, picture in zip(names, pictures, strict=True):
        assert cv2.imwrite(str(folder / name), picture)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    names = [f"{i:06d}.png" for i in range(3)]
    put(tmp_path / "left", names, LEFT)
    put(tmp_path / "right", names, RIGHT)
    (tmp_path / "board.toml").write_text("format=1\ninner_corners=[9, 7]\nsquare_mm=40.0\n")
    return tmp_path


def seen(boards: BoardFolder) -> tuple[list[Image], list[Image]]:
    pairs = list(boards.pairs())
    assert [pair.frame for pair in pairs] == list(range(len(boards)))
    return [pair.left for pair in pairs], [pair.right for pair in pairs]


def refusal(folder: Path, board: Board | None = None) -> str:
    with pytest.raises(InputError) as caught:
        for _ in open_board_folder(folder, board).pairs():
            pass
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_pairs_come_as_they_were_taken(folder: Path) -> None:
    (folder / "rig.toml").write_text("not even TOML: it is never read")
    boards = open_board_folder(folder)
    assert (boards.board, boards.image_size) == (BOARD, (64, 48))
    assert boards.warnings == ()
    assert set(boards.inputs) == {"board.toml", "left", "right"}
    left, right = seen(boards)
    assert_array_equal(left, LEFT)
    assert_array_equal(right, RIGHT)


def test_pan_columns_are_read_with_times_and_without(folder: Path) -> None:
    for text in (FRAMES, FRAMES.replace("frame,", "frame,t_left_s,t_right_s,")):
        rows = text.splitlines()
        if "t_left_s" in rows[0]:
            rows[1:] = [row.replace(",", ",1.0,1.0,", 1) for row in rows[1:]]
        (folder / "frames.csv").write_text("\n".join(rows) + "\n")
        boards = open_board_folder(folder)
        assert_allclose(boards.pan_left, np.radians([5, 10, 0]))
        assert_allclose(boards.pan_right, np.radians([-5, -5, 2.5]))
        assert boards.warnings == ()
        assert [pair.pan_left for pair in boards.pairs()] == boards.pan_left.tolist()


def test_a_pan_angle_of_many_turns_is_refused(folder: Path) -> None:
    (folder / "frames.csv").write_text("frame,pan_left_deg,pan_right_deg\n0,1,1\n1,5e16,2\n2,3,3\n")
    assert "line 3: pan_left_deg is 5e+16; at most 3600 is plausible" in refusal(folder)


def test_names_are_sorted_as_people_count(tmp_path: Path) -> None:
    names = ["img2.png", "img10.png", "img1.png"]
    put(tmp_path / "left", names, LEFT)
    put(tmp_path / "right", names, RIGHT)
    boards = open_board_folder(tmp_path, BOARD)
    assert [boards.name(i) for i in range(3)] == ["img1.png", "img2.png", "img10.png"]
    left, right = seen(boards)
    assert_array_equal(left, [LEFT[2], LEFT[0], LEFT[1]])
    assert_array_equal(right, [RIGHT[2], RIGHT[0], RIGHT[1]])


@pytest.mark.parametrize(
    ("lefts", "rights", "names"),
    [
        (["left01.png", "left3.png"], ["right01.png", "right3.png"], "left01.png and right01.png"),
        (["a_001.png", "a_003.png"], ["b7-1.png", "b7-3.png"], "a_001.png and b7-1.png"),
        (["x.png", "y.png"], ["u.png", "v.png"], "x.png and u.png"),
    ],
)
def test_partners_are_found_by_name_by_number_or_in_order(
    tmp_path: Path, lefts: list[str], rights: list[str], names: str
) -> None:
    put(tmp_path / "left", lefts, LEFT[:2])
    put(tmp_path / "right", rights, RIGHT[:2])
    boards = open_board_folder(tmp_path, BOARD)
    assert boards.name(0) == names
    assert_array_equal(seen(boards)[1], RIGHT[:2])


def test_pictures_of_both_sides_may_lie_side_by_side(tmp_path: Path) -> None:
    put(tmp_path, ["left1.png", "left2.png"], LEFT[:2])
    put(tmp_path, ["right1.png", "right2.png"], RIGHT[:2])
    boards = open_board_folder(tmp_path, BOARD)
    assert set(boards.inputs) == {"left1.png", "left2.png", "right1.png", "right2.png"}
    assert_array_equal(seen(boards)[0], LEFT[:2])


def test_two_videos_do_as_well(tmp_path: Path) -> None:
    write_video(tmp_path / "left.mkv", LEFT)
    write_video(tmp_path / "right.avi", RIGHT)
    boards = open_board_folder(tmp_path, BOARD)
    assert boards.name(1) == "image 1"
    assert_array_equal(seen(boards)[1], RIGHT)


def test_a_board_by_option_wins_and_a_contradiction_is_reported(folder: Path) -> None:
    other = Board(8, 6, 0.025)
    boards = open_board_folder(folder, other)
    assert boards.board == other
    assert "9 x 7 inner corners of 40 mm; 8 x 6 inner corners of 25 mm" in boards.warnings[0]
    assert open_board_folder(folder, BOARD).warnings == ()
    (folder / "board.toml").write_text("format = 2")
    assert "format: is 2" in open_board_folder(folder, other).warnings[0]


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("frame,pan_left_deg,pan_rigth_deg", "Did you mean `pan_right_deg`?"),
        ("frame,pan_left_deg,other", "no pan_right_deg; that base is taken to stand at 0"),
    ],
)
def test_a_missing_or_misspelt_pan_column_is_reported(
    folder: Path, header: str, message: str
) -> None:
    (folder / "frames.csv").write_text(FRAMES.replace(FRAMES.splitlines()[0], header))
    boards = open_board_folder(folder)
    assert any(message in warning for warning in boards.warnings)
    assert_allclose(boards.pan_right, 0)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("2,0.0,2.5\n", "", "has 2 rows; there are 3 pairs"),
        ("2,0.0", "3,0.0", "line 4: frame is 3; 2 is expected"),
        ("2,0.0", "2,", "line 4: pan_left_deg is empty"),
        ("frame", "number", "no column frame"),
    ],
)
def test_a_wrong_frames_csv_is_refused(folder: Path, old: str, new: str, message: str) -> None:
    (folder / "frames.csv").write_text(FRAMES)
    replace(folder / "frames.csv", old, new)
    assert message in refusal(folder)


def test_folders_that_hold_no_pairs_are_refused(tmp_path: Path) -> None:
    assert "does not exist" in refusal(tmp_path / "nowhere", BOARD)
    assert "has no left/" in refusal(tmp_path, BOARD)
    (tmp_path / "left").mkdir()
    put(tmp_path / "right", ["a.png"], RIGHT[:1])
    assert "left: holds no pictures" in refusal(tmp_path, BOARD)
    put(tmp_path / "left", ["a.png"], LEFT[:1])
    assert "has no board.toml" in refusal(tmp_path)
    (tmp_path / "right" / "a.png").rename(tmp_path / "elsewhere.png")
    (tmp_path / "right").rmdir()
    assert "has no right/" in refusal(tmp_path, BOARD)
    (tmp_path / "right").symlink_to(tmp_path / "left")
    assert "leads to the left pictures" in refusal(tmp_path, BOARD)
    assert "is a file" in refusal(tmp_path / "elsewhere.png", BOARD)


def test_a_picture_without_a_partner_is_named_and_counts_for_one_camera(tmp_path: Path) -> None:
    put(tmp_path / "left", ["0.png", "1.png"], LEFT[:2])
    put(tmp_path / "right", ["1.png"], RIGHT[:1])
    boards = open_board_folder(tmp_path, BOARD)
    assert (len(boards), boards.name(0), boards.name(1)) == (1, "1.png", "0.png")
    assert "left/0.png: has no partner" in boards.warnings[0]
    ((frame, side, image),) = boards.single_pictures()
    assert (frame, side) == (1, "left")
    assert_array_equal(image, LEFT[0])
    put(tmp_path / "left", ["0.png"], [LEFT[0][:40]])
    with pytest.raises(InputError, match=r"0\.png: is 64 x 40 px"):
        list(open_board_folder(tmp_path, BOARD).single_pictures())


def test_names_that_match_nowhere_are_refused_where_one_side_has_more(tmp_path: Path) -> None:
    put(tmp_path / "left", ["x.png", "y.png"], LEFT[:2])
    put(tmp_path / "right", ["u.png"], RIGHT[:1])
    assert "has 2 pictures" in refusal(tmp_path, BOARD)


def test_videos_of_different_lengths_are_refused(tmp_path: Path) -> None:
    write_video(tmp_path / "left.mkv", LEFT)
    write_video(tmp_path / "right.mkv", RIGHT[:2])
    assert "has 3 images" in refusal(tmp_path, BOARD)
    put(tmp_path / "right", ["a.png"], RIGHT[:1])
    assert "has right/ and right.mkv" in refusal(tmp_path, BOARD)
    (tmp_path / "right.mkv").unlink()
    assert "a video on the left and pictures on the right" in refusal(tmp_path, BOARD)


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_a_truncated_picture_is_named(tmp_path: Path, suffix: str) -> None:
    names = [f"{i}.{suffix}" for i in range(3)]
    put(tmp_path / "left", names, LEFT)
    put(tmp_path / "right", names, RIGHT)
    bad = tmp_path / "right" / names[1]
    bad.write_bytes(bad.read_bytes()[: bad.stat().st_size // 2])
    assert f"{bad}: is damaged or no picture" in refusal(tmp_path, BOARD)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("left/000002.png", b"hello", "is damaged or no picture"),
        ("left/000002.png", LEFT[2].astype(np.uint16), "has 16 bits a sample"),
        ("left/000002.png", b"", "is empty"),
        *(
            (name, LEFT[0][:40], "is 64 x 40 px; the first left one is 64 x 48")
            for name in ("left/000002.png", "right/000000.png", "right/000001.png")
        ),
    ],
)
def test_what_is_no_picture_or_of_another_size_is_named(
    folder: Path, name: str, content: bytes | Image, message: str
) -> None:
    if isinstance(content, bytes):
        (folder / name).write_bytes(content)
    else:
        cv2.imwrite(str(folder / name), content)
    assert f"{Path(name).name}: {message}" in refusal(folder)


@pytest.mark.shared
def test_the_recorded_boards_and_the_real_ones_open() -> None:
    boards = open_board_folder(require_shared() / "calibration_boards")
    assert (len(boards), boards.image_size, np.ptp(boards.pan_left)) == (20, (1280, 720), 0)
    assert_allclose(np.degrees(boards.pan_left), 7.5)
    real = open_board_folder(require_shared().parent / "data" / "stereo_checkerboard_opencv", BOARD)
    assert (len(real), real.name(9)) == (13, "left11.jpg and right11.jpg")
    assert len(list(real.pairs())) == 13
