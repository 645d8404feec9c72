"""The grasping paper's two arms are ours, and its Eqs 22 and 23 belong to the second one.

Truth is the product of the DH matrices of Table 1, and of the same with the twists of joints 3, 4
and 5 negated; lengths in mm. Angles come as columns (6, m).
"""

from functools import reduce

import numpy as np
import pytest
from numpy import arccos, arctan2, cos, hypot, pi, sin, sqrt
from numpy.testing import assert_allclose

import robots
from robots.transforms import Array
from tests.support.postures import link, turned_by

L10, L11, L2, L30, L31, D6 = 95.0, 350.0, 245.0, 135.0, 270.0, 85.0  # Tables 1 and 2
R1, R2 = L2, hypot(L30, L31)  # Eqs 28, 29
TWISTS = {"table": (-1, 0, 1, -1, 1, 0), "elbow_up": (-1, 0, -1, 1, -1, 0)}  # α / 90°
LENGTHS = [(L10, L11), (L2, 0), (L30, 0), (0, L31), (0, 0), (0, D6)]  # a, d
LOWER = np.radians([-170, -90, -20, -160, -120, -360])[:, None]  # Table 1
UPPER = np.radians([170, 135, 171, 160, 120, 360])[:, None]
THETA = np.random.default_rng(1).uniform(LOWER, UPPER, (6, 3000))
SAME = 1e-9  # mm or rad


def links(theta: Array, arm: str) -> list[Array]:
    rows = zip(theta, LENGTHS, TWISTS[arm], strict=True)
    return [link(t, a, d, quarter) for t, (a, d), quarter in rows]


def pose(theta: Array, arm: str) -> Array:
    return reduce(np.matmul, links(theta, arm))


@pytest.mark.parametrize(("name", "arm"), [("rv_3sd", "table"), ("rv_3sd_melfa", "elbow_up")])
def test_our_tables_are_these_two_arms(name: str, arm: str) -> None:
    ours = robots.load(name)
    found = robots.forward(ours, ours.joint_angles(THETA.T))
    found[:, :3, 3] *= 1000
    assert_allclose(found, pose(THETA, arm), atol=SAME)


# Eqs 21-29 solve the elbow-up arm in the machine's angles J2 = θ2 + 90°, J3 = θ3 + 90°.
JOINTS = np.random.default_rng(2).uniform(LOWER, UPPER, (6, 3000))
SHIFT = np.radians([0, -90, -90, 0, 0, 0])[:, None]
REACHED = pose(JOINTS + SHIFT, "elbow_up")
FLANGE = REACHED[:, :3, 3].T
WRIST = FLANGE - D6 * REACHED[:, :3, 2].T  # E
P = WRIST[0] * cos(JOINTS[0]) + WRIST[1] * sin(JOINTS[0]) - L10
Q = WRIST[2] - L11
CBE = arccos(np.clip((R1**2 + P**2 + Q**2 - R2**2) / (2 * sqrt(P**2 + Q**2) * R1), -1, 1))  # 24
ELEVATION = arctan2(Q, P)  # Eq 25
BCE = arccos(np.clip((R1**2 + R2**2 - (P**2 + Q**2)) / (2 * R2 * R1), -1, 1))  # Eq 26
E = arctan2(L30, L31)  # Eq 27
UP = sin(JOINTS[2] - E) > 0  # the elbow is above the line from shoulder to wrist


def test_eq_22_elbow_up_gives_the_machines_j2() -> None:
    assert turned_by(pi / 2 - (CBE + ELEVATION), JOINTS[1])[UP].max() < 1e-6


def test_eq_22_elbow_down_is_wrong_and_subtracts_the_angle_instead() -> None:
    up = pi / 2 - (CBE + ELEVATION)
    assert np.median(turned_by(-up, JOINTS[1])[~UP]) > 0.1
    assert turned_by(pi / 2 - (ELEVATION - CBE), JOINTS[1])[~UP].max() < 1e-6


def test_eq_23_gives_the_machines_j3_elbow_up_alone() -> None:
    assert turned_by(pi - BCE + E, JOINTS[2])[UP].max() < 1e-6
    assert np.median(turned_by(pi - BCE + E, JOINTS[2])[~UP]) > 0.1
    assert turned_by(BCE - pi + E, JOINTS[2])[~UP].max() < 1e-6


@pytest.mark.parametrize("j2_zero", [0, -90])
@pytest.mark.parametrize("j3_zero", [-90, 0, 90])
def test_table_1_does_not_carry_eqs_22_and_23_with_right_angle_zeros(
    j2_zero: float, j3_zero: float
) -> None:
    theta = JOINTS + np.radians([0, j2_zero, j3_zero, 0, 0, 0])[:, None]
    there = pose(theta, "table")
    wrist = there[:, :3, 3] - D6 * there[:, :3, 2]
    assert np.linalg.norm(wrist.T - WRIST, axis=0).max() > 150  # mm


def test_table_1_carries_them_with_a_zero_of_no_mechanical_meaning() -> None:
    zero = np.array([0, -pi / 2, pi / 2 - 2 * E, 0, 0, 0])[:, None]
    assert_allclose(np.degrees(pi / 2 - 2 * E), 36.870, atol=5e-4)
    there = pose(JOINTS + zero, "table")
    assert_allclose((there[:, :3, 3] - D6 * there[:, :3, 2]).T, WRIST, atol=SAME)
