"""A real UR10 before a laser tracker: poses of Landgraf and others (2021), read as published."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from tests.support.beside import shared
from tests.support.posed import encoders_csv, poses_csv
from verify.calibration.kinematics.poses import IdentificationPoses, build_poses

SERIES = {
    "A": "Series_A/measurements_grid.csv",
    "B": "Series_B/measurements_joint_configurations.csv",
}
JOINTS = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"]


def series(name: str, every: int = 1) -> IdentificationPoses:
    """Readings and tracker poses of a series; skips without the data.

    The tracker's own scatter (0.01 mm, 0.003°) is far below what an arm's model leaves, so no
    covariance is stated.
    """
    return _read(shared("data", "robot_ur10_lasertracker") / SERIES[name], every)


def concatenate(recordings: list[IdentificationPoses]) -> IdentificationPoses:
    """Recordings of one arm, base and target anew in each, as one set of rows."""
    each = np.repeat(np.arange(len(recordings)), [len(one) for one in recordings])
    values = {
        f.name: np.concatenate(parts) if isinstance(parts[0], np.ndarray) else parts[0]
        for f in fields(IdentificationPoses)
        if (parts := [getattr(one, f.name) for one in recordings])
    }
    own = {"base": each, "tool": each, "recording": each, "block": np.arange(len(each))}
    return IdentificationPoses(**{**values, **own})


def _read(path: Path, every: int) -> IdentificationPoses:
    table = pd.read_csv(path, sep=";", decimal=",").iloc[::every]
    q = table[[f"{joint}_joint" for joint in JOINTS]].to_numpy(dtype=float)
    turns = table[[f"measurement_r{axis}" for axis in "xyz"]].to_numpy(dtype=float)
    target = np.tile(np.eye(4), (len(q), 1, 1))
    target[:, :3, :3] = Rotation.from_euler("XYZ", turns, degrees=True).as_matrix()
    target[:, :3, 3] = table[[f"measurement_{axis}" for axis in "xyz"]].to_numpy() * 1e-3
    return build_poses(q, target)


def write_session(
    folder: Path,
    rows: IdentificationPoses,
    *,
    positions_alone: bool = False,
    period: float = 0.1,
    robot: str = "ur10",
) -> Path:
    """Write rows as a session of poses, one each `period`, s; base and target not stated."""
    folder.mkdir()
    t = period * rows.block
    more = {"target": rows.tool + 1.0} if rows.tool.any() else None
    poses = poses_csv(t, rows.world_T_target, positions_alone=positions_alone, more=more)
    (folder / "poses.csv").write_text(poses)
    first = rows.tool == 0
    (folder / "encoders.csv").write_text(encoders_csv(t[first], rows.q[first]))
    (folder / "session.toml").write_text(
        f'format = 1\nrobot = "{robot}"\nencoders = "encoders.csv"\n'
        "[clock]\nencoder_offset_s = 0.0\n"
        '[poses]\nfile = "poses.csv"\ninstrument = "a laser tracker"\nframe = "robot_base"\n'
    )
    return folder
