"""Near a singularity: which joints are coupled, and which sum of them is determined."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import robots
from robots.transforms import Array, difference
from tests.support.postures import stretched, wrist_on_axis_1

ARMS = {name: robots.load(name) for name in robots.names()}
EVERY_ARM = pytest.mark.parametrize("arm", ARMS.values(), ids=str)
REGULAR = np.array([0.3, -0.6, 1.2, 0.5, 0.9, -0.4])  # DH angles far from any singularity


def found(arm: robots.DhArm, **theta: float) -> robots.Coupling | None:
    angles = REGULAR.copy()
    angles[2] = stretched(arm) + 1.2
    for key, value in theta.items():
        angles[int(key[-1]) - 1] = value
    return robots.coupled(arm, arm.joint_angles(angles))


@pytest.mark.parametrize(
    ("name", "label", "joints"),
    [
        ("iust_6r", "2+3+4+6", (1, 2, 3, 5)),
        ("rv_3sd", "4+6", (3, 5)),
        ("rv_3sd_melfa", "4+6", (3, 5)),
    ],
)
@pytest.mark.parametrize(("theta5", "sense"), [(0.1, 1.0), (-0.19, 1.0), (np.pi - 0.1, -1.0)])
def test_a_straight_wrist_couples_the_joints_on_record(
    name: str, label: str, joints: tuple[int, ...], theta5: float, sense: float
) -> None:
    coupling = found(ARMS[name], theta5=theta5)
    assert (coupling.label, coupling.joints, coupling.factor) == (label, joints, "wrist")
    assert_allclose(coupling.value, abs(np.sin(theta5)))
    expected = np.zeros(6)
    expected[list(joints)] = 1.0
    expected[5] = sense
    assert_allclose(coupling.combination, expected)


@EVERY_ARM
def test_the_threshold_is_a_fifth(arm: robots.DhArm) -> None:
    assert found(arm, theta5=np.arcsin(0.199)) is not None
    assert found(arm, theta5=np.arcsin(0.201)) is None
    assert found(arm, theta3=stretched(arm) + np.arcsin(0.199)) is not None
    assert found(arm, theta3=stretched(arm) + np.arcsin(0.201)) is None


def self_motion(arm: robots.DhArm, q: Array) -> Array:
    """Directions of q that leave the flange still, by finite differences, not by `jacobian`."""
    nudges = 1e-6 * np.eye(6)
    apart = difference(robots.forward(arm, q + nudges), robots.forward(arm, q - nudges)) / 2e-6
    _, s, vt = np.linalg.svd(apart.T)
    return vt[s < 1e-5]


@EVERY_ARM
@pytest.mark.parametrize("factor", ["wrist", "elbow", "shoulder"])
def test_at_a_singularity_the_joints_are_those_that_its_self_motion_moves(
    arm: robots.DhArm, factor: str
) -> None:
    theta = REGULAR.copy()
    theta[2] = stretched(arm) + 1.2
    if factor == "wrist":
        theta[4] = 0.0
    elif factor == "elbow":
        theta[2] = stretched(arm)
    else:
        candidates = arm.theta(wrist_on_axis_1(arm, 200, 7))
        open_ = np.minimum(
            np.abs(np.sin(candidates[:, 4])), np.abs(np.sin(candidates[:, 2] - stretched(arm)))
        )
        theta = candidates[np.argmax(open_)]
    q = arm.joint_angles(theta)
    coupling = robots.coupled(arm, q)
    still = self_motion(arm, q)
    assert coupling.factor == factor
    assert len(still) == 1
    moving = np.flatnonzero(np.abs(still[0]) > 0.1 * np.abs(still[0]).max())
    assert set(moving) <= set(coupling.joints)
    assert np.abs(still[0][[j for j in range(6) if j not in coupling.joints]]).max(initial=0) < 0.1
    if coupling.combination is not None:
        assert abs(coupling.combination @ still[0]) < 1e-6


@EVERY_ARM
def test_two_singularities_at_once_are_merged(arm: robots.DhArm) -> None:
    coupling = found(arm, theta5=0.05, theta3=stretched(arm) + 0.05)
    assert coupling.factor == "wrist+elbow"
    alone = found(arm, theta5=0.05), found(arm, theta3=stretched(arm) + 0.05)
    wrist, elbow = (set(each.joints) for each in alone if each is not None)
    assert {1, 2} <= elbow
    assert wrist | {1, 2} <= set(coupling.joints)


@pytest.mark.parametrize("name", ["ur5", "kinova"])
def test_a_urdf_arms_coupled_sum_stays_put_where_its_joints_do_not(name: str) -> None:
    arm = robots.load(name)
    q = np.random.default_rng(1).uniform(
        np.maximum(arm.lower, -3), np.minimum(arm.upper, 3), (200, 6)
    )
    couplings = [(angles, robots.coupled(arm, angles)) for angles in q]
    near = [(angles, coupling) for angles, coupling in couplings if coupling is not None]
    assert 5 < len(near) < 100
    for angles, coupling in near:
        assert coupling.factor == "singular value"
        assert coupling.value < 0.1
        scaled = robots.jacobian(arm, angles)
        scaled[:3] /= 0.143
        spread = np.linalg.inv(scaled.T @ scaled)  # of q, the pose known to 1 in each direction
        assert max(np.sqrt(np.diag(spread))[list(coupling.joints)]) > 2
        if coupling.combination is not None:
            alone = np.sqrt(np.diag(spread))[list(coupling.joints)].max()
            assert np.sqrt(coupling.combination @ spread @ coupling.combination) < alone / 2


def test_the_ur5s_straight_wrist_couples_four_joints_and_seven_joints_always_are() -> None:
    coupling = robots.coupled(robots.load("ur5"), np.array([0.3, -1.2, 1.4, -0.9, 0.02, 0.4]))
    assert coupling.label == "2+3+4+6"
    assert coupling.combination is not None
    coupling = robots.coupled(robots.load("panda"), np.array([0.1, 0.2, 0.3, -1.5, 0.5, 1.6, 0.7]))
    assert coupling.factor == "redundancy"
    assert len(coupling.joints) >= 3


@pytest.mark.parametrize("name", ["iust_6r", "rv_3sd", "ur5"])
def test_many_postures_at_once_are_coupled_as_each_alone(name: str) -> None:
    arm = robots.load(name)
    q = np.random.default_rng(4).uniform(-2.5, 2.5, (300, arm.dof))
    if arm.dof == 6:
        q[::3, 4] *= 0.1
    together, alone = robots.couplings(arm, q), [robots.coupled(arm, one) for one in q]
    labels = [found and (found.label, found.factor, found.value) for found in together]
    assert labels == [found and (found.label, found.factor, found.value) for found in alone]
    assert 0 < sum(found is not None for found in together) < len(q)
    assert robots.couplings(arm, q[:0]) == ()
