from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.verify.recorded import images, require_shared, write_video
from verify.checksums import ffv1_intact, png_intact

PNG = cv2.imencode(".png", images(1)[0])[1].tobytes()


def packets(path: Path) -> list[bytes]:
    """The pictures of a video as they are encoded, by OpenCV's own demuxer."""
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
    encoded = []
    while (taken := capture.read())[0]:
        encoded.append(np.asarray(taken[1], dtype=np.uint8).tobytes())
    return encoded


@pytest.fixture(scope="module")
def packet(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("checksums") / "left.mkv"
    write_video(path, images(1))
    return packets(path)[0]


@given(data=st.data())
def test_no_bit_of_a_picture_flips_unseen(packet: bytes, data: st.DataObject) -> None:
    at = data.draw(st.integers(0, 8 * len(packet) - 1))
    flipped = bytearray(packet)
    flipped[at // 8] ^= 1 << at % 8
    assert ffv1_intact(packet)
    assert not ffv1_intact(bytes(flipped))


@given(at=st.integers(0, 8 * len(PNG) - 1))
def test_no_bit_of_a_png_flips_unseen(at: int) -> None:
    flipped = bytearray(PNG)
    flipped[at // 8] ^= 1 << at % 8
    assert png_intact(PNG)
    assert not png_intact(bytes(flipped))


def test_a_cut_picture_is_not_whole(packet: bytes) -> None:
    assert not any(ffv1_intact(packet[:length]) for length in range(1, len(packet), 7))
    assert not any(ffv1_intact(packet[start:]) for start in range(1, 40))
    assert not ffv1_intact(b"abc" + packet)
    assert not any(png_intact(PNG[:length]) for length in range(len(PNG)))


@pytest.mark.shared
def test_every_picture_of_the_recorded_sessions_is_intact() -> None:
    videos = sorted(require_shared().glob("*/*.mkv"))
    assert videos
    for video in videos:
        assert all(ffv1_intact(packet) for packet in packets(video))
