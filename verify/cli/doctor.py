"""Say what works on this machine: versions, codecs, disk, ports, cameras; and of a station.

What `verify doctor` finds out about a machine, without any device of a station.

What `verify doctor` finds out about a station's devices: each is opened and watched a while.
"""

import os
import platform
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import typer
from serial.tools import list_ports

from verify.cli.terminal import terminal
from verify.core.records import Image
from verify.core.version import __version__
from verify.devices.melfa.reader import MelfaEncoders
from verify.devices.protocols import CameraDevice, EncoderDevice, EncoderReading, PanDevice
from verify.errors import InputError
from verify.io.video import open_images
from verify.live.recording.matroska import MatroskaFile, PictureEncoder, picture_format
from verify.live.station.station import Station

MARKS = {"works": "works ", "doubt": "doubt ", "fails": "FAILS "}


def doctor(
    station: Annotated[
        Path | None, typer.Argument(help="A station file: its devices are tried too.")
    ] = None,
) -> int:
    """Say what works on this machine and, with a station file, what of the station.

    Exit status 0: all works; 1: something does not; 2: the station file cannot be used.

    Example: verify doctor station.toml
    """
    from verify.live.station.station import open_station
    from verify.simulation.devices.station import SimulatedStation

    known = None if station is None else open_station(station, SimulatedStation)
    findings = [*check_versions(), *check_codecs()]
    if known is None:
        findings += [check_disk(Path())]
        findings += [*check_serial_ports(), *check_video_devices()]
    else:
        for warning in known.warnings:
            terminal.warn(warning)
        findings += [check_disk(known.recording.folder)]
        findings += check_devices(known)
    for finding in findings:
        terminal.say(f"{MARKS[finding.outcome]}{finding.what}: {finding.sentence}")
        terminal.record(
            {
                "type": "check",
                "what": finding.what,
                "outcome": finding.outcome,
                "text": finding.sentence,
                **finding.figures,
            }
        )
    return int(any(finding.outcome == "fails" for finding in findings))


