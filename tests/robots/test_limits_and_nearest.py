"""Limits, whole turns, and the branch nearest to a reading."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import robots
from robots.limits import near
from robots.transforms import difference
from tests.robots.strategies import wrist_on_axis_1

ARMS = {name: robots.load(name) for name in robots.names()}


def test_a_joint_that_spans_two_turns_doubles_the_answers() -> None:
    arm = ARMS["rv_3sd"]
    q = np.radians([10, 20, 30, 40, 50, 60])
    assert_allclose(np.degrees(robots.turns(arm, q)[:, 5]), [-300, 60])
    assert_allclose(robots.turns(arm, q)[:, :5], [q[:5]] * 2)


def test_a_joint_outside_its_limits_comes_inside_by_a_turn_or_drops_out() -> None:
    arm = ARMS["rv_3sd_melfa"]
    q = np.radians([10, 270, 30, 40, 50, 0])  # J2 = 270° is -90°, its limit
    inside = robots.turns(arm, q)
    assert_allclose(np.degrees(inside[:, 1]), -90)
    assert_allclose(np.degrees(inside[:, 5]), [-360, 0, 360])
    assert robots.within_limits(arm, inside).all()
    q[1] = np.radians(200)
    assert robots.turns(arm, q).shape == (0, 6)


def test_branches_with_nan_have_no_turns_and_are_not_within_limits() -> None:
    arm = ARMS["iust_6r"]
    branches = robots.inverse(arm, robots.forward(arm, np.radians([10, 20, 30, 40, 50, 60]))).q
    assert len(robots.turns(arm, branches)) == 2
    assert robots.within_limits(arm, branches).sum() == 2


def test_limits_hold_to_their_last_digit_and_no_further() -> None:
    for arm in ARMS.values():
        assert robots.within_limits(arm, arm.lower)
        assert robots.within_limits(arm, arm.upper)
        for joint in range(6):
            beyond = arm.upper.copy()
            beyond[joint] += 1e-6
            assert not robots.within_limits(arm, beyond)


@pytest.mark.parametrize("arm", ARMS.values(), ids=str)
@pytest.mark.parametrize("limits", [False, True])
def test_the_nearest_branch_is_the_one_that_made_the_pose(arm: robots.DhArm, limits: bool) -> None:
    random = np.random.default_rng(1)
    q = random.uniform(arm.lower, arm.upper, (2000, 6))
    q = q[np.abs(np.linalg.det(robots.jacobian(arm, q))) > 1e-4]  # other branches are far away
    reading = q + random.normal(0, 0.003, q.shape)
    found, reached = robots.nearest(arm, robots.forward(arm, q), reading, limits=limits)
    assert reached.all()
    assert_allclose(found, q, atol=1e-9)  # the same turn of joint 6 too


def test_the_nearest_within_limits_may_be_a_turn_away() -> None:
    arm = ARMS["rv_3sd"]
    q = np.radians([10, 20, 30, 40, 50, 355])
    pose = robots.forward(arm, q)
    reading = q.copy()
    reading[5] = np.radians(365)
    found, _ = robots.nearest(arm, pose, reading)
    assert_allclose(np.degrees(found[5]), 355)
    reading[5] = np.radians(-190)
    q[5] = np.radians(-5)
    found, _ = robots.nearest(arm, robots.forward(arm, q), reading, limits=True)
    assert robots.within_limits(arm, found)


def test_a_pose_out_of_reach_is_not_reached() -> None:
    pose = np.eye(4)
    pose[:3, 3] = 3.0
    for name in ("iust_6r", "ur5"):
        arm = robots.load(name)
        found, reached = robots.nearest(arm, pose, np.full(6, 0.1))
        assert not reached
        assert np.isnan(found).all()


@pytest.mark.parametrize("arm", ARMS.values(), ids=str)
def test_on_a_singularity_the_free_joint_stays_where_the_encoder_reads(arm: robots.DhArm) -> None:
    q = wrist_on_axis_1(arm, 10, 2)
    q = q[np.abs(np.sin(arm.theta(q)[:, 4])) > 0.1]
    found, reached = robots.nearest(arm, robots.forward(arm, q), q)
    assert reached.all()
    assert np.median(np.abs(found - near(q, found)).max(axis=-1)) < 1e-9


@pytest.mark.parametrize("name", ["ur5", "panda", "xarm7"])
@pytest.mark.parametrize("limits", [False, True])
def test_a_urdf_arm_finds_back_to_the_pose_from_nearby(name: str, limits: bool) -> None:
    arm = robots.load(name)
    random = np.random.default_rng(3)
    q = random.uniform(
        np.maximum(arm.lower, -3) + 0.1, np.minimum(arm.upper, 3) - 0.1, (25, arm.dof)
    )
    pose = robots.forward(arm, q)
    reading = q + random.normal(0, 0.03, q.shape)
    found, reached = robots.nearest(arm, pose, reading, limits=limits)
    assert reached.all()
    assert np.abs(difference(robots.forward(arm, found), pose)).max() < 1e-10
    away, own = (np.linalg.norm(each - reading, axis=-1) for each in (found, q))
    assert (away <= own + 1e-6).mean() > 0.9  # next to a singularity another answer may be taken
    if limits:
        assert robots.within_limits(arm, found).all()


def test_of_a_redundant_arms_answers_the_one_nearest_the_seed_is_taken() -> None:
    arm = robots.load("panda")
    q = np.array([0.1, 0.2, 0.3, -1.5, 0.5, 1.6, 0.7])
    pose = robots.forward(arm, q)
    seed = q + np.array([0.05, -0.02, 0.04, 0.01, -0.03, 0.02, -0.05])
    found, reached = robots.nearest(arm, pose, seed)
    assert reached
    self_motion = np.linalg.svd(robots.jacobian(arm, found))[2][-1]
    assert abs(self_motion @ (seed - found)) < 1e-8  # Lagrange: nothing is left to gain along it
