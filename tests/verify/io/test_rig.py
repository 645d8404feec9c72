import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from tests.support.recorded import RIG, refusal, replace
from tests.support.strategies import assert_same, every_disk, finite, positive, texts
from verify.core.records import Array
from verify.core.rig import Camera, Covariance, Rig
from verify.io import rig as io_rig

triples = st.tuples(finite, finite, finite).map(np.array)
directions = triples.filter(lambda v: np.linalg.norm(v) > 1e-3).map(lambda v: v / np.linalg.norm(v))


@st.composite
def motions(draw: st.DrawFn) -> Array:
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(draw(directions) * draw(st.floats(0, np.pi))).as_matrix()
    motion[:3, 3] = draw(triples)
    return motion


@st.composite
def cameras(draw: st.DrawFn) -> Camera:
    fx, fy, skew = draw(st.floats(64, 1e4)), draw(st.floats(64, 1e4)), draw(finite)
    cx, cy = draw(st.floats(0, 1279)), draw(st.floats(0, 719))
    return Camera(
        matrix=np.array([[fx, skew, cx], [0, fy, cy], [0, 0, 1]]),
        distortion=np.array(draw(st.tuples(*[finite] * 5))),
        pan_center=draw(triples),
        pan_axis=draw(directions),
        pan_zero=draw(finite),
        mount=draw(motions()),
        pan=draw(finite),
        pan_standard_uncertainty=draw(st.none() | positive),
        line_time=draw(st.floats(0, 1e-3)),
        exposure=draw(st.none() | positive),
    )


@st.composite
def covariances(draw: st.DrawFn) -> Covariance:
    parameters = (
        "left.fx_px",
        "right.mount_ry_deg",
        "robot_base.rz_deg",
        "led.A.1.x_mm",
        "left.k1",
    )
    factors = np.array(draw(st.lists(triples, min_size=5, max_size=5))) + np.eye(5, 3)
    covariance = factors @ factors.T + np.eye(5)
    scale = np.sqrt(np.diag(covariance))
    return Covariance(
        parameters=parameters,
        standard_uncertainty=np.array(draw(st.tuples(*[positive] * 5))),
        correlation=covariance / np.outer(scale, scale),
        degrees_of_freedom=draw(st.none() | positive),
        temperature_c=draw(st.none() | finite),
    )


@st.composite
def rigs(draw: st.DrawFn) -> Rig:
    columns = draw(st.integers(1, 7))
    cell = st.floats(-10, 10, allow_subnormal=False)
    return Rig(
        image_size=(1280, 720),
        left=draw(cameras()),
        right=draw(cameras()),
        rig_T_base=draw(motions()),
        base_source=draw(st.sampled_from(["fixture", "motion"])),
        registration=draw(st.none() | texts),
        absorption=draw(st.none() | arrays(float, (12, columns), elements=cell)),
        covariance=draw(st.none() | covariances()),
    )


@every_disk
@given(rig=rigs())
def test_a_rig_written_and_read_is_the_same_rig(
    rig: Rig, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "rig.toml"
    io_rig.write(path, rig)
    again, _ = io_rig.read(path)
    assert_same(rig, again)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "rig.toml").write_text(RIG)
    return tmp_path / "rig.toml"


def test_millimetres_and_degrees_become_metres_and_radians(path: Path) -> None:
    rig, warnings = io_rig.read(path)
    assert warnings == ()
    assert rig.image_size == (64, 48)
    assert_allclose(rig.left.pan_center, [-0.06, 0, 0])
    assert_allclose(rig.left.mount[:3, 3], [0, 0.001, 0.002])
    assert rig.left.pan == pytest.approx(np.pi / 24)
    assert_array_equal(rig.left.pan_axis, [0, 1, 0])
    assert_allclose(rig.rig_T_base[:3, 3], [0.01, 0.02, 0.65])
    turned, _ = cv2.Rodrigues(np.array([0, 0, np.pi / 2]))  # the rotation in the file, by OpenCV
    assert_allclose(rig.rig_T_base[:3, :3], turned, atol=1e-15)
    assert (rig.left.pan_zero, rig.left.line_time, rig.left.exposure) == (0.0, 0.0, None)
    assert rig.left.pan_standard_uncertainty is None


def test_a_mm_a_degree_of_absorption_is_57_mm_a_radian(path: Path) -> None:
    rows = "[" + ",".join(["[1.0, 2.0]"] * 12) + "]"
    replace(path, 'source = "fixture"', f'source = "motion"\nabsorption = {rows}')
    absorption = io_rig.read(path)[0].absorption
    metres = [0.05729577951308232, 0.11459155902616464]  # 1 rad = 57.29577951308232 deg
    for row in (0, 1, 2, 6, 7, 8):
        assert_allclose(absorption[row], metres)
    for row in (3, 4, 5, 9, 10, 11):
        assert_allclose(absorption[row], [1, 2])  # degrees a degree


def test_a_pan_axis_gets_unit_length(path: Path) -> None:
    replace(
        path,
        "pan_center_mm = [-60.0, 0.0, 0.0]",
        "pan_center_mm = [-60, 0, 0]\npan_axis = [0, 3, 4]",
    )
    assert_allclose(io_rig.read(path)[0].left.pan_axis, [0, 0.6, 0.8])


