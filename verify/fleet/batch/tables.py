"""Write sessions.parquet, frames.parquet and failures.csv; the same sessions give the same bytes.

Both tables have as many columns a joint as the fleet's longest arm has joints. Unknown values, and
joints that an arm does not have, are null. docs/batch.md explains the columns.
"""

import hashlib
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

import reports
from reports import Results
from verify.analysis.uncertainty.sources import ALIGNMENT, CLOCK
from verify.fleet.batch.records import SessionFailure
from verify.io.results import RESULTS
from verify.io.session.keys import parse_start
from verify.measurement.systematics import PAN_ANGLE

STATUSES = (
    "too_few_leds", "ambiguous_leds", "no_encoder", "unreachable", "outlier", "unaligned",
)  # fmt: skip
FLANGE_UNITS = (("position", "mm"), ("orientation", "deg"))
NUMBER, TEXT, COUNT = pa.float64(), pa.string(), pa.int64()

JOINT_COLUMNS = (
    ("mean_error_deg", NUMBER), ("plain_mean_error_deg", NUMBER), ("rms_error_deg", NUMBER),
    ("max_abs_error_deg", NUMBER), ("standard_uncertainty_deg", NUMBER),
    ("expanded_uncertainty_deg", NUMBER), ("coverage_factor", NUMBER),
    ("session_uncertainty_deg", NUMBER), ("worst_error_deg", NUMBER),
    ("worst_error_standard_uncertainty_deg", NUMBER), ("tolerance_deg", NUMBER),
    ("conformance_probability", NUMBER), ("verdict", TEXT), ("reason", TEXT), ("pairs", COUNT),
    ("visible_fraction", NUMBER), ("visible_fraction_since_registration", NUMBER),
    ("minimum_detectable_error_deg", NUMBER), ("minimum_separable_error_deg", NUMBER),
)  # fmt: skip
CAUSE_TYPE = pa.struct(
    [
        ("joint", COUNT), ("kind", TEXT), ("value", NUMBER), ("unit", TEXT),
        ("standard_uncertainty", NUMBER), ("expanded_uncertainty", NUMBER), ("explains", NUMBER),
        ("candidates", pa.list_(pa.struct([("joint", COUNT), ("kind", TEXT)]))),
        ("parameter", TEXT), ("per_turn", COUNT), ("per_turn_candidates", pa.list_(COUNT)),
        ("t_s", NUMBER), ("phase_deg", NUMBER), ("turn_deg", NUMBER), ("separating_motion", TEXT),
    ]
)  # fmt: skip
FRAME_COLUMNS = (
    ("frame", COUNT), ("t_s", NUMBER), ("status", TEXT), ("leds_seen", COUNT),
    ("known_dof", COUNT), ("reprojection_rms_px", NUMBER),
    *((f"{axis}_mm", NUMBER) for axis in "xyz"),
    *((f"r{axis}_deg", NUMBER) for axis in "xyz"),
    *((f"{axis}_encoder_mm", NUMBER) for axis in "xyz"),
    *((f"r{axis}_encoder_deg", NUMBER) for axis in "xyz"),
)  # fmt: skip
FRAME_JOINT_COLUMNS = ("measured_deg", "encoder_deg", "error_deg", "u_deg", "error_u_deg")


def sessions_schema(joints: int) -> pa.Schema:
    """Give the columns of sessions.parquet for a fleet whose longest arm has so many joints."""
    flange = [
        column
        for name, unit in FLANGE_UNITS
        for column in (
            (f"{name}_rms_error_{unit}", NUMBER), (f"{name}_max_error_{unit}", NUMBER),
            (f"{name}_expanded_uncertainty_{unit}", NUMBER), (f"{name}_worst_error_{unit}", NUMBER),
            (f"{name}_worst_error_standard_uncertainty_{unit}", NUMBER),
            (f"{name}_tolerance_{unit}", NUMBER), (f"{name}_conformance_probability", NUMBER),
            (f"{name}_verdict", TEXT), (f"{name}_reason", TEXT),
        )
    ]  # fmt: skip
    return pa.schema(
        [
            ("session", TEXT), ("robot", TEXT), ("description", TEXT),
            ("started", pa.timestamp("us", tz="UTC")), ("kept_in", TEXT), ("tool_version", TEXT),
            ("calibration", TEXT), ("base_source", TEXT), ("registration", TEXT),
            ("robot_fingerprint", TEXT), ("serial_number", TEXT), ("joints", COUNT),
            ("pairs_recorded", COUNT), ("pairs_measured", COUNT),
            *((f"rejected_{status}", COUNT) for status in STATUSES),
            ("clock_encoder_offset_s", NUMBER), ("clock_standard_uncertainty_s", NUMBER),
            ("clock_source", TEXT), ("clock_observable", pa.bool_()), ("verdict", TEXT),
            ("decision_rule", TEXT),
            *((f"q{j + 1}_{name}", kind) for j in range(joints) for name, kind in JOINT_COLUMNS),
            ("joint_error_correlation", pa.list_(NUMBER)), *flange,
            ("diagnosis", pa.list_(CAUSE_TYPE)), ("uncounted", pa.list_(TEXT)),
            ("inputs", pa.list_(pa.struct([("file", TEXT), ("digest", TEXT)]))),
            ("warnings", pa.list_(TEXT)), ("known_dof", COUNT),
        ]
    )  # fmt: skip


