"""poses.csv: what is read, and one clear line for what cannot be."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.recorded import refusal
from verify.io import poses as io_poses

PLACE = "t_s,x_mm,y_mm,z_mm"
HEADER = f"{PLACE},qw,qx,qy,qz"
ROWS = ["0.0,100.0,-200.0,300.5,1,0,0,0", "0.1,101.0,-201.0,301.5,0.5,0.5,0.5,0.5"]


def write(folder: Path, *rows: str, header: str = HEADER) -> Path:
    path = folder / "poses.csv"
    path.write_text("\n".join([header, *rows, ""]))
    return path


def test_millimetres_and_scalar_first_quaternions_are_read(tmp_path: Path) -> None:
    poses, warnings = io_poses.read(write(tmp_path, *ROWS))
    assert warnings == ()
    assert poses.t.tolist() == [0.0, 0.1]
    np.testing.assert_allclose(poses.position, [[0.1, -0.2, 0.3005], [0.101, -0.201, 0.3015]])
    # 120° about (1, 1, 1): x goes to y, y to z, z to x
    cycle = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    np.testing.assert_allclose(poses.rotation[0], np.eye(3), atol=1e-15)
    np.testing.assert_allclose(poses.rotation[1], cycle, atol=1e-15)
    assert poses.position_uncertainty is None
    assert poses.orientation_uncertainty is None


def test_columns_stand_in_any_order(tmp_path: Path) -> None:
    header = "qx,qy,qz,qw,note,t_s,z_mm,y_mm,x_mm"
    poses, _ = io_poses.read(write(tmp_path, "0.6,0,0,0.8,hello,2.5,3,2,1", header=header))
    np.testing.assert_allclose(poses.position, [[1e-3, 2e-3, 3e-3]])
    turn = Rotation.from_rotvec([2 * np.arcsin(0.6), 0, 0]).as_matrix()
    np.testing.assert_allclose(poses.rotation, [turn], atol=1e-15)


def test_a_quaternion_and_its_negative_are_one_turn(tmp_path: Path) -> None:
    poses, _ = io_poses.read(write(tmp_path, "0,1,2,3,0.8,0.6,0,0", "1,1,2,3,-0.8,-0.6,-0.0,-0.0"))
    np.testing.assert_allclose(poses.rotation[0], poses.rotation[1], atol=1e-15)


def test_positions_alone_are_enough(tmp_path: Path) -> None:
    poses, _ = io_poses.read(write(tmp_path, "0,1,2,3", "1,2,3,4", header=PLACE))
    assert poses.rotation is None
    assert len(poses) == 2


def test_stated_uncertainties_are_read(tmp_path: Path) -> None:
    header = f"{HEADER},x_u_mm,y_u_mm,z_u_mm,rx_u_deg,ry_u_deg,rz_u_deg"
    poses, _ = io_poses.read(write(tmp_path, f"{ROWS[0]},0.01,0.02,0.03,1,2,3", header=header))
    np.testing.assert_allclose(poses.position_uncertainty, [[1e-5, 2e-5, 3e-5]])
    np.testing.assert_allclose(poses.orientation_uncertainty, np.deg2rad([[1.0, 2.0, 3.0]]))


def test_the_last_decimal_sets_the_rounding(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    turns = np.round(np.roll(Rotation.random(50, rng=rng).as_quat(), 1, axis=1), 4)
    rows = [
        f"{i},{x:.2f},{y:.2f},{z:.2f}," + ",".join(f"{v:.4f}" for v in turns[i])
        for i, (x, y, z) in enumerate(rng.uniform(-500, 500, (50, 3)))
    ]
    poses, _ = io_poses.read(write(tmp_path, *rows))
    # a rectangle's standard deviation (GUM 4.3.7); of an angle twice that of a half's sine
    np.testing.assert_allclose(poses.rounding, [1e-5 / 12**0.5, 2e-4 / 12**0.5], rtol=1e-9)


def test_a_torn_last_line_is_left_out_of_an_open_recording(tmp_path: Path) -> None:
    path = write(tmp_path, *ROWS)
    path.write_text(path.read_text() + "0.2,10")
    poses, warnings = io_poses.read(path, torn=True)
    assert len(poses) == 2
    assert "cut off" in warnings[0]


@pytest.mark.parametrize(
    ("rows", "header", "place", "message"),
    [
        (["0,1,2,3"], "t,x,y,z", "line 1", "no column x_mm"),
        (["0,1,2,3"], "t_s,x_mm,y_mm", "line 1", "no column z_mm"),
        (["0,1,2,3,1,0,0"], f"{PLACE},qw,qx,qy", "line 1", "no column qz"),
        ([ROWS[0], "0.1,1,2,nan,1,0,0,0"], HEADER, "line 3", 'z_mm is "nan"'),
        ([ROWS[0], "0.0,1,2,3,1,0,0,0"], HEADER, "line 3", "times rise strictly"),
        (["0,1,2,3,0.9,0,0,0"], HEADER, "line 2", "the quaternion has the length 0.9"),
        ([ROWS[0], "1,1,2,3,0,0,0,0"], HEADER, "line 3", "the quaternion has the length 0;"),
        (["0,1,2,3,0.1"], f"{PLACE},x_u_mm", "line 1", "no column y_u_mm"),
        (["0,1,2,3,1,0,1"], f"{PLACE},x_u_mm,y_u_mm,z_u_mm", "line 2", "y_u_mm is 0; a standard"),
        (["0,1,2,3,1,1,1"], f"{PLACE},rx_u_deg,ry_u_deg,rz_u_deg", "line 1", "and no quaternion"),
    ],
)
def test_unreadable_files_are_refused_in_one_line(
    tmp_path: Path, rows: list[str], header: str, place: str, message: str
) -> None:
    found = str(refusal(io_poses.read, write(tmp_path, *rows, header=header)))
    assert place in found
    assert message in found
