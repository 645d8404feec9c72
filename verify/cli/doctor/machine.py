"""Check the machine: versions, codecs, disk, ports, cameras that the system lists."""

import os
import platform
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from serial.tools import list_ports

from verify.core.kernels.entries import rotation_vectors
from verify.core.native import library_folder
from verify.core.records import Image
from verify.core.version import __version__
from verify.errors import InputError
from verify.io.encoding import write_video
from verify.io.video import open_images
from verify.live.recording.matroska import MatroskaFile, PictureEncoder, picture_format

TEST_IMAGE_SIZE = (720, 1280)  # rows, columns of the pictures that codecs are tried with
N_TEST_IMAGES = 10
MIN_WRITE_SPEED = 30.0  # MB/s: two cameras of 1280 x 720 at 30 Hz, noise and all
MIN_FREE_SPACE = 10.0  # GB: well over ten minutes of it
TEST_FILE_SIZE = 64  # MB, to find the disk's speed
PACKAGES = ("numpy", "opencv-python-headless", "av", "pin", "pyserial")


@dataclass(frozen=True, slots=True)
class Finding:
    """Outcome of one check."""

    what: str
    outcome: str  # works, doubt, fails
    sentence: str
    figures: dict[str, Any] = field(default_factory=dict)  # for --json


def check_versions() -> list[Finding]:
    """List the versions of Python, verify and its libraries."""
    text = [f"{name} {metadata.version(name)}" for name in PACKAGES]
    python = f"Python {platform.python_version()} on {platform.system()} {platform.machine()}"
    return [Finding("versions", "works", f"verify {__version__}, {python}, {', '.join(text)}")]


def check_inner_loops() -> Finding:
    """Compile the inner loops where they are not yet, and try one."""
    name, vector = "inner loops", np.empty((1, 3))
    try:
        rotation_vectors(np.diag([1.0, -1.0, -1.0])[None], vector)
    except (InputError, OSError) as error:
        return Finding(name, "fails", str(error))
    if not np.isclose(vector[0, 0], np.pi):
        return Finding(name, "fails", f"half a turn is {np.degrees(vector[0, 0]):.6g}°")
    return Finding(name, "works", f"compiled, in {library_folder()}")


def check_codecs() -> list[Finding]:
    """Write pictures as recordings do, by other programs and simulated too, and read them back."""
    grey = np.random.default_rng(0).integers(0, 40, TEST_IMAGE_SIZE, dtype=np.uint8)
    pictures = [grey] * N_TEST_IMAGES
    colour, jpeg = np.stack([grey] * 3, axis=-1), cv2.imencode(".jpg", grey)[1].tobytes()
    return [
        _read_back("recording grey pictures", grey, partial(_record, grey, None)),
        _read_back("recording colour pictures", colour, partial(_record, colour, None)),
        _read_back(
            "recording JPEGs as they come", grey, partial(_record, grey, jpeg), lossless=False
        ),
        _read_back("FFV1", grey, lambda path, done: write_video(path, pictures, 30.0, done)),
    ]


def check_disk(folder: Path) -> Finding:
    """Find out how much room a folder's disk has, and how fast it is."""
    place = next(p for p in (folder.absolute(), *folder.absolute().parents) if p.exists())
    try:
        speed = _write_speed(place)
        free = shutil.disk_usage(place).free / 1e9
    except OSError as error:
        return Finding("disk", "fails", f"{place}: {(error.strerror or str(error)).lower()}")
    sentence = f"{place}: {free:.1f} GB free, {speed:.0f} MB/s"
    figures = {"free_gb": round(free, 3), "speed_mb_s": round(speed, 1)}
    if speed < MIN_WRITE_SPEED:
        sentence += f"; two cameras of 1280 x 720 at 30 Hz may need {MIN_WRITE_SPEED:.0f} MB/s"
    elif free < MIN_FREE_SPACE:
        sentence += "; the disk will soon be full"
    outcome = "works" if speed >= MIN_WRITE_SPEED and free >= MIN_FREE_SPACE else "doubt"
    return Finding("disk", outcome, sentence, figures)


def check_serial_ports() -> list[Finding]:
    """List the serial ports that the system knows."""
    ports = [f"{port.device} ({port.description})" for port in sorted(list_ports.comports())]
    return [Finding("serial ports", "works", ", ".join(ports) or "none is here")]


def check_video_devices() -> list[Finding]:
    """List the cameras that the system knows, where it has names for them."""
    if sys.platform != "linux":
        text = "this system does not list them; name 0, 1, … in a station file and try it"
        return [Finding("cameras", "works", text)]
    there = sorted(map(str, Path("/dev").glob("video*")))
    return [Finding("cameras", "works", ", ".join(there) or "none found (/dev/video*)")]


def _read_back(
    name: str,
    image: Image,
    write: Callable[[Path, Callable[[], None]], None],
    *,
    lossless: bool = True,
) -> Finding:
    """Try a codec; `write` makes a file of the picture, and calls what it is given after each."""
    with tempfile.TemporaryDirectory() as folder:
        path, times = Path(folder) / "video.mkv", [time.perf_counter()]
        try:
            write(path, lambda: times.append(time.perf_counter()))
            back = list(open_images(path).images())
        except (OSError, ValueError, InputError) as error:
            return Finding(name, "fails", str(error))
    if len(back) != N_TEST_IMAGES or back[0].shape != image.shape:
        return Finding(name, "fails", "what was written cannot be read back")
    if lossless and not np.array_equal(back[-1], image):
        return Finding(name, "fails", "what was read back is not what was written")
    spent = float(np.median(np.diff(times))) * 1e3
    text = f"{TEST_IMAGE_SIZE[1]} x {TEST_IMAGE_SIZE[0]} px in {spent:.1f} ms, and read back"
    return Finding(name, "works", text, {"ms_a_picture": round(spent, 2)})


def _record(image: Image, raw: bytes | None, path: Path, done: Callable[[], None]) -> None:
    coder = PictureEncoder(picture_format(image, raw))
    file = MatroskaFile(path, coder.track)
    for number in range(N_TEST_IMAGES):
        file.add(coder.encode(image, raw), number / 30.0)
        done()
    file.close()


def _write_speed(place: Path) -> float:
    """Write a file that the disk really has, MB/s."""
    block = np.random.default_rng(0).bytes(1 << 20)  # a disk that compresses must not cheat
    with tempfile.TemporaryFile(dir=place) as file:
        begin = time.perf_counter()
        for _ in range(TEST_FILE_SIZE):
            file.write(block)
        file.flush()
        os.fsync(file.fileno())
        return TEST_FILE_SIZE * len(block) / 1e6 / (time.perf_counter() - begin)