def frames_schema(joints: int) -> pa.Schema:
    """Give the columns of frames.parquet likewise."""
    return pa.schema(
        [
            ("session", TEXT),
            *FRAME_COLUMNS,
            *((f"q{j + 1}_{name}", NUMBER) for name in FRAME_JOINT_COLUMNS for j in range(joints)),
            ("position_error_mm", NUMBER),
            ("orientation_error_deg", NUMBER),
            ("ambiguous_joints", TEXT),
        ]
    )


CLOCK_KEYS = ("encoder_offset_s", "standard_uncertainty_s", "source", "observable")
SUMMARY_KEYS = ("verdict", "decision_rule", "diagnosis", "warnings", "known_dof")
_PAN_RANGE_KEYS = ("pan_min_deg", "pan_max_deg")  # of the session, not of the calibration


def session_row(results: Results, kept_in: str) -> dict[str, Any]:
    """Flatten a session's results, kept in a place below OUT, to what `sessions_schema` names.

    Columns that are missing are null.
    """
    summary, setup = results.summary, results.setup
    session, pairs, clock = summary["session"], summary["pairs"], summary["clock"]
    flat: dict[str, Any] = {
        "session": session["path"],
        "robot": session["robot"],
        "description": session["description"],
        "started": parse_start(session["started"]),
        "kept_in": kept_in,
        "tool_version": summary["tool"]["version"],
        "calibration": calibration_digest(setup),
        "base_source": setup["rig"].get("base_source"),
        "registration": setup["rig"].get("registration"),
        "robot_fingerprint": setup["robot"].get("fingerprint"),
        "serial_number": session.get("certificate", {}).get("serial_number"),
        "joints": len(summary["joints"]),
        "pairs_recorded": pairs["recorded"],
        "pairs_measured": pairs["measured"],
        **{f"rejected_{name}": pairs["rejected"].get(name, 0) for name in STATUSES},
        **{f"clock_{key}": clock[key] for key in CLOCK_KEYS},
        **{key: summary[key] for key in SUMMARY_KEYS},
        "joint_error_correlation": [c for line in summary["joint_error_correlation"] for c in line],
        "uncounted": summary["budget"]["uncounted"],
        "inputs": [{"file": f, "digest": d} for f, d in sorted(summary["inputs"].items())],
    }
    own = _session_uncertainty(results)
    for entry in summary["joints"]:
        name = f"q{entry['joint']}"
        flat |= {f"{name}_{key}": entry.get(key) for key, _ in JOINT_COLUMNS}
        flat[f"{name}_session_uncertainty_deg"] = own.get(entry["joint"])
    for part, _unit in FLANGE_UNITS:
        flat |= {f"{part}_{key}": value for key, value in summary[part].items()}
    return flat