def test_a_rotation_rounded_to_seven_decimals_is_made_orthonormal(path: Path) -> None:
    exact = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
    replace(
        path, "[[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]", str(exact.round(7).tolist())
    )
    R = io_rig.read(path)[0].rig_T_base[:3, :3]
    assert_allclose(R.T @ R, np.eye(3), atol=1e-15)
    assert_allclose(R, exact, atol=1e-7)


def test_a_principal_point_far_off_the_centre_is_warned_of(path: Path) -> None:
    text = path.read_text()
    path.write_text(text.replace("31.5]", "47.5]", 1))  # 25 % of 64
    warnings = io_rig.read(path)[1]
    assert len(warnings) == 1
    assert "left.camera_matrix: cx = 47.5 px" in warnings[0]
    path.write_text(text.replace("31.5]", "41.5]", 1))  # 16 %
    assert io_rig.read(path)[1] == ()


COVARIANCE = """
[covariance]
parameters = ["left.fx_px", "robot_base.rz_deg"]
standard_uncertainty = [0.3, 0.01]
correlation = [[1.0, 0.5], [0.5, 1.0]]
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[64, 48]", "[64, 0]", ["image_size: is 64 x 0"]),
        ("[64, 48]", "[30, 48]", ["left.camera_matrix: has cx = 31.5 px, outside"]),
        (
            "-60.0, 0.0, 0.0]",
            "-60.0, 0.0, 0.0]\npan_axis = [0, 0, 0]",
            ["left.pan_axis: has no length"],
        ),
        ("[[0.0, -1.0, 0.0]", "[[0.0, -1.001, 0.0]", ["robot_base.rotation: is not a rotation"]),
        ("[[0.0, -1.0, 0.0]", "[[0.0, 1.0, 0.0]", ["robot_base.rotation: is a reflection"]),
        ('"fixture"', '"jig"', ['robot_base.source: is "jig"', '"fixture" or "motion"']),
        (
            '"fixture"',
            '"fixture"\nabsorption = [[0.0]]',
            ["robot_base.absorption: has 1 rows", "12"],
        ),
        ("[[50.0, 0.0, 31.5]", "[[-50.0, 0.0, 31.5]", ["left.", "has fx = -50.0 px"]),
        (  # millimetres
            "[[50.0, 0.0, 31.5]",
            "[[0.8, 0.0, 31.5]",
            ["left.camera_matrix: has fx = 0.8 px", "in pixels is 3 px or more"],
        ),
        ("[0.0, 50.0, 23.5]", "[1.0, 50.0, 23.5]", ["left.", "is not a camera matrix"]),
        ("[[1.0, 0.0, 0.0]", "[[1.1, 0.0, 0.0]", ["left.mount_rotation: is not a rotation"]),
    ],
)
def test_a_wrong_rig_is_refused_by_its_key(
    path: Path, old: str, new: str, message: list[str]
) -> None:
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    found = str(refusal(io_rig.read, path))
    for words in message:
        assert words in found
    assert found.startswith(str(path))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("left.fx_px", "left", 'parameters[0]: is "left"'),
        ("left.fx_px", "led.A", 'parameters[0]: is "led.A"'),
        ("left.fx_px", "robot_base.rw_deg", "parameters[0]"),
        ("left.fx_px", "robot_base.rz_deg", "parameters[1]: repeats"),
        ("[0.3, 0.01]", "[0.3]", "standard_uncertainty: has 1 numbers; there are 2"),
        ("[0.3, 0.01]", "[0.3, -0.01]", "standard_uncertainty[1]: is -0.01"),
        ("[[1.0, 0.5], [0.5, 1.0]]", "[[1.0, 0.5]]", "correlation: has another size"),
        ("[[1.0, 0.5], [0.5, 1.0]]", "[[1.0, 0.5], [0.4, 1.0]]", "symmetric"),
        ("[[1.0, 0.5], [0.5, 1.0]]", "[[1.0, 0.5], [0.5, 0.9]]", "diagonal"),
        ("[[1.0, 0.5], [0.5, 1.0]]", "[[1.0, 1.1], [1.1, 1.0]]", "eigenvalue -0.1"),
        ("0.01]\n", "0.01]\ndegrees_of_freedom = 0\n", "degrees_of_freedom: is 0"),
    ],
)
def test_a_wrong_covariance_is_refused(path: Path, old: str, new: str, message: str) -> None:
    path.write_text(RIG + COVARIANCE)
    assert io_rig.read(path)[0].covariance is not None
    replace(path, old, new)
    found = str(refusal(io_rig.read, path))
    assert "covariance" in found
    assert message in found


def test_what_is_written_reads_like_what_a_person_would_write(path: Path) -> None:
    text = io_rig.encode(io_rig.read(path)[0]).decode()
    assert "pan_deg = 7.5\n" in text
    assert "camera_matrix = [[50.0, 0.0, 31.5], [0.0, 50.0, 23.5], [0.0, 0.0, 1.0]]\n" in text
    written, original = tomllib.loads(text), tomllib.loads(RIG)
    for table in ("left", "right", "robot_base"):
        assert (
            written[table] == written[table] | original[table]
        )  # nothing changed, some made plain
