"""Pairs that a recording set aside are found again when it was cut off before they were encoded."""

import os
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.support.devices.recording_process import FACTS, assert_recorded, pair, reading
from verify.devices.protocols import CapturedPair
from verify.errors import InputError
from verify.io.session.session import open_session
from verify.io.unfinished import HEADER, MAGIC, NAME
from verify.live.recording.session import MAX_UNENCODED_PAIRS, SessionWriter


def cut_off(folder: Path, encoded: int, aside: int) -> list[CapturedPair]:
    """A session whose writer is gone: some pairs in its videos, others set aside."""
    pairs = [pair(number, 10 + number / 30) for number in range(encoded + aside)]
    part = SessionWriter(folder, FACTS, datetime(2026, 1, 1, tzinfo=UTC), pairs[0])
    for number in range(20):
        part.add_reading(reading(9.9 + number * 0.1))
    for index, given in enumerate(pairs):
        if index and index < encoded:
            assert part.set_aside(given)  # as a recorder does, so that slots are used anew
        if index < encoded:
            part.add_pair(given)
        else:
            assert part.set_aside(given)
    return pairs


@pytest.mark.parametrize(
    ("encoded", "aside"),
    [(1, 3), (MAX_UNENCODED_PAIRS + 5, MAX_UNENCODED_PAIRS), (2 * MAX_UNENCODED_PAIRS, 0)],
)
def test_pairs_that_were_set_aside_are_found_when_the_recording_was_cut_off(
    tmp_path: Path, encoded: int, aside: int
) -> None:
    pairs = cut_off(tmp_path / "session", encoded, aside)
    session = open_session(tmp_path / "session")
    assert session.open
    assert (f"{aside} pairs in {NAME}" in session.warnings[-1]) == bool(aside)
    assert NAME in session.inputs
    assert_recorded(session, pairs)
    assert_recorded(session, pairs)  # a second time: nothing was used up


def test_a_pair_that_was_being_set_aside_is_left_out(tmp_path: Path) -> None:
    pairs = cut_off(tmp_path / "session", 3, 2)
    ring = tmp_path / "session" / NAME
    size = (ring.stat().st_size - 4096) // MAX_UNENCODED_PAIRS
    with ring.open("r+b") as file:  # the number of the last one is not there yet
        file.seek(4096 + 4 * size)
        file.write((-1).to_bytes(8, "little", signed=True))
    assert_recorded(open_session(tmp_path / "session"), pairs[:4])


def test_a_ring_that_was_copied_in_part_gives_what_it_has(tmp_path: Path) -> None:
    pairs = cut_off(tmp_path / "session", 2, 3)
    ring = tmp_path / "session" / NAME
    size = (ring.stat().st_size - 4096) // MAX_UNENCODED_PAIRS
    os.truncate(ring, 4096 + 4 * size - 1)
    assert_recorded(open_session(tmp_path / "session"), pairs[:3])


@pytest.mark.parametrize("kept", [0, 40, 300, 700])
def test_a_video_cut_within_its_first_image_leaves_the_pairs_set_aside(
    tmp_path: Path, kept: int
) -> None:
    pairs = cut_off(tmp_path / "session", 1, 3)
    os.truncate(tmp_path / "session" / "left.mkv", kept)
    session = open_session(tmp_path / "session")
    assert f"3 pairs in {NAME}" in session.warnings[-1]
    for before, after in zip(pairs[1:], session.pairs(), strict=True):
        assert after.t_left == before.t_left
        assert_array_equal(after.left, before.left)


@pytest.mark.parametrize("zeros", [0, 9999])
def test_a_ring_that_never_reached_the_disk_leaves_the_pairs_in_the_videos(
    tmp_path: Path, zeros: int
) -> None:
    pairs = cut_off(tmp_path / "session", 2, 3)
    (tmp_path / "session" / NAME).write_bytes(bytes(zeros))
    assert_recorded(open_session(tmp_path / "session"), pairs[:2])


HUGE = HEADER.pack(MAGIC, 2**60, *[2**32, 2**32, 1] * 2)  # 2**64 pixels, which is 0 in 64 bits


@pytest.mark.parametrize("content", [b"something else", HUGE + bytes(9999), None])
def test_another_file_of_that_name_is_refused(content: bytes | None, tmp_path: Path) -> None:
    cut_off(tmp_path / "session", 2, 3)
    ring = tmp_path / "session" / NAME
    ring.unlink()
    if content is None:
        os.mkfifo(ring)
    else:
        ring.write_bytes(content)
    with pytest.raises(InputError, match=r"pending\.raw: (holds no pending pairs|is not a plain)"):
        open_session(tmp_path / "session")


@pytest.mark.parametrize("t", [np.nan, -1.0])
def test_pending_pairs_without_rising_times_are_refused(t: float, tmp_path: Path) -> None:
    cut_off(tmp_path / "session", 2, 3)
    ring = tmp_path / "session" / NAME
    size = (ring.stat().st_size - 4096) // MAX_UNENCODED_PAIRS
    with ring.open("r+b") as file:
        file.seek(4096 + 3 * size + 8)
        file.write(np.array([t]).tobytes())
    with pytest.raises(InputError, match=r"pending\.raw: holds pairs whose times do not rise"):
        open_session(tmp_path / "session")


def test_little_room_on_the_disk_sets_nothing_aside(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pairs = [pair(number, 10 + number / 30) for number in range(2)]
    part = SessionWriter(tmp_path / "session", FACTS, datetime(2026, 1, 1, tzinfo=UTC), pairs[0])
    assert not part.set_aside(pairs[0])  # the first one goes to the video at once
    part.add_pair(pairs[0])
    free = type("Usage", (), {"free": 3 << 20})
    monkeypatch.setattr("verify.live.recording.session.shutil.disk_usage", lambda _: free)
    assert not part.set_aside(pairs[1])
    assert not (tmp_path / "session" / NAME).exists()
