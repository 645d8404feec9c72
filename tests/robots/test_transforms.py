"""Rigid motions: laws of the group."""

import numpy as np
from numpy.testing import assert_allclose

from robots.transforms import Array, carry, difference, invert, rotation_exp


def motions(count: int) -> Array:
    random = np.random.default_rng(1)
    poses = np.zeros((count, 4, 4))
    poses[:, :3, :3] = rotation_exp(random.normal(size=(count, 3)))
    poses[:, :3, 3] = random.normal(size=(count, 3))
    poses[:, 3, 3] = 1
    return poses


def test_a_motion_and_its_inverse_cancel() -> None:
    poses = motions(20)
    assert_allclose(invert(poses) @ poses, np.broadcast_to(np.eye(4), (20, 4, 4)), atol=1e-15)
    assert_allclose(invert(poses[0]), np.linalg.inv(poses[0]), atol=1e-14)


def test_carried_points_are_the_homogeneous_product() -> None:
    pose, points = motions(1)[0], np.random.default_rng(2).normal(size=(7, 3))
    homogeneous = np.concatenate([points, np.ones((7, 1))], axis=1)
    assert_allclose(carry(pose, points), (homogeneous @ pose.T)[:, :3], atol=1e-15)
    assert carry(motions(4)[:, None], points).shape == (4, 7, 3)


def test_the_difference_carries_one_pose_onto_the_other() -> None:
    b, c = motions(2)
    apart = difference(b, c)
    assert_allclose(rotation_exp(apart[3:]) @ c[:3, :3], b[:3, :3], atol=1e-14)
    assert_allclose(c[:3, 3] + apart[:3], b[:3, 3], atol=1e-15)
