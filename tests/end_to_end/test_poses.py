"""Sessions of another instrument's poses as users give them to each command."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from tests.support.command import SAMPLES, verify
from tests.support.posed import poses_csv, write_posed

SAMPLE = SAMPLES / "multi_joint_fault_6r"


@pytest.fixture(scope="module")
def posed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample's poses as `verify run` wrote them to frames.csv, as a session of their own."""
    folder = tmp_path_factory.mktemp("posed")
    assert verify("run", SAMPLE, "-o", folder / "through-pictures").status == 1
    frames = pd.read_csv(folder / "through-pictures" / "frames.csv")
    poses = np.tile(np.eye(4), (len(frames), 1, 1))
    poses[:, :3, 3] = frames[["x_mm", "y_mm", "z_mm"]] * 1e-3
    turns = np.deg2rad(frames[["rx_deg", "ry_deg", "rz_deg"]].to_numpy())
    poses[:, :3, :3] = Rotation.from_rotvec(turns).as_matrix()
    return write_posed(
        folder / "another day",
        SAMPLE,
        poses_csv(frames["t_s"].to_numpy(), poses),
        frame="robot_base",
        more="\n[tolerance]\njoints_deg = 0.2\n",
    )


def test_run_and_report_take_poses(posed: Path, tmp_path: Path) -> None:
    done = verify("run", posed, "-o", tmp_path / "out")
    assert done.status == 1
    assert "Joint 2 reads 0.3" in done.out
    assert "Measured by another instrument, not by cameras: a laser tracker" in done.err
    assert verify("report", tmp_path / "out").status == 0
    assert (tmp_path / "out" / "report.pdf").stat().st_size > 10_000


@pytest.mark.slow
def test_batch_takes_poses_beside_pictures(posed: Path, tmp_path: Path) -> None:
    done = verify("batch", posed.parent, SAMPLE, "-o", tmp_path / "fleet", "--workers", "1")
    assert done.status == 1
    sessions = pd.read_parquet(tmp_path / "fleet" / "sessions.parquet")
    assert len(sessions) == 2
    assert set(sessions["verdict"]) == {"nonconform"}


def test_leds_and_cameras_are_not_calibrated_by_poses(posed: Path, tmp_path: Path) -> None:
    written = ("-o", tmp_path / "rig.toml", "--marker", tmp_path / "marker.toml")
    assert "--marker" in verify("calibrate", "register", posed, *written).refusal
    assert "no pictures" in verify("calibrate", "check", posed).refusal
    assert not list(tmp_path.iterdir())
