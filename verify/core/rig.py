"""The calibrated cameras on their turning bases: the rotating-base camera model."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from verify.core.records import Array, rigid_transform

Coefficients = Array | Sequence[float]  # k1, k2, p1, p2, k3


@dataclass(frozen=True, slots=True, eq=False)  # arrays have no plain equality
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
    # the pose of the last pan reading: needed a dozen times a pair
    _placed: dict[float, tuple[Array, Array]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def rig_T_camera(self, pan: float) -> Array:
        """Place the camera in the rig for one pan reading (rad); read-only (4, 4)."""
        return self._place(pan)[0]

    def camera_T_rig(self, pan: float) -> Array:
        """Carry points of the rig into the camera, for one pan reading (rad); read-only (4, 4)."""
        return self._place(pan)[1]

    def _place(self, pan: float) -> tuple[Array, Array]:
        cached = self._placed.get(pan)
        if cached is not None:
            return cached
        turn = cv2.Rodrigues(self.pan_axis * (pan + self.pan_zero))[0]
        placed = rigid_transform(turn, self.pan_center) @ self.mount
        both = placed, np.asarray(np.linalg.inv(placed), dtype=np.float64)
        for matrix in both:
            matrix.flags.writeable = False
        self._placed.clear()
        self._placed[pan] = both
        return both

    def project(self, points_camera: Array) -> Array:
        """Image (..., 2), px, of points (..., 3), m, in the camera frame; OpenCV's distortion."""
        xy = points_camera[..., :2] / points_camera[..., 2:3]
        return self.to_pixels(distort(xy, self.distortion))

    def to_pixels(self, distorted: Array) -> Array:
        """Carry distorted normalised coordinates (..., 2) to pixels."""
        k = self.matrix
        return distorted @ k[:2, :2].T + k[:2, 2]

    def normalise(self, pixels: Array) -> Array:
        """Invert lens and matrix: (..., 2) px to undistorted normalised coordinates (x/z, y/z).

        Newton's method on the distortion, to rounding; a spot's centre needs 1e-6 px
        (cv2.undistortPoints stops 0.06 px short by default).
        """
        k = self.matrix
        target = np.empty(np.shape(pixels))
        target[..., 1] = (pixels[..., 1] - k[1, 2]) / k[1, 1]
        target[..., 0] = (pixels[..., 0] - k[0, 2] - k[0, 1] * target[..., 1]) / k[0, 0]
        return undistort(target, self.distortion)


def distort(xy: Array, coefficients: Coefficients) -> Array:
    """Apply OpenCV's distortion k1, k2, p1, p2, k3 to normalised coordinates (..., 2)."""
    k1, k2, p1, p2, k3 = coefficients
    x, y = xy[..., 0], xy[..., 1]
    xx, yy, twice_xy = x * x, y * y, 2 * x * y
    r2 = xx + yy
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    distorted = np.empty(xy.shape)
    distorted[..., 0] = x * radial + p1 * twice_xy + p2 * (r2 + 2 * xx)
    distorted[..., 1] = y * radial + p1 * (r2 + 2 * yy) + p2 * twice_xy
    return distorted


def distort_with_jacobian(xy: Array, coefficients: Coefficients) -> tuple[Array, Array]:
    """Apply `distort` and take its derivative by the coordinates: (..., 2) and (..., 2, 2).

    The derivative is symmetric. Coefficients may differ from point to point, (...,) each.
    """
    k1, k2, p1, p2, k3 = coefficients
    x, y = xy[..., 0], xy[..., 1]
    xx, xy_, yy = x * x, x * y, y * y
    r2 = xx + yy
    higher = r2 * k3 + k2
    radial = 1 + r2 * (k1 + r2 * higher)
    slope = 2 * (k1 + r2 * (higher + higher + r2 * k3))  # d radial / d r2, times 2
    p1_x, p1_y, p2_x, p2_y = p1 * x, p1 * y, p2 * x, p2 * y
    lean = p1_y + p2_x
    straight = radial + 2 * lean
    distorted, jacobian = np.empty(xy.shape), np.empty((*xy.shape, 2))
    distorted[..., 0] = x * straight + p2 * r2
    distorted[..., 1] = y * straight + p1 * r2
    jacobian[..., 0, 0] = straight + xx * slope + 4 * p2_x
    jacobian[..., 0, 1] = jacobian[..., 1, 0] = xy_ * slope + 2 * (p1_x + p2_y)
    jacobian[..., 1, 1] = straight + yy * slope + 4 * p1_y
    return distorted, jacobian


def undistort(distorted: Array, coefficients: Array) -> Array:
    """Invert `distort` by Newton's method, (..., 2) to (..., 2)."""
    xy = np.array(distorted, dtype=float)
    if not np.any(coefficients):
        return xy
    scalars = coefficients.tolist()  # arrays multiply by floats faster than by numpy's scalars
    for _ in range(30):  # quadratic convergence: three or four suffice for a usual lens
        predicted, slope = distort_with_jacobian(xy, scalars)
        a, b, d = slope[..., 0, 0], slope[..., 0, 1], slope[..., 1, 1]
        off = predicted - distorted
        across = off[..., ::-1] * b[..., None]
        step = (off * np.stack([d, a], axis=-1) - across) / (a * d - b * b)[..., None]
        xy -= step
        # the next step would be about the square of this one: below rounding
        if not np.any(np.abs(step) > 1e-9):
            break
    return xy


@dataclass(frozen=True, slots=True)
class Covariance:
    """Standard uncertainties and correlation of a calibration's named parameters."""

    # such as left.fx_px, right.mount_ry_deg, robot_base.rz_deg, led.A.x_mm
    parameters: tuple[str, ...]
    standard_uncertainty: Array  # (p,), in each parameter's own unit (its name's suffix)
    correlation: Array  # (p, p)
    degrees_of_freedom: float | None = None
    temperature_c: float | None = None

    @property
    def by_name(self) -> dict[str, float]:
        """Standard uncertainties by the parameters' names."""
        return dict(zip(self.parameters, self.standard_uncertainty.tolist(), strict=True))

    def take(self, kept: list[int]) -> "Covariance":
        """Keep some of the parameters, by their places."""
        return replace(
            self,
            parameters=tuple(self.parameters[i] for i in kept),
            standard_uncertainty=self.standard_uncertainty[kept],
            correlation=self.correlation[np.ix_(kept, kept)],
        )


@dataclass(frozen=True, slots=True, eq=False)  # nor has this
class Rig:
    """Two cameras and the robot's base, in one frame."""

    image_size: tuple[int, int]  # width, height, px
    left: Camera
    right: Camera
    rig_T_base: Array  # (4, 4); nan where no robot was registered
    base_source: str = "fixture"  # "motion": fitted through the robot's own encoders; "": none
    registration: str | None = None
    # (12, joints): motion of base and LED body a radian of joint offset; m, rad
    absorption: Array | None = None
    covariance: Covariance | None = None

    @property
    def registered(self) -> bool:
        """Whether the robot's base is known in the rig."""
        return bool(self.base_source)
