"""Cameras: pictures and their times, settings read back, cameras that vanish and return."""

import math
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.support.devices.camera_server import CameraServer, jpeg, picture
from tests.support.processes import wait_until
from tests.support.recorded import images, write_folder, write_video
from verify.devices.cameras.capture import MAX_QUEUED, CameraCapture, open_camera
from verify.devices.cameras.opencv import JpegDecoder, OpenCvSource
from verify.devices.cameras.stream import StreamClock
from verify.devices.protocols import (
    READ_TIMEOUT,
    CameraDevice,
    CameraFrame,
    CameraSettings,
    CapturedImage,
)
from verify.errors import InputError


def take(camera: CameraDevice, count: int, patience: float = 10.0) -> list[CameraFrame]:
    frames: list[CameraFrame] = []
    deadline = time.monotonic() + patience
    while len(frames) < count and time.monotonic() < deadline:
        if (frame := camera.read()) is not None:
            frames.append(frame)
    return frames


def drain(camera: CameraDevice) -> None:
    """Take what a camera that gives nothing new still has."""
    for _ in range(MAX_QUEUED + 2):
        camera.read()


class FakeCapture:
    """What cv2.VideoCapture is, of a camera with a mind of its own."""

    def __init__(self, backend: str = "V4L2", opened: bool = True, **keeps: float) -> None:
        self.backend, self.opened, self.keeps = backend, opened, keeps
        self.values: dict[int, float] = {cv2.CAP_PROP_FPS: 25.0}
        self.asked: list[tuple[int, float]] = []
        self.picture = picture(7)
        self.stamped: float | None = None
        self.working = True

    def isOpened(self) -> bool:  # noqa: N802
        return self.opened

    def getBackendName(self) -> str:  # noqa: N802
        return self.backend

    def set(self, key: int, value: float) -> bool:
        self.asked.append((key, value))
        kept = {getattr(cv2, f"CAP_PROP_{name}"): v for name, v in self.keeps.items()}
        self.values[key] = kept.get(key, value)
        return True

    def get(self, key: int) -> float:
        if key == cv2.CAP_PROP_POS_MSEC and self.stamped is not None:
            return self.stamped * 1e3
        return self.values.get(key, 0.0)

    def grab(self) -> bool:
        return self.working

    def retrieve(self) -> tuple[bool, Any]:
        return True, self.picture

    def release(self) -> None:
        self.working = False


def source(capture: FakeCapture, **settings: Any) -> OpenCvSource:
    return OpenCvSource(CameraSettings(0, **settings), lambda _: capture)


def test_settings_are_set_format_first_with_automatic_control_off() -> None:
    capture = FakeCapture()
    asked = source(
        capture, size=(1280, 720), rate=30.0, format="YUYV", exposure=0.005, gain=3.0,
        white_balance=4500.0,
    )  # fmt: skip
    assert asked.refused == ()
    keys = [key for key, _ in capture.asked]
    assert keys[0] == cv2.CAP_PROP_FOURCC
    automatic = keys.index(cv2.CAP_PROP_AUTO_EXPOSURE)
    assert automatic < keys.index(cv2.CAP_PROP_EXPOSURE)
    assert keys.index(cv2.CAP_PROP_AUTO_WB) < keys.index(cv2.CAP_PROP_WB_TEMPERATURE)
    output = dict(capture.asked)
    assert output[cv2.CAP_PROP_AUTO_EXPOSURE] == 1.0  # V4L2's word for manual
    assert output[cv2.CAP_PROP_EXPOSURE] == pytest.approx(50.0)  # in units of 100 µs
    assert output[cv2.CAP_PROP_AUTO_WB] == 0.0


REFUSED = [
    ("width", "1280 px", "640 px"),
    ("height", "720 px", "480 px"),
    ("rate", "30 Hz", "15 Hz"),
    ("exposure", "0.005 s", "0.0156 s"),
]


@pytest.mark.parametrize(
    ("capture", "refused"),
    [
        (FakeCapture(FRAME_WIDTH=640, FRAME_HEIGHT=480, FPS=15, EXPOSURE=156), REFUSED),
        (FakeCapture(FPS=29.97, EXPOSURE=52), []),  # a camera may round
        (FakeCapture("DSHOW", EXPOSURE=math.log2(0.005)), []),  # a power of two
        (FakeCapture("AVFOUNDATION"), [(*REFUSED[3][:2], "not settable through AVFOUNDATION")]),
    ],
    ids=["other values", "rounded", "power of two", "not settable"],
)
def test_what_a_camera_refuses_is_named_with_what_it_does_instead(
    capture: FakeCapture, refused: list[tuple[str, str, str]]
) -> None:
    found = source(capture, size=(1280, 720), rate=30.0, exposure=0.005).refused
    assert [(r.setting, r.asked, r.got) for r in found] == refused


