"""Every session is found once; unreadable folders are reported."""

import csv
import os
from pathlib import Path

import fsspec
import pytest

from tests.support.recorded import refusal
from verify.fleet.batch import finding
from verify.fleet.batch.finding import find_sessions
from verify.fleet.batch.records import SessionFailure
from verify.fleet.batch.tables import write_failures

NOWHERE = Path("nowhere")
HOSTILE = ('a,b"c', "line\nbreak", "<script>alert(1)</script>", "=1+1", "-o", "Prüfung № 3")


def stub(folder: Path) -> Path:
    folder.mkdir(parents=True)
    (folder / "session.toml").write_text("format = 1\n")
    return folder


def test_sessions_are_found_once_at_every_depth_and_none_inside_another(tmp_path: Path) -> None:
    """Nor where a folder is named twice or linked, in the batch's own, or half written."""
    out, inside = tmp_path / "out", ("a/first/inside", "out/sessions/x", ".verify-partial-1234")
    for place in ("b", "a/deep/down", "a/first", *inside):
        stub(tmp_path / place)
    (tmp_path / "link").symlink_to("a")
    found, failures = find_sessions([str(tmp_path), str(tmp_path / "a")], out)
    names = [one.session for one in found]
    assert names == [f"{tmp_path}/{n}" for n in ("a/deep/down", "a/first", "b")]
    assert not failures


def test_a_symlink_that_leads_in_a_circle_is_reported_and_ends(tmp_path: Path) -> None:
    stub(tmp_path / "one")
    (tmp_path / "up").symlink_to("..", target_is_directory=True)
    (tmp_path / "around").symlink_to(".")
    (tmp_path / "itself").symlink_to("itself")
    (tmp_path / "broken").symlink_to("nothing")
    (tmp_path / "high").symlink_to("../..")
    found, failures = find_sessions([str(tmp_path)], NOWHERE)
    assert len(found) == 1
    assert {Path(f.session).name for f in failures} == {"up", "around", "itself", "high"}
    assert all("circle" in f.why for f in failures)


def test_hostile_names_stay_what_they_are_and_failures_csv_can_be_read(tmp_path: Path) -> None:
    for name in HOSTILE:
        stub(tmp_path / name)
    os.mkdir(os.fsencode(tmp_path) + b"/\xff\xfe")  # noqa: PTH102  # no UTF-8
    (tmp_path / os.fsdecode(b"\xff\xfe") / "session.toml").write_text("")
    found, _ = find_sessions([str(tmp_path)], NOWHERE)
    names = [one.session for one in found]
    assert {name.removeprefix(f"{tmp_path}/") for name in names} == {*HOSTILE, "\\udcff\\udcfe"}
    formulas = [f"{sign}1+1" for sign in "=+-@\t"]  # to a spreadsheet, as folders may be called
    listed = [*names, *formulas]
    write_failures(tmp_path, [SessionFailure(name, "refused", 'why, "so"') for name in listed])
    with (tmp_path / "failures.csv").open(newline="", encoding="utf-8") as file:
        read = [(row["session"], row["why"]) for row in csv.DictReader(file)]
    plain = [*names, *(f"'{text}" for text in formulas)]
    assert read == [(name, 'why, "so"') for name in plain]


def test_a_folder_without_permission_is_reported_and_the_rest_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stub(tmp_path / "open" / "one")
    closed = tmp_path / "closed"
    closed.mkdir()
    plain = os.scandir

    def guarded(path: str) -> object:  # whoever runs the tests may be allowed everything
        if str(path) == str(closed):
            raise PermissionError(13, "Permission denied", str(path))
        return plain(path)

    monkeypatch.setattr(os, "scandir", guarded)
    found, failures = find_sessions([str(tmp_path)], NOWHERE)
    assert len(found) == 1
    (failure,) = failures
    assert (failure.session, failure.kind) == (str(closed), "unreadable")
    assert "permission denied" in failure.why


@pytest.mark.parametrize(
    "root",
    ["nothing/there", "file", "empty", "nul\0", "nonsense://x/y", "file:///nothing/there/at/all"],
)
def test_a_root_that_is_no_folder_with_sessions_is_refused(root: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "empty").mkdir()
    refusal(find_sessions, [root if "://" in root else str(tmp_path / root)], NOWHERE)


def test_sessions_behind_a_url_are_found_fetched_and_distinguished() -> None:
    storage = fsspec.filesystem("memory")
    for name in ("a/one", "a/one/inside", "b/two"):
        storage.pipe(f"/lab/{name}/session.toml", b"format = 1\n")
    storage.pipe("/lab/a/one/left/000000.png", b"picture")
    storage.pipe("/lab/a/one/truth.csv", b"never read")
    try:
        found, _ = find_sessions(["memory://lab"], NOWHERE)
        paths = [one.session.removeprefix("memory://").lstrip("/") for one in found]
        assert paths == ["lab/a/one", "lab/b/two"]
        with finding.local_copy(found[0].folder) as folder:
            assert (folder / "left" / "000000.png").read_bytes() == b"picture"
            assert not (folder / "truth.csv").exists()
        assert not folder.exists()
        before = finding.file_versions(found[0].folder)
        assert before == finding.file_versions(found[0].folder)
        storage.pipe("/lab/a/one/left/000000.png", b"another")
        after = finding.file_versions(found[0].folder)
        assert [n for n in after if after[n] != before[n]] == ["left/000000.png"]
    finally:
        storage.rm("/lab", recursive=True)


@pytest.mark.parametrize("name", ["sessions", "sessions/../sessions", "sessions/one"])
def test_results_into_the_folder_of_the_sessions_itself_are_refused(
    tmp_path: Path, name: str
) -> None:
    one = tmp_path / "sessions" / "one"
    one.mkdir(parents=True)
    (one / "session.toml").touch()
    error = refusal(find_sessions, [str(tmp_path / name)], (tmp_path / name).resolve())
    assert "the folder of the results as well" in error.found
