"""Every way to a pose, and no other, at and near singularities; limits, turns, the nearest."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import robots
from robots.inverse import near
from robots.transforms import Array, difference
from tests.support.postures import NEAR, stretched, with_signs, wrist_on_axis_1

ARMS = {name: robots.load(name) for name in robots.names()}
EVERY_ARM = pytest.mark.parametrize("arm", ARMS.values(), ids=str)
POSE = 1e-9  # m and rad: what every returned branch must reach


def worst(arm: robots.DhArm, branches: Array, poses: Array) -> float:
    exists = np.isfinite(branches[..., 0])
    asked = np.broadcast_to(poses[..., None, :, :], (*exists.shape, 4, 4))[exists]
    apart = difference(robots.forward(arm, branches[exists]), asked).reshape(-1, 2, 3)
    return float(np.linalg.norm(apart, axis=-1).max(initial=0))


def to_own_joints(branches: Array, q: Array) -> Array:
    away = np.abs(near(branches, q[..., None, :]) - q[..., None, :]).max(axis=-1)
    return np.nanmin(away, axis=-1)


@pytest.mark.slow
@pytest.mark.parametrize("arm", [*ARMS.values(), with_signs(ARMS["rv_3sd"])], ids=str)
def test_ten_thousand_random_poses_give_their_own_joints_back_and_every_branch_reaches(
    arm: robots.DhArm,
) -> None:
    q = np.random.default_rng(1).uniform(arm.lower, arm.upper, (10_000, 6))
    pose = robots.forward(arm, q)
    branches = robots.inverse(arm, pose)
    assert worst(arm, branches.q, pose) < 1e-13  # rounding; 1e-9 is what is promised
    regular = np.abs(np.linalg.det(robots.jacobian(arm, q))) > 1e-7  # m³, of up to 0.02
    assert regular.mean() > 0.99
    assert to_own_joints(branches.q, q)[regular].max() < 1e-8
    theta = arm.theta(branches.q)
    assert_allclose(arm.joint_angles(arm.theta(q)), q, atol=1e-14)
    assert np.nanmin(theta) > -np.pi - 1e-12  # q = sign (θ - offset) and back may round
    assert np.nanmax(theta) <= np.pi + 1e-12


@EVERY_ARM
@pytest.mark.parametrize("factor", ["wrist", "elbow", "shoulder", "all"])
def test_next_to_each_singularity_every_branch_reaches_its_pose(
    arm: robots.DhArm, factor: str
) -> None:
    random = np.random.default_rng(2)
    for turn in (0.0, np.pi):
        for offset in NEAR:
            theta = random.uniform(-np.pi, np.pi, (100, 6))
            if factor in ("shoulder", "all"):
                theta = arm.theta(wrist_on_axis_1(arm, 20, 3))
                theta[:, 1] += offset
            if factor in ("elbow", "all"):
                theta[:, 2] = stretched(arm) + turn + offset
            if factor in ("wrist", "all"):
                theta[:, 4] = turn + offset
            q = arm.joint_angles(theta)
            pose = robots.forward(arm, q)
            held = robots.inverse(arm, pose, hold=q).q
            assert worst(arm, robots.inverse(arm, pose).q, pose) < POSE
            assert worst(arm, held, pose) < POSE
            if factor == "wrist" and abs(offset) not in (1e-8, 1e-9):
                # free joints are held, others are as good as rounding over |sin θ5|
                limit = 1e-6 if abs(offset) < 1e-9 else 1e-11 / abs(offset)
                assert np.median(to_own_joints(held, q)) < limit


@pytest.mark.parametrize(
    ("name", "q_deg", "count"),
    [
        ("iust_6r", [10, 20, 30, 40, 50, 60], 2),
        ("rv_3sd", [10, 20, 30, 40, 50, 60], 4),
        ("rv_3sd_melfa", [10, 110, 120, 40, 50, 60], 8),  # J2 = θ2 + 90°, J3 = θ3 + 90°
    ],
)
def test_the_number_of_solutions_is_the_one_on_record(
    name: str, q_deg: list[float], count: int
) -> None:
    arm = ARMS[name]
    branches = robots.inverse(arm, robots.forward(arm, np.radians(q_deg))).q
    assert np.isfinite(branches).all(axis=-1).sum() == count
    if name == "iust_6r":
        second = branches[np.isfinite(branches[:, 0]) & (branches[:, 2] < 0)]
        assert_allclose(np.degrees(second[0, 1:4]), [39.711279, -30, 80.288721], atol=1e-6)
        assert len(robots.turns(arm, branches)) == 2  # rows with NaN have none
        assert robots.within_limits(arm, branches).sum() == 2


@EVERY_ARM
def test_branches_keep_their_order(arm: robots.DhArm) -> None:
    q = np.random.default_rng(3).uniform(-np.pi, np.pi, (1000, 6))
    pose = robots.forward(arm, q)
    theta = arm.theta(robots.inverse(arm, pose).q).reshape(-1, 2, 2, 2, 6)
    wrist = pose[:, :2, 3] - arm.d[5] * pose[:, :2, 2]
    facing = np.cos(theta[..., 0] - np.arctan2(wrist[:, 1], wrist[:, 0])[:, None, None, None])
    bend = np.sin(theta[..., 2] - stretched(arm))
    bent = np.sin(theta[..., 4])
    for choice, axis in ((facing, 1), (bend, 2), (bent, 3)):
        first, second = np.moveaxis(choice, axis, 0)
        assert np.nanmin(first) > -1e-9
        assert np.nanmax(second) < 1e-9


@EVERY_ARM
def test_a_batch_of_any_shape_is_its_poses_one_by_one(arm: robots.DhArm) -> None:
    q = np.random.default_rng(4).uniform(arm.lower, arm.upper, (3, 1000, 6))
    q[0, :5, 4] = 0.0
    pose = robots.forward(arm, q)
    together = robots.inverse(arm, pose, hold=q)
    assert together.q.shape == (3, 1000, 8, 6)
    assert together.degenerate.shape == (3, 1000, 8)
    for i, j in ((0, 2), (1, 700), (2, 999)):
        alone = robots.inverse(arm, pose[i, j], hold=q[i, j])
        assert_allclose(alone.q, together.q[i, j], atol=1e-12)
        assert (alone.degenerate == together.degenerate[i, j]).all()


@pytest.mark.parametrize(("name", "joint"), [("iust_6r", 5), ("rv_3sd", 3), ("rv_3sd_melfa", 3)])
@pytest.mark.parametrize("theta5", [0.0, np.pi])
def test_a_straight_wrist_keeps_the_free_joint_and_flags_it(
    name: str, joint: int, theta5: float
) -> None:
    arm = ARMS[name]
    q = arm.joint_angles(np.array([0.3, -0.7, 1.4, 0.2, theta5, -0.4]))
    pose = robots.forward(arm, q)
    for angle in (q[joint], q[joint] + 0.05):
        hold = q.copy()
        hold[joint] = angle
        branches = robots.inverse(arm, pose, hold=hold)
        straight = np.isfinite(branches.q[:, 0]) & (branches.degenerate & 1 > 0)
        assert straight.any()
        assert_allclose(near(branches.q[straight, joint], hold[joint]), hold[joint], atol=1e-12)
        assert worst(arm, branches.q, pose) < 1e-13
    assert to_own_joints(robots.inverse(arm, pose, hold=q).q, q) < 1e-7


@EVERY_ARM
def test_a_wrist_on_axis_1_keeps_joint_1_and_flags_it(arm: robots.DhArm) -> None:
    q = wrist_on_axis_1(arm, 50, 5)
    q = q[np.abs(np.sin(arm.theta(q)[:, 4])) > 0.1]
    branches = robots.inverse(arm, robots.forward(arm, q), hold=q)
    assert (branches.degenerate & 2 == 2).all()
    exists = np.isfinite(branches.q[..., 0])
    first = np.broadcast_to(q[:, None, 0], exists.shape)[exists]
    assert_allclose(near(branches.q[exists][:, 0], first), first, atol=1e-12)
    assert np.median(to_own_joints(branches.q, q)) < 1e-9


def test_a_free_joint_moves_to_where_the_elbow_closes() -> None:
    arm = ARMS["iust_6r"]
    q = wrist_on_axis_1(arm, 300, 8)
    pose = robots.forward(arm, q)
    branches = robots.inverse(arm, pose).q  # held at 0, where many elbows do not close
    assert np.isfinite(branches[..., 0]).any(axis=-1).mean() > 0.99
    assert worst(arm, branches, pose) < 1e-13


def test_the_reach_is_the_one_on_record() -> None:
    assert_allclose(robots.reach(ARMS["iust_6r"]).minimum, 0.1265)
    assert_allclose(robots.reach(ARMS["iust_6r"]).maximum, 0.3765)
    for name in ("rv_3sd", "rv_3sd_melfa"):
        reach = robots.reach(ARMS[name])
        assert_allclose([reach.minimum, reach.maximum], [0.056869, 0.546869], atol=1e-6)


def assert_same_branches(mine: Array, other: Array, tolerance: float) -> None:
    mine = mine[np.isfinite(mine[:, 0])]
    away = np.abs(near(mine[:, None], other[None]) - other[None]).max(axis=-1)
    assert max(away.min(axis=1).max(), away.min(axis=0).max()) < tolerance


@pytest.mark.parametrize("name", ["rv_3sd", "rv_3sd_melfa"])
def test_another_librarys_closed_form_finds_the_same_solutions(name: str) -> None:
    pytest.importorskip("py_opw_kinematics")
    pytest.importorskip("eaik.IK_DH")
    from scipy.spatial.transform import RigidTransform

    from tests.bench.ik import opw_robot

    arm = ARMS[name]
    theirs = opw_robot(arm)
    q = np.random.default_rng(6).uniform(arm.lower, arm.upper, (2000, 6))
    pose = robots.forward(arm, q)
    assert_allclose(theirs.batch_forward(q).as_matrix(), pose, atol=1e-12)
    found = theirs.reach(RigidTransform.from_matrix(pose)).joints
    ours = robots.inverse(arm, pose).q
    regular = np.abs(np.linalg.det(robots.jacobian(arm, q))) > 1e-7
    for mine, other in zip(ours[regular], found[regular], strict=True):
        assert_same_branches(mine, other[np.isfinite(other[:, 0])], 1e-6)


def test_another_librarys_closed_form_finds_the_6rs_solutions() -> None:
    eaik = pytest.importorskip("eaik.IK_DH")
    arm = ARMS["iust_6r"]
    theirs = eaik.DhRobot(arm.alpha, arm.a, arm.d)
    q = np.random.default_rng(7).uniform(arm.lower, arm.upper, (200, 6))
    pose = robots.forward(arm, q)
    ours = robots.inverse(arm, pose).q
    regular = np.abs(np.linalg.det(robots.jacobian(arm, q))) > 1e-5
    for mine, flange in zip(ours[regular], pose[regular], strict=True):
        answer = theirs.IK(flange)
        exact = ~np.asarray(answer.is_LS, dtype=bool)
        # their answers are worse than ours by far, and some stand twice
        assert_same_branches(mine, np.asarray(answer.Q)[exact], 1e-4)


def test_a_joint_that_spans_two_turns_doubles_the_answers_and_one_outside_comes_inside() -> None:
    q = np.radians([10, 20, 30, 40, 50, 60])
    assert_allclose(np.degrees(robots.turns(ARMS["rv_3sd"], q)[:, 5]), [-300, 60])
    assert_allclose(robots.turns(ARMS["rv_3sd"], q)[:, :5], [q[:5]] * 2)
    arm = ARMS["rv_3sd_melfa"]
    q = np.radians([10, 270, 30, 40, 50, 0])  # J2 = 270° is -90°, its limit
    inside = robots.turns(arm, q)
    assert_allclose(np.degrees(inside[:, 1]), -90)
    assert_allclose(np.degrees(inside[:, 5]), [-360, 0, 360])
    assert robots.within_limits(arm, inside).all()
    q[1] = np.radians(200)
    assert robots.turns(arm, q).shape == (0, 6)


def test_limits_hold_to_their_last_digit_and_no_further() -> None:
    for arm in ARMS.values():
        assert robots.within_limits(arm, arm.lower)
        assert robots.within_limits(arm, arm.upper)
        for joint in range(6):
            beyond = arm.upper.copy()
            beyond[joint] += 1e-6
            assert not robots.within_limits(arm, beyond)


@EVERY_ARM
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
    arm, five = ARMS["rv_3sd"], [10, 20, 30, 40, 50]
    q, reading = np.radians([[*five, 355], [*five, 365]])
    found, _ = robots.nearest(arm, robots.forward(arm, q), reading)
    assert_allclose(np.degrees(found[5]), 355)
    q, reading = np.radians([[*five, -5], [*five, -190]])
    found, _ = robots.nearest(arm, robots.forward(arm, q), reading, limits=True)
    assert robots.within_limits(arm, found)


@pytest.mark.parametrize("name", [*ARMS, "ur5"])
def test_a_pose_out_of_reach_is_not_reached(name: str) -> None:
    arm, pose = robots.load(name), np.eye(4)
    pose[:3, 3] = 2.0, 0.0, 0.0
    found, reached = robots.nearest(arm, pose, np.full(6, 0.1))
    assert not reached
    assert np.isnan(found).all()
    assert not isinstance(arm, robots.DhArm) or np.isnan(robots.inverse(arm, pose).q).all()


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
