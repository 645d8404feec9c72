"""Write trajectories as TUM files, and tables as CSV, Parquet or a MATLAB file.

| format | writes |
|---|---|
| tum | a folder with measured.tum, encoders.tum |
| csv, parquet | a folder with a file a table; csv also summary.json |
| mat | a file with a struct a table, poses, joints and the summary |

TUM: a line a pose, `t x y z qx qy qz qw`, seconds and metres. `evo_ape tum encoders.tum
measured.tum` compares them.

Source: TUM RGB-D benchmark, file formats; MathWorks, MAT-File Format (written by scipy.io).
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import scipy.io

from verify.io.export.content import ExportContent, summary_text


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
