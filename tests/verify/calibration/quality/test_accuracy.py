from dataclasses import replace
from functools import reduce

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tests.support.boards.calibrated import moved
from tests.support.reports import calibration as made
from verify.calibration.quality.accuracy import (
    SPOT_SIGMA,
    TEST_LENGTH,
    length_uncertainty,
    uncertainty_field,
)
from verify.calibration.quality.advice import calibration_doubts
from verify.calibration.quality.coverage import board_orientations, view_frame
from verify.calibration.quality.quality import NOISE_GROUP, judge_calibration
from verify.calibration.quality.results import pan_axes_angle, stereo_geometry
from verify.calibration.stereo.records import covariance_in_si, state_covariance
from verify.core.records import Array
from verify.core.rig import Camera, Covariance, Rig
from verify.measurement.triangulation import triangulate

STILL = np.zeros(2)  # rad, the pan readings of a rig whose bases stand still
DRAWS = 1500  # of a Monte Carlo: a standard deviation is then known to 1.8 %
CLOSE = 0.08  # relative, over four standard deviations of that


def drawn_rigs(rig: Rig, count: int = DRAWS) -> list[Rig]:
    """Rigs as the covariance says they might be."""
    random = np.random.default_rng(5)
    steps = random.multivariate_normal(
        np.zeros(len(rig.covariance.parameters)),
        covariance_in_si(rig.covariance),
        count,
        method="eigh",
    )
    names = rig.covariance.parameters
    return [
        reduce(lambda at, change: moved(at, *change), zip(names, step.tolist(), strict=True), rig)
        for step in steps
    ]


def in_pixels(camera: Camera, point: Array) -> Array:
    camera_T_rig = np.linalg.inv(camera.rig_T_camera(0.0))
    return camera.project(camera_T_rig[:3, :3] @ point + camera_T_rig[:3, 3])


def spread(rigs: list[Rig], points: Array, nominal: Rig) -> Array:
    """Points that each rig triangulates from the pixels of the nominal one, (n, m, 3)."""
    left = np.array([in_pixels(nominal.left, p) for p in points])
    right = np.array([in_pixels(nominal.right, p) for p in points])
    return np.array([triangulate(r.left, r.right, 0.0, 0.0, left, right)[0] for r in rigs])


def test_every_corner_is_counted_once_a_picture() -> None:
    found = made.calibration()
    for side in judge_calibration(found).coverage:
        seen = (found.residuals.camera == side.camera).sum()
        assert side.counts.sum() == side.regions.sum() == seen


def test_a_board_s_tilts_are_those_it_was_placed_with() -> None:
    found = made.calibration(count=3)
    rig_T_view = view_frame(found.rig, STILL)
    wanted = [(0.3, 0.0), (0.0, -0.4), (-0.2, 0.0)]
    poses = []
    for about_horizontal, about_vertical in wanted:
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_rotvec([about_horizontal, about_vertical, 0.0]).as_matrix()
        pose[2, 3] = 1.1
        poses.append(rig_T_view @ pose)
    stood = board_orientations(replace(found, rig_T_board=np.array(poses)), np.zeros((3, 2)))
    assert_allclose([(s.about_horizontal, s.about_vertical) for s in stood], wanted, atol=1e-12)
    assert_allclose([s.tilt for s in stood], [0.3, 0.4, 0.2], atol=1e-9)
    corners = made.BOARD.points @ poses[0][:3, :3].T + poses[0][:3, 3]
    depth = (corners - rig_T_view[:3, 3]) @ rig_T_view[:3, 2]
    assert depth[0] < depth[-1]  # tilted up: the upper edge is nearer
    assert stood[0].distance == pytest.approx((depth[0] + depth[-1]) / 2)


