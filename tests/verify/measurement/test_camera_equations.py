"""The two papers' camera and colour equations: what is printed right is shown right, each misprint
shown wrong and its mended form right. Truth is OpenCV's pinhole, moments and colour conversion.

6R: Korayem et al. 2018, eqs. 1-10. Its image is inverted, in the plane z = 0 of a local frame whose
lens stands at z = F; its rotating base turns that frame. Lengths in mm, as there.
Grasping: the RV-3SD paper, eqs. 1-16 and 35.
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
        F, B = 4.0, 120.0
        points = np.random.default_rng(0).uniform([-80, -80, 500], [80, 80, 900], (20, 3))
        one, two = (Station(F, 0.0, np.array([x, 0, 0])) for x in (-B / 2, B / 2))
        u1, v1 = one.image(points)
        u2, _ = two.image(points)
        Z = F - B * F / (u1 - u2)
        assert np.all(u1 - u2 < 0)
        assert_allclose(Z, points[:, 2], rtol=1e-12)
        assert_allclose((F - Z) / F * u1 - B / 2, points[:, 0], atol=1e-9)
        assert_allclose((F - Z) / F * v1, points[:, 1], atol=1e-9)
        both_at_plus_half = Station(F, 0.0, np.array([-B / 2, 0, 0]))  # X01 = X02 = B / 2
        assert_allclose(both_at_plus_half.image(points)[0] - u1, 0, atol=1e-12)

    def test_disparity_vanishes_at_infinity(self) -> None:
        far = np.array([[0.0, 0.0, 1e9]])
        one, two = (Station(4.0, 0.0, np.array([x, 0.0, 0])) for x in (-60, 60))
        assert_allclose(one.image(far)[0] - two.image(far)[0], 0, atol=1e-6)

    def test_triangulation_of_the_code_is_eqs_7_and_8_mended(self, pair: Pair) -> None:
        cameras, pixels = [], []
        for station in (pair.one, pair.two):
            focal = station.F / PIXEL
            matrix = np.array([[focal, 0, 639.5], [0, focal, 359.5], [0, 0, 1]])
            cameras.append(
                Camera(
                    matrix=matrix,
                    distortion=np.zeros(5),
                    pan_center=station.lens / 1000,
                    pan_axis=np.array([0.0, 1.0, 0.0]),
                    pan_zero=0.0,
                    mount=np.eye(4),
                )
            )
            pixels.append(np.stack(station.image(pair.points), axis=1) / -PIXEL + [639.5, 359.5])
        found, _ = triangulate(
            cameras[0], cameras[1], pair.one.beta, pair.two.beta, pixels[0], pixels[1]
        )
        X, Z = found[:, 0] * 1000, found[:, 2] * 1000
        assert_allclose(Z, eq7_Z(pair, pair.points[:, 0])["mended"], rtol=1e-9)
        assert_allclose(X, pair.points[:, 0], atol=1e-9)

    def test_the_camera_table_is_1296_by_810_pixels(self) -> None:
        assert_allclose(np.array([3888, 2430]) / (1000 * PIXEL), [1296, 810], rtol=1e-12)


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


class TestGrasping:
    F = 1000.0  # px
    B = 120.0  # mm

    def images(self, points: Array) -> tuple[Array, Array]:
        """Upright images, px from the centre, of points from the left lens; by OpenCV."""
        matrix = np.diag([self.F, self.F, 1.0])
        left, right = (
            project(points, np.zeros(3), np.array([-x, 0, 0]), matrix) for x in (0.0, self.B)
        )
        return left, right

    def points(self) -> Array:
        return np.random.default_rng(0).uniform([-80, -80, 500], [200, 80, 900], (20, 3))

    def test_eqs_1_and_2_are_similar_triangles(self) -> None:
        points = self.points()
        (x1, y1), Z = self.images(points)[0].T, points[:, 2]
        assert_allclose(points[:, 0] / x1, Z / self.F, rtol=1e-12)
        assert_allclose(points[:, 1] / y1, Z / self.F, rtol=1e-12)

    def test_eqs_3_to_5_hold_with_x2_counted_inward_and_the_difference_otherwise(self) -> None:
        points = self.points()
        left, right = self.images(points)
        x1, x2, Z = left[:, 0], right[:, 0], points[:, 2]
        inward = -x2
        assert_allclose((self.B - points[:, 0]) / inward, Z / self.F, rtol=1e-9)
        assert_allclose(Z / self.F * x1 + Z / self.F * inward, self.B, rtol=1e-9)
        assert_allclose(self.B * self.F / (x1 + inward), Z, rtol=1e-9)
        assert_allclose(self.B * self.F / (x1 - x2), Z, rtol=1e-9)
        assert plainly_wrong(self.B * self.F / (x1 + x2), Z)

    def test_eq_6_projects_and_eq_7_as_printed_is_no_rotation(self) -> None:
        points, center = self.points(), np.array([30.0, -20.0, 10.0])
        vector = np.array([0.1, -0.2, 0.3])
        K = np.array([[1000.0, 0, 640], [0, 1001, 360], [0, 0, 1]])
        R = np.asarray(cv2.Rodrigues(vector)[0], dtype=float)
        seen = project(points, vector, -R @ center, K)
        homogeneous = K @ np.c_[R, -R @ center] @ np.c_[points, np.ones(len(points))].T
        assert_allclose((homogeneous[:2] / homogeneous[2]).T, seen, rtol=1e-10)
        printed = R.T.copy()
        printed[1, 2] = R[2, 0]  # r31 where r32 belongs
        assert np.abs(printed @ printed.T - np.eye(3)).max() > 0.01
        for rotation in (printed, R.T):
            homogeneous = K @ np.c_[rotation, -R @ center] @ np.c_[points, np.ones(20)].T
            assert plainly_wrong((homogeneous[:2] / homogeneous[2]).T, seen)

    def test_eq_8_weighted_steps_to_the_centroid_of_eqs_13_to_16(self) -> None:
        image = np.random.default_rng(1).uniform(0, 1, (40, 60)).astype(np.float32)
        moments = cv2.moments(image)
        centroid = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
        y, x = np.mgrid[:40, :60]
        at = np.array([21.0, 17.0])
        step = np.array([(image * (x - at[0])).sum(), (image * (y - at[1])).sum()]) / image.sum()
        assert_allclose(at + step, centroid, rtol=1e-6)  # OpenCV sums 32-bit pixels
        inside = np.stack([x.ravel(), y.ravel()], axis=1)
        flat = cv2.moments(np.ones((40, 60), np.float32))
        mean = np.array([flat["m10"], flat["m01"]]) / flat["m00"]
        assert_allclose(at + np.mean(inside - at, axis=0), mean, rtol=1e-9)

    @pytest.mark.parametrize("angle", [-60.0, 0.0, 25.0, 80.0])
    def test_the_windows_axes_follow_from_second_moments(self, angle: float) -> None:
        image = np.zeros((400, 400), np.uint8)
        cv2.ellipse(image, (210, 190), (120, 50), angle, 0, 360, 1, -1)
        M = cv2.moments(image)
        xc, yc = M["m10"] / M["m00"], M["m01"] / M["m00"]
        a = M["m20"] / M["m00"] - xc**2
        b = 2 * (M["m11"] / M["m00"] - xc * yc)
        c = M["m02"] / M["m00"] - yc**2
        axes = 2 * np.sqrt((a + c + np.array([1, -1]) * np.hypot(b, a - c)) / 2)
        assert_allclose([xc, yc], [210, 190], atol=0.2)
        assert_allclose(axes, [120, 50], atol=1.0)  # a drawn ellipse is good to a pixel
        assert_allclose(np.degrees(np.arctan2(b, a - c) / 2), angle, atol=0.5)

    def colours(self) -> tuple[Array, Array, Array]:
        R, G, B = np.random.default_rng(2).integers(0, 256, (3, 5000)).astype(float)
        uneven = (R != G) | (G != B)
        return R[uneven], G[uneven], B[uneven]

    def test_eqs_9_and_10_give_the_geometric_hue_with_the_root_over_all(self) -> None:
        R, G, B = self.colours()
        top = 0.5 * ((R - G) + (R - B))
        H1 = np.degrees(np.arccos(np.clip(top / np.sqrt((R - G) ** 2 + (R - B) * (G - B)), -1, 1)))
        H = np.where(B <= G, H1, 360 - H1)
        # Truth: the angle about the grey axis, from red towards green.
        grey = np.ones(3) / np.sqrt(3)
        red = np.array([1.0, 0, 0]) - grey / np.sqrt(3)
        across = np.cross(grey, red)
        colour = np.stack([R, G, B], axis=1)
        truth = np.degrees(np.arctan2(colour @ across, colour @ red)) % 360
        assert_allclose((H - truth + 180) % 360 - 180, 0, atol=1e-5)  # arccos at 0 and 180 degrees
        atan = np.degrees(np.arctan2(np.sqrt(3) * (G - B), 2 * R - G - B)) % 360
        assert_allclose((atan - truth + 180) % 360 - 180, 0, atol=1e-9)
        outside = np.sqrt((R - G) ** 2) + (R - B) * (G - B)  # the root over its first term alone
        outside = np.where(outside == 0, 1.0, outside)
        assert plainly_wrong(np.degrees(np.arccos(np.clip(top / outside, -1, 1))), H1)

    def test_the_geometric_hue_is_within_1_12_degrees_of_the_hexagonal(self) -> None:
        R, G, B = self.colours()
        bgr = (np.stack([B, G, R], axis=1)[None] / 255).astype(np.float32)
        hexagonal = cv2.cvtColor(bgr, cv2.COLOR_BGR2HSV)[0, :, 0]
        geometric = np.degrees(np.arctan2(np.sqrt(3) * (G - B), 2 * R - G - B))
        difference = np.abs((geometric - hexagonal + 180) % 360 - 180)
        assert 1.1 < difference.max() < 1.125

    def test_eqs_11_and_12_are_opencvs_saturation_and_value(self) -> None:
        R, G, B = self.colours()
        bgr = (np.stack([B, G, R], axis=1)[None] / 255).astype(np.float32)
        _, S, V = cv2.cvtColor(bgr, cv2.COLOR_BGR2HSV)[0].T
        most, least = np.maximum(np.maximum(R, G), B), np.minimum(np.minimum(R, G), B)
        assert_allclose((most - least) / most, S, atol=1e-5)  # OpenCV adds 1e-7 below the line
        assert_allclose(most / 255, V, atol=1e-6)

    def test_eq_35_has_the_centre_of_a_smaller_picture(self) -> None:
        printed = np.array([310.0, 257.0])
        assert np.linalg.norm(printed - [320, 240]) < 20 < np.linalg.norm(printed - [640, 360])
