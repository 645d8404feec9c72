"""Recordings are whole at any moment, equal to the measurement, and never delay it."""

import errno
import os
import random
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.support.devices.recording_process import FACTS, assert_recorded, pair, reading
from tests.support.recorded import HEIGHT, WIDTH
from verify.devices.cameras.opencv import JpegDecoder
from verify.devices.protocols import CapturedPair
from verify.io.session.session import open_session
from verify.io.video import open_images
from verify.live.recording.matroska import MatroskaFile, PictureEncoder, picture_format
from verify.live.recording.recorder import SessionRecorder
from verify.live.recording.session import MIN_FREE_BYTES, SessionWriter

ROOT = Path(__file__).parents[4]


def record(folder: Path, pairs: list[CapturedPair], facts: Any = FACTS) -> SessionRecorder:
    recorder = SessionRecorder(folder, "session", facts)
    for number in range(len(pairs) * 3):
        recorder.reading(reading(pairs[0].t_left - 0.1 + 0.02 * number))
    list(recorder.keep(iter(pairs)))
    recorder.close()
    return recorder


def pairs_at_thirty_hertz(count: int) -> list[CapturedPair]:
    return [pair(number, 1234.5 + number / 30) for number in range(count)]


def test_a_closed_recording_is_a_session_that_holds_what_was_kept(tmp_path: Path) -> None:
    given = pairs_at_thirty_hertz(8)
    recorder = record(tmp_path, given)
    session = open_session(tmp_path / "session")
    assert not session.open
    assert session.warnings == ()
    assert recorder.state().pairs == len(session) == 8
    assert_recorded(session, given)


def test_times_and_angles_that_are_measured_with_are_those_of_the_file_to_the_last_digit(
    tmp_path: Path,
) -> None:
    recorder = SessionRecorder(tmp_path, "session", replace(FACTS, turning=True))
    rng = np.random.default_rng(1)
    given = [
        replace(pair(number, float(100 + number / 30 + rng.uniform(0, 0.01))), pan_left=angle)
        for number, angle in enumerate(rng.uniform(-1, 1, 20).tolist())
    ]
    readings = [
        recorder.reading(
            replace(reading(99.9 + 0.01 * n + 1e-4 / 3), q=rng.uniform(-0.01, 0.01, 6))
        )
        for n in range(50)
    ]
    kept = list(recorder.keep(iter(given)))
    recorder.close()
    session = open_session(tmp_path / "session")
    assert [p.t_left for p in session.pairs()] == [p.t_left for p in given]
    assert [p.pan_left for p in session.pairs()] == [p.pan_left for p in kept]
    assert_array_equal(session.encoders.t, [r.t for r in readings])
    assert_array_equal(session.encoders.q, [r.q for r in readings])


@pytest.mark.parametrize("shape", [(48, 64), (48, 64, 3), (47, 63), (47, 63, 3)])
def test_pictures_come_back_as_they_were(tmp_path: Path, shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(3)
    pictures = [rng.integers(0, 255, shape, dtype=np.uint8) for _ in range(5)]
    coder = PictureEncoder(picture_format(pictures[0], None))
    file = MatroskaFile(tmp_path / "video.mkv", coder.track)
    for number, picture in enumerate(pictures):
        file.add(coder.encode(picture, None), number / 30)
    file.close()
    video = open_images(tmp_path / "video.mkv")
    assert video.count() == 5
    for before, after in zip(pictures, video.images(), strict=True):
        assert_array_equal(after, before)


@pytest.mark.parametrize("colour", [False, True])
def test_jpegs_go_to_the_file_as_they_came_and_are_read_as_they_were_measured(
    tmp_path: Path, colour: bool
) -> None:
    decoder, pairs = JpegDecoder(), []
    for number in range(6):
        raws, images = [], []
        for side in range(2):
            rng = np.random.default_rng(2 * number + side)
            shape = (HEIGHT, WIDTH, 3) if colour else (HEIGHT, WIDTH)
            rough = rng.integers(0, 255, shape, dtype=np.uint8)
            raw = cv2.imencode(".jpg", cv2.GaussianBlur(rough, (0, 0), 2))[1].tobytes()
            image = decoder.decode(raw)
            raws.append(raw)
            images.append(image)
        t = 5 + number / 30
        lossy = True, True
        pairs.append(CapturedPair(number, t, t, 0.0, 0.0, *images, lossy, *raws))
    record(tmp_path, pairs)
    assert_recorded(open_session(tmp_path / "session"), pairs)
    data = (tmp_path / "session" / "left.mkv").read_bytes()
    assert all(p.left_raw is not None and p.left_raw in data for p in pairs)


def start(folder: Path, rate: float) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "tests.support.devices.recording_process", str(folder), str(rate)],
        cwd=ROOT, stdout=subprocess.PIPE, text=True,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip


