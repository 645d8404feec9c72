import json
import re
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from pandas.testing import assert_frame_equal

import reports
from reports.results import MANIFEST, to_json_value
from tests.support.reports import session as made


def test_a_results_folder_gives_back_what_was_written_always_alike(tmp_path: Path) -> None:
    results = made.nonconforming()
    reports.write(results, tmp_path / "results")
    again = reports.read(tmp_path / "results")
    assert again.summary == results.summary
    assert again.setup == results.setup
    assert again.images == results.images
    assert again.tables.keys() == results.tables.keys()
    for name, table in results.tables.items():
        assert_frame_equal(again.tables[name], table, check_dtype=False)
    reports.write(results, tmp_path / "again")
    files = {path.name: path.read_bytes() for path in (tmp_path / "results").iterdir()}
    assert MANIFEST in files
    assert {path.name: path.read_bytes() for path in (tmp_path / "again").iterdir()} == files
    reports.write(made.nothing(), tmp_path / "nothing")
    assert reports.read(tmp_path / "nothing") == made.nothing()


def test_only_own_files_are_written_and_removed(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    reports.write(made.one_pair(), folder)
    reports.write(made.one_pair(), folder)
    assert (folder / "notes.txt").read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["results"]


def test_numbers_of_other_libraries_become_json_and_what_is_not_finite_becomes_null() -> None:
    found = to_json_value(
        {"a": np.float64(1.5), "b": np.nan, "c": np.arange(2), 3: (np.True_, np.int64(4))}
    )
    assert found == {"a": 1.5, "b": None, "c": [0, 1], "3": [True, 4]}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    reports.write(made.one_pair(), tmp_path / "results")
    return tmp_path / "results"


def _complaint(folder: Path) -> str:
    with pytest.raises(reports.ReportError) as caught:
        reports.read(folder)
    message = str(caught.value)
    assert "\n" not in message
    assert re.search(r"\. (Run|Name|Use) .+\.$", message), message  # ends with what to do
    assert str(folder) in message
    return message


def test_a_folder_without_results_is_named(tmp_path: Path) -> None:
    assert "no results.json" in _complaint(tmp_path)
    assert "no results.json" in _complaint(tmp_path / "absent")


@pytest.mark.parametrize(
    "text",
    [b"", b"\xff\xfe", b"[1]", b'{"format": 99}', b'{"format": 1}', b"[" * 100_000,
     b'{"format": ' + b"[" * 900 + b"]" * 900 + b"}"],
)  # fmt: skip
def test_a_damaged_or_foreign_manifest_is_refused_in_one_line(folder: Path, text: bytes) -> None:
    (folder / MANIFEST).write_bytes(text)
    assert MANIFEST in _complaint(folder)


@pytest.mark.parametrize("name", ["frames.parquet", "pair.png"])
def test_a_file_that_was_changed_cut_short_or_lost_is_named(folder: Path, name: str) -> None:
    content = (folder / name).read_bytes()
    (folder / name).write_bytes(content[:-1])
    assert name in _complaint(folder)
    (folder / name).unlink()
    assert name in _complaint(folder)


@pytest.mark.parametrize(
    "error", [pa.ArrowMemoryError("malloc"), pa.ArrowException("Failed to launch worker thread")]
)
def test_too_little_memory_is_not_taken_for_a_damaged_table(
    folder: Path, error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pq, "ParquetFile", Mock(side_effect=error))
    with pytest.raises(type(error)):
        reports.read(folder)


def test_a_manifest_cannot_reach_outside_its_folder(folder: Path) -> None:
    manifest = json.loads((folder / MANIFEST).read_text())
    manifest["tables"]["../secret"] = {"sha256": ""}
    (folder / MANIFEST).write_text(json.dumps(manifest))
    assert "../secret" in _complaint(folder)


def test_a_table_outside_the_folder_and_an_unwritable_folder_are_refused(tmp_path: Path) -> None:
    results = replace(made.one_pair(), tables={"../frames": pd.DataFrame()})
    with pytest.raises(reports.ReportError, match="no name for a table"):
        reports.write(results, tmp_path / "results")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").write_text("")
    with pytest.raises(reports.ReportError, match="cannot be written"):
        reports.write(made.one_pair(), tmp_path / "file" / "results")


@pytest.mark.parametrize(
    ("summary", "command"),
    [
        ({}, "verify run"),
        ({"kind": "calibration"}, "verify calibrate boards"),
        ({"kind": "calibration", "method": "check"}, "verify calibrate check"),
        ({"kind": "registration", "method": "fixture"}, "verify calibrate register"),
        ({"kind": "registration"}, "command again that wrote it"),
    ],
)
def test_a_damaged_folder_names_the_command_that_makes_it_anew(
    summary: dict[str, str], command: str, tmp_path: Path
) -> None:
    folder = tmp_path / "results"
    table = pd.DataFrame({"frame": [1, 2]})
    reports.write(reports.Results(summary, {}, {"pairs": table}), folder)
    (folder / "pairs.parquet").write_bytes(b"PAR1")
    assert command in _complaint(folder)
    (tmp_path / "summary.json").write_text(json.dumps(summary))  # named by it where all is lost
    (folder / MANIFEST).write_text("{")
    assert command in _complaint(folder)
    (folder / MANIFEST).unlink()
    (folder / MANIFEST).symlink_to("/dev/zero")  # endless
    assert command in _complaint(folder)
