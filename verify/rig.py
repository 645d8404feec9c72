"""The calibrated cameras on their turning bases: the rotating-base camera model."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from verify.records import Array


@dataclass(frozen=True, slots=True)
class Camera:
    """A camera on a turning base: rig_T_camera(b) = Trans(pan_center) Rot(pan_axis, b) Mount."""

    matrix: Array  # (3, 3), px
    distortion: Array  # (5,), k1, k2, p1, p2, k3 (OpenCV)
    pan_center: Array  # (3,), m, rig frame
    pan_axis: Array  # (3,), unit vector, rig frame
    pan_zero: float  # rad, added to every pan reading
    mount: Array  # (4, 4), turntable_T_camera
    pan: float = 0.0  # rad, the reading where frames.csv gives none
    pan_standard_uncertainty: float | None = None  # rad, of each pan reading
    line_time: float = 0.0  # s a row, rolling shutter
    exposure: float | None = None  # s

    def rig_T_camera(self, pan: float) -> Array:
        """Place the camera for one pan reading (rad); (4, 4)."""
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec(self.pan_axis * (pan + self.pan_zero)).as_matrix()
        turn[:3, 3] = self.pan_center
        placed: Array = turn @ self.mount
        return placed

    def project(self, points_camera: Array) -> Array:
        """Image of points in the camera frame: (..., 3) m to (..., 2) px, distortion included.

        Source: OpenCV's five-coefficient model, which rig.toml names.
        """
        xy = points_camera[..., :2] / points_camera[..., 2:3]
        return self.to_pixels(distort(xy, self.distortion))

    def to_pixels(self, distorted: Array) -> Array:
        """Carry distorted normalised coordinates (..., 2) to pixels."""
        k = self.matrix
        x, y = distorted[..., 0], distorted[..., 1]
        return np.stack([k[0, 0] * x + k[0, 1] * y + k[0, 2], k[1, 1] * y + k[1, 2]], axis=-1)

    def normalise(self, pixels: Array) -> Array:
        """Invert lens and matrix: (..., 2) px to undistorted normalised coordinates (x/z, y/z).

        Newton on the distortion until nothing moves by more than 1e-13; far below the 1e-6 px
        that a spot's centre asks for (cv2.undistortPoints stops 0.06 px short by default).
        """
        k = self.matrix
        y = (pixels[..., 1] - k[1, 2]) / k[1, 1]
        x = (pixels[..., 0] - k[0, 2] - k[0, 1] * y) / k[0, 0]
        target = np.stack([x, y], axis=-1)
        return undistort(target, self.distortion)


def distort(xy: Array, coefficients: Array) -> Array:
    """Apply OpenCV's distortion k1, k2, p1, p2, k3 to normalised coordinates (..., 2)."""
    k1, k2, p1, p2, k3 = coefficients
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=-1,
    )


def distortion_jacobian(xy: Array, coefficients: Array) -> Array:
    """Derivative of `distort` by the coordinates, (..., 2, 2)."""
    k1, k2, p1, p2, k3 = coefficients
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + 3 * k3 * r2))  # d radial / d r2, times 2
    cross = x * y * slope + 2 * p1 * x + 2 * p2 * y
    row_x = np.stack([radial + x * x * slope + 2 * p1 * y + 6 * p2 * x, cross], axis=-1)
    row_y = np.stack([cross, radial + y * y * slope + 6 * p1 * y + 2 * p2 * x], axis=-1)
    return np.stack([row_x, row_y], axis=-2)


def undistort(distorted: Array, coefficients: Array) -> Array:
    """Invert `distort` by Newton's method, (..., 2) to (..., 2)."""
    xy = np.array(distorted, dtype=float)
    if not np.any(coefficients):
        return xy
    for _ in range(30):  # quadratic convergence: five or six suffice for any sane lens
        error = distort(xy, coefficients) - distorted
        step = np.linalg.solve(distortion_jacobian(xy, coefficients), error[..., None])[..., 0]
        xy -= step
        if not np.any(np.abs(step) > 1e-13):
            break
    return xy


@dataclass(frozen=True, slots=True)
class Covariance:
    """Standard uncertainties and correlation of named parameters, as calibration wrote them."""

    parameters: tuple[
        str, ...
    ]  # e.g. left.fx_px, right.mount_ry_deg, robot_base.rz_deg, led.A.x_mm
    standard_uncertainty: Array  # (p,), in each parameter's own unit (its name's suffix)
    correlation: Array  # (p, p)
    degrees_of_freedom: float | None = None
    temperature_c: float | None = None


@dataclass(frozen=True, slots=True)
class Rig:
    """Two cameras, and where the robot stands between them."""

    image_size: tuple[int, int]  # width, height, px
    left: Camera
    right: Camera
    rig_T_base: Array  # (4, 4); nan where no robot was registered
    base_source: str = "fixture"  # "motion": fitted through the robot's own encoders; "": none
    registration: str | None = None
    absorption: Array | None = (
        None  # (12, joints): base and LED-body motion a rad of offset; m, rad
    )
    covariance: Covariance | None = None

    @property
    def registered(self) -> bool:
        """A robot's place in the rig is known."""
        return bool(self.base_source)
