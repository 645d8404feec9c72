"""sessions.parquet, frames.parquet and failures.csv: the same sessions give the same bytes."""

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

import reports
from verify.batch import schema
from verify.batch.records import Failure
from verify.batch.rows import row
from verify.results_folder import RESULTS

SESSIONS_A_GROUP = 256  # rows of sessions.parquet that are in memory at once
PAIRS_A_GROUP = 65_536  # likewise of frames.parquet
FAILURE_COLUMNS = ("session", "kind", "why")


def write(folder: Path, kept: Sequence[tuple[str, Path]], failures: Sequence[Failure]) -> None:
    """Write the three tables into a folder.

    Args:
        folder: exists, holds none of them.
        kept: each measured session's name and where its results are kept, by name.
        failures: by name.

    Raises:
        ReportError: results that were kept are damaged.
    """
    joints = _rows(folder / "sessions.parquet", kept)
    _frames(folder / "frames.parquet", kept, joints)
    write_failures(folder, failures)


def write_failures(folder: Path, failures: Iterable[Failure]) -> None:
    """Write failures.csv alone."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(FAILURE_COLUMNS)
    writer.writerows((one.session, one.kind, one.why) for one in failures)
    (folder / "failures.csv").write_text(text.getvalue(), encoding="utf-8", newline="")


def _rows(path: Path, kept: Sequence[tuple[str, Path]]) -> int:
    """Write sessions.parquet; give the number of joints of the longest arm."""
    joints = max(len(_read(place).summary["joints"]) for _, place in kept)
    columns = schema.sessions(joints)
    with pq.ParquetWriter(path, columns, compression="zstd") as writer:
        for start in range(0, len(kept), SESSIONS_A_GROUP):
            some = kept[start : start + SESSIONS_A_GROUP]
            flat = [row(_read(place), f"{place.parent.name}/{place.name}") for _, place in some]
            writer.write_table(pa.Table.from_pylist(flat, schema=columns))
    return joints


def _frames(path: Path, kept: Sequence[tuple[str, Path]], joints: int) -> None:
    columns = schema.frames(joints)
    with pq.ParquetWriter(path, columns, compression="zstd") as writer:
        for group in _groups(_frames_of(session, place, columns) for session, place in kept):
            writer.write_table(group, row_group_size=PAIRS_A_GROUP)


def _groups(tables: Iterator[pa.Table]) -> Iterator[pa.Table]:
    """Put short tables together, so that a reader need not open thousands of groups."""
    waiting: list[pa.Table] = []
    count = 0
    for table in tables:
        waiting.append(table)
        count += len(table)
        if count >= PAIRS_A_GROUP:
            yield pa.concat_tables(waiting)
            waiting, count = [], 0
    if waiting:
        yield pa.concat_tables(waiting)


def _frames_of(session: str, place: Path, columns: pa.Schema) -> pa.Table:
    own = pq.read_table(place / RESULTS / "frames.parquet")
    count = len(own)
    arrays: list[Any] = [pa.repeat(pa.scalar(session, pa.string()), count)]
    for field in list(columns)[1:]:
        there = field.name in own.column_names
        arrays.append(
            own[field.name].combine_chunks().cast(field.type)
            if there
            else pa.nulls(count, field.type)
        )
    return pa.table(arrays, schema=columns)


def _read(place: Path) -> reports.Results:
    return reports.read(place / RESULTS)
