""""""

import errno
import os
import struct
import threading
import zlib
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from tests.support.beside import shared
from tests.support.recorded import images, write_folder, write_video
from verify.core.records import Image
from verify.errors import InputError
from verify.io.video import decode_in_step, ffv1_intact, open_images, png_intact


@pytest.fixture(params=["video", "folder"])
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    if request.param == "video":
        write_video(tmp_path / "left.mkv", images(10))
        return tmp_path / "left.mkv"
    write_folder(tmp_path / "left", images(10))
    return tmp_path / "left"


@pytest.fixture
def video(tmp_path: Path) -> Path:
    write_video(tmp_path / "left.mkv", images(10))
    return tmp_path / "left.mkv"


@pytest.fixture(params=[1, 2], ids=["one processor", "two processors"])
def processors(request: pytest.FixtureRequest) -> Iterator[int]:
    """Let images be decoded as a process with so many processors' time decodes them."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(request.param)
    yield request.param
    cv2.setNumThreads(before)


@pytest.mark.parametrize("kind", ["grey", "colour"])
@pytest.mark.parametrize("writer", [write_video, write_folder])
def test_images_come_back_bit_by_bit_and_in_their_own_kind(
    tmp_path: Path, kind: str, writer: Callable[[Path, list[Image]], None]
) -> None:
    written = images(10, colour=kind == "colour")
    writer(tmp_path / "left.mkv", written)
    stream = open_images(tmp_path / "left.mkv")
    assert stream.count() == stream.count(torn=True) == 10
    assert_array_equal(list(stream.images()), written)


def test_a_path_that_is_not_utf_8_is_opened(video: Path, tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(b"lat\xfcn")
    folder.mkdir()
    stream = open_images(video.rename(folder / "left.mkv"))
    assert stream.count() == 10
    assert_array_equal(list(stream.images()), images(10))


@pytest.mark.parametrize("torn", [False, True])
def test_a_video_without_read_permission_is_named_as_that(
    video: Path, torn: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path, *_: object, **__: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(Path, "open", refuse)  # as the system does, but for root
    with pytest.raises(InputError, match=r"left\.mkv: permission denied\. Grant access"):
        open_images(video).count(torn)


@pytest.mark.usefixtures("processors")
def test_both_sides_stay_in_step(path: Path, tmp_path: Path) -> None:
    write_video(tmp_path / "right.mkv", images(10)[::-1])
    pairs = list(decode_in_step(open_images(path), open_images(tmp_path / "right.mkv"), 10))
    assert_array_equal([left for left, _ in pairs], images(10))
    assert_array_equal([right for _, right in pairs], images(10)[::-1])
    assert len(list(decode_in_step(open_images(path), open_images(path), 3))) == 3


@pytest.mark.usefixtures("processors")
def test_a_side_that_ends_early_is_named(video: Path, tmp_path: Path) -> None:
    write_video(tmp_path / "short.mkv", images(7))
    with pytest.raises(InputError, match=r"short\.mkv: only 7 of 10 images can be decoded"):
        list(decode_in_step(open_images(video), open_images(tmp_path / "short.mkv"), 10))


@pytest.mark.parametrize("stop", ["close", "exception", "end", "bad image"])
def test_no_thread_remains_after_the_loop(tmp_path: Path, stop: str) -> None:
    write_folder(tmp_path / "left", images(10))
    if stop == "bad image":
        (tmp_path / "left" / "000005.png").write_bytes(b"no image")
    before = threading.active_count()
    side = open_images(tmp_path / "left")
    pairs = decode_in_step(side, side, 10)
    next(pairs)
    assert threading.active_count() == before + 2
    if stop == "close":
        pairs.close()
    elif stop == "exception":
        with pytest.raises(KeyboardInterrupt):
            pairs.throw(KeyboardInterrupt())
    elif stop == "end":
        assert len(list(pairs)) == 9
    else:
        with pytest.raises(InputError, match=r"000005\.png: is damaged or no PNG"):
            list(pairs)
    assert threading.active_count() == before


def test_a_fast_reader_holds_few_images(
    path: Path, monkeypatch: pytest.MonkeyPatch, processors: int
) -> None:
    stream = open_images(path)
    drawn = []
    genuine = stream.images

    def counted() -> Iterator[Image]:
        for image in genuine():
            drawn.append(image)
            yield image

    monkeypatch.setattr(stream, "images", counted)
    pairs = decode_in_step(stream, open_images(path), 10)
    list(islice(pairs, 2))
    pairs.close()
    assert len(drawn) <= (8 if processors == 1 else 2 + 4)


@pytest.mark.parametrize("part", range(1, 10))
def test_a_flipped_bit_in_a_video_is_never_measured(video: Path, part: int) -> None:
    data = bytearray(video.read_bytes())
    at = len(data) * part // 10
    data[at] ^= 0x10
    video.write_bytes(data)
    with pytest.raises(InputError, match=r"image \d of 10 is damaged"):
        open_images(video).count()
    # noise fills each image alike, so the damage sits where the byte sits; what precedes it is good
    assert open_images(video).count(torn=True) in (part - 1, part)


def test_a_video_whose_every_image_is_damaged_is_refused(video: Path) -> None:
    data = video.read_bytes()
    for packet in packets(video):
        at = data.index(packet)
        damaged = bytearray(packet)
        damaged[len(packet) // 2] ^= 0x10
        data = data[:at] + bytes(damaged) + data[at + len(packet) :]
    video.write_bytes(data)
    with pytest.raises(InputError, match="image 0 of 10 is damaged"):
        open_images(video).count()


def test_a_video_without_checksums_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "left.mkv"
    with av.open(path, "w") as container:
        stream = container.add_stream("ffv1", rate=30, options={"level": "3", "slicecrc": "0"})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "gray"
        for image in images(3, colour=False):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, "gray")))
        container.mux(stream.encode(None))
    assert open_images(path).count() == 3


def test_a_video_cut_anywhere_holds_the_images_before_the_cut(video: Path) -> None:
    data = video.read_bytes()
    counts = []
    for part in range(2, 10):
        video.write_bytes(data[: len(data) * part // 10])
        stream = open_images(video)
        counts.append(stream.count(torn=True))
        assert_array_equal(list(stream.images())[: counts[-1]], images(10)[: counts[-1]])
    assert counts == sorted(counts)
    assert counts[0] >= 1
    assert counts[-1] >= 7


def test_a_torn_folder_ends_at_its_first_gap_or_bad_image(tmp_path: Path) -> None:
    write_folder(tmp_path / "left", images(10))
    stream = open_images(tmp_path / "left")
    file = tmp_path / "left" / "000006.png"
    file.write_bytes(file.read_bytes()[:-1])
    assert stream.count(torn=True) == 6
    file.unlink()
    assert stream.count(torn=True) == 6
    with pytest.raises(InputError, match=r"left: has no 000006.png; it holds 9 numbered images"):
        stream.count()


def test_a_picture_that_declares_more_pixels_than_fit_is_refused(tmp_path: Path) -> None:
    write_folder(tmp_path / "left", images(1))
    file = tmp_path / "left" / "000000.png"
    data = bytearray(file.read_bytes())
    data[16:24] = struct.pack(">II", 60_000, 60_000)  # of the first chunk, IHDR
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    file.write_bytes(data)
    with pytest.raises(InputError, match=r"000000\.png: is damaged or no PNG"):
        list(open_images(tmp_path / "left").images())


def test_other_files_in_a_folder_of_images_are_left_alone(tmp_path: Path) -> None:
    write_folder(tmp_path / "left", images(3))
    (tmp_path / "left" / "Thumbs.db").write_bytes(b"x")
    (tmp_path / "left" / "notes.png").write_bytes(b"x")
    assert open_images(tmp_path / "left").count() == 3
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"empty: has no 000000.png; it holds 0 numbered images\."):
        open_images(tmp_path / "empty").count()


def test_more_than_eight_bits_are_refused_not_squeezed(tmp_path: Path) -> None:
    write_video(tmp_path / "deep.mkv", images(2), depth=16)
    with pytest.raises(InputError, match="has 16 bits a sample; 8 are expected"):
        next(open_images(tmp_path / "deep.mkv").images())
    (tmp_path / "deep").mkdir()
    cv2.imwrite(str(tmp_path / "deep" / "000000.png"), np.full((4, 4), 4095, dtype=np.uint16))
    with pytest.raises(InputError, match="has 16 bits a sample; 8 are expected"):
        next(open_images(tmp_path / "deep").images())


@pytest.mark.shared
def test_a_colour_video_of_another_maker_comes_in_three_channels() -> None:
    video = shared("data", "colour_video_visp", "cube_video.mp4")
    stream = open_images(video)
    reference = cv2.VideoCapture(str(video))
    for image in islice(stream.images(), 3):
        taken, expected = reference.read()
        assert taken
        assert_array_equal(image, expected)
    rows = (video.parent / "cap_visibility.csv").read_text().strip().count("\n")
    assert stream.count() == rows


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
