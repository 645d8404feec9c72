"""What a session or a results folder holds that other programs can show: poses, joints, tables.

Trajectories are written as TUM files, and tables as CSV, Parquet or a MATLAB file.

| format | writes |
|---|---|
| tum | a folder with measured.tum, encoders.tum |
| csv, parquet | a folder with a file a table; csv also summary.json |
| mat | a file with a struct a table, poses, joints and the summary |

TUM: a line a pose, `t x y z qx qy qz qw`, seconds and metres. `evo_ape tum encoders.tum
measured.tum` compares them.

Source: TUM RGB-D benchmark, file formats; MathWorks, MAT-File Format (written by scipy.io).
"""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import scipy.io
from scipy.spatial.transform import Rotation

import robots
from verify.core.records import POSE_NAMES, Array
from verify.errors import InputError
from verify.io.results import RESULTS, read_results
from verify.io.session.folder import SESSION_FILE
from verify.io.session.keys import parse_start
from verify.io.session.session import Session, open_session

UNDATED = datetime(1970, 1, 1, tzinfo=UTC)  # of a session that does not say when it was recorded
MEASURED, ENCODERS = "measured", "encoders"


@dataclass(frozen=True, slots=True)
class PoseSeries:
    """A flange or another body at some instants, in the robot's base or an instrument's frame."""

    t: Array  # (n,), s from the session's start
    position: Array  # (n, 3), m
    quaternion: Array  # (n, 4), scalar last


@dataclass(frozen=True, slots=True)
class AngleSeries:
    """Joint angles at some instants."""

    t: Array  # (n,), s from the session's start
    q: Array  # (n, joints), rad


@dataclass(frozen=True, slots=True)
class ExportContent:
    """What is to be written for another program."""

    name: str
    started: datetime
    joint_names: tuple[str, ...]
    poses: Mapping[str, PoseSeries]  # by what gave them: measured, encoders
    joints: Mapping[str, AngleSeries]
    tables: Mapping[str, pd.DataFrame]
    summary: Mapping[str, Any] = field(default_factory=dict)  # of results
    session: Session | None = None  # whose pictures and rig can be written
    notes: tuple[str, ...] = ()


def is_exportable(path: Path) -> bool:
    """Whether a folder holds a session or results."""
    return (path / SESSION_FILE).is_file() or (path / RESULTS).is_dir()


def read_content(folder: Path) -> ExportContent:
    """Read a results folder, or else a session.

    Raises:
        InputError: the folder is damaged, or neither.
    """
    if (folder / RESULTS).is_dir():
        return _of_results(folder)
    return _of_session(folder)


def _of_results(folder: Path) -> ExportContent:
    results = read_results(folder)
    frames, poses, joints = results.table("frames"), {}, {}
    names: tuple[str, ...] = ()
    if "x_encoder_mm" in frames and frames["t_s"].notna().all():
        encoder = tuple(name.replace("_", "_encoder_") for name in POSE_NAMES)
        for kind, columns in ((MEASURED, POSE_NAMES), (ENCODERS, encoder)):
            t, values = _known_rows(frames, columns)
            turns = Rotation.from_rotvec(np.deg2rad(values[:, 3:]))
            poses[kind] = PoseSeries(t, values[:, :3] * 1e-3, turns.as_quat())
        count = sum(bool(re.fullmatch(r"q\d+_encoder_deg", str(name))) for name in frames)
        names = tuple(f"q{j}" for j in range(1, count + 1))
        for kind, word in ((MEASURED, "measured"), (ENCODERS, "encoder")):
            t, degrees = _known_rows(frames, tuple(f"{name}_{word}_deg" for name in names))
            joints[kind] = AngleSeries(t, np.deg2rad(degrees))
    started = (results.summary.get("session") or {}).get("started")
    return ExportContent(
        name=folder.resolve().name,
        started=parse_start(started) or UNDATED,
        joint_names=names,
        poses=poses,
        joints=joints,
        tables=results.tables,
        summary=results.summary,
    )


def _known_rows(frames: pd.DataFrame, columns: tuple[str, ...]) -> tuple[Array, Array]:
    """Times (n,), s, and values (n, columns) of the rows in which none is missing."""
    values = np.stack([frames[name].to_numpy(float) for name in columns], axis=1)
    known = np.isfinite(values).all(axis=1)
    return frames["t_s"].to_numpy(float)[known], values[known]


