import errno
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.small_disk import mounted
from verify.errors import InputError
from verify.writing import folder_written_whole, write_whole


def names(folder: Path) -> list[str]:
    """Everything below a folder, hidden files too."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


@pytest.fixture
def full_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 64 kB."""
    with mounted(tmp_path / "disk", "-o", "size=64k") as disk:
        yield disk


def build(out: Path, force: bool = False, then: Callable[[], object] = lambda: None) -> None:
    """Build a folder of one file; then something else happens."""
    with folder_written_whole(out, force) as folder:
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


def test_who_reads_while_it_is_replaced_sees_the_old_file_whole(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_bytes(b"before")
    with (tmp_path / "rig.toml").open("rb") as reader:
        write_whole(tmp_path / "rig.toml", b"after, and longer")
        assert reader.read() == b"before"


def test_a_file_gets_the_permissions_that_the_user_gives_new_files(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_whole(tmp_path / "rig.toml", b"x")
        with folder_written_whole(tmp_path / "out"):
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
    def interrupted(*_: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "write", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "rig.toml", b"after")
    assert names(tmp_path) == []


def test_a_full_disk_is_said_in_one_line(full_disk: Path) -> None:
    write_whole(full_disk / "rig.toml", b"before")
    with pytest.raises(InputError, match="no space left on device"):
        write_whole(full_disk / "rig.toml", bytes(200_000))
    assert (full_disk / "rig.toml").read_bytes() == b"before"
    with (
        pytest.raises(InputError, match=r"out: no space left on device\. Free some space"),
        folder_written_whole(full_disk / "out") as folder,
    ):
        (folder / "frames.csv").write_bytes(bytes(200_000))
    assert names(full_disk) == ["rig.toml"]


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
    with folder_written_whole(out) as folder:
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


def test_a_folder_that_is_not_empty_is_refused_unless_forced(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"is not empty.*Choose another -o or give --force\."):
        build(tmp_path, then=too_late)
    assert names(tmp_path) == ["notes.txt"]


def test_force_replaces_what_is_made_and_leaves_the_rest(tmp_path: Path) -> None:
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "a.parquet").write_text("old")
    (tmp_path / "results" / "notes.txt").write_text("mine")
    (tmp_path / "summary.json").write_text("old")
    with folder_written_whole(tmp_path, force=True) as folder:
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
    with folder_written_whole(".") as folder:
        (folder / "summary.json").write_text("{}")
    assert Path("summary.json").read_text() == "{}"
    assert tmp_path.stat().st_ino == inode


def test_what_a_killed_run_left_does_not_make_a_folder_full(tmp_path: Path) -> None:
    out = tmp_path / "report"
    out.mkdir()
    (out / ".verify-partial-0123").mkdir()
    with folder_written_whole(out) as folder:
        (folder / "summary.json").write_text("{}")
    assert (out / "summary.json").exists()


def test_a_link_to_a_folder_is_followed(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "report").symlink_to(tmp_path / "disk")
    with folder_written_whole(tmp_path / "report") as folder:
        (folder / "summary.json").write_text("{}")
    assert (tmp_path / "report").is_symlink()
    assert (tmp_path / "disk" / "summary.json").exists()


def test_a_file_in_the_way_is_refused(tmp_path: Path) -> None:
    (tmp_path / "report").touch()
    with pytest.raises(InputError, match="report: is a file; a folder is expected"):
        build(tmp_path / "report", force=True, then=too_late)


def test_a_place_without_permission_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(path: Path, *_: object) -> None:  # root, who may run this, is refused nothing
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(Path, "mkdir", refused)
    with pytest.raises(InputError, match=r"report: permission denied\. Grant access"):
        build(tmp_path / "report", then=too_late)


def test_a_folder_filled_by_another_run_meanwhile_is_not_overwritten(tmp_path: Path) -> None:
    out = tmp_path / "report"

    def another_run() -> None:
        out.mkdir()
        (out / "summary.json").write_text("theirs")

    with pytest.raises(InputError, match="report: directory not empty"):
        build(out, then=another_run)
    assert (out / "summary.json").read_text() == "theirs"
    assert names(tmp_path) == ["report", "report/summary.json"]


def test_an_error_of_the_program_inside_stays_that_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), folder_written_whole(tmp_path / "report") as folder:
        (folder / "nowhere" / "a").write_text("a")
