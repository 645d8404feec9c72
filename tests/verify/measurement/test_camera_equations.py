"""The 6R paper's stereo equations, mended, are this triangulation; as printed they are not.

Korayem et al. 2018, eqs. 7 and 8; truth is OpenCV's pinhole. Its image is inverted, in the plane
z = 0 of a local frame whose lens stands at z = F; its rotating base turns that frame. Lengths in
mm.
"""

# The equations keep the papers' own letters, capitals among them.
# ruff: noqa: N802, N803, N806

from dataclasses import dataclass

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from verify.core.records import Array
from verify.core.rig import Camera
from verify.measurement.triangulation import triangulate

PIXEL = 0.003  # mm, the camera table's pixel pitch
PLAINLY = 1e-3  # mm, what an equation that is wrong is off by at the least; a right one 1e-9


def project(points: Array, rotation_vector: Array, offset: Array, matrix: Array) -> Array:
    """OpenCV's image (n, 2) without a lens."""
    pixels = cv2.projectPoints(points, rotation_vector, offset, matrix, np.zeros(5))[0]
    return np.asarray(pixels, dtype=float).reshape(-1, 2)


@dataclass
class Station:
    """One of the 6R paper's cameras."""

    F: float  # mm
    beta: float  # rad
    C: Array  # mm, centre of the local frame in the global one

    @property
    def rotation(self) -> Array:
        """RotY(beta), by OpenCV."""
        return np.asarray(cv2.Rodrigues(np.array([0, self.beta, 0]))[0], dtype=float)

    @property
    def lens(self) -> Array:
        return self.C + self.rotation[:, 2] * self.F

    def image(self, points: Array) -> tuple[Array, Array]:
        """The paper's u, v in mm of global points (n, 3): OpenCV's image, turned upside down."""
        vector = np.array([0, -self.beta, 0])
        matrix = np.diag([self.F, self.F, 1.0])
        offset = -self.rotation.T @ self.lens
        upright = project(points, vector, offset, matrix)
        return -upright[:, 0], -upright[:, 1]


@dataclass
class Pair:
    one: Station
    two: Station
    points: Array  # (n, 3), mm, global


@pytest.fixture(params=range(10))
def pair(request: pytest.FixtureRequest) -> Pair:
    """Unequal cameras, centres out of line, bases toed in, points before both."""
    rng = np.random.default_rng(request.param)
    one = Station(
        rng.uniform(3, 6), rng.uniform(0.05, 0.4), np.array([-60.0, *rng.normal(0, 5, 2)])
    )
    two = Station(
        rng.uniform(3, 6), -rng.uniform(0.05, 0.4), np.array([60.0, *rng.normal(0, 5, 2)])
    )
    return Pair(one, two, rng.uniform([-80, -80, 500], [80, 80, 900], (20, 3)))


def plainly_wrong(found: Array, truth: Array) -> bool:
    return float(np.median(np.abs(found - truth))) > PLAINLY


def test_triangulation_is_eqs_7_and_8_mended_and_not_as_printed(pair: Pair) -> None:
    views = []
    for station in (pair.one, pair.two):
        focal = station.F / PIXEL
        matrix = np.array([[focal, 0, 639.5], [0, focal, 359.5], [0, 0, 1]])
        axis = np.array([0.0, 1.0, 0.0])
        camera = Camera(matrix, np.zeros(5), station.lens / 1000, axis, 0.0, np.eye(4))
        pixels = np.stack(station.image(pair.points), axis=1) / -PIXEL + [639.5, 359.5]
        views.append((camera, station.beta, pixels))
    (left, pan_left, left_px), (right, pan_right, right_px) = views
    found, _ = triangulate(left, right, pan_left, pan_right, left_px, right_px)
    assert_allclose(found * 1000, pair.points, rtol=1e-9, atol=1e-9)
    Z = eq7_Z(pair, pair.points[:, 0])
    assert_allclose(Z["mended"], pair.points[:, 2], rtol=1e-9)
    assert plainly_wrong(Z["printed first term"], pair.points[:, 2])
    assert plainly_wrong(Z["printed m2"], pair.points[:, 2])


def m_n(station: Station, u: Array) -> tuple[Array, Array]:
    """Eq. 8 as printed for camera 1; mended for camera 2."""
    c, s = np.cos(station.beta), np.sin(station.beta)
    return station.F * c + u * s, u * c - station.F * s


def eq7_Z(pair: Pair, X: Array) -> dict[str, Array]:
    F1, F2 = pair.one.F, pair.two.F
    (X1, _, Z1), (X2, _, Z2) = -pair.one.C, -pair.two.C
    u1, u2 = pair.one.image(pair.points)[0], pair.two.image(pair.points)[0]
    (m1, n1), (m2, n2) = m_n(pair.one, u1), m_n(pair.two, u2)
    printed_m2 = F2 * np.cos(pair.two.beta) - u2 * np.sin(pair.two.beta)

    def Z(first: Array | float, m2: Array) -> Array:
        top = m1 * m2 * first + m1 * F2 * u2 - m2 * F1 * u1 + m2 * n1 * Z1 - m1 * n2 * Z2
        return np.asarray(top / (m1 * n2 - m2 * n1))

    return {
        "mended": Z(X1 - X2, m2),
        "printed first term": Z(X - X1, m2),
        "printed m2": Z(X1 - X2, printed_m2),
    }
