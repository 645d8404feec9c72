"""From two centroids to a point: OpenCV's projection is the truth, scatter judges covariance."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.boards.calibrated import moved
from tests.support.scene import make_rig, project
from verify.core.records import Array
from verify.core.rig import Covariance, Rig
from verify.grasping.tracking import stereo
from verify.grasping.tracking.stereo import (
    LineOfSight,
    StereoPoint,
    line_of_sight,
    locate,
    object_size,
    place_camera,
    ray_midpoint,
)

POINT = np.array([0.06, -0.03, 0.72])
SIGMA = 0.2  # px


def sights(
    rig: Rig, left: Array, right: Array, extent: float = 0.0
) -> tuple[LineOfSight, LineOfSight]:
    covariance, wide = np.eye(2) * SIGMA**2, np.full(2, extent)
    return (
        line_of_sight(place_camera(rig.left, rig.left.pan), left, covariance, wide),
        line_of_sight(place_camera(rig.right, rig.right.pan), right, covariance, wide),
    )


def pixels(rig: Rig, point: Array = POINT) -> tuple[Array, Array]:
    left = project(rig.left, rig.left.pan, point[None])[0]
    return left, project(rig.right, rig.right.pan, point[None])[0]


def located(rig: Rig, left: Array, right: Array, extent: float = 0.0) -> StereoPoint:
    seen = sights(rig, left, right, extent)
    return locate(*seen, rig, ray_midpoint(*seen))


def test_the_point_is_where_it_was_projected_from() -> None:
    place = located(make_rig(), *pixels(make_rig()))
    np.testing.assert_allclose(place.point, POINT, atol=1e-8)
    assert place.mismatch < 1e-4


def test_it_is_the_point_of_least_reprojection_error() -> None:
    rig = make_rig()
    left, right = pixels(rig)
    left, right = left + np.array([0.5, -0.8]), right + np.array([-0.4, 0.9])

    def cost(point: Array) -> float:
        a, b = pixels(rig, point)
        return float(((a - left) ** 2).sum() + ((b - right) ** 2).sum())

    best = located(rig, left, right).point
    for direction in np.vstack([np.eye(3), -np.eye(3)]):
        assert cost(best) < cost(best + 1e-5 * direction)


def test_covariance_and_mismatch_are_those_of_the_scatter() -> None:
    rig, rng = make_rig(), np.random.default_rng(5)
    left, right = pixels(rig)
    places = [
        located(rig, left + rng.normal(0, SIGMA, 2), right + rng.normal(0, SIGMA, 2))
        for _ in range(600)
    ]
    scatter = np.cov(np.array([p.point for p in places]).T)
    np.testing.assert_allclose(places[0].covariance, scatter, rtol=0.25, atol=1e-8)
    assert np.mean([p.mismatch**2 for p in places]) == pytest.approx(1.0, abs=0.2)


def test_rays_that_do_not_meet_before_the_cameras_are_a_mismatch_or_no_point() -> None:
    rig = make_rig()
    left, right = pixels(rig)
    assert located(rig, left, right + np.array([0.0, 3.0])).mismatch > 9.0
    seen = sights(rig, left - np.array([250.0, 0.0]), right + np.array([250.0, 0.0]))
    assert locate(*seen, rig, ray_midpoint(*seen)) is None


STATED = {
    "left.fx_px": 1.0, "left.cx_px": 0.8, "left.k1": 0.002, "right.cy_px": 0.5,
    "right.pan_center_x_mm": 0.3, "right.mount_ry_deg": 0.02,
}  # fmt: skip


def with_covariance(rig: Rig) -> Rig:
    names = (*STATED, "robot_base.x_mm")
    sigma = np.array([*STATED.values(), 5.0])
    correlation = np.eye(len(names))
    correlation[0, 1] = correlation[1, 0] = 0.4
    return replace(rig, covariance=Covariance(names, sigma, correlation))


def erring(rig: Rig, rng: np.random.Generator) -> Rig:
    """A rig whose stated parameters are off by a draw; small rotations act on the left."""
    mixed = np.linalg.cholesky(np.array([[1.0, 0.4], [0.4, 1.0]])) @ rng.normal(size=2)
    draws = dict(zip(STATED, [*mixed, *rng.normal(size=4)], strict=True))
    units = {"_mm": 1e-3, "deg": np.pi / 180}
    for name, sigma in STATED.items():
        rig = moved(rig, name, draws[name] * sigma * units.get(name[-3:], 1.0))
    return rig


def test_what_the_rig_states_of_itself_is_carried_to_the_point() -> None:
    rig, rng = make_rig(), np.random.default_rng(6)
    left, right = pixels(rig)
    points = [located(erring(rig, rng), left, right).point for _ in range(500)]
    claimed = located(with_covariance(rig), left, right).systematic
    np.testing.assert_allclose(claimed, np.cov(np.array(points).T), rtol=0.25, atol=2e-8)


def test_a_pan_readings_uncertainty_is_carried_too() -> None:
    rig = make_rig()
    left, right = pixels(rig)
    u = np.deg2rad(0.03)
    stated = replace(rig, left=replace(rig.left, pan_standard_uncertainty=u))
    turned = replace(rig, left=replace(rig.left, pan_zero=rig.left.pan_zero + u))
    moved = located(turned, left, right).point - POINT
    np.testing.assert_allclose(
        located(stated, left, right).systematic, np.outer(moved, moved), rtol=0.05, atol=1e-10
    )


def test_the_colours_lie_grows_with_the_patch_and_does_not_average_out() -> None:
    rig = make_rig()
    left, right = pixels(rig)
    small, large = (located(rig, left, right, extent).systematic for extent in (20.0, 60.0))
    np.testing.assert_allclose(large, 9 * small, rtol=0.02)
    assert np.sqrt(small[2, 2]) > 1e-4


def test_the_size_is_that_of_a_ball_wherever_it_is() -> None:
    rig, radius = make_rig(), 0.02
    for point in (POINT, np.array([0.22, 0.12, 0.6]), np.array([-0.1, 0.0, 1.1])):
        extents = []
        for camera in (rig.left, rig.right):
            centre = camera.rig_T_camera(camera.pan)[:3, 3]
            sightline = (point - centre) / np.linalg.norm(point - centre)
            across = np.linalg.svd(sightline[None])[2][1:]
            angle = np.linspace(0, 2 * np.pi, 90)[:, None]
            rim = point + radius * (np.cos(angle) * across[0] + np.sin(angle) * across[1])
            extents.append(np.ptp(project(camera, camera.pan, rim), axis=0))
        left, right = pixels(rig, point)
        a, b = sights(rig, left, right)
        a, b = (
            replace(s, extent=extent + 2 * stereo.RIM_WIDTH)
            for s, extent in zip((a, b), extents, strict=True)
        )
        metres, uncertainty = object_size(a, b, located(rig, left, right))
        np.testing.assert_allclose(metres, 2 * radius, atol=uncertainty.max())