def calibration_digest(setup: dict[str, Any]) -> str:
    """Give sessions measured with the same rig, registration and marker the same short text."""
    rig = dict(setup["rig"])
    for side in ("left", "right"):
        rig[side] = {k: v for k, v in rig.get(side, {}).items() if k not in _PAN_RANGE_KEYS}
    text = json.dumps([rig, setup["marker"]], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def _session_uncertainty(results: Results) -> dict[int, float]:
    """The part of each joint's standard uncertainty that every session draws anew, degrees.

    Pixels, readings, and how the instants were brought together; rig, base and marker are shared
    by all sessions of one calibration.
    """
    budget = results.table("budget")
    if not len(budget):
        return {}
    anew = (budget["kind"] == "random") | budget["source"].isin([ALIGNMENT, CLOCK, PAN_ANGLE])
    chosen = budget[anew]
    square = (chosen["standard_uncertainty_deg"] ** 2).groupby(chosen["joint"]).sum(min_count=1)
    return {int(str(joint)): float(value**0.5) for joint, value in square.items()}


MAX_SESSIONS_PER_GROUP = 512  # rows of sessions.parquet that are in memory at once
MAX_PAIRS_PER_GROUP = 16_384  # likewise of frames.parquet
MAX_TABLES_PER_GROUP = 32  # that wait: of a short session's table most is overhead
FAILURE_COLUMNS = ("session", "kind", "why")


def write(
    folder: Path, kept: Sequence[tuple[str, Path]], failures: Sequence[SessionFailure]
) -> None:
    """Write the three tables into a folder that holds none of them.

    `kept` has each measured session's name and where its results are; both lists are by name.

    Raises:
        ReportError: results that were kept are damaged.
    """
    joints = _write_sessions(folder / "sessions.parquet", kept)
    columns = frames_schema(joints)
    every = (_session_frames(session, place, columns) for session, place in kept)
    _write_groups(folder / "frames.parquet", columns, every, MAX_PAIRS_PER_GROUP)
    write_failures(folder, failures)


def read_flat_columns(path: Path) -> pd.DataFrame:
    """Read sessions.parquet but for lists, `uncounted` apart: a fleet is judged by the rest."""
    with path.open("rb") as file:  # Arrow takes no path that is not UTF-8
        schema = pq.read_schema(file)
    flat = [
        field.name
        for field in schema
        if field.name == "uncounted" or not pa.types.is_nested(field.type)
    ]
    table: pd.DataFrame = _read_table(path, flat).to_pandas(use_threads=False)
    return table


def _read_table(path: Path, columns: list[str] | None = None) -> pa.Table:
    """Read without Arrow's threads: `pq.read_table` waits for ever where one cannot start."""
    with path.open("rb") as file:
        return pq.ParquetFile(file).read(columns, use_threads=False)


def write_failures(folder: Path, failures: Iterable[SessionFailure]) -> None:
    """Write failures.csv alone."""
    table = failure_table(failures).map(_text_cell)
    table.to_csv(folder / "failures.csv", index=False, lineterminator="\n")


def failure_table(failures: Iterable[SessionFailure]) -> pd.DataFrame:
    """One row a failure, its texts as they are."""
    return pd.DataFrame(map(astuple, failures), columns=FAILURE_COLUMNS, dtype=str)


def _text_cell(text: str) -> str:
    """Quote what a spreadsheet would take for a formula: a folder may have any name."""
    return f"'{text}" if text[:1] in tuple("=+-@\t\r") else text


def _write_sessions(path: Path, kept: Sequence[tuple[str, Path]]) -> int:
    """Write sessions.parquet; give the number of joints of the longest arm."""
    places = [place for _, place in kept]
    joints = max(len(reports.read(place / RESULTS, ()).summary["joints"]) for place in places)
    columns = sessions_schema(joints)
    rows = (
        session_row(reports.read(place / RESULTS, ("budget",)), f"{place.parent.name}/{place.name}")
        for place in places
    )
    every = (pa.Table.from_pylist([row], schema=columns) for row in rows)
    _write_groups(path, columns, every, MAX_SESSIONS_PER_GROUP)
    return joints


def _write_groups(path: Path, columns: pa.Schema, tables: Iterator[pa.Table], most: int) -> None:
    """Write tables, short ones put together, so that a reader need not open thousands of groups."""
    waiting: list[pa.Table] = []
    with path.open("wb") as file, pq.ParquetWriter(file, columns, compression="zstd") as writer:
        for table in tables:
            waiting.append(table)
            if len(waiting) >= MAX_TABLES_PER_GROUP:
                waiting = [pa.concat_tables(waiting).combine_chunks()]
            if sum(map(len, waiting)) >= most:
                writer.write_table(pa.concat_tables(waiting), row_group_size=most)
                waiting = []
        if waiting:
            writer.write_table(pa.concat_tables(waiting), row_group_size=most)


def _session_frames(session: str, place: Path, columns: pa.Schema) -> pa.Table:
    """Read a session's pairs; columns that its table lacks are null."""
    own = _read_table(place / RESULTS / "frames.parquet")
    own = own.add_column(0, columns[0], [pa.repeat(session, len(own))])
    whole = pa.concat_tables([columns.empty_table(), own], promote_options="permissive")
    return whole.select(columns.names).cast(columns)
