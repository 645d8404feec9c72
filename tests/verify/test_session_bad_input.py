import os
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.verify.recorded import (
    PAIRS,
    images,
    replace,
    write_folder,
    write_session,
    write_video,
)
from verify.errors import InputError
from verify.session import open_session


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_session(tmp_path / "tuesday")


def complaint(folder: Path) -> str:
    """Open and read a session that has something wrong; return the one line that says so."""
    with pytest.raises(InputError) as caught:
        for _ in open_session(folder).pairs():
            pass
    line = str(caught.value)
    assert line.isprintable()
    return line


def add(text: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        with (folder / "session.toml").open("a") as file:
            file.write(text)

    return change


def swap(file: str, old: str, new: str) -> Callable[[Path], None]:
    return lambda folder: replace(folder / file, old, new)


def write(file: str, content: bytes) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        (folder / file).write_bytes(content)

    return change


def drop(file: str) -> Callable[[Path], None]:
    return lambda folder: (folder / file).unlink()


def five_joints(folder: Path) -> None:
    lines = (folder / "encoders.csv").read_text().splitlines()
    (folder / "encoders.csv").write_text("\n".join(line.rpartition(",")[0] for line in lines))


def pngs_with_a_gap(folder: Path) -> None:
    write_folder(folder / "left", images())
    (folder / "left" / "000003.png").unlink()
    replace(folder / "session.toml", '"left.mkv"', '"left"')


def damaged_png(folder: Path) -> None:
    write_folder(folder / "left", images())
    file = folder / "left" / "000004.png"
    file.write_bytes(file.read_bytes()[:-100])
    replace(folder / "session.toml", '"left.mkv"', '"left"')


def flipped_bit(folder: Path) -> None:
    data = bytearray((folder / "right.mkv").read_bytes())
    data[len(data) // 2] ^= 1
    (folder / "right.mkv").write_bytes(data)


def truncated(folder: Path) -> None:
    data = (folder / "left.mkv").read_bytes()
    (folder / "left.mkv").write_bytes(data[: len(data) // 2])


def other_size(side: str) -> Callable[[Path], None]:
    return lambda folder: write_video(folder / side, [picture[:40] for picture in images()])


def video_of(count: int) -> Callable[[Path], None]:
    return lambda folder: write_video(folder / "right.mkv", (images() * 2)[:count])


def link_outside(folder: Path) -> None:
    outside = folder.parent / "secret.toml"
    outside.write_text("format = 1")
    (folder / "rig.toml").unlink()
    (folder / "rig.toml").symlink_to(outside)


def absorption_of_one_joint(folder: Path) -> None:
    rows = "[0.0]," * 12
    replace(folder / "rig.toml", '"fixture"', f'"motion"\nabsorption = [{rows}]')


def pipe(folder: Path) -> None:
    (folder / "left.mkv").unlink()
    os.mkfifo(folder / "left.mkv")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (drop("session.toml"), ["has no session.toml"]),
        (drop("rig.toml"), ["session.toml, rig", "does not exist"]),
        (drop("left.mkv"), ["session.toml, left", "does not exist"]),
        (write("encoders.csv", b""), ["encoders.csv", "is empty"]),
        (write("left.mkv", b""), ["left.mkv", "is empty"]),
        (write("session.toml", b'format = 1\nrobot = "a\n'), ["session.toml, line 2, column"]),
        (write("session.toml", b"format = 1\n# \xff\n"), ["session.toml, line 2", "UTF-8"]),
        (swap("session.toml", "format = 1", "format = 2"), ["format: is 2", "format 1"]),
        (swap("session.toml", "format = 1", ""), ["format: is missing"]),
        (swap("session.toml", '"rig.toml"', "3"), ["session.toml, rig: is 3", "text"]),
        (swap("session.toml", 'left = "left.mkv"', ""), ["session.toml, left: is missing"]),
        (add('recording = "opne"'), ['recording: is "opne"', "`open`"]),
        (add("[clock]\nencoder_offset_s = nan"), ["clock.encoder_offset_s: is nan", "finite"]),
        (add("[clock]\n"), ["clock.encoder_offset_s: is missing"]),
        (add("[tolerance]\njoints_deg = [0.1, 0.2]"), ["tolerance.joints_deg", "list of 2", "6"]),
        (add('[tolerance]\njoints_deg = "0.1"'), ["joints_deg", '"0.1"', "number or a list"]),
        (add("[tolerance]\njoints_deg = [1, 1, 1, 1, 1, 0]"), ["joints_deg[5]: is 0", "positive"]),
        (add("[tolerance]\nposition_mm = -1.0"), ["tolerance.position_mm: is -1.0"]),
        (add("[encoder_readings]\nresolution_deg = -0.1"), ["encoder_readings.resolution_deg"]),
        (swap("session.toml", '"iust_6r"', '"iust6r"'), ['"iust6r"', '"iust_6r"', "toml, robot"]),
        (swap("session.toml", '"iust_6r"', '"../arm.urdf"'), ["robot", "outside the folder"]),
        (swap("session.toml", '"iust_6r"', '"arm.urdf"'), ["robot", "does not exist"]),
        (swap("session.toml", '"rig.toml"', '"../rig.toml"'), ["rig", "outside the folder"]),
        (swap("session.toml", '"rig.toml"', '"/etc/hostname"'), ["rig", "outside the folder"]),
        (swap("session.toml", '"rig.toml"', '""'), ["rig: names nothing"]),
        (swap("session.toml", '"rig.toml"', '"."'), ["is a folder"]),
        (link_outside, ["rig", "outside the folder"]),
        (pipe, ["left.mkv", "not a plain file"]),
        (swap("session.toml", '"right.mkv"', '"left.mkv"'), ["right", "each camera"]),
        (swap("session.toml", '"rig.toml"', '"a\\u001b[31m\\nb.toml"'), ["\\x1b[31m\\nb.toml"]),
        (five_joints, ["encoders.csv, line 1", "5 joint columns", "6 joints"]),
        (video_of(PAIRS - 1), ["right.mkv", "has 5 images", "6 rows", "open"]),
        (video_of(PAIRS + 1), ["right.mkv", "has 7 images", "6 rows"]),
        (truncated, ["left.mkv", "6 rows"]),
        (flipped_bit, ["right.mkv", "of 6 is damaged"]),
        (write("left.mkv", b"not a video" * 100), ["left.mkv", "no video"]),
        (pngs_with_a_gap, ["left", "has no 000003.png"]),
        (damaged_png, ["000004.png", "damaged"]),
        (other_size("left.mkv"), ["left.mkv", "image 0 is 64 x 40 px", "64 x 48"]),
        (other_size("right.mkv"), ["right.mkv", "image 0 is 64 x 40 px", "64 x 48"]),
        (swap("rig.toml", "20.0, 650.0]", '"20", 650.0]'), ["position_mm[1]", '"20"']),
        (swap("marker.toml", '"red"', '"redd"'), ["led[1].colour", "`red`"]),
        (absorption_of_one_joint, ["absorption", "1 columns", "6 joints"]),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_in_one_line_that_names_the_place(
    folder: Path, capfd: pytest.CaptureFixture[str], change: Callable[[Path], None], said: list[str]
) -> None:
    change(folder)
    line = complaint(folder)
    for words in said:
        assert words in line
    assert capfd.readouterr() == ("", "")  # no line of OpenCV's, ffmpeg's or libpng's beside ours


@pytest.mark.parametrize("name", ["nowhere", "rig.toml", "a\nb\x1b[31m", "zero\0byte"])
def test_what_is_no_folder_is_refused(folder: Path, name: str) -> None:
    assert "tuesday" in complaint(folder / name)


def test_a_file_that_may_not_be_read_is_named(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    genuine = Path.read_bytes

    def guarded(path: Path) -> bytes:  # root, who runs this in a container, may read everything
        if path.name == "rig.toml":
            raise PermissionError(13, "Permission denied", str(path))
        return genuine(path)

    monkeypatch.setattr(Path, "read_bytes", guarded)
    line = complaint(folder)
    assert "rig.toml: permission denied" in line
    assert "Grant access" in line


def test_an_open_session_without_one_whole_pair_is_refused(folder: Path) -> None:
    add('recording = "open"')(folder)
    write_folder(folder / "left", images())
    (folder / "left" / "000000.png").write_bytes(b"\x89PNG")
    replace(folder / "session.toml", '"left.mkv"', '"left"')
    assert "before the first whole pair" in complaint(folder)
