from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from robots.transforms import difference
from tests.support.scene import facing, make_marker, make_rig, project, sight
from verify.core.records import Array
from verify.measurement.pose import fit_pose, perturb

SIGMA = 0.05  # px, a typical spot


def cramer_rao(rig, marker, pose, sigma) -> Array:
    """Bound of the pose covariance from OpenCV's projection alone, by central differences."""
    columns = []
    for i in range(6):
        pixels = []
        for sign in (1, -1):
            moved = perturb(pose, sign * 1e-6 * np.eye(6)[i])
            points = marker.leds @ moved[:3, :3].T + moved[:3, 3]
            pixels.append(
                np.concatenate([project(c, c.pan, points) for c in (rig.left, rig.right)])
            )
        columns.append((pixels[0] - pixels[1]).ravel() / 2e-6)
    design = np.stack(columns, axis=1)
    return np.linalg.inv(design.T @ design) * sigma**2


def test_a_pose_without_noise_is_found_exactly_from_a_start_that_is_far_off() -> None:
    rig, marker, truth = make_rig(), make_marker(), facing(0.05, -0.03, 0.6)
    start = perturb(truth, np.array([0.01, -0.01, 0.02, 0.1, -0.1, 0.2]))
    pose = fit_pose(*sight(rig, marker, truth, SIGMA), rig, marker, start)
    assert_allclose(difference(pose.rig_T_flange, truth), 0, atol=1e-9)
    assert pose.known_dof == 6


@pytest.mark.parametrize("count", [3, 4])
def test_scatter_reaches_the_cramer_rao_bound_and_the_covariance_is_true(count: int) -> None:
    rig, marker, truth = make_rig(), make_marker(count), facing(0.02, 0.01, 0.62)
    rng = np.random.default_rng(7)
    bound = cramer_rao(rig, marker, truth, SIGMA)
    errors = []
    for _ in range(600):
        pose = fit_pose(*sight(rig, marker, truth, SIGMA, rng), rig, marker, truth)
        errors.append(difference(pose.rig_T_flange, truth))
    scatter = np.cov(np.array(errors).T)
    # 600 draws know a standard deviation to 3 %: 1.1 leaves three of them
    assert np.all(np.sqrt(np.diag(scatter) / np.diag(bound)) < 1.1)
    assert_allclose(np.sqrt(np.diag(pose.covariance)), np.sqrt(np.diag(bound)), rtol=0.01)
    assert_allclose(np.sqrt(np.diag(scatter)), np.sqrt(np.diag(pose.covariance)), rtol=0.1)


def test_two_leds_determine_five_and_one_three_degrees_of_freedom() -> None:
    rig, truth = make_rig(), facing()
    two = make_marker(2)
    pose = fit_pose(*sight(rig, two, truth, SIGMA), rig, two, truth)
    assert pose.known_dof == 5
    line = truth[:3, :3] @ (two.leds[0] - two.leds[1])
    spin = np.concatenate([-np.cross(line, truth[:3, :3] @ two.leds[0]), line])
    assert_allclose(pose.determined.T @ spin / np.linalg.norm(spin), 0, atol=1e-7)
    one = make_marker(1)
    assert fit_pose(*sight(rig, one, truth, SIGMA), rig, one, truth).known_dof == 3


def test_an_led_in_one_camera_still_counts() -> None:
    rig, marker, truth = make_rig(), make_marker(), facing()
    both, more = (
        fit_pose(*sight(rig, marker, truth, SIGMA, leds=(left, [0, 1, 2])), rig, marker, truth)
        for left in ([0, 1, 2], [0, 1, 2, 3])
    )
    assert np.all(np.diag(more.covariance) < np.diag(both.covariance))


def test_a_merged_spot_is_refused_and_does_not_move_the_pose() -> None:
    rig, marker, truth = make_rig(), make_marker(), facing()
    left, right = sight(rig, marker, truth, SIGMA, np.random.default_rng(3))
    clean = fit_pose(left, right, rig, marker, truth)
    dragged = left.centre.copy()
    dragged[1] += [0.9, -0.4]
    pose = fit_pose(replace(left, centre=dragged), right, rig, marker, truth)
    assert pose.rejected.tolist() == [False, True] + [False] * 6
    assert pose.consistent
    sigma = np.sqrt(np.diag(pose.covariance))
    assert np.all(np.abs(difference(pose.rig_T_flange, clean.rig_T_flange)) < 2 * sigma)


def test_spots_that_no_pose_explains_are_called_inconsistent() -> None:
    rig, marker, truth = make_rig(), make_marker(), facing()
    left, right = sight(rig, marker, truth, SIGMA)
    noise = np.random.default_rng(1).normal(0, 3.0, left.centre.shape)
    pose = fit_pose(replace(left, centre=left.centre + noise), right, rig, marker, truth)
    assert not pose.consistent


def test_spots_that_err_together_as_is_stated_are_consistent() -> None:
    """Of 200 rigs whose optical centres are off as far as stated, none contradicts its spots."""
    rig, marker, truth = make_rig(), make_marker(), facing()
    rng, count, clean = np.random.default_rng(5), len(marker), 0.005
    # every spot of a camera moves alike: columns left x, left y, right x, right y
    columns = 0.3 * np.kron(np.eye(2), np.tile(np.eye(2), (count, 1)))
    agree = []
    for _ in range(200):
        left, right = sight(rig, marker, truth, clean, rng)
        off = 0.3 * rng.standard_normal((2, 2))
        views = (
            replace(view, centre=view.centre + d)
            for view, d in zip((left, right), off, strict=True)
        )
        pose = fit_pose(*views, rig, marker, truth, lambda *_: columns)
        agree.append(pose.consistent and not pose.rejected.any())
    assert all(agree)


def test_an_unknown_acceleration_correlates_what_alignment_moved() -> None:
    """A lever on the right image's spots must cost depth, not average out over LEDs."""
    rig, marker, truth = make_rig(), make_marker(), facing()
    left, right = sight(rig, marker, truth, SIGMA)
    speed = np.tile([150.0, 20.0], (4, 1))
    moved = replace(right, velocity=speed, lever=np.full((4, 3), [0.004 * 0.067 / 2, 0.0, 0.0]))
    pose = fit_pose(replace(left, velocity=speed), moved, rig, marker, truth)
    depth = truth[:3, 3] / np.linalg.norm(truth[:3, 3])
    along = depth @ pose.covariance_alignment[:3, :3] @ depth
    across = np.trace(pose.covariance_alignment[:3, :3]) - along
    assert along > 3 * across
    assert pose.twist[:3] @ pose.twist[:3] > 0
