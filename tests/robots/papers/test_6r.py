"""The 6R paper's table and Jacobian, as printed, are ours; its misprints: docs/arms.md.

Korayem et al. (2018), section 4, on random angles; the truth is the product of the six DH matrices
of Table 2, multiplied here and nowhere else. Angles come as columns (6, m).
"""

from functools import reduce

import numpy as np
from numpy import cos, sin
from numpy.testing import assert_allclose

import robots
from robots.transforms import Array
from tests.support.postures import link

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


LEVER = A4 - D6 * S5
RHO = A1 + A2 * C2 + A3 * C23 + C234 * LEVER
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
