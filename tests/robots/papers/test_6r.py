"""The 6R paper's kinematics as printed: what is right shown right, each misprint shown wrong.

Korayem et al. (2018), section 4, on random angles; the truth is the product of the six DH matrices
of Table 2, multiplied here and nowhere else. Angles come as columns (6, m).
"""

from functools import reduce

import numpy as np
from numpy import arctan2, cos, hypot, sin, sqrt
from numpy.testing import assert_allclose

import robots
from robots.transforms import Array
from tests.support.postures import link, turned_by

A1, A2, A3, A4, D1, D6 = 36.5, 251.5, 125.0, 92.0, 438.0, 152.8  # Table 2, mm
TABLE = [(A1, D1, -1), (A2, 0, 0), (A3, 0, 0), (A4, 0, 1), (0, 0, -1), (0, D6, 0)]  # a, d, α / 90°
THETA = np.random.default_rng(1).uniform(-2.9, 2.9, (6, 3000))
SAME = 1e-9  # mm or rad: rounding of products of lengths near 500


def table_2(theta: Array) -> Array:
    return reduce(np.matmul, [link(t, *row) for t, row in zip(theta, TABLE, strict=True)])


POSE = table_2(THETA)
N, ORIENT, A, P = (POSE[:, :3, i].T for i in range(4))
C1, C2, _, _, C5, C6 = cos(THETA)
S1, S2, _, _, S5, S6 = sin(THETA)
C23, S23 = cos(THETA[1] + THETA[2]), sin(THETA[1] + THETA[2])
C234, S234 = cos(THETA[1:4].sum(axis=0)), sin(THETA[1:4].sum(axis=0))


def test_our_table_is_the_papers() -> None:
    ours = robots.forward(robots.load("iust_6r"), THETA.T)
    assert_allclose(ours[:, :3, :3], POSE[:, :3, :3], atol=1e-14)
    assert_allclose(ours[:, :3, 3] * 1000, POSE[:, :3, 3], atol=SAME)


def test_table_2_read_as_modified_dh_does_not_reproduce_the_printed_position() -> None:
    def modified(theta: Array, a: float, d: float, quarter: int) -> Array:
        return link(np.zeros_like(theta), a, 0, quarter) @ link(theta, 0, d, 0)

    pose = reduce(np.matmul, [modified(t, *row) for t, row in zip(THETA, TABLE, strict=True)])
    assert np.median(np.abs(pose[:, :3, 3] - POSE[:, :3, 3])) > 10  # mm


LEVER = A4 - D6 * S5
RHO = A1 + A2 * C2 + A3 * C23 + C234 * LEVER
T06 = [  # nx, ox, ax, px and so on
    [-C6 * S1 * S5 + C1 * (C234 * C5 * C6 - S234 * S6),
     S1 * S5 * S6 - C1 * (C6 * S234 + C234 * C5 * S6),
     -C5 * S1 - C1 * C234 * S5, -D6 * C5 * S1 + C1 * RHO],
    [C234 * C5 * C6 * S1 + C1 * C6 * S5 - S1 * S234 * S6,
     -C6 * S1 * S234 - (C234 * C5 * S1 + C1 * S5) * S6,
     C1 * C5 + C234 * S1 * S5, D6 * C1 * C5 + S1 * RHO],
    [-C5 * C6 * S234 - C234 * S6, -C234 * C6 + C5 * S234 * S6,
     S234 * S5, D1 - A2 * S2 - A3 * S23 - S234 * LEVER],
]  # fmt: skip


def test_the_entries_of_t06_are_right_but_for_the_second_sign_of_ay() -> None:
    off = np.abs(np.moveaxis(np.array(T06), -1, 0) - POSE[:, :3])
    assert np.argwhere(off.max(axis=0) > SAME).tolist() == [[1, 2]]
    assert np.median(off[:, 1, 2]) > 0.1
    assert np.median(np.abs(A[0] ** 2 + T06[1][2] ** 2 + A[2] ** 2 - 1)) > 0.1  # no unit vector
    assert_allclose(C1 * C5 - C234 * S1 * S5, A[1], atol=SAME)


WRIST = P - D6 * A


def test_theta1_needs_the_quadrant_and_its_opposite() -> None:
    ratio = np.arctan(WRIST[1] / WRIST[0])
    one = arctan2(WRIST[1], WRIST[0])
    assert 0.2 < (turned_by(ratio, THETA[0]) < SAME).mean() < 0.8
    assert 0.2 < (turned_by(one, THETA[0]) < SAME).mean() < 0.8
    either = np.minimum(turned_by(one, THETA[0]), turned_by(one + np.pi, THETA[0]))
    assert either.max() < 1e-7


def test_theta5_is_right_with_two_arguments_but_its_root_loses_digits() -> None:
    cosine = A[1] * C1 - A[0] * S1
    printed = arctan2(np.sign(S5) * D6 * sqrt(1 - np.minimum(cosine**2, 1)), P[1] * C1 - P[0] * S1)
    assert turned_by(printed, THETA[4]).max() < 1e-6
    better = arctan2(np.sign(S5) * hypot(A[0] * C1 + A[1] * S1, A[2]), cosine)
    assert turned_by(better, THETA[4]).max() < 1e-13
    assert turned_by(printed, THETA[4]).max() > 100 * turned_by(better, THETA[4]).max()