@pytest.mark.realtime
def test_the_kernels_stamp_is_taken_where_it_is_of_the_hosts_clock() -> None:
    capture = FakeCapture()
    capture.stamped = time.monotonic() - 0.03
    shot = source(capture).grab()
    assert shot.t == pytest.approx(capture.stamped, abs=1e-6)
    assert shot.t_uncertainty == pytest.approx(0.02)  # half a period at 25 Hz
    capture.stamped = 12345678.0  # another clock
    shot = source(capture, delay=0.01).grab()
    assert shot.t == pytest.approx(time.monotonic() - 0.01, abs=0.05)
    assert shot.t_uncertainty == pytest.approx(0.04)


def test_jpegs_of_a_camera_are_kept_as_they_come() -> None:
    capture, data = FakeCapture(), jpeg(9)
    capture.picture = np.frombuffer(data, np.uint8)[None]
    shot = source(capture, format="MJPG").grab()
    assert (cv2.CAP_PROP_CONVERT_RGB, 0) in capture.asked
    assert shot.raw == data
    assert_array_equal(shot.image, JpegDecoder().decode(data))
    grey = source(FakeCapture(), format="MJPG", grey=True).grab()  # one channel on request
    assert (grey.image.shape, grey.raw) == ((48, 64), None)


def test_no_camera_is_an_error_and_so_is_one_that_is_unplugged() -> None:
    with pytest.raises(OSError, match="another program"):
        source(FakeCapture(opened=False))
    capture = FakeCapture()
    opened = source(capture)
    capture.working = False
    with pytest.raises(OSError, match="unplugged"):
        opened.grab()


class Flaky:
    """A source that works while `there` is set, and hangs while `hanging` is."""

    def __init__(self) -> None:
        self.there, self.free = threading.Event(), threading.Event()
        self.there.set()
        self.free.set()
        self.refused = ()
        self.opened = self.given = 0

    def open(self) -> "Flaky":
        if not self.there.is_set():
            raise OSError("no such device")
        self.opened += 1
        return self

    def grab(self) -> CapturedImage | None:
        time.sleep(0.005)
        self.free.wait()
        if not self.there.is_set():
            raise OSError("it was unplugged")
        self.given += 1
        return CapturedImage(time.monotonic(), 0.0, picture(self.given), None)

    def close(self) -> None:
        pass


@pytest.fixture
def eye() -> Iterator[tuple[Flaky, CameraCapture]]:
    flaky = Flaky()
    camera = CameraCapture("left eye", flaky.open)
    assert len(take(camera, 3)) == 3
    yield flaky, camera
    flaky.free.set()
    camera.close()


def test_a_camera_that_vanishes_is_named_and_taken_up_again(
    eye: tuple[Flaky, CameraCapture],
) -> None:
    flaky, camera = eye
    flaky.there.clear()
    wait_until(lambda: not camera.state().connected, 10.0)
    assert camera.state().sentence == "left eye: not connected: it was unplugged"
    wait_until(lambda: "no such device" in camera.state().sentence, 10.0)
    drain(camera)
    flaky.there.set()
    assert len(take(camera, 3)) == 3
    assert camera.state().connected
    assert flaky.opened == 2


@pytest.mark.realtime
def test_unread_pictures_are_dropped_and_a_hanging_camera_blocks_nothing(
    eye: tuple[Flaky, CameraCapture],
) -> None:
    flaky, camera = eye
    first = take(camera, 1)[0]
    wait_until(lambda: camera.state().lost > 5, 10.0)
    lost = camera.state().lost
    numbers = [frame.sequence for frame in take(camera, MAX_QUEUED)]
    assert numbers[0] - first.sequence - 1 >= lost
    assert "nobody read in time" in camera.state().sentence
    flaky.free.clear()
    drain(camera)
    begin = time.monotonic()
    assert camera.read() is None
    assert time.monotonic() - begin < READ_TIMEOUT + 0.1
    begin = time.monotonic()
    camera.close()
    assert time.monotonic() - begin < 1.5


