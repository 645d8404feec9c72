"""The grasping paper's kinematics, Eqs 17-34, as printed: right ones right, misprints wrong.

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


def rows(*entries: tuple[Array | float, ...]) -> Array:
    zero = np.zeros(THETA.shape[1])
    return np.moveaxis(np.array([[zero + entry for entry in row] for row in entries]), -1, 0)


C, S = cos(THETA), sin(THETA)
LAST = (0, 0, 0, 1)
PRINTED = [  # Eqs 18 and 19, with s1 and c1 in the fifth as they stand
    rows((C[0], 0, -S[0], L10 * C[0]), (S[0], 0, C[0], L10 * S[0]), (0, -1, 0, L11), LAST),
    rows((C[1], -S[1], 0, L2 * C[1]), (S[1], C[1], 0, L2 * S[1]), (0, 0, 1, 0), LAST),
    rows((C[2], 0, S[2], L30 * C[2]), (S[2], 0, -C[2], L30 * S[2]), (0, 1, 0, 0), LAST),
    rows((C[3], 0, -S[3], 0), (S[3], 0, C[3], 0), (0, -1, 0, L31), LAST),
    rows((C[4], 0, S[0], 0), (S[4], 0, -C[0], 0), (0, 1, 0, 0), LAST),
    rows((C[5], -S[5], 0, 0), (S[5], C[5], 0, 0), (0, 0, 1, D6), LAST),
]
MENDED_FIFTH = rows((C[4], 0, S[4], 0), (S[4], 0, -C[4], 0), (0, 1, 0, 0), LAST)


@pytest.mark.parametrize(("name", "arm"), [("rv_3sd", "table"), ("rv_3sd_melfa", "elbow_up")])
def test_our_tables_are_these_two_arms(name: str, arm: str) -> None:
    ours = robots.load(name)
    found = robots.forward(ours, ours.joint_angles(THETA.T))
    found[:, :3, 3] *= 1000
    assert_allclose(found, pose(THETA, arm), atol=SAME)


@pytest.mark.parametrize("joint", [0, 1, 2, 3, 5])
def test_the_matrices_of_eqs_18_and_19_are_table_1_in_standard_dh(joint: int) -> None:
    assert_allclose(PRINTED[joint], links(THETA, "table")[joint], atol=1e-15 * L11)


def test_eq_19s_second_matrix_means_theta5_where_it_prints_theta1() -> None:
    true = links(THETA, "table")[4]
    assert np.abs(PRINTED[4] - true).max(axis=(1, 2)).min() > 0
    assert np.median(np.abs(np.linalg.det(PRINTED[4][:, :3, :3]) - 1)) > 0.1  # not a rotation
    assert_allclose(MENDED_FIFTH, true, atol=1e-15)


def test_eq_17_is_the_product_and_its_third_row_ends_in_vz() -> None:
    product = reduce(np.matmul, [*PRINTED[:4], MENDED_FIFTH, PRINTED[5]])
    assert_allclose(product, pose(THETA, "table"), atol=SAME)
    rotation = product[:, :3, :3].copy()
    rotation[:, 2, 1] = rotation[:, 1, 1]  # vy in the third row, as printed
    assert np.median(np.abs(np.linalg.det(rotation) - 1)) > 0.1


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


def test_eq_21_holds_for_the_wrist_not_for_the_tip() -> None:
    wrist, tip = arctan2(WRIST[1], WRIST[0]), arctan2(FLANGE[1], FLANGE[0])
    either = np.minimum(turned_by(wrist, JOINTS[0]), turned_by(wrist + pi, JOINTS[0]))
    assert either.max() < 1e-7
    missed = np.minimum(turned_by(tip, JOINTS[0]), turned_by(tip + pi, JOINTS[0]))
    assert 3 < np.degrees(np.median(missed)) < 12  # 7° over the joint range, on record
    assert (missed < 1e-6).mean() < 0.01


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


# Eqs 30-34: the wrist, with Table 1's twists; Z'' in the forearm's frame is (u, v, w)
FOREARM = reduce(np.matmul, links(THETA, "table")[:3])
U, V, W = np.einsum("mji,mj->im", FOREARM[:, :3, :3], pose(THETA, "table")[:, :3, 2])


def test_eq_30_holds_for_a_positive_theta5_and_is_half_a_turn_off_for_a_negative_one() -> None:
    theta4 = arctan2(V, U)
    positive = THETA[4] > 0
    assert turned_by(theta4, THETA[3])[positive].max() < 1e-6
    assert turned_by(theta4 + pi, THETA[3])[~positive].max() < 1e-6


def test_eqs_31_to_33_never_see_the_sign_of_theta5() -> None:
    turn = rows((C[3], -S[3], 0), (S[3], C[3], 0), (0, 0, 1))  # Eq 34
    theta5_1 = arccos(np.clip(W, -1, 1))  # Eq 32
    theta5_2 = arccos(np.clip(np.sum((turn @ [0, 0, 1]).T * [U, V, W], axis=0), -1, 1))  # Eq 33
    assert_allclose(theta5_1, theta5_2, atol=1e-7)
    printed = np.where(theta5_2 > pi / 2, -theta5_1, theta5_1)  # Eq 31
    assert (turned_by(printed, THETA[4]) > 0.1).mean() > 0.3
    sideways = arccos(np.clip(np.sum((turn @ [1, 0, 0]).T * [U, V, W], axis=0), -1, 1))
    mended = np.where(sideways > pi / 2, -theta5_1, theta5_1)
    assert turned_by(mended, THETA[4]).max() < 1e-6
    plainly = arctan2(U * C[3] + V * S[3], W)
    assert turned_by(plainly, THETA[4]).max() < 1e-12
