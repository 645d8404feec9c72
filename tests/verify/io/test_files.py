"""An output folder that cannot be made: one line, exit status 2, and a remedy that fits.

A disk that fills up midway leaves nothing half-written behind.
"""

import errno
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import Mock

import pytest

from tests.support.command import verify
from verify.errors import InputError
from verify.io import files
from verify.io.files import write_folder_whole, write_whole, written_together


def names(folder: Path) -> list[str]:
    """Everything below a folder, hidden files too."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def build(out: Path, force: bool = False, then: Callable[[], object] = lambda: None) -> None:
    """Build a folder of one file; then something else happens."""
    with write_folder_whole(out, force) as folder:
        (folder / "summary.json").write_text("ours")
        then()


def too_late() -> None:
    pytest.fail("nothing may be computed for a place that is refused")


def no_space(*_: object) -> int:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_file_holds_what_was_given_and_nothing_lies_beside_it(tmp_path: Path) -> None:
    data = os.urandom(100_000)
    write_whole(tmp_path / "rig.toml", data)
    assert (tmp_path / "rig.toml").read_bytes() == data
    write_whole(tmp_path / "rig.toml", b"")
    assert (tmp_path / "rig.toml").read_bytes() == b""
    assert names(tmp_path) == ["rig.toml"]


def test_a_reader_during_replacement_gets_the_old_file(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_bytes(b"before")
    with (tmp_path / "rig.toml").open("rb") as reader:
        write_whole(tmp_path / "rig.toml", b"after, and longer")
        assert reader.read() == b"before"


def test_a_file_gets_the_permissions_that_the_user_gives_new_files(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_whole(tmp_path / "rig.toml", b"x")
        with write_folder_whole(tmp_path / "out"):
            pass
    finally:
        os.umask(before)
    assert (tmp_path / "rig.toml").stat().st_mode & 0o777 == 0o640
    assert (tmp_path / "out").stat().st_mode & 0o777 == 0o750


def test_a_file_is_written_whole_though_the_system_takes_it_in_pieces(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    genuine = os.write
    monkeypatch.setattr(os, "write", lambda handle, data: genuine(handle, bytes(data[:7])))
    write_whole(tmp_path / "rig.toml", b"0123456789" * 5)
    assert (tmp_path / "rig.toml").read_bytes() == b"0123456789" * 5


@pytest.mark.parametrize("failing", ["write", "fsync", "open"])
def test_a_write_that_fails_leaves_what_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: str
) -> None:
    path = tmp_path / "rig.toml"
    path.write_bytes(b"before")
    monkeypatch.setattr(os, failing, no_space)
    with pytest.raises(InputError) as caught:
        write_whole(path, b"after")
    monkeypatch.undo()
    assert str(caught.value) == (
        f"{path}: no space left on device. Free some space or write somewhere else."
    )
    assert path.read_bytes() == b"before"
    assert names(tmp_path) == ["rig.toml"]


def test_an_interrupt_leaves_what_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "write", Mock(side_effect=KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "rig.toml", b"after")
    assert names(tmp_path) == []


@pytest.mark.parametrize("place", ["nowhere/rig.toml", "file/rig.toml", "folder", "n" * 300])
def test_a_place_that_cannot_be_written_is_named(tmp_path: Path, place: str) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError) as caught:
        write_whole(tmp_path / place, b"x")
    assert str(caught.value).startswith(str(tmp_path / place))
    assert names(tmp_path) == ["file", "folder"]


def test_a_folder_appears_with_all_that_was_built_in_it(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "report"
    with write_folder_whole(out) as folder:
        (folder / "results").mkdir()
        (folder / "results" / "a.parquet").write_text("a")
        (folder / "summary.json").write_text("{}")
        assert not out.exists()
        assert not out.parent.exists()
    assert names(tmp_path) == [
        "deep",
        "deep/report",
        "deep/report/results",
        "deep/report/results/a.parquet",
        "deep/report/summary.json",
    ]


@pytest.mark.parametrize("stop", [KeyboardInterrupt, ZeroDivisionError, InputError("x", "is bad")])
@pytest.mark.parametrize("before", ["nothing", "empty", "full"])
def test_a_run_that_fails_leaves_the_place_as_it_was(
    tmp_path: Path, stop: type[BaseException] | BaseException, before: str
) -> None:
    out = tmp_path / "report"
    if before != "nothing":
        out.mkdir()
    if before == "full":
        (out / "summary.json").write_text("old")
    there = names(tmp_path)
    kind = stop if isinstance(stop, type) else type(stop)

    def fails() -> None:
        raise stop

    with pytest.raises(kind):
        build(out, force=True, then=fails)
    assert names(tmp_path) == there
    if before == "full":
        assert (out / "summary.json").read_text() == "old"


def test_force_replaces_what_is_made_and_leaves_the_rest(tmp_path: Path) -> None:
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "a.parquet").write_text("old")
    (tmp_path / "results" / "notes.txt").write_text("mine")
    (tmp_path / "summary.json").write_text("old")
    with write_folder_whole(tmp_path, force=True) as folder:
        (folder / "results").mkdir()
        (folder / "results" / "a.parquet").write_text("new")
        (folder / "summary.json").write_text("new")
        (folder / "figures").mkdir()
        (folder / "figures" / "a.svg").write_text("new")
        assert (tmp_path / "summary.json").read_text() == "old"
    texts = {p.name: p.read_text() for p in tmp_path.rglob("*") if p.is_file()}
    assert texts == {"a.parquet": "new", "notes.txt": "mine", "summary.json": "new", "a.svg": "new"}
    assert not [name for name in names(tmp_path) if "partial" in name]


def test_an_empty_folder_is_filled_and_stays_the_same_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inode = tmp_path.stat().st_ino  # it may be someone's current folder, or a mount
    monkeypatch.chdir(tmp_path)
    with write_folder_whole(Path()) as folder:
        (folder / "summary.json").write_text("{}")
    assert Path("summary.json").read_text() == "{}"
    assert tmp_path.stat().st_ino == inode


def test_what_a_killed_run_left_does_not_make_a_folder_full(tmp_path: Path) -> None:
    out = tmp_path / "report"
    out.mkdir()
    (out / ".verify-partial-0123").mkdir()
    with write_folder_whole(out) as folder:
        (folder / "summary.json").write_text("{}")
    assert (out / "summary.json").exists()


def test_a_link_to_itself_is_no_place_to_write(tmp_path: Path) -> None:
    (tmp_path / "report").symlink_to("report")
    refused = pytest.raises(InputError, match="report: too many levels of symbolic links")
    with refused, write_folder_whole(tmp_path / "report"):
        pass


def test_a_link_to_a_folder_is_followed(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "report").symlink_to(tmp_path / "disk")
    with write_folder_whole(tmp_path / "report") as folder:
        (folder / "summary.json").write_text("{}")
    assert (tmp_path / "report").is_symlink()
    assert (tmp_path / "disk" / "summary.json").exists()


def test_a_file_in_the_way_is_refused(tmp_path: Path) -> None:
    (tmp_path / "report").touch()
    with pytest.raises(InputError, match="report: is a file; a folder is expected"):
        build(tmp_path / "report", force=True, then=too_late)


@pytest.mark.parametrize("before", [False, True], ids=["new", "empty"])
def test_a_folder_filled_by_another_run_is_not_overwritten(before: bool, tmp_path: Path) -> None:
    out = tmp_path / "report"

    def another_run() -> None:
        out.mkdir(exist_ok=True)
        (out / "summary.json").write_text("theirs")

    if before:
        out.mkdir()
    with pytest.raises(InputError, match="report: another run has written there meanwhile"):
        build(out, then=another_run)
    assert (out / "summary.json").read_text() == "theirs"
    assert names(tmp_path) == ["report", "report/summary.json"]


@pytest.mark.parametrize("obstacle", ["b", "results"])
def test_nothing_is_replaced_where_something_stands_in_the_way(
    obstacle: str, tmp_path: Path
) -> None:
    (tmp_path / "a").write_text("old")
    (tmp_path / obstacle).mkdir() if obstacle == "b" else (tmp_path / obstacle).touch()

    def built() -> None:
        with write_folder_whole(tmp_path, force=True) as folder:
            (folder / "results").mkdir()
            for name in ("a", "b", "results/c"):
                (folder / name).write_text("new")

    with pytest.raises(InputError, match=f"{obstacle}: is a .* Move it away"):
        built()
    assert (tmp_path / "a").read_text() == "old"
    assert names(tmp_path) == ["a", obstacle]


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
    message = refusal(tmp_path / "notes.txt" / below)
    assert "lies below a file; a folder is expected. Choose another -o." in message
    assert (tmp_path / "notes.txt").read_text() == "mine"


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs /proc")
def test_a_place_that_takes_no_folders() -> None:
    message = refusal(Path("/proc/verify-report"))
    assert "/proc/verify-report: cannot be made" in message
    assert "Choose another place, in a folder that takes files." in message


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
                write_folder_whole(locked / "report"),
            ):
                pytest.fail("the work began")
            assert list(locked.iterdir()) == []
        finally:
            locked.chmod(0o700)


def written_and_failed(failure: BaseException, rig: Path, marker: Path) -> None:
    with written_together(rig, marker):
        write_whole(rig, b"new")
        write_whole(marker, b"new")
        raise failure


@pytest.mark.parametrize("failure", [OSError(errno.ENOSPC, "full"), KeyboardInterrupt()])
def test_a_failure_takes_new_files_away_and_brings_old_ones_back(
    tmp_path: Path, failure: BaseException
) -> None:
    rig, marker = tmp_path / "rig.toml", tmp_path / "marker.toml"
    marker.write_bytes(b"old")
    with pytest.raises(type(failure)):
        written_and_failed(failure, rig, marker)
    assert [p.name for p in tmp_path.iterdir()] == ["marker.toml"]
    assert marker.read_bytes() == b"old"


def test_what_a_killed_process_was_building_goes_with_the_next_write(tmp_path: Path) -> None:
    ended = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"],
                           capture_output=True, text=True, check=True)  # fmt: skip
    for pid in (ended.stdout.strip(), str(os.getppid())):
        (tmp_path / f"{files.PARTIAL_PREFIX}{files._HOST}-{pid}-ab").mkdir()
    write_whole(tmp_path / "table.csv", b"a")
    left = {entry.name for entry in tmp_path.iterdir()}
    assert left == {"table.csv", f"{files.PARTIAL_PREFIX}{files._HOST}-{os.getppid()}-ab"}
