"""The two papers' stereo and hue equations: what is printed right is shown right, each misprint
shown wrong and its mended form right. Truth is OpenCV's pinhole and colour conversion.

6R: Korayem et al. 2018, eqs. 1-10. Its image is inverted, in the plane z = 0 of a local frame whose
lens stands at z = F; its rotating base turns that frame. Lengths in mm, as there.
Grasping: the RV-3SD paper, eqs. 3-7, 9 and 10.
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


def local(station: Station, points: Array) -> Array:
    return (points - station.C) @ station.rotation


def printed_eq4(beta: float) -> Array:
    return np.array([[np.cos(beta), 0, np.sin(beta)], [0, 1, 0], [np.sin(beta), 0, np.cos(beta)]])


def eq6(station: Station, xyz: Array) -> tuple[Array, Array]:
    scale = -station.F / (xyz[:, 2] - station.F)
    return xyz[:, 0] * scale, xyz[:, 1] * scale


def plainly_wrong(found: Array, truth: Array) -> bool:
    return float(np.median(np.abs(found - truth))) > PLAINLY


class TestKorayem:
    def test_eq_1_mended_places_the_local_frame_and_eq_6_is_the_pinhole(self, pair: Pair) -> None:
        for camera in (pair.one, pair.two):
            homogeneous = np.eye(4)  # eqs. 2 and 3: lower case local, upper case global
            homogeneous[:3, :3], homogeneous[:3, 3] = camera.rotation, camera.C
            P = np.linalg.solve(homogeneous, np.c_[pair.points, np.ones(len(pair.points))].T).T
            assert_allclose(eq6(camera, P[:, :3]), camera.image(pair.points), rtol=0, atol=1e-9)
            assert_allclose(P[:, 3], 1, atol=1e-12)

    def test_eq_1_and_5_as_printed_miss_the_image(self, pair: Pair) -> None:
        # M = R T P with the mended R, T carrying +X0 "the position of the local centre"
        for rotation in (pair.one.rotation, pair.one.rotation.T, printed_eq4(pair.one.beta)):
            P = pair.points @ np.linalg.inv(rotation).T - pair.one.C
            assert plainly_wrong(eq6(pair.one, P)[0], pair.one.image(pair.points)[0])

    def test_eq_4_as_printed_is_no_rotation_and_mended_it_is_the_inverse_turn(
        self, pair: Pair
    ) -> None:
        beta = pair.one.beta
        printed = printed_eq4(beta)
        assert_allclose(np.linalg.det(printed), np.cos(2 * beta), atol=1e-12)
        assert np.abs(printed @ printed.T - np.eye(3)).max() > 0.05
        mended = printed * np.array([[1, 1, -1], [1, 1, 1], [1, 1, 1]])
        assert_allclose(mended, pair.one.rotation.T, atol=1e-12)

    def test_eq_7_X_is_right(self, pair: Pair) -> None:
        u1, _ = pair.one.image(pair.points)
        m1, n1 = m_n(pair.one, u1)
        X0, _, Z0 = -pair.one.C
        X = (u1 * pair.one.F - m1 * X0 - n1 * (pair.points[:, 2] + Z0)) / m1
        assert_allclose(X, pair.points[:, 0], atol=1e-9)

    def test_eq_7_Y_needs_plus_signs_in_the_bracket(self, pair: Pair) -> None:
        _, v1 = pair.one.image(pair.points)
        X, Y, Z = pair.points.T
        X0, Y0, Z0 = -pair.one.C
        s, c = np.sin(pair.one.beta), np.cos(pair.one.beta)
        mended = v1 - Y0 - v1 / pair.one.F * ((X + X0) * s + (Z + Z0) * c)
        printed = v1 - Y0 - v1 / pair.one.F * ((X - X0) * s + (Z - Z0) * c)
        assert_allclose(mended, Y, atol=1e-9)
        assert plainly_wrong(printed, Y)

    def test_eq_7_Z_needs_the_difference_of_the_centres(self, pair: Pair) -> None:
        Z = eq7_Z(pair, pair.points[:, 0])
        assert_allclose(Z["mended"], pair.points[:, 2], rtol=1e-9)
        assert plainly_wrong(Z["printed first term"], pair.points[:, 2])

    def test_eq_8_m2_needs_a_plus_sign(self, pair: Pair) -> None:
        Z = eq7_Z(pair, pair.points[:, 0])
        assert plainly_wrong(Z["printed m2"], pair.points[:, 2])
        # m = F c + u s and n = u c - F s are F times the ray's z and -x: right for m1, n1, n2
        for camera in (pair.one, pair.two):
            u, _ = camera.image(pair.points)
            ray = pair.points - camera.lens
            m, n = m_n(camera, u)
            assert_allclose(-n / m, ray[:, 0] / ray[:, 2], atol=1e-12)

    def test_eq_9_as_printed_has_no_disparity_and_eq_10_needs_it(self) -> None:
        F = 4.0
        # eq. 9 prints X01 = X02 = B / 2: both cameras in one place
        (u1, v1), (u2, _) = (
            Station(F, 0.0, np.array([x, 0, 0])).image(POINTS) for x in (-B / 2, B / 2)
        )
        Z = F - B * F / (u1 - u2)
        assert_allclose(Z, POINTS[:, 2], rtol=1e-12)
        assert_allclose((F - Z) / F * u1 - B / 2, POINTS[:, 0], atol=1e-9)
        assert_allclose((F - Z) / F * v1, POINTS[:, 1], atol=1e-9)

    def test_triangulation_of_the_code_is_eqs_7_and_8_mended(self, pair: Pair) -> None:
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
        X, Z = found[:, 0] * 1000, found[:, 2] * 1000
        assert_allclose(Z, eq7_Z(pair, pair.points[:, 0])["mended"], rtol=1e-9)
        assert_allclose(X, pair.points[:, 0], atol=1e-9)


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


B, FOCAL = 120.0, 1000.0  # mm, px, of the grasping paper's parallel cameras
POINTS = np.random.default_rng(0).uniform([-80, -80, 500], [200, 80, 900], (20, 3))


class TestGrasping:
    def test_eqs_3_to_5_hold_with_x2_counted_inward_and_the_difference_otherwise(self) -> None:
        matrix, Z = np.diag([FOCAL, FOCAL, 1.0]), POINTS[:, 2]
        x1, x2 = (
            project(POINTS, np.zeros(3), np.array([-x, 0, 0]), matrix)[:, 0] for x in (0.0, B)
        )
        inward = -x2
        assert_allclose((B - POINTS[:, 0]) / inward, Z / FOCAL, rtol=1e-9)
        assert_allclose(Z / FOCAL * x1 + Z / FOCAL * inward, B, rtol=1e-9)
        assert_allclose(B * FOCAL / (x1 - x2), Z, rtol=1e-9)
        assert plainly_wrong(B * FOCAL / (x1 + x2), Z)

    def test_eq_6_projects_and_eq_7_as_printed_is_no_rotation(self) -> None:
        vector, center = np.array([0.1, -0.2, 0.3]), np.array([30.0, -20.0, 10.0])
        K = np.array([[1000.0, 0, 640], [0, 1001, 360], [0, 0, 1]])
        R = np.asarray(cv2.Rodrigues(vector)[0], dtype=float)
        pixels = project(POINTS, vector, -R @ center, K)
        printed = R.T.copy()
        printed[1, 2] = R[2, 0]  # r31 where r32 belongs
        assert np.abs(printed @ printed.T - np.eye(3)).max() > 0.01
        for rotation, right in ((R, True), (printed, False), (R.T, False)):
            u, v, w = K @ np.c_[rotation, -R @ center] @ np.c_[POINTS, np.ones(20)].T
            if right:
                assert_allclose(np.c_[u / w, v / w], pixels, rtol=1e-10)
            else:
                assert plainly_wrong(np.c_[u / w, v / w], pixels)

    def test_eq_10_with_its_root_over_all_is_the_geometric_hue_near_the_hexagonal(self) -> None:
        R, G, B = np.random.default_rng(2).integers(0, 256, (3, 5000)).astype(float)
        R, G, B = (colour[(R != G) | (G != B)] for colour in (R, G, B))
        top, root = 0.5 * ((R - G) + (R - B)), (R - G) ** 2 + (R - B) * (G - B)
        H1 = np.degrees(np.arccos(np.clip(top / np.sqrt(root), -1, 1)))
        # truth: the angle about the grey axis, from red towards green
        truth = np.degrees(np.arctan2(np.sqrt(3) * (G - B), 2 * R - G - B)) % 360
        off = np.where(B <= G, H1, 360 - H1) - truth
        assert_allclose((off + 180) % 360 - 180, 0, atol=1e-5)  # arccos at 0 and 180 degrees
        outside = np.abs(R - G) + (R - B) * (G - B)  # the root over its first term alone
        outside = np.where(outside == 0, 1.0, outside)
        assert plainly_wrong(np.degrees(np.arccos(np.clip(top / outside, -1, 1))), H1)
        bgr = (np.stack([B, G, R], axis=1)[None] / 255).astype(np.float32)
        away = truth - cv2.cvtColor(bgr, cv2.COLOR_BGR2HSV)[0, :, 0]
        assert 1.1 < np.abs((away + 180) % 360 - 180).max() < 1.125
