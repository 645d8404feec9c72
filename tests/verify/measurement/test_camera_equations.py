"""The 6R paper's stereo equations, mended, are this triangulation; as printed they are not.

Korayem et al. 2018, eqs. 7 and 8; truth is OpenCV's pinhole. Its image is inverted, in the plane
z = 0 of a local frame whose lens stands at z = F; its rotating base turns that frame. Lengths in
mm.
"""

# The equations keep the papers' own letters, capitals among them.
# ruff: noqa: N806

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.support.scene import project
from verify.core.records import Array
from verify.core.rig import Camera
from verify.measurement.triangulation import triangulate

PIXEL = 0.003  # mm, the camera table's pixel pitch
CENTRE = np.array([639.5, 359.5])  # px
PLAINLY = 1e-3  # mm, what an equation that is wrong is off by at the least; a right one 1e-9


@dataclass
class Station:
    """One of the 6R paper's cameras, at some points (n, 3), mm, global."""

    F: float  # mm
    beta: float  # rad
    C: Array  # mm, centre of the local frame in the global one
    points: Array

    @property
    def camera(self) -> Camera:
        lens = self.C + self.F * np.array([np.sin(self.beta), 0, np.cos(self.beta)])
        matrix = np.diag([self.F / PIXEL, self.F / PIXEL, 1.0])
        matrix[:2, 2] = CENTRE
        return Camera(matrix, np.zeros(5), lens / 1000, np.array([0.0, 1.0, 0.0]), 0.0, np.eye(4))

    @property
    def pixels(self) -> Array:
        return project(self.camera, self.beta, self.points / 1000)

    def u_m_n(self) -> tuple[Array, Array, Array]:
        """The paper's u, mm, OpenCV's image turned upside down; eq. 8, for camera 2 mended."""
        u = -PIXEL * (self.pixels - CENTRE)[:, 0]
        c, s = np.cos(self.beta), np.sin(self.beta)
        return u, self.F * c + u * s, u * c - self.F * s


@pytest.mark.parametrize("seed", range(10))
def test_triangulation_is_eqs_7_and_8_mended_and_not_as_printed(seed: int) -> None:
    """Unequal cameras, centres out of line, bases toed in, points before both."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([-80, -80, 500], [80, 80, 900], (20, 3))
    one, two = (
        Station(
            rng.uniform(3, 6), sign * rng.uniform(0.05, 0.4),
            np.array([-sign * 60.0, *rng.normal(0, 5, 2)]), points,
        )
        for sign in (1, -1)
    )  # fmt: skip
    bases = one.beta, two.beta
    found, _ = triangulate(one.camera, two.camera, *bases, one.pixels, two.pixels)
    assert_allclose(found * 1000, points, rtol=1e-9, atol=1e-9)

    (X1, _, Z1), (X2, _, Z2) = -one.C, -two.C
    (u1, m1, n1), (u2, m2, n2) = one.u_m_n(), two.u_m_n()

    def off(first: Array | float, m2: Array) -> float:
        """Median error of eq. 7's Z."""
        top = m1 * m2 * first + m1 * two.F * u2 - m2 * one.F * u1 + m2 * n1 * Z1 - m1 * n2 * Z2
        return float(np.median(np.abs(top / (m1 * n2 - m2 * n1) - points[:, 2])))

    assert off(X1 - X2, m2) < 1e-6
    assert off(points[:, 0] - X1, m2) > PLAINLY  # its first term as printed
    printed_m2 = two.F * np.cos(two.beta) - u2 * np.sin(two.beta)
    assert off(X1 - X2, printed_m2) > PLAINLY
