"""The rotating-base camera against OpenCV's own projection and against brute force."""

import cv2
import numpy as np
from numpy.testing import assert_allclose

from tests.support.scene import make_rig, project
from verify.core.rig import distort, distort_with_jacobian

CAMERA = make_rig().left


def test_projection_is_opencvs_at_any_pan() -> None:
    points = np.random.default_rng(4).uniform([-0.35, -0.2, 0.5], [0.35, 0.2, 0.9], (500, 3))
    for pan in (-0.4, 0.0, 0.13):
        camera_T_rig = np.linalg.inv(CAMERA.rig_T_camera(pan))
        inside = points @ camera_T_rig[:3, :3].T + camera_T_rig[:3, 3]
        assert_allclose(CAMERA.project(inside), project(CAMERA, pan, points), atol=1e-9)


def test_positive_pan_turns_the_optical_axis_towards_plus_x() -> None:
    upright = make_rig(pan=0.0).left
    axis = upright.rig_T_camera(0.2)[:3, 2]
    assert axis[0] > upright.rig_T_camera(0.0)[0, 2] + 0.15


def test_the_lens_is_inverted_to_a_millionth_of_a_pixel_up_to_the_corners() -> None:
    x, y = np.meshgrid(np.linspace(0, 1279, 60), np.linspace(0, 719, 40))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    rays = np.concatenate([CAMERA.normalise(pixels), np.ones((len(pixels), 1))], axis=1)
    back, _ = cv2.projectPoints(
        rays.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), CAMERA.matrix, CAMERA.distortion
    )
    assert np.max(np.abs(back.reshape(-1, 2) - pixels)) < 1e-6


def test_the_distortions_derivative_is_its_difference_quotient() -> None:
    xy = np.random.default_rng(2).uniform(-0.5, 0.5, (20, 2))
    step = 1e-6
    quotient = np.stack(
        [
            (distort(xy + step * unit, CAMERA.distortion)
             - distort(xy - step * unit, CAMERA.distortion)) / (2 * step)
            for unit in np.eye(2)
        ],
        axis=-1,
    )  # fmt: skip
    assert_allclose(distort_with_jacobian(xy, CAMERA.distortion)[1], quotient, atol=1e-8)
