"""Truth: cv2.projectPoints, the laws of rigid motion, scipy's alignment."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tests.support.scene import make_rig, project
from verify.core.records import Array
from verify.core.rig import Camera
from verify.measurement.triangulation import fit_rigid, triangulate


def turn(rotation_vector: Array) -> Array:
    return Rotation.from_rotvec(rotation_vector).as_matrix()


def upright(x: float) -> Camera:
    """A camera without a lens, on a vertical axis."""
    matrix = np.array([[1010.0, 0, 640.0], [0, 1008.0, 355.0], [0, 0, 1.0]])
    place, axis = np.array([x, 0.004, -0.007]), np.array([0.0, 1.0, 0.0])
    return Camera(matrix, np.zeros(5), place, axis, 0.2 * x, np.eye(4))


LEFT, RIGHT = upright(-0.1), upright(0.1)


def scene(rng: np.random.Generator, n: int = 20) -> Array:
    return rng.uniform([-0.15, -0.12, 0.45], [0.15, 0.12, 1.0], (n, 3))


@pytest.mark.parametrize("seed", range(10))
def test_a_point_that_opencv_projects_is_found_again(seed: int) -> None:
    rng, rig = np.random.default_rng(seed), make_rig(baseline=0.16)
    pans = rng.uniform(0.02, 0.2), -rng.uniform(0.02, 0.2)
    truth = scene(rng)
    pixels = project(rig.left, pans[0], truth), project(rig.right, pans[1], truth)
    points, gap = triangulate(rig.left, rig.right, *pans, *pixels)
    assert_allclose(points, truth, rtol=0, atol=1e-9)
    assert_allclose(gap, 0, atol=1e-9)
    left, right = pixels  # every left spot meets every right one
    every, gap = triangulate(rig.left, rig.right, *pans, left[:, None], right[None])
    assert every.shape == (20, 20, 3)
    assert_allclose(np.diagonal(gap), 0, atol=1e-9)
    assert_allclose(every[np.arange(20), np.arange(20)], truth, atol=1e-9)


def test_a_vertical_mismatch_shows_as_gap_and_the_point_lies_midway() -> None:
    apart = np.array([0, 2e-3, 0])
    truth = np.array([[0.0, 0.0, 0.7]])
    pixels = project(LEFT, 0.1, truth - apart / 2), project(RIGHT, -0.1, truth + apart / 2)
    points, gap = triangulate(LEFT, RIGHT, 0.1, -0.1, *pixels)
    assert_allclose(gap, 2e-3, rtol=2e-3)  # rays drawn 2 mm apart, a little slanted to each other
    assert_allclose(points, truth, atol=1e-4)  # the gap's own slant: a twentieth of it


def test_rays_that_are_parallel_or_meet_behind_a_camera_give_nan() -> None:
    middle = np.array([640.0, 355.0])
    for pan in (0.0, 0.2):  # parallel axes, then axes that part
        pans = -pan - LEFT.pan_zero, pan - RIGHT.pan_zero
        points, gap = triangulate(LEFT, RIGHT, *pans, middle, middle)
        assert np.all(np.isnan(points))
        assert np.isnan(gap)


@pytest.mark.parametrize("seed", range(10))
def test_a_rigid_motion_is_recovered_and_noise_is_fitted_as_scipy_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points_b = rng.normal(0, 0.05, (5, 3))
    rotation, shift = turn(rng.normal(0, 2, 3)), rng.normal(0, 1, 3)
    clean = points_b @ rotation.T + shift
    a_T_b = fit_rigid(clean, points_b)
    assert_allclose(a_T_b[:3, :3], rotation, atol=1e-12)
    assert_allclose(a_T_b[:3, 3], shift, atol=1e-12)
    noisy = clean + rng.normal(0, 1e-3, clean.shape)
    oracle, _ = Rotation.align_vectors(noisy - noisy.mean(0), points_b - points_b.mean(0))
    assert_allclose(fit_rigid(noisy, points_b)[:3, :3], oracle.as_matrix(), atol=1e-9)


def test_a_mirrored_set_is_never_fitted_by_a_reflection_and_a_flat_one_is_enough() -> None:
    points_b = np.random.default_rng(0).normal(0, 0.05, (5, 3))
    a_T_b = fit_rigid(points_b * [1, 1, -1], points_b)
    assert_allclose(np.linalg.det(a_T_b[:3, :3]), 1, rtol=1e-12)
    flat, rotation = points_b * [1, 1, 0], turn(np.array([0.5, -1.0, 2.0]))
    assert_allclose(fit_rigid(flat @ rotation.T, flat)[:3, :3], rotation, atol=1e-12)


@pytest.mark.parametrize(
    ("points", "why"),
    [
        (np.eye(3)[:2], "three points"),
        (np.outer([0.0, 1.0, 2.0, 5.0], [1.0, 2.0, 3.0]), "one line"),
        (np.ones((4, 3)), "one line"),
        (np.full((4, 3), np.nan), "finite"),
    ],
)
def test_points_that_fix_no_pose_are_refused(points: Array, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        fit_rigid(points, points)