def _of_session(folder: Path) -> ExportContent:
    session = open_session(folder)
    arm, encoders = session.arm, session.encoders
    offset = session.clock.encoder_offset if session.clock is not None else 0.0
    t = encoders.t + offset
    poses = {ENCODERS: _series(t, robots.forward(arm, encoders.q))}
    names = tuple(f"q{j}" for j in range(1, arm.dof + 1))
    angles = {f"{n}_deg": v for n, v in zip(names, np.rad2deg(encoders.q).T, strict=True)}
    tables = {"encoders": pd.DataFrame({"t_s": encoders.t, **angles})}
    if session.instrument is None:
        frames = session.frames
        times = {"t_left_s": frames.t_left, "t_right_s": frames.t_right}
        pans = {"pan_left_deg": frames.pan_left, "pan_right_deg": frames.pan_right}
        pans = {name: np.rad2deg(values) for name, values in pans.items()}
        tables["frames"] = pd.DataFrame({"frame": np.arange(len(frames)), **times, **pans})
    else:
        measured = session.instrument.poses
        if not session.instrument.positions_alone and measured.target is None:
            poses[MEASURED] = _series(measured.t, measured.transforms)
        place = dict(zip(("x_mm", "y_mm", "z_mm"), measured.position.T * 1e3, strict=True))
        tables["poses"] = pd.DataFrame({"t_s": measured.t, **place})
    notes = []
    if session.clock is None:
        notes.append(
            "session.toml states no [clock]: readings keep the controller's time, which may be "
            "off the cameras'. The results of `verify run` have both on one clock."
        )
    return ExportContent(
        name=session.name,
        started=parse_start(session.started) or UNDATED,
        joint_names=arm.joint_names if isinstance(arm, robots.UrdfArm) else names,
        poses=poses,
        joints={ENCODERS: AngleSeries(t, encoders.q)},
        tables=tables,
        session=session if session.instrument is None else None,
        notes=tuple(notes),
    )


def _series(t: Array, transforms: Array) -> PoseSeries:
    turns = Rotation.from_matrix(transforms[:, :3, :3])
    return PoseSeries(t, transforms[:, :3, 3], turns.as_quat())


def require_poses(content: ExportContent, source: Path) -> None:
    """Refuse, by an InputError, what holds no poses with a time."""
    if not any(len(series.t) for series in content.poses.values()):
        expected = "poses with times are expected, of a session or of `verify run`"
        raise InputError(source, "holds no poses", expected, "Choose --to csv for its tables.")


def summary_text(content: ExportContent) -> str:
    """summary.json as one text; empty where there are no results."""
    if not content.summary:
        return ""
    return json.dumps(content.summary, ensure_ascii=False, default=str)


def write_tum(content: ExportContent, folder: Path) -> None:
    """Write NAME.tum for each series of poses."""
    for name, series in content.poses.items():
        rows = np.column_stack([series.t, series.position, series.quaternion])
        np.savetxt(folder / f"{name}.tum", rows, ["%.9f"] + ["%.12f"] * 7)


def write_csv(content: ExportContent, folder: Path) -> None:
    """Write NAME.csv for each table, numbers to their last digit."""
    for name, table in content.tables.items():
        table.to_csv(folder / f"{name}.csv", index=False, lineterminator="\n")
    if text := summary_text(content):
        (folder / "summary.json").write_text(f"{text}\n", encoding="utf-8")


def write_parquet(content: ExportContent, folder: Path) -> None:
    """Write NAME.parquet for each table."""
    for name, table in content.tables.items():
        (folder / f"{name}.parquet").write_bytes(table.to_parquet(index=False))


def write_mat(content: ExportContent, path: Path) -> None:
    """Write a struct a table, poses and joints as matrices, and the summary as JSON."""
    variables: dict[str, Any] = {
        name: {column: _column(table[column]) for column in table.columns}
        for name, table in content.tables.items()
        if len(table)
    }
    for name, series in content.poses.items():
        variables[f"pose_{name}"] = {
            "t_s": series.t[:, None],
            "position_m": series.position,
            "quaternion_xyzw": series.quaternion,
        }
    for name, angles in content.joints.items():
        variables[f"joints_{name}"] = {"t_s": angles.t[:, None], "q_rad": angles.q}
    if text := summary_text(content):
        variables["summary_json"] = text
    scipy.io.savemat(  # to the very name: no ".mat" behind it
        str(path), variables, appendmat=False, do_compression=True, long_field_names=True
    )


def _column(values: "pd.Series[Any]") -> Any:
    """A column as MATLAB has it, (n, 1): numbers with NaN for what is missing, or a cell array."""
    if pd.api.types.is_numeric_dtype(values):
        return values.to_numpy(dtype=float, na_value=np.nan)[:, None]
    return np.array([str(value) for value in values], dtype=object)[:, None]


FOLDERS: dict[str, Callable[[ExportContent, Path], None]] = {
    "tum": write_tum,
    "csv": write_csv,
    "parquet": write_parquet,
}