def test_theta234_as_printed_belongs_to_a_negative_theta5() -> None:
    sum_234 = THETA[1:4].sum(axis=0)
    along = A[0] * C1 + A[1] * S1
    printed, mended = arctan2(-A[2], along), arctan2(A[2], -along)
    positive = S5 > 0
    assert turned_by(printed, sum_234)[positive].min() > 3.1  # half a turn off, always
    assert turned_by(mended, sum_234)[positive].max() < 1e-11
    assert turned_by(mended + np.pi, sum_234)[~positive].max() < 1e-11
    assert turned_by(printed, sum_234)[~positive].max() < 1e-11


def test_theta6_is_right_with_two_arguments() -> None:
    printed = arctan2(ORIENT[0] * S1 - ORIENT[1] * C1, N[1] * C1 - N[0] * S1)
    printed = np.where(S5 > 0, printed, printed + np.pi)
    assert turned_by(printed, THETA[5]).max() < 1e-11


T_TRUE = A2 * C2 + A3 * C23
U_TRUE = A2 * S2 + A3 * S23


def test_t_lacks_a1_and_u_is_right() -> None:
    printed = C1 * P[0] + S1 * P[1] + D6 * S5 * C234 - A4 * C234
    assert_allclose(printed - T_TRUE, A1, atol=SAME)
    assert_allclose(-P[2] + D1 - A4 * S234 + D6 * S5 * S234, U_TRUE, atol=SAME)


def test_w_means_a2_squared_where_it_prints_a_squared() -> None:
    square = T_TRUE**2 + U_TRUE**2
    mended = (-(A3**2) + square + A2**2) / (2 * A2)
    azimuth = arctan2(U_TRUE, T_TRUE)
    assert_allclose(mended, sqrt(square) * cos(THETA[1] - azimuth), atol=SAME)
    for a in (A1, A3, A4):  # no other length can be meant
        other = (-(A3**2) + square + a**2) / (2 * A2)
        assert np.abs(other - mended).min() > 50


def test_theta2_theta3_and_theta4_are_right_with_two_arguments() -> None:
    square = T_TRUE**2 + U_TRUE**2
    ratio = np.clip((-(A3**2) + square + A2**2) / (2 * A2) / sqrt(square), -1, 1)
    root = sqrt(1 - ratio**2)
    seen = np.zeros(THETA.shape[1], dtype=bool)
    for sign in (1, -1):
        theta2 = arctan2(sign * root, ratio) + arctan2(U_TRUE, T_TRUE)
        theta3 = arctan2(U_TRUE - A2 * sin(theta2), T_TRUE - A2 * cos(theta2)) - theta2
        theta4 = THETA[1:4].sum(axis=0) - theta2 - theta3
        away = np.max(
            [turned_by(t, THETA[i]) for i, t in ((1, theta2), (2, theta3), (3, theta4))], axis=0
        )
        seen |= away < 1e-5
    assert seen.all()


FORE = A3 * S23 + S234 * LEVER
ZERO, ONE = np.zeros_like(C1), np.ones_like(C1)
PRINTED_J = [
    [-D6 * C1 * C5 - S1 * RHO, -C1 * (A2 * S2 + FORE), -C1 * FORE, C1 * S234 * -LEVER,
     -D6 * C1 * C234 * C5 + D6 * S1 * S5, ZERO],
    [-D6 * S1 * C5 + C1 * RHO, -S1 * (A2 * S2 + FORE), -S1 * FORE, S1 * S234 * -LEVER,
     -D6 * (C234 * C5 * S1 + C1 * S5), ZERO],
    [ZERO, -A2 * C2 - A3 * C23 - C234 * LEVER, -A3 * C23 - C234 * LEVER, -C234 * LEVER,
     D6 * C5 * S234, ZERO],
    [ZERO, -S1, -S1, -S1, C1 * S234, -C5 * S1 - C1 * C234 * S5],
    [ZERO, C1, C1, C1, S1 * S234, C1 * C5 - C234 * S1 * S5],
    [ONE, ZERO, ZERO, ZERO, C234, S234 * S5],
]  # fmt: skip


def test_the_entries_of_j_are_right_and_ours() -> None:
    ours = robots.jacobian(robots.load("iust_6r"), THETA.T)
    ours[:, :3] *= 1000
    assert_allclose(ours, np.moveaxis(np.array(PRINTED_J), -1, 0), atol=SAME)


def test_det_j_is_the_product_on_record() -> None:
    wrist = A1 + A2 * C2 + A3 * C23 + A4 * C234
    found = np.linalg.det(np.moveaxis(np.array(PRINTED_J), -1, 0))
    assert_allclose(found, -A2 * A3 * sin(THETA[2]) * S5 * wrist, rtol=1e-6, atol=1)
