"""A robot registered by a board on its base: corners by OpenCV; its coverage is test_coverage's."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from reports import render_html
from robots.transforms import invert
from tests.support.boards.fixture import BOARD, pair, placed
from tests.support.drawn_rig import CAMERAS, TURN, random_correlation
from tests.support.scene import make_rig
from verify.calibration.registration.fixture import register_fixture
from verify.calibration.registration.results import fixture_results
from verify.core.records import Array
from verify.core.rig import Covariance, Rig
from verify.errors import InputError
from verify.io import fiducials
from verify.io import rig as io_rig

FIXED = np.diag(np.square([2e-4] * 3 + [np.deg2rad(0.03)] * 3))
RIG = make_rig()
BASE_T_BOARD: Array = invert(RIG.rig_T_base) @ placed()


def doubtful_rig() -> Rig:
    names = (*CAMERAS, *TURN, "left.pan_axis_rx_deg")
    correlation = random_correlation(np.random.default_rng(3), len(names), len(names) + 20)
    sigma = np.array([0.3] * 8 + [0.01] * 3 + [0.02])
    return replace(RIG, covariance=Covariance(names, sigma, correlation))


def test_without_noise_the_base_is_where_it_is() -> None:
    pairs = [pair(RIG, placed(), frame=i, turn=0.05 * i) for i in range(3)]
    found = register_fixture(RIG, pairs, BOARD, BASE_T_BOARD, np.zeros((6, 6)))
    assert_allclose(found.rig.rig_T_base, RIG.rig_T_base, atol=1e-9)
    assert found.residual_rms_px < 1e-6
    assert found.noise == 0.25  # no less is believed
    one_camera = replace(pairs[0], left=None)
    found = register_fixture(RIG, [one_camera], BOARD, BASE_T_BOARD, np.zeros((6, 6)))
    assert_allclose(found.rig.rig_T_base, RIG.rig_T_base, atol=1e-7)


@pytest.mark.slow
def test_repeats_do_not_average_the_fixture_out() -> None:
    pairs = [pair(RIG, placed(), np.random.default_rng(i), frame=i) for i in range(12)]
    one, many = (
        register_fixture(RIG, some, BOARD, BASE_T_BOARD, np.zeros((6, 6)))
        for some in (pairs[:1], pairs)
    )
    assert np.trace(many.base_covariance) < np.trace(one.base_covariance) / 8
    many = register_fixture(RIG, pairs, BOARD, BASE_T_BOARD, FIXED)
    assert np.sqrt(many.base_covariance[0, 0]) > 0.99 * np.sqrt(FIXED[0, 0])


def test_a_pair_in_which_the_board_had_moved_is_named_and_left_out() -> None:
    rng = np.random.default_rng(2)
    pairs = [pair(RIG, placed(), rng, frame=i) for i in range(6)]
    pairs[4] = pair(RIG, placed(x=-0.0895), rng, frame=4)
    found = register_fixture(RIG, pairs, BOARD, BASE_T_BOARD, FIXED)
    assert found.frames.tolist() == [0, 1, 2, 3, 5]
    assert any("pair 4 puts the board 0.4" in w for w in found.warnings)
    results = fixture_results(found)  # in the file's units
    base, table = results.summary["base"], results.tables["pairs"]
    u = np.sqrt(np.diag(found.base_covariance))
    assert_allclose(base["standard_uncertainty_mm"], 1e3 * u[:3])
    assert_allclose(base["standard_uncertainty_deg"], np.rad2deg(u[3:]))
    assert_allclose(table[["x_mm", "y_mm", "z_mm"]], 1e3 * found.pair_difference[:, :3])
    assert_allclose(table["rz_deg"], np.rad2deg(found.pair_difference[:, 5]))
    assert "It hides nothing." in render_html(results)


def test_what_pan_readings_are_off_by_leaves_no_corner_out() -> None:
    u, rng = np.deg2rad(0.02), np.random.default_rng(4)
    sides = (replace(c, pan_standard_uncertainty=u) for c in (RIG.left, RIG.right))
    rig = Rig(RIG.image_size, *sides, RIG.rig_T_base, "")
    errors = [(u, -u), (-1.5 * u, u), (0.5 * u, 2 * u)]
    pairs = [
        pair(rig, placed(), rng, frame=i, turn=0.05 * (i + 1), error=error)
        for i, error in enumerate(errors)
    ]
    decisions = register_fixture(rig, pairs, BOARD, BASE_T_BOARD, FIXED).decisions
    assert f"rests on {2 * len(errors) * len(BOARD)} corners" in decisions[0]
    assert not any("left out" in text for text in decisions)
    right = pairs[1].right
    assert right is not None
    centre = right.centre.copy()
    centre[17] += [0.0, 0.6]
    pairs[1] = replace(pairs[1], right=replace(right, centre=centre))
    decisions = register_fixture(rig, pairs, BOARD, BASE_T_BOARD, FIXED).decisions
    assert "Left out are corners that the others contradict: 1." in decisions


def test_pairs_of_which_none_is_known_to_be_right_are_refused() -> None:
    rng = np.random.default_rng(2)
    pairs = [pair(RIG, placed(), rng), pair(RIG, placed(), rng, frame=1, error=(0.002, 0.0))]
    with pytest.raises(InputError, match=r"pair [01] puts the board"):
        register_fixture(RIG, pairs, BOARD, BASE_T_BOARD, FIXED)


def test_a_rig_that_cannot_have_taken_the_pictures_is_no_scatter_of_corners() -> None:
    """A pan reading 1° off bends the pattern by pixels; one 0.2° off still moves the base."""
    rng = np.random.default_rng(2)
    gross = pair(RIG, placed(), rng, error=(np.radians(1.0), 0.0))
    with pytest.raises(InputError, match=r"its corners are \d\.\d px"):
        register_fixture(RIG, [gross], BOARD, BASE_T_BOARD, FIXED)
    little = pair(RIG, placed(), rng, error=(np.radians(0.2), 0.0))
    found = register_fixture(RIG, [little], BOARD, BASE_T_BOARD, FIXED)
    assert any("times as far from where the board's pose puts them" in w for w in found.warnings)
    sound = register_fixture(RIG, [pair(RIG, placed(), rng)], BOARD, BASE_T_BOARD, FIXED)
    assert not any("times as far" in w for w in sound.warnings)


def test_copies_of_a_pair_count_once() -> None:
    one = pair(RIG, placed(), np.random.default_rng(1))
    pairs = [replace(one, frame=i) for i in range(6)]
    found, single = (register_fixture(RIG, p, BOARD, BASE_T_BOARD, FIXED) for p in (pairs, [one]))
    assert_allclose(found.base_covariance, single.base_covariance)
    assert any("the same pictures" in w for w in found.warnings)


def test_no_view_of_the_board_is_refused() -> None:
    blind = replace(pair(RIG, placed()), left=None, right=None)
    with pytest.raises(InputError, match="is in no picture"):
        register_fixture(RIG, [blind], BOARD, np.eye(4), FIXED)


def test_the_rig_that_is_found_survives_its_file(tmp_path: Path) -> None:
    rig = replace(doubtful_rig(), base_source="motion", absorption=np.ones((12, 6)))
    seen = [pair(rig, placed(), np.random.default_rng(1))]
    found = register_fixture(rig, seen, BOARD, BASE_T_BOARD, FIXED)
    io_rig.write(tmp_path / "rig.toml", found.rig)
    back, _ = io_rig.read(tmp_path / "rig.toml")
    assert back.base_source == "fixture"
    assert back.absorption is None
    assert back.registration == found.rig.registration
    assert_allclose(back.rig_T_base, found.rig.rig_T_base, atol=1e-9)
    again = register_fixture(back, seen, BOARD, BASE_T_BOARD, FIXED)
    assert again.rig.covariance.parameters == found.rig.covariance.parameters


FIXTURE = """format = 1
position_mm = [120.0, -40.0, 15.0]
rotation_vector_deg = [0.0, 0.0, 90.0]
"""


def test_a_fixture_file_gives_place_and_uncertainty(tmp_path: Path) -> None:
    path = tmp_path / "fixture.toml"
    stated = "position_standard_uncertainty_mm = 0.1\n"
    stated += "rotation_standard_uncertainty_deg = [0.1, 0.2, 0.3]\n"
    path.write_text(FIXTURE + stated)
    fixture, warnings = fiducials.read_fixture(path)
    assert not warnings
    expected = [[0, -1, 0, 0.12], [1, 0, 0, -0.04], [0, 0, 1, 0.015]]
    assert_allclose(fixture.base_T_board[:3], expected, atol=1e-15)
    sigma = [1e-4] * 3 + np.deg2rad([0.1, 0.2, 0.3]).tolist()
    assert_allclose(np.sqrt(np.diag(fixture.covariance)), sigma)
    path.write_text(FIXTURE)
    fixture, warnings = fiducials.read_fixture(path)
    assert not fixture.covariance.any()
    assert "rotation_standard_uncertainty_deg not stated; taken as exact" in warnings[0]
    path.write_text(FIXTURE.replace("[120.0, -40.0, 15.0]", "[0.12, -0.04, 0.015]") + stated)
    assert "is that in metres?" in fiducials.read_fixture(path)[1][0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (FIXTURE + "rotation = [[1.0,0,0],[0,1.0,0],[0,0,1.0]]\n", "rotation: is given twice"),
        ("format = 1\nposition_mm = [1.0, 2.0, 3.0]\n", "rotation: is missing"),
        ("format = 1\nposition_mm = [1.0, 2.0, 3.0]\nrotation = [[1,0,0],[0,1,0],[0,0,-1]]\n",
         "is a reflection"),
        ("format = 1\nposition_mm = [1.0, 2.0, 3.0]\nrotation = [[1,0.1,0],[0,1,0],[0,0,1]]\n",
         "is not a rotation"),
        (FIXTURE + "position_standard_uncertainty_mm = -1.0\n", "is -1.0"),
    ],
)  # fmt: skip
def test_a_wrong_fixture_file_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "fixture.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        fiducials.read_fixture(path)