@pytest.mark.realtime
def test_a_network_camera_gives_its_jpegs_and_is_found_again() -> None:
    server = CameraServer()
    camera = open_camera(CameraSettings(server.url))
    frames = take(camera, 5)
    assert len(frames) == 5
    for frame in frames:
        assert frame.raw is not None
        assert_array_equal(frame.image, JpegDecoder().decode(frame.raw))
        assert frame.image.shape == (48, 64, 3)
    numbers = [next(n for n in range(99) if jpeg(n) == frame.raw) for frame in frames]
    assert numbers == list(range(numbers[0], numbers[0] + 5))
    server.close()
    wait_until(lambda: not camera.state().connected, 10.0)
    assert "not connected" in camera.state().sentence
    drain(camera)
    again = CameraServer(server.port)
    assert len(take(camera, 3)) == 3
    camera.close()
    again.close()


@pytest.mark.realtime
def test_pictures_of_another_size_than_the_rigs_are_never_given_out(tmp_path: Path) -> None:
    flaky = Flaky()
    camera = CameraCapture("left eye", flaky.open, (1280, 720))
    message = "left eye: gives pictures of 64 x 48 px; 1280 x 720 are needed"
    wait_until(lambda: camera.state().sentence == message, 10.0)
    assert camera.read() is None
    camera.close()
    write_video(tmp_path / "left.mkv", images(3))
    replay = open_camera(CameraSettings(str(tmp_path / "left.mkv"), size=(1280, 720)))
    assert replay.read() is None
    assert "has pictures of 64 x 48 px; 1280 x 720 are needed" in replay.state().sentence


@pytest.mark.realtime
def test_a_damaged_picture_is_counted_and_the_next_one_taken() -> None:
    server = CameraServer(damaged=3)
    camera = open_camera(CameraSettings(server.url, grey=True))
    frames = take(camera, 8)
    assert len(frames) == 8
    assert all(frame.image.shape == (48, 64) and frame.raw is None for frame in frames)
    assert "1 pictures could not be decoded" in camera.state().sentence
    camera.close()
    server.close()


@pytest.mark.realtime
@pytest.mark.parametrize(
    "url", ["http://127.0.0.1:9/video", "rtsp://127.0.0.1:9/stream", "nonsense://x"]
)
def test_a_missing_network_camera_is_reported(url: str) -> None:
    camera = open_camera(CameraSettings(url))
    wait_until(lambda: "being opened" not in camera.state().sentence, 10.0)
    assert camera.state().sentence.startswith(f"{url}: not connected: ")
    assert camera.read() is None
    camera.close()


def test_a_stream_clock_finds_the_quickest_way_and_follows_a_slow_drift() -> None:
    rng, clock = np.random.default_rng(2), StreamClock()
    taken = np.arange(0, 600, 1 / 30)
    stamps = 5000.0 + taken * (1 + 5e-5)
    arrivals = 100.0 + taken + 0.02 + rng.exponential(0.01, len(taken))
    found = [clock.taken(s, a) for s, a in zip(stamps, arrivals, strict=True)]
    error = np.array(found[300:]) - (100.0 + taken[300:] + 0.02)
    assert np.ptp(error) < 0.003
    assert abs(error.mean()) < 0.002


@pytest.mark.realtime
def test_a_file_is_played_at_the_requested_rate(tmp_path: Path) -> None:
    pictures = images(12)
    write_video(tmp_path / "left.mkv", pictures)
    camera = open_camera(CameraSettings(str(tmp_path / "left.mkv"), rate=60.0))
    begin = time.monotonic()
    frames = take(camera, 12)
    assert time.monotonic() - begin >= 11 / 60
    assert_allclose(np.diff([frame.t for frame in frames]), 1 / 60, atol=1e-9)
    for frame, before in zip(frames, pictures, strict=True):
        assert_array_equal(frame.image, before)
    assert camera.read() is None
    assert camera.state().ended
    assert camera.state().sentence == "left.mkv: over after 12 pictures"


@pytest.mark.realtime
def test_a_folder_is_played_as_fast_as_it_is_read(tmp_path: Path) -> None:
    write_folder(tmp_path / "left", images(40))
    camera = open_camera(CameraSettings(str(tmp_path / "left"), rate=0.0))
    begin = time.monotonic()
    frames = take(camera, 40)
    assert time.monotonic() - begin < 40 / 30
    assert_allclose(np.diff([frame.t for frame in frames]), 1 / 30, atol=1e-9)


def test_a_damaged_file_ends_with_a_message_and_a_missing_one_is_reported_at_once(
    tmp_path: Path,
) -> None:
    (tmp_path / "left.mkv").write_bytes(b"no video at all")
    camera = open_camera(CameraSettings(str(tmp_path / "left.mkv")))
    assert camera.read() is None
    assert camera.state().ended
    assert "not a video" in camera.state().sentence
    with pytest.raises(InputError, match="no such file"):
        open_camera(CameraSettings(str(tmp_path / "right.mkv")))
