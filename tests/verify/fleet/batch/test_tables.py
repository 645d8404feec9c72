"""The tables: typed, the same bytes for the same sessions, and what was kept is trusted or not."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pyarrow.parquet as pq
import pytest

from reports.results import Results
from tests.support.command import ROOT
from tests.support.reports import session as made
from verify.cli.options import ToleranceOptions
from verify.errors import InputError
from verify.fleet.batch import tables
from verify.fleet.batch.records import BatchOptions, SessionFailure
from verify.fleet.batch.store import ENTRY_FILE, ResultStore, require_writable
from verify.fleet.batch.tables import calibration_digest
from verify.fleet.batch.tasks import pack_results, rename_session

OPTIONS = BatchOptions(ToleranceOptions(None, None, None), "1.0")
SESSIONS = ("lab/a", 'lab/b,"c"\n<b>d</b>')


def keep(folder: Path, results: dict[str, Results]) -> ResultStore:
    require_writable(folder)
    store = ResultStore(folder)
    for name, one in results.items():
        store.keep(pack_results(name, rename_session(one, "nowhere", name), None), OPTIONS)
    return store


@pytest.fixture
def store(tmp_path: Path) -> ResultStore:
    results = (made.nonconforming(), made.conforming())
    return keep(tmp_path, dict(zip(SESSIONS, results, strict=True)))


def written(store: ResultStore, folder: Path, names: Sequence[str]) -> Path:
    folder.mkdir()
    kept = [(name, store.place(name)) for name in sorted(names)]
    tables.write(folder, kept, [SessionFailure('x,"y"\nz', "refused", "why")])
    return folder


def test_the_tables_have_the_documented_types_and_one_row_a_session(
    store: ResultStore, tmp_path: Path
) -> None:
    out = written(store, tmp_path / "one", SESSIONS)
    sessions, frames = (pq.read_table(out / f"{n}.parquet") for n in ("sessions", "frames"))
    assert sessions.schema == tables.sessions_schema(6)
    assert frames.schema == tables.frames_schema(6)
    assert sessions["session"].to_pylist() == sorted(SESSIONS)
    counts = pd.Series(frames["session"].to_pylist()).value_counts()
    assert counts.to_dict() == dict(
        zip(sessions["session"].to_pylist(), sessions["pairs_recorded"].to_pylist(), strict=True)
    )
    codec = pq.ParquetFile(out / "frames.parquet").metadata.row_group(0).column(0).compression
    assert codec == "ZSTD"


def test_a_shorter_arm_leaves_the_further_columns_empty(tmp_path: Path) -> None:
    results = {"four": made.nonconforming(4, 20), "six": made.nonconforming(6, 20)}
    folder = written(keep(tmp_path, results), tmp_path / "out", ["four", "six"])
    table = pd.read_parquet(folder / "sessions.parquet")
    assert table["joints"].tolist() == [4, 6]
    assert table["q5_mean_error_deg"].isna().tolist() == [True, False]
    frames = pd.read_parquet(folder / "frames.parquet")
    assert frames[frames["session"] == "four"]["q6_error_deg"].isna().all()


def test_waves_that_explain_the_errors_alike_are_all_in_the_table_of_sessions(
    tmp_path: Path,
) -> None:
    waves = made.cause(5, "eccentricity", 0.12, 0.02, "deg")
    waves |= {"per_turn": 39, "per_turn_candidates": [38, 39, 40, 80]}
    one = made.nonconforming()
    results = {"one": replace(one, summary=one.summary | {"diagnosis": [waves]})}
    folder = written(keep(tmp_path, results), tmp_path / "out", ["one"])
    (kept,) = pq.read_table(folder / "sessions.parquet")["diagnosis"].to_pylist()[0]
    assert kept["per_turn_candidates"] == [38, 39, 40, 80]
    explained = (ROOT / "docs" / "batch.md").read_text()
    assert [name for name in kept if f"`{name}`" not in explained] == []


def test_kept_results_are_trusted_only_while_they_are_whole(store: ResultStore) -> None:
    name = SESSIONS[0]
    kept = store.kept(name)
    assert kept.options == OPTIONS.described
    assert store.kept("another") is None
    table = store.place(name) / "results" / "frames.parquet"
    table.write_bytes(table.read_bytes()[:-1])
    assert store.kept(name) is None
    whole = (store.place(SESSIONS[1]) / ENTRY_FILE).read_text()
    for damaged in (
        "",
        "{half",
        "[]",
        "[" * 100_000,
        whole.replace('"files": {', '"files": 3, "x": {'),
    ):
        (store.place(SESSIONS[1]) / ENTRY_FILE).write_text(damaged)
        assert store.kept(SESSIONS[1]) is None


def test_a_sessions_name_cannot_leave_the_store_and_a_file_is_no_store(tmp_path: Path) -> None:
    store = ResultStore(tmp_path)
    for name in ("../../etc", "a/..", "/", "x" * 500, "n\n", "s3://b/ü"):
        assert store.place(name).parent == tmp_path / "sessions"
        assert len(store.place(name).name) < 60
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="is a file"):
        require_writable(tmp_path / "file")


def test_sessions_of_one_rig_and_marker_share_a_calibration() -> None:
    setup = {"rig": {"left": {"fx_px": 1.0, "pan_min_deg": 0.0}, "right": {}}, "marker": {}}
    swept = {"rig": {"left": {"fx_px": 1.0, "pan_min_deg": 9.0}, "right": {}}, "marker": {}}
    other = {"rig": {"left": {"fx_px": 1.1, "pan_min_deg": 0.0}, "right": {}}, "marker": {}}
    assert calibration_digest(setup) == calibration_digest(swept) != calibration_digest(other)


def test_every_column_is_explained() -> None:
    explained = (ROOT / "docs" / "batch.md").read_text()
    grouped = ("rejected_", "position_", "orientation_")
    names = [re.sub(r"^q\d+_", "qN_", field.name) for field in tables.sessions_schema(2)]
    names = [re.sub(r"_deg$", "_mm", n.removeprefix("orientation_")) if n.startswith(grouped)
             else n for n in names]  # fmt: skip
    names = [n.removeprefix("position_") for n in names if not n.startswith("rejected_")]
    assert [n for n in names if f"`{n}`" not in explained] == []
    results = (ROOT / "docs" / "results.md").read_text()
    columns = [re.sub(r"^q\d+_", "qN_", field.name) for field in tables.frames_schema(2)][1:]
    assert [n for n in columns if f"`{n}`" not in results] == []
