"""A camera where it stands now, and one point as it sees it."""

from dataclasses import dataclass

import numpy as np

from verify.records import Array, StereoPair
from verify.rig import Camera, Rig, distortion_jacobian


@dataclass(frozen=True, slots=True)
class Placed:
    """A camera turned to one pan reading."""

    camera: Camera
    pan: float  # rad, as read
    rig_T_camera: Array  # (4, 4)

    def inside(self, points_rig: Array) -> Array:
        """Carry points of the rig into the camera, (..., 3) m."""
        points: Array = (points_rig - self.rig_T_camera[:3, 3]) @ self.rig_T_camera[:3, :3]
        return points

    def slope(self, inside: Array) -> Array:
        """Derivative of x/z, y/z by a point of the rig, (2, 3), at a point (3,) in the camera."""
        x, y, z = inside
        flat = np.array([[1.0, 0.0, -x / z], [0.0, 1.0, -y / z]]) / z
        found: Array = flat @ self.rig_T_camera[:3, :3].T
        return found

    def lens(self, xy: Array) -> Array:
        """Derivative of the pixel by x/z and y/z, (2, 2) px."""
        found: Array = self.camera.matrix[:2, :2] @ distortion_jacobian(xy, self.camera.distortion)
        return found


@dataclass(frozen=True, slots=True)
class Sight:
    """A line of sight: the normalised coordinates of a patch's centre, and how well known."""

    placed: Placed
    xy: Array  # (2,), x/z and y/z
    covariance: Array  # (2, 2), of xy
    lens: Array  # (2, 2), px: d pixel / d xy
    extent: Array  # (2,), px

    @property
    def ray(self) -> Array:
        """Direction in the rig, of unit depth in the camera, (3,)."""
        direction: Array = self.placed.rig_T_camera[:3, :3] @ np.append(self.xy, 1.0)
        return direction

    @property
    def slant(self) -> Array:
        """By how much a ball looks wider than on the optical axis, along rows and columns, (2,)."""
        wider: Array = np.hypot(1.0, self.xy)
        return wider


def placed(camera: Camera, pan: float) -> Placed:
    """Turn a camera to a pan reading, rad."""
    return Placed(camera, pan, camera.rig_T_camera(pan))


def both(rig: Rig, pair: StereoPair) -> tuple[Placed, Placed]:
    """Turn both cameras to a pair's pan readings."""
    return placed(rig.left, pair.pan_left), placed(rig.right, pair.pan_right)


def sight(camera: Placed, pixel: Array, covariance: Array, extent: Array) -> Sight:
    """Make a line of sight of a pixel (2,), its covariance (2, 2) px² and the patch's extent."""
    xy = camera.camera.normalise(pixel)
    lens = camera.lens(xy)
    back = np.linalg.inv(lens)
    return Sight(camera, xy, back @ covariance @ back.T, lens, extent)


def project(camera: Placed, point: Array) -> tuple[Array, Array, Sight]:
    """Picture a point of the rig.

    Returns:
        The pixel (2,), its derivative by the point (2, 3), px/m, and the line of sight, exact and
        of no extent.
    """
    inside = camera.inside(point)
    xy = inside[:2] / inside[2]
    lens = camera.lens(xy)
    exact = Sight(camera, xy, np.zeros((2, 2)), lens, np.zeros(2))
    return camera.camera.project(inside), lens @ camera.slope(inside), exact