def test_the_common_view_is_where_both_cameras_point() -> None:
    rig = made.calibration().rig
    view = view_frame(rig, STILL)
    assert_allclose(view[:3, :3] @ view[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(view[:3, :3]) == pytest.approx(1)
    for camera in (rig.left, rig.right):
        assert camera.rig_T_camera(0.0)[:3, 2] @ view[:3, 2] > np.cos(
            np.deg2rad(9)
        )  # toed in by 7.5°


def parallel_rig() -> Rig:
    """Two pinholes, 0.2 m apart, that look the same way; only the baseline is uncertain."""
    matrix = np.array([[1000.0, 0, 639.5], [0, 1000.0, 359.5], [0, 0, 1]])
    none, up = np.zeros(3), np.array([0.0, 1, 0])
    left = Camera(matrix, np.zeros(5), none, up, 0.0, np.eye(4))
    mount = np.eye(4)
    mount[0, 3] = 0.2
    right = replace(left, mount=mount)
    covariance = Covariance(("right.mount_x_mm",), np.array([0.2]), np.eye(1))
    return Rig((1280, 720), left, right, np.full((4, 4), np.nan), "", covariance=covariance)


def test_a_point_s_noise_follows_the_law_of_parallel_cameras() -> None:
    found = uncertainty_field(parallel_rig(), STILL, 0.8, turning=False)
    middle = found.random[len(found.y) // 2, len(found.x) // 2]
    depth = 0.8**2 / (1000 * 0.2) * np.sqrt(2) * SPOT_SIGMA  # metrology.md, section 2
    lateral = 0.8 / 1000 * SPOT_SIGMA / np.sqrt(2)
    assert np.sqrt(middle[2, 2]) == pytest.approx(depth, rel=0.01)
    assert np.sqrt(middle[1, 1]) == pytest.approx(lateral, rel=0.01)


def test_a_baseline_s_error_scales_the_depth() -> None:
    rig = parallel_rig()
    found = uncertainty_field(rig, STILL, 0.8, turning=False)
    middle = found.systematic[len(found.y) // 2, len(found.x) // 2]
    assert np.sqrt(middle[2, 2]) == pytest.approx(0.8 * 0.001, rel=1e-3)  # 0.2 mm of 200 mm
    random, systematic = length_uncertainty(rig, STILL, 0.8, 2, turning=False)
    assert systematic == pytest.approx(TEST_LENGTH * 0.001, rel=1e-3)
    assert random > 0


def test_points_are_mapped_only_where_both_cameras_see_them() -> None:
    found = uncertainty_field(made.calibration().rig, STILL, 0.6, turning=False)
    rig = made.calibration().rig
    rig_T_view = view_frame(rig, STILL)
    for i, y in enumerate(found.y):
        for j, x in enumerate(found.x):
            point = rig_T_view[:3, :3] @ [x, y, found.distance] + rig_T_view[:3, 3]
            pixels = [in_pixels(c, point) for c in (rig.left, rig.right)]
            seen = all((p >= -0.5).all() and (p <= [1279.5, 719.5]).all() for p in pixels)
            assert np.isfinite(found.random[i, j]).all() == seen


def test_points_lengths_and_baseline_scatter_as_in_rigs_drawn_from_the_covariance() -> None:
    rig = made.calibration().rig
    rigs, rig_T_view = drawn_rigs(rig), view_frame(rig, STILL)
    found = uncertainty_field(rig, STILL, 1.0, turning=False)
    places = [(2, 4), (1, 1), (3, 7)]
    points = [[found.x[j], found.y[i], 1.0] for i, j in places]
    points += [[-TEST_LENGTH / 2, 0, 1.0], [TEST_LENGTH / 2, 0, 1.0]]
    shown = spread(rigs, np.array(points) @ rig_T_view[:3, :3].T + rig_T_view[:3, 3], rig)
    for k, (i, j) in enumerate(places):
        there = np.cov(shown[:, k] @ rig_T_view[:3, :3], rowvar=False)
        assert_allclose(np.diag(there), np.diag(found.systematic[i, j]), rtol=2 * CLOSE)
    length = np.linalg.norm(shown[:, 4] - shown[:, 3], axis=1)
    stated = length_uncertainty(rig, STILL, 1.0, 0, turning=False)[1]
    assert stated == pytest.approx(length.std(), rel=CLOSE)
    entry = stereo_geometry(rig, STILL)
    left_T_right = np.linalg.inv(rig.left.rig_T_camera(0.0)) @ rig.right.rig_T_camera(0.0)
    turn = Rotation.from_matrix(left_T_right[:3, :3]).as_rotvec(degrees=True)
    assert_allclose(entry["rotation_vector_deg"], turn, atol=1e-9)
    assert entry["baseline_mm"] == pytest.approx(170.0, abs=0.2)
    assert entry["convergence_deg"] == pytest.approx(15.0, abs=0.1)
    baselines = [np.linalg.norm(r.right.pan_center - r.left.pan_center) for r in rigs]
    u = entry["baseline_standard_uncertainty_mm"]
    assert u == pytest.approx(1e3 * np.std(baselines), rel=CLOSE)


def test_the_turning_axes_angle_is_found_with_its_uncertainty() -> None:
    rig = made.calibration().rig
    tilted = Rotation.from_rotvec([0.01, 0.0, 0.0]).apply(rig.right.pan_axis)
    rig = replace(
        rig,
        right=replace(rig.right, pan_axis=tilted),
        covariance=Covariance(("right.pan_axis_rx_deg",), np.array([0.02]), np.eye(1)),
    )
    entry = pan_axes_angle(rig)
    assert entry["axes_angle_deg"] == pytest.approx(np.rad2deg(0.01))
    assert entry["axes_angle_standard_uncertainty_deg"] == pytest.approx(0.02, rel=1e-3)


def test_the_working_distance_is_the_boards_median_even_where_maps_coincide() -> None:
    found = made.calibration(count=3)
    rig_T_view = view_frame(found.rig, STILL)
    poses = np.tile(rig_T_view, (3, 1, 1))
    for pose, z in zip(poses, (0.66, 0.67, 1.2), strict=True):
        pose[:3, 3] += z * rig_T_view[:3, 2]
    quality = judge_calibration(replace(found, rig_T_board=poses))
    assert quality.working_distance == 0.65
    assert [f.distance for f in quality.fields] == [0.65, 1.2]


def test_pan_readings_add_their_own_uncertainty_where_bases_turn() -> None:
    rig = made.calibration().rig
    loose = replace(rig, left=replace(rig.left, pan_standard_uncertainty=np.deg2rad(0.1)))
    still = uncertainty_field(loose, STILL, 0.9, turning=False)
    turned = uncertainty_field(loose, STILL, 0.9, turning=True)
    assert_allclose(still.systematic, uncertainty_field(rig, STILL, 0.9, turning=False).systematic)
    more = turned.systematic[2, 4] - still.systematic[2, 4]
    assert np.sqrt(more[2, 2]) > 0.005  # 0.1° at 0.9 m and 170 mm: Z² / B times the angle
    found = replace(made.calibration(), rig=loose, turning=True)
    assert judge_calibration(found).contributions[0].group == "pan readings"


def test_what_is_left_were_a_group_exact_is_the_covariance_given_that_group() -> None:
    found = made.calibration()
    quality = judge_calibration(found)
    given = found.rig.covariance
    focal = np.array([n.partition(".")[2] in ("fx_px", "fy_px") for n in given.parameters])
    keep, whole = np.flatnonzero(~focal), covariance_in_si(given)
    gain = np.linalg.solve(whole[focal][:, focal], whole[focal][:, keep])
    conditional = whole[keep][:, keep] - whole[keep][:, focal] @ gain  # focal lengths exact
    covariance = state_covariance([given.parameters[i] for i in keep], conditional)
    rest = replace(found, rig=replace(found.rig, covariance=covariance))
    by_group = {c.group: c for c in quality.contributions}
    again = {c.group: c for c in judge_calibration(rest).contributions}
    noise = again[NOISE_GROUP]
    assert by_group["focal lengths"].without == pytest.approx(np.hypot(noise.alone, noise.without))
    assert quality.contributions[0].without == min(c.without for c in quality.contributions)


@pytest.mark.parametrize(
    ("cy", "u", "odd", "believed"),
    [(355.0, 0.2, False, True), (193.8, 3.0, True, True), (193.8, 60.0, True, False)],
)
def test_an_unusual_principal_point_is_accepted_if_well_determined(
    cy: float, u: float, odd: bool, believed: bool
) -> None:
    found = made.calibration()
    given = found.rig.covariance
    sigma = given.standard_uncertainty.copy()
    sigma[[given.parameters.index(f"left.{key}") for key in ("cx_px", "cy_px")]] = u
    matrix = found.rig.left.matrix.copy()
    matrix[:2, 2] = [639.5, cy]
    rig = replace(
        found.rig,
        left=replace(found.rig.left, matrix=matrix),
        covariance=replace(given, standard_uncertainty=sigma),
    )
    found = replace(found, rig=rig)
    quality = judge_calibration(found)
    point = quality.principal_points[0]
    assert point.distance == pytest.approx(abs(cy - 359.5))
    assert (point.odd, point.believed) == (odd, believed)
    named = [s for s in calibration_doubts(found, quality) if "principal point" in s]
    assert len(named) == (odd and not believed)


def test_a_focal_length_that_is_hardly_known_is_a_doubt() -> None:
    found = made.calibration()
    given = found.rig.covariance
    sigma = given.standard_uncertainty.copy()
    sigma[given.parameters.index("right.fx_px")] = 0.03 * found.rig.right.matrix[0, 0]
    rig = replace(found.rig, covariance=replace(given, standard_uncertainty=sigma))
    (doubt,) = calibration_doubts(replace(found, rig=rig), judge_calibration(found))
    assert doubt.startswith("The right camera's focal length")
    assert "± 6.0% only (k = 2)" in doubt
