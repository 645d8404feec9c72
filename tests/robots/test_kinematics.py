"""Where the flange is and how it moves: against pinocchio, differences and printed figures."""

import numpy as np
import pinocchio
import pytest
from numpy.testing import assert_allclose

import robots
from tests.support.postures import linked, with_signs

ARMS = {name: robots.load(name) for name in robots.names()}
EVERY_ARM = pytest.mark.parametrize("arm", ARMS.values(), ids=str)


def test_at_the_controllers_zero_upper_arm_and_forearm_stand_upright_the_elbow_offset_behind() -> (
    None
):
    arm = ARMS["rv_3sd_melfa"]
    pose = robots.forward(arm, np.zeros(6))
    assert_allclose(pose[:3, 3] * 1000, [95 - 135, 0, 350 + 245 + 270 + 85], atol=1e-9)
    assert_allclose(pose[:3, 2], [0, 0, 1], atol=1e-15)


@pytest.mark.parametrize(
    "arm",
    [made(arm.unlinked) for arm in ARMS.values() for made in (lambda a: a, with_signs)],
    ids=str,
)
def test_pose_and_jacobian_are_pinocchios(arm: robots.DhArm) -> None:
    model = robots.pinocchio_model(arm)
    data = model.createData()
    frame = model.getFrameId("flange")
    world = pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
    q = np.random.default_rng(1).uniform(-np.pi, np.pi, (300, 6))
    poses, moves = robots.forward(arm, q), robots.jacobian(arm, q)
    for angles, pose, columns in zip(q, poses, moves, strict=True):
        theirs = pinocchio.computeFrameJacobian(model, data, angles, frame, world)
        placed = pinocchio.updateFramePlacement(model, data, frame).homogeneous
        assert_allclose(pose, placed, atol=1e-14)
        assert_allclose(columns, theirs, atol=1e-14)
    assert robots.inverse(arm, poses, hold=q).q.shape == (300, 8, 6)
    assert_allclose(model.lowerPositionLimit, arm.lower)


@pytest.mark.parametrize("name", ["iust_6r", "rv_3sd_melfa", "ur5"])
def test_a_linked_arm_stands_where_its_axes_turn(name: str) -> None:
    """Joint 2's motor turns link 3 back: the plain arm, which is pinocchio's, gets q3 - q2."""
    plain = robots.load(name)
    arm, q = linked(plain), np.random.default_rng(4).uniform(-2.5, 2.5, (20, 6))
    poses = robots.forward(plain, q - np.eye(6)[2] * q[:, [1]])
    assert_allclose(robots.forward(arm, q), poses, atol=1e-14)
    assert_allclose(robots.link_frames(arm, q)[:, -1], poses, atol=1e-14)
    check = robots.self_check(arm, poses=100, seed=3)
    assert (check.lost, max(check.inverse_position, check.difference_jacobian) < 1e-8) == (0, True)


@EVERY_ARM
def test_one_pose_and_a_batch_are_the_same(arm: robots.DhArm) -> None:
    q = np.random.default_rng(2).uniform(arm.lower, arm.upper, (2, 3, 6))
    poses, moves = robots.forward(arm, q), robots.jacobian(arm, q)
    assert poses.shape == (2, 3, 4, 4)
    assert moves.shape == (2, 3, 6, 6)
    for index in np.ndindex(2, 3):
        assert_allclose(robots.forward(arm, q[index]), poses[index], atol=1e-15)
        assert_allclose(robots.jacobian(arm, q[index]), moves[index], atol=1e-15)


@pytest.mark.parametrize("name", [*robots.names(), "ur5", "panda", "kinova"])
def test_link_frames_stand_on_the_joints_axes_and_end_at_the_flange(name: str) -> None:
    arm = robots.load(name)
    q = np.random.default_rng(6).uniform(arm.lower, arm.upper, (10, arm.dof))
    frames, moves = robots.link_frames(arm, q), robots.jacobian(arm.unlinked, arm.axis_angles(q))
    assert_allclose(frames[:, -1], robots.forward(arm, q), atol=1e-12)
    sign = arm.sign if isinstance(arm, robots.DhArm) else np.ones(arm.dof)
    axes = frames[:, :-1, :3, 2] * sign[:, None]
    levers = frames[:, -1:, :3, 3] - frames[:, :-1, :3, 3]
    assert_allclose(axes, np.swapaxes(moves[:, 3:], 1, 2), atol=1e-12)
    assert_allclose(np.cross(axes, levers), np.swapaxes(moves[:, :3], 1, 2), atol=1e-12)


def test_the_wrong_number_of_joints_is_refused() -> None:
    with pytest.raises(ValueError, match="iust_6r has 6 joints"):
        robots.forward(ARMS["iust_6r"], np.zeros(5))