TEST_IMAGE_SIZE = (720, 1280)  # rows, columns of the pictures that codecs are tried with
N_TEST_IMAGES = 10
MIN_WRITE_SPEED = 30.0  # MB/s: two cameras of 1280 x 720 at 30 Hz, noise and all
MIN_FREE_SPACE = 10.0  # GB: well over ten minutes of it
TEST_FILE_SIZE = 64  # MB, to find the disk's speed
PACKAGES = ("numpy", "opencv-python-headless", "av", "pin", "pyserial")


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was tried."""

    what: str
    outcome: str  # works, doubt, fails
    sentence: str
    figures: dict[str, Any] = field(default_factory=dict)  # for --json


def check_versions() -> list[Finding]:
    """Say which versions of what are here."""
    said = [f"{name} {metadata.version(name)}" for name in PACKAGES]
    python = f"Python {platform.python_version()} on {platform.system()} {platform.machine()}"
    return [Finding("versions", "works", f"verify {__version__}, {python}, {', '.join(said)}")]


def check_codecs() -> list[Finding]:
    """Write pictures as a recording does, and read them back."""
    rng = np.random.default_rng(0)
    grey = rng.integers(0, 40, TEST_IMAGE_SIZE, dtype=np.uint8)
    jpeg = cv2.imencode(".jpg", grey)[1].tobytes()
    return [
        _lossless("grey pictures", grey),
        _lossless("colour pictures", np.stack([grey] * 3, axis=-1)),
        _read_back("JPEGs as they come", grey, jpeg, lossless=False),
        _ffv1(grey),
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
        sentence += "; that is soon full"
    outcome = "works" if speed >= MIN_WRITE_SPEED and free >= MIN_FREE_SPACE else "doubt"
    return Finding("disk", outcome, sentence, figures)


def check_serial_ports() -> list[Finding]:
    """List the serial ports that the system knows."""
    ports = sorted(list_ports.comports())
    if not ports:
        return [Finding("serial ports", "works", "none is here")]
    said = [f"{port.device} ({port.description})" for port in ports]
    return [Finding("serial ports", "works", ", ".join(said))]


def check_video_devices() -> list[Finding]:
    """List the cameras that the system knows, where it has names for them."""
    if sys.platform != "linux":
        said = "this system does not list them; name 0, 1, … in a station file and try it"
        return [Finding("cameras", "works", said)]
    there = sorted(map(str, Path("/dev").glob("video*")))
    said = ", ".join(there) or "none is here (/dev/video*)"
    return [Finding("cameras", "works", said)]


def _lossless(what: str, image: Image) -> Finding:
    return _read_back(what, image, None, lossless=True)


def _read_back(what: str, image: Image, raw: bytes | None, *, lossless: bool) -> Finding:
    name = f"recording {what}"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video.mkv"
        try:
            coder = PictureEncoder(picture_format(image, raw))
            file = MatroskaFile(path, coder.track)
            times = [time.perf_counter()]
            for number in range(N_TEST_IMAGES):
                file.add(coder.encode(image, raw), number / 30.0)
                times.append(time.perf_counter())
            spent = float(np.median(np.diff(times))) * 1e3
            file.close()
            back = list(open_images(path).images())
        except (OSError, ValueError, InputError) as error:
            return Finding(name, "fails", str(error))
    if len(back) != N_TEST_IMAGES or back[0].shape != image.shape:
        return Finding(name, "fails", "what was written cannot be read back")
    if lossless and not np.array_equal(back[-1], image):
        return Finding(name, "fails", "what was read back is not what was written")
    figures = {"ms_a_picture": round(spent, 2)}
    said = f"{TEST_IMAGE_SIZE[1]} x {TEST_IMAGE_SIZE[0]} px in {spent:.1f} ms, and read back"
    return Finding(name, "works", said, figures)


def _ffv1(image: Image) -> Finding:
    """Try the codec of recordings by other programs, simulated ones included."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video.mkv"
        code = cv2.VideoWriter.fourcc(*"FFV1")
        writer = cv2.VideoWriter(str(path), code, 30.0, (image.shape[1], image.shape[0]), False)
        writer.write(image)
        writer.release()
        try:
            back = list(open_images(path).images())
        except InputError as error:
            return Finding("FFV1", "fails", str(error))
    if len(back) == 1 and np.array_equal(back[0], image):
        return Finding("FFV1", "works", "written and read back")
    return Finding("FFV1", "fails", "what was read back is not what was written")


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


START_TIMEOUT = 5.0  # s that a device is given for its first word
WATCH_TIME = 1.0  # s from then on
MIN_RATE_RATIO = 0.9  # share of the rate asked for below which it is doubtful


def check_devices(station: Station) -> list[Finding]:
    """Try all devices at once, as a run does: cameras share a bus."""
    found: dict[str, Finding] = {}
    cameras: tuple[CameraDevice, CameraDevice] | None = None
    works: list[tuple[str, Callable[[], Finding]]] = []
    try:
        cameras = station.open_cameras()
    except InputError as error:
        found["cameras"] = Finding("cameras", "fails", str(error))
    for side, camera in zip(("left camera", "right camera"), cameras or (), strict=False):
        works.append((side, _try_camera(side, camera, station)))
    encoders, pan = station.open_encoders(), station.open_pan()
    works.append(("encoders", _try_encoders(encoders)))
    if pan is not None:
        works.append(("pan bases", _try_pan(pan)))

    def run(name: str, work: Callable[[], Finding]) -> None:
        found[name] = work()

    threads = [threading.Thread(target=run, args=work, daemon=True) for work in works]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if pan is None:
        said = "fixed, as the rig's calibration has them"
        found["pan bases"] = Finding("pan bases", "works", said)
    order = ("cameras", "left camera", "right camera", "encoders", "pan bases")
    return [found[name] for name in order if name in found]


