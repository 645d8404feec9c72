"""The straight line: hand poses by their law, joint angles against pinocchio along the way."""

import numpy as np
import pinocchio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import robots
from tests.support.grasp.cells import melfa
from verify.core.records import Array
from verify.grasping.planning.approach import ApproachLine, hand_poses, line_path, nearest_turn

directions = (
    st.integers(0, 2**32 - 1)
    .map(lambda seed: np.random.default_rng(seed).normal(size=3))
    .map(lambda v: v / np.linalg.norm(v))
)


def solved(q: Array) -> int:
    """The branch that joint angles belong to."""
    answers = robots.inverse(melfa(), robots.forward(melfa(), q), hold=q).q
    return int(np.nanargmin(np.abs(np.sin((answers - q) / 2)).max(axis=1)))


@settings(max_examples=30)
@given(directions, st.floats(-np.pi, np.pi))
def test_a_hand_points_along_the_direction_turned_about_it(direction: Array, turn: float) -> None:
    point = np.array([0.4, 0.1, 0.05])
    plain, turned = hand_poses(direction, point, np.array([0.0, turn]))
    for pose in (plain, turned):
        assert_allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3), atol=1e-12)
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)
        assert_allclose(pose[:3, 2], direction)
        assert_allclose(pose[:3, 3], point)
    # Rodrigues: the plain hand turned about the direction
    turning = robots.transforms.rotation_exp(turn * direction)
    assert_allclose(turned[:3, :3], turning @ plain[:3, :3], atol=1e-12)
    back = nearest_turn(direction, turned[:3, :3])
    assert np.cos(back - turn) == pytest.approx(1)


@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1), directions)
def test_along_a_line_the_flange_stays_on_it_and_the_branch_the_same(
    seed: int, direction: Array
) -> None:
    arm = melfa()
    q = np.random.default_rng(seed).uniform(arm.lower, arm.upper)
    line = ApproachLine(robots.forward(arm, q), 0.08 * direction)
    branch = solved(q)
    path = line_path(arm, line, branch, q)
    if isinstance(path, str):
        return
    assert path.length == pytest.approx(0.08)
    assert_allclose(path.q(0.0), q, atol=1e-7)
    model = robots.pinocchio_model(arm)
    data = model.createData()
    for s in np.linspace(0, path.length, 23).tolist():
        q_there = path.q(s)
        pinocchio.framesForwardKinematics(model, data, q_there)
        pose = data.oMf[model.getFrameId("flange")]
        # 0.02 mm and 0.01° were asked midway between the nodes: nowhere is it twice as far
        assert_allclose(pose.translation, line.start[:3, 3] + s * direction, atol=4e-5)
        assert_allclose(pose.rotation, line.start[:3, :3], atol=4e-4)
        sine = np.abs(np.sin(arm.theta(q_there))[4])
        if sine > 0.05:  # next to a straight wrist two branches are one to rounding
            assert solved(q_there) == branch


def refused(q: Array, shift: Array) -> str:
    path = line_path(melfa(), ApproachLine(robots.forward(melfa(), q), shift), solved(q), q)
    assert isinstance(path, str)
    return path


def test_a_line_out_of_reach_names_the_place() -> None:
    q = np.radians([0.0, 20.0, 60.0, 0.0, 30.0, 0.0])
    message = refused(q, np.array([0.6, 0.0, 0.0]))
    assert message.startswith("out of reach")
    before = float(message.split()[3])
    flange = robots.forward(melfa(), q)
    for shift, there in ((0.6 - before / 1e3 - 0.08, True), (0.6 - before / 1e3 + 0.001, False)):
        pose = flange.copy()
        pose[0, 3] += shift
        assert bool(np.isfinite(robots.inverse(melfa(), pose).q).any()) == there


def test_a_line_past_a_straight_wrist_is_refused() -> None:
    """Down through a posture whose wrist is straight but for 0.0001 mm beside: joint 4 leaps."""
    q = np.radians([0.0, 30.0, 70.0, 0.0, 0.0, 0.0])
    through = robots.forward(melfa(), q)
    shift = np.array([0.0, 0.0, -0.1])
    start = through.copy()
    start[:3, 3] -= 0.5 * shift
    start[1, 3] += 1e-7
    begin, reached = robots.nearest(melfa(), start, q)
    assert reached
    path = line_path(melfa(), ApproachLine(start, shift), solved(begin), begin)
    assert isinstance(path, str)
    assert "wrist" in path
    assert "50 mm before the end of the line" in path