@pytest.mark.realtime
@pytest.mark.parametrize("round_number", range(2))
def test_after_a_kill_every_pair_that_was_handed_on_is_there(
    tmp_path: Path, round_number: int
) -> None:
    chance = random.Random(round_number)
    folders = [tmp_path / str(number) for number in range(5)]
    rates = (5, 30, 30, 60, 200)
    processes = [start(folder, rate) for folder, rate in zip(folders, rates, strict=True)]
    handed_on = []
    for process in processes:
        process.stdout.readline()  # it is under way
    for process in processes:
        time.sleep(chance.uniform(0.02, 0.4))
        process.kill()
    for process in processes:
        whole_lines = process.communicate()[0].rpartition("\n")[0].splitlines()
        handed_on.append(np.array([line.split() for line in whole_lines], dtype=float))
    for folder, output in zip(folders, handed_on, strict=True):
        # a pair that the disk was too slow for is handed on before; how many those were is told
        late = int(output[-1, 2]) if len(output) else 0
        times = output[: len(output) - late, 1] if len(output) else []
        session = open_session(folder / "killed")
        assert session.open
        assert len(session) >= len(times) + 1  # the first line was read before
        measured = list(session.pairs())
        assert_array_equal([p.t_left for p in measured[1 : len(times) + 1]], times)
        for p in measured:
            assert_array_equal(p.left, pair(p.frame, 0.0).left)
            assert_array_equal(p.right, pair(p.frame, 0.0).right)
        assert session.encoders.t[-1] >= measured[-1].t_left - 1.0


def test_a_folders_name_has_marks_of_strftime_and_need_not_be_utf_8(tmp_path: Path) -> None:
    recorder = SessionRecorder(tmp_path, "a\udcff-%Y-%%-%-d", FACTS)
    list(recorder.keep(iter(pairs_at_thirty_hertz(1))))
    recorder.close()
    (folder,) = recorder.state().folders
    assert re.fullmatch("a\udcff-[0-9]{4}-%-[0-9]{1,2}", folder.name)
    assert (folder / "session.toml").exists()


def test_a_controller_whose_clock_starts_anew_starts_a_new_session(tmp_path: Path) -> None:
    recorder = SessionRecorder(tmp_path, "session", FACTS)
    given = pairs_at_thirty_hertz(10)

    def pairs() -> Iterator[CapturedPair]:
        for p in given[:5]:
            recorder.reading(reading(p.t_left))
            yield p
        recorder.reading(replace(reading(0.5, segment=1), t_host=given[4].t_left))
        for p in given[5:]:
            shown = p.t_left - given[4].t_left
            recorder.reading(replace(reading(0.5 + shown, segment=1), t_host=p.t_left))
            yield p

    assert len(list(recorder.keep(pairs()))) == 10
    recorder.close()
    first, second = (open_session(folder) for folder in recorder.state().folders)
    assert (first.name, second.name) == ("session", "session-2")
    assert (len(first), len(second)) == (5, 5)
    assert second.encoders.t[0] == 0.5
    assert not first.open
    assert not second.open