def _try_camera(name: str, camera: CameraDevice, station: Station) -> Callable[[], Finding]:
    def work() -> Finding:
        frames = _collect_readings(lambda: [f] if (f := camera.read()) is not None else [])
        state = camera.state()
        camera.close()
        if not frames:
            return Finding(name, "fails", state.sentence)
        height, width = frames[0].image.shape[:2]
        t = np.array([frame.t for frame in frames])
        figures: dict[str, Any] = {"size": [width, height], "pictures": len(frames)}
        sentence = f"{state.sentence}; {width} x {height} px"
        if len(t) > 1:
            figures["rate_hz"] = round(float((len(t) - 1) / max(t[-1] - t[0], 1e-9)), 2)
            figures["longest_gap_ms"] = round(float(np.diff(t).max() * 1e3), 1)
            sentence += f", {figures['rate_hz']:.1f} a second"
            sentence += f", at most {figures['longest_gap_ms']:.0f} ms apart"
        if frames[0].raw is not None:
            sentence += ", JPEGs kept as they come"
        if (width, height) != tuple(station.rig.image_size):
            wanted = "{} x {}".format(*station.rig.image_size)
            return Finding(name, "fails", f"{sentence}; the rig is for {wanted} px", figures)
        missed = frames[-1].sequence - frames[0].sequence + 1 - len(frames)
        if missed:
            figures["missed"] = missed
            sentence += f"; {missed} were missed meanwhile"
        doubtful = bool(state.refused or missed)
        return Finding(name, "doubt" if doubtful else "works", sentence, figures)

    return work


def _try_encoders(encoders: EncoderDevice) -> Callable[[], Finding]:
    def work() -> Finding:
        readings: list[EncoderReading] = _collect_readings(encoders.read)
        state = encoders.state()
        trips = list(encoders.round_trips) if isinstance(encoders, MelfaEncoders) else []
        encoders.close()
        if not readings:
            return Finding("encoders", "fails", state.sentence)
        t = np.array([reading.t_host for reading in readings])
        half = float(np.median([reading.half_width for reading in readings]))
        figures: dict[str, Any] = {"readings": len(t), "half_width_ms": round(half * 1e3, 4)}
        sentence = f"{state.sentence}; each known within ± {half * 1e3:.3g} ms"
        if len(t) > 1:
            figures["rate_hz"] = round(float((len(t) - 1) / max(t[-1] - t[0], 1e-9)), 2)
            sentence += f", {figures['rate_hz']:.1f} a second"
        if trips:
            figures["round_trip_ms"] = round(float(np.median(trips)) * 1e3, 2)
            sentence += f", round trip {figures['round_trip_ms']:.1f} ms"
        angles = ", ".join(f"{angle:.2f}°" for angle in np.rad2deg(readings[-1].q))
        doubtful = bool(state.bad or state.lost)
        sentence += f"; now at {angles}"
        return Finding("encoders", "doubt" if doubtful else "works", sentence, figures)

    return work


def _try_pan(pan: PanDevice) -> Callable[[], Finding]:
    def work() -> Finding:
        readings = _collect_readings(pan.read)
        state = pan.state()
        pan.close()
        if not readings:
            return Finding("pan bases", "fails", state.sentence)
        left, right = np.rad2deg(readings[-1].pan).tolist()
        sentence = f"{state.sentence}; left {left:.2f}°, right {right:.2f}°"
        return Finding("pan bases", "doubt" if state.bad else "works", sentence)

    return work


def _collect_readings(read: Callable[[], list[Any]]) -> list[Any]:
    """Collect what a device gives for a second from its first word on; empty if it is mute."""
    things: list[Any] = []
    deadline = time.monotonic() + START_TIMEOUT
    while time.monotonic() < deadline:
        new = read()
        if new and not things:
            deadline = time.monotonic() + WATCH_TIME
        things += new
    return things
