"""A small recorded session, written by other code than the readers under test."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.support.beside import shared
from verify.core.records import Image
from verify.errors import InputError

PAIRS, WIDTH, HEIGHT = 6, 64, 48

SESSION = """format = 1
robot = "iust_6r"
description = "small"
started = 2026-11-20T10:00:00Z
rig = "rig.toml"
marker = "marker.toml"
left = "left.mkv"
right = "right.mkv"
frames = "frames.csv"
encoders = "encoders.csv"
"""
CAMERA = """
[{side}]
camera_matrix = [[50.0, 0.0, 31.5], [0.0, 50.0, 23.5], [0.0, 0.0, 1.0]]
distortion = [-0.1, 0.05, 0.001, -0.001, 0.0]
pan_center_mm = [{x}, 0.0, 0.0]
pan_deg = 7.5
mount_rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
mount_offset_mm = [0.0, 1.0, 2.0]
"""
RIG = (
    f"format = 1\nimage_size = [{WIDTH}, {HEIGHT}]\n"
    + CAMERA.format(side="left", x=-60.0)
    + CAMERA.format(side="right", x=60.0)
    + """
[robot_base]
rotation = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
position_mm = [10.0, 20.0, 650.0]
source = "fixture"
"""
)
MARKER = """format = 1
led_diameter_mm = 5.0

[[led]]
name = "A"
position_mm = [60.0, 0.0, 10.0]

[[led]]
name = "B"
position_mm = [-45.0, 40.0, 15.0]
colour = "red"
"""


def images(count: int = PAIRS, colour: bool = False) -> list[Image]:
    """Pictures of noise: no two alike, none that a codec could guess."""
    shape = (count, HEIGHT, WIDTH, 3) if colour else (count, HEIGHT, WIDTH)
    return list(np.random.default_rng(5).integers(0, 255, shape, dtype=np.uint8))


def write_video(path: Path, pictures: list[Image], depth: int = 8) -> None:
    """Encode as lossless FFV1."""
    height, width = pictures[0].shape[:2]
    options = [cv2.VIDEOWRITER_PROP_IS_COLOR, int(pictures[0].ndim == 3)]
    options += [cv2.VIDEOWRITER_PROP_DEPTH, cv2.CV_8U if depth == 8 else cv2.CV_16U]
    ffv1 = cv2.VideoWriter.fourcc(*"FFV1")
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, ffv1, 25.0, (width, height), options)
    assert writer.isOpened()
    for picture in pictures:
        writer.write(picture if depth == 8 else picture.astype(np.uint16) * 256)
    writer.release()


def write_folder(path: Path, pictures: list[Image]) -> None:
    """Write numbered PNGs."""
    path.mkdir()
    for number, picture in enumerate(pictures):
        assert cv2.imwrite(str(path / f"{number:06d}.png"), picture)


def write_session(folder: Path) -> Path:
    """Write a whole session of six pairs that has nothing wrong with it."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "session.toml").write_text(SESSION)
    (folder / "rig.toml").write_text(RIG)
    (folder / "marker.toml").write_text(MARKER)
    pictures = images()
    write_video(folder / "left.mkv", pictures)
    write_video(folder / "right.mkv", pictures[::-1])
    rows = [f"{i},{0.1 * i:.3f},{0.1 * i + 0.004:.3f}" for i in range(PAIRS)]
    (folder / "frames.csv").write_text("\n".join(["frame,t_left_s,t_right_s", *rows, ""]))
    header = "t_s," + ",".join(f"q{joint}_deg" for joint in range(1, 7))
    readings = [
        f"{0.02 * i:.3f}," + ",".join(str(i + joint) for joint in range(6)) for i in range(30)
    ]
    (folder / "encoders.csv").write_text("\n".join([header, *readings, ""]))
    return folder


def replace(path: Path, old: str, new: str) -> None:
    """Change a text in a file; it is there exactly once or the test is wrong."""
    text = path.read_text()
    assert text.count(old) == 1, f"{old!r} stands {text.count(old)} times"
    path.write_text(text.replace(old, new))


def refusal(read: Callable[..., object], *given: object) -> InputError:
    """What is said of something that is refused, in one line."""
    with pytest.raises(InputError) as caught:
        read(*given)
    assert str(caught.value).isprintable()
    return caught.value


def require_shared() -> Path:
    """Find the recorded sessions, or skip the test."""
    return shared("sessions")
