"""An output folder that cannot be made: one line, exit status 2, and a remedy that fits."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from tests.end_to_end.command import verify
from verify.errors import InputError
from verify.writing import folder_written_whole, write_whole

NOBODY = 65534  # the user id of nobody, by custom


def refusal(place: Path) -> str:
    ended = verify("grab", "--sim", "-o", place)
    assert ended.status == 2
    assert ended.err.count("\n") == 1, ended.err
    assert "Put the file there" not in ended.err
    return ended.err


@pytest.mark.parametrize("below", ["report", "deep/report"])
def test_a_folder_below_a_file(tmp_path: Path, below: str) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    said = refusal(tmp_path / "notes.txt" / below)
    assert "lies below a file; a folder is expected. Choose another -o." in said
    assert (tmp_path / "notes.txt").read_text() == "mine"


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs /proc")
def test_a_place_that_takes_no_folders() -> None:
    said = refusal(Path("/proc/verify-report"))
    assert "/proc/verify-report: cannot be made" in said
    assert "Choose another place, in a folder that takes files." in said


@contextmanager
def nobody() -> Iterator[None]:
    """Be somebody without rights for a while: to root nothing is forbidden."""
    before = os.geteuid()
    if before == 0:
        os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(before)


def test_a_folder_without_write_permission() -> None:
    with TemporaryDirectory() as name:
        locked = Path(name)
        locked.chmod(0o555)
        try:
            with (
                nobody(),
                pytest.raises(InputError, match=r"report: permission denied\. Grant access to the"),
                folder_written_whole(locked / "report"),
            ):
                pytest.fail("the work began")
            assert list(locked.iterdir()) == []
        finally:
            locked.chmod(0o700)


def test_a_file_whose_folder_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"rig\.toml: cannot be made: .*Choose another place"):
        write_whole(tmp_path / "gone" / "rig.toml", b"")


def test_nothing_is_worked_out_for_a_place_that_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with (
        pytest.raises(InputError, match="lies below a file"),
        folder_written_whole(tmp_path / "file" / "report"),
    ):
        pytest.fail("the work began")