def test_pairs_whose_times_do_not_rise_are_left_out_and_counted(tmp_path: Path) -> None:
    given = pairs_at_thirty_hertz(6)
    given[3] = replace(given[3], t_right=given[2].t_right)
    recorder = SessionRecorder(tmp_path, "session", FACTS)
    recorder.reading(reading(1.0))
    kept = list(recorder.keep(iter(given)))
    recorder.close()
    assert [p.t_left for p in kept] == [p.t_left for n, p in enumerate(given) if n != 3]
    assert [p.frame for p in kept] == [0, 1, 2, 3, 4]
    assert recorder.state().dropped == 1
    assert len(open_session(tmp_path / "session")) == 5


def test_readings_before_the_first_pair_and_repeated_times(tmp_path: Path) -> None:
    recorder = SessionRecorder(tmp_path, "session", FACTS)
    for number in range(500):
        recorder.reading(reading(number * 0.01))
        recorder.reading(reading(number * 0.01))  # the same instant again
    list(recorder.keep(iter([pair(0, 5.0), pair(1, 5.1)])))
    recorder.close()
    t = open_session(tmp_path / "session").encoders.t
    assert t[-1] == 4.99
    assert 3.9 < t[0] < 4.1
    assert np.all(np.diff(t) > 0)


def test_the_uncertainty_of_reading_times_is_reported_at_the_end(tmp_path: Path) -> None:
    record(tmp_path, pairs_at_thirty_hertz(5))
    output = open_session(tmp_path / "session").encoder_time_standard_uncertainty
    assert output == pytest.approx(0.001 / np.sqrt(3), rel=1e-2)  # uniform within ± 1 ms


def test_a_disk_that_fills_to_the_last_byte_leaves_whole_pairs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, room = os.write, [60_000]

    def write(file: int, data: Any) -> int:
        if len(data) > room[0]:
            taken = real(file, bytes(data)[: room[0]]) if room[0] else 0
            room[0] = 0
            if not taken:
                raise OSError(28, "No space left on device")
            return taken
        room[0] -= len(data)
        return real(file, data)

    def full_disk(folder: Path, *rest: Any) -> SessionWriter:
        part = SessionWriter(folder, *rest)
        monkeypatch.setattr("verify.live.recording.matroska.os.write", write)
        return part

    recorder = SessionRecorder(tmp_path, "session", FACTS, full_disk)
    recorder.reading(reading(1.0))
    assert len(list(recorder.keep(iter(pairs_at_thirty_hertz(20))))) == 20
    recorder.close()
    monkeypatch.undo()
    assert "no space left" in recorder.state().sentence
    folder = tmp_path / "session"
    pairs = recorder.state().pairs
    assert 3 < pairs < 20
    # cut back to what is whole: as many images on either side as rows
    assert open_images(folder / "left.mkv").count() == pairs
    assert open_images(folder / "right.mkv").count() == pairs
    assert len(open_session(folder)) >= pairs


def test_pairs_that_are_on_the_disk_stay_there_when_encoding_fails(tmp_path: Path) -> None:
    class Full(SessionWriter):
        def add_pair(self, pair: CapturedPair) -> None:
            if self.pairs == 3:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            super().add_pair(pair)

    given = pairs_at_thirty_hertz(8)
    recorder = SessionRecorder(tmp_path, "session", FACTS, Full, write_timeout=5.0)
    for number in range(30):
        recorder.reading(reading(given[0].t_left - 0.1 + 0.02 * number))
    list(recorder.keep(iter(given)))
    recorder.close()
    assert "no space left" in recorder.state().sentence
    session = open_session(tmp_path / "session")
    # five that were set aside, the first of which was refused, and none that came later
    assert session.open
    assert 3 < len(session) <= 8
    assert len(session) + recorder.state().late >= 8
    assert_recorded(session, given[: len(session)])


@pytest.mark.realtime
def test_a_disk_that_is_too_slow_ends_the_recording_and_nothing_else(tmp_path: Path) -> None:
    class Slow(SessionWriter):
        def add_pair(self, *arguments: Any) -> None:
            time.sleep(0.25)
            super().add_pair(*arguments)

    begin = [0.0]

    def timed() -> Iterator[CapturedPair]:
        for p in pairs_at_thirty_hertz(150):
            time.sleep(0.01)
            begin[0] = time.monotonic()
            yield p

    recorder = SessionRecorder(tmp_path, "session", FACTS, Slow)
    recorder.reading(reading(1.0))
    held = [time.monotonic() - begin[0] for _ in recorder.keep(timed())]
    assert len(held) == 150
    assert max(held) < 0.3
    state = recorder.state()
    assert "too slow" in state.sentence
    assert state.late > 0
    recorder.close()
    session = open_session(tmp_path / "session")
    assert not session.open
    assert 0 < len(session) == recorder.state().pairs < 150


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (PermissionError(13, "Permission denied"), "permission denied"),
        (OSError(5, "Input/output error"), "input/output error"),
        (ZeroDivisionError("oh"), "a defect of this program, ZeroDivisionError: oh"),
    ],
)
def test_a_system_error_ends_the_recording_with_a_message(
    tmp_path: Path, error: Exception, words: str
) -> None:
    class Refused(SessionWriter):
        def add_pair(self, *arguments: Any) -> None:
            if self.pairs == 5:
                raise error
            super().add_pair(*arguments)

    recorder = SessionRecorder(tmp_path, "session", FACTS, Refused)
    recorder.reading(reading(1.0))
    assert len(list(recorder.keep(iter(pairs_at_thirty_hertz(20))))) == 20
    recorder.close()
    assert words in recorder.state().sentence
    session = open_session(tmp_path / "session")
    assert recorder.state().pairs == 5
    assert len(session) >= 5  # those beyond were set aside, and wait to be encoded
    assert_recorded(session, pairs_at_thirty_hertz(20)[: len(session)])


def test_a_deleted_folder_is_noticed(tmp_path: Path) -> None:
    recorder = SessionRecorder(tmp_path, "session", FACTS)
    recorder.reading(reading(1.0))
    pairs = pairs_at_thirty_hertz(10)
    list(recorder.keep(iter(pairs[:5])))
    for file in (tmp_path / "session").iterdir():
        file.unlink()
    list(recorder.keep(iter(pairs[5:])))
    recorder.close()
    assert "the folder was deleted" in recorder.state().sentence


def test_an_unwritable_folder_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    recorder = SessionRecorder(tmp_path / "file", "session", FACTS)
    assert len(list(recorder.keep(iter(pairs_at_thirty_hertz(3))))) == 3
    recorder.close()
    assert "recording has stopped" in recorder.state().sentence
    assert "not a directory" in recorder.state().sentence


def test_a_second_recording_never_touches_the_first(tmp_path: Path) -> None:
    record(tmp_path, pairs_at_thirty_hertz(3))
    recorder = record(tmp_path, pairs_at_thirty_hertz(4))
    assert [len(open_session(tmp_path / name)) for name in ("session", "session-2")] == [3, 4]
    assert recorder.state().folders == (tmp_path / "session-2",)


def test_a_recording_without_a_pair_leaves_no_folder(tmp_path: Path) -> None:
    recorder = SessionRecorder(tmp_path, "session", FACTS)
    recorder.reading(reading(1.0))
    recorder.close()
    assert list(tmp_path.iterdir()) == []
    assert recorder.state().folders == ()


def test_room_is_kept_to_close_the_session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Plain(SessionWriter):
        def set_aside(self, pair: CapturedPair) -> bool:  # noqa: ARG002
            return False

    recorder = SessionRecorder(tmp_path, "session", FACTS, Plain)
    recorder.reading(reading(1.0))
    pairs = pairs_at_thirty_hertz(10)
    list(recorder.keep(iter(pairs[:5])))
    free = type("Usage", (), {"free": MIN_FREE_BYTES})
    monkeypatch.setattr("verify.live.recording.session.shutil.disk_usage", lambda _: free)
    list(recorder.keep(iter(pairs[5:])))
    recorder.close()
    assert "no space left" in recorder.state().sentence
    session = open_session(tmp_path / "session")
    assert not session.open
    assert_recorded(session, pairs[:5])
