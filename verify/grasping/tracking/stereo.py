"""Locate an object by its patches in both pictures: point with covariance, and size.

Least squares of the reprojection error; a patch's centroid misses the object's middle by a share of
its extent, which does not average out.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.linalg import block_diag

from verify.core.records import SIDES, Array, StereoPair
from verify.core.rig import Camera, Covariance, Rig, distort_with_jacobian
from verify.measurement.sensitivities import camera_derivatives
from verify.measurement.systematics import CAMERA_KEYS, PAN_READINGS, covariance_in_si

# of a patch's extent, standard: by as much its centroid misses the object's middle, differently in
# either picture: reflections, shading, the side a camera sees. It does not average out.
U_COLOUR_CENTRE = 0.005
# px by which a patch reaches beyond its object: pixels that show a quarter of it count
RIM_WIDTH = 1.0
U_EXTENT = 1.0  # px, standard, of an extent: whole pixels, and a rim that depends on what is behind
UNDISTORT_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-12)
MIN_SINE = 1e-6  # of half the angle between rays: below, they are parallel
N_ITERATIONS = 2  # of Gauss-Newton: from the midpoint of the rays the first leaves a millionth


@dataclass(frozen=True, slots=True)
class PannedCamera:
    """A camera turned to one pan reading."""

    camera: Camera
    pan: float  # rad, as read
    rig_T_camera: Array  # (4, 4)

    def inside(self, points_rig: Array) -> Array:
        """Carry points of the rig into the camera, (..., 3) m."""
        return (points_rig - self.rig_T_camera[:3, 3]) @ self.rig_T_camera[:3, :3]

    def slope(self, inside: Array) -> Array:
        """Derivative of x/z, y/z by a point of the rig, (2, 3), at a point (3,) in the camera."""
        x, y, z = inside.tolist()
        flat = np.array([[1 / z, 0.0, -x / z**2], [0.0, 1 / z, -y / z**2]])
        return flat @ self.rig_T_camera[:3, :3].T

    def picture(self, xy: Array) -> tuple[Array, Array]:
        """Pixel (2,) of x/z and y/z, and its derivative by them, (2, 2) px."""
        distorted, slope = distort_with_jacobian(xy, self.camera.distortion.tolist())
        return self.camera.to_pixels(distorted), self.camera.matrix[:2, :2] @ slope


@dataclass(frozen=True, slots=True)
class LineOfSight:
    """A line of sight: the normalised coordinates of a patch's centre, and how well known."""

    placed: PannedCamera
    xy: Array  # (2,), x/z and y/z
    covariance: Array  # (2, 2), of xy
    lens: Array  # (2, 2), px: d pixel / d xy
    extent: Array  # (2,), px

    @property
    def ray(self) -> Array:
        """Direction in the rig, of unit depth in the camera, (3,)."""
        return np.asarray(self.placed.rig_T_camera[:3, :3] @ np.append(self.xy, 1.0))


def place_camera(camera: Camera, pan: float) -> PannedCamera:
    """Turn a camera to a pan reading, rad."""
    return PannedCamera(camera, pan, camera.rig_T_camera(pan))


def place_cameras(rig: Rig, pair: StereoPair) -> tuple[PannedCamera, PannedCamera]:
    """Turn both cameras to a pair's pan readings."""
    return place_camera(rig.left, pair.pan_left), place_camera(rig.right, pair.pan_right)


def line_of_sight(
    camera: PannedCamera, pixel: Array, covariance: Array, extent: Array
) -> LineOfSight:
    """Make a line of sight of a pixel (2,), its covariance (2, 2) px² and the patch's extent."""
    optics = camera.camera.matrix, camera.camera.distortion
    xy = cv2.undistortPoints(pixel[None], *optics, criteria=UNDISTORT_CRITERIA)[0, 0]
    lens = camera.picture(xy)[1]
    back = np.linalg.inv(lens)
    return LineOfSight(camera, xy, back @ covariance @ back.T, lens, extent)


def project(camera: PannedCamera, point: Array) -> tuple[Array, Array, float]:
    """Picture a point of the rig: pixel (2,), its derivative by it (2, 3), px/m, and depth, m."""
    inside = camera.inside(point)
    pixel, lens = camera.picture(inside[:2] / inside[2])
    return pixel, lens @ camera.slope(inside), float(inside[2])


@dataclass(frozen=True, slots=True)
class StereoPoint:
    """A point seen by both cameras."""

    point: Array  # (3,), m, rig
    covariance: Array  # (3, 3), m², from the pixels' covariance
    systematic: Array  # (3, 3), m², from what the rig states of itself and from U_COLOUR_CENTRE
    mismatch: float  # of the rays, in standard deviations of all that is known
    depth: Array  # (2,), m, along the optical axes, left and right


def ray_midpoint(left: LineOfSight, right: LineOfSight) -> Array:
    """The point midway between two lines of sight, (3,) m; nan where they do not meet."""
    a, b = left.placed.rig_T_camera[:3, 3], right.placed.rig_T_camera[:3, 3]
    u, w = left.ray, right.ray
    (s, t), _, rank, _ = np.linalg.lstsq(np.column_stack([u, -w]), b - a, rcond=MIN_SINE)
    midpoint: Array = (a + s * u + b + t * w) / 2
    return midpoint if rank == 2 and min(s, t) > 0 else np.full(3, np.nan)


def locate(left: LineOfSight, right: LineOfSight, rig: Rig, start: Array) -> StereoPoint | None:
    """Find the point of least reprojection error, and what is known of it.

    Both cameras' sights are of one instant; the rig's covariance is carried along where it states
    one. It starts at (3,), m, from `ray_midpoint`. None where the rays do not meet before both
    cameras.
    """
    if not np.isfinite(start).all():
        return None
    sights = (left, right)
    noise, lies = np.zeros((4, 4)), np.zeros((4, 4))
    for i, sight in enumerate(sights):
        rows = np.s_[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]
        noise[rows] = sight.covariance
        wander = np.linalg.inv(sight.lens) * (U_COLOUR_CENTRE * sight.extent)
        lies[rows] = wander @ wander.T
    weight = np.linalg.inv(noise + lies)
    pictured = np.concatenate([left.xy, right.xy])
    point = start
    for _ in range(N_ITERATIONS):
        inside = [sight.placed.inside(point) for sight in sights]
        slope = np.concatenate([s.placed.slope(p) for s, p in zip(sights, inside, strict=True)])
        left_over = pictured - np.concatenate([p[:2] / p[2] for p in inside])
        gain = np.linalg.solve(slope.T @ weight @ slope, slope.T @ weight)
        step = gain @ left_over
        point = point + step
    left_over = left_over - slope @ step
    stated = _systematic_covariance(sights, point, slope, rig)
    across = np.linalg.svd(slope)[0][:, 3]  # the one direction that no point explains
    spread = float(across @ (noise + lies + stated) @ across)
    return StereoPoint(
        point,
        gain @ noise @ gain.T,
        gain @ (lies + stated) @ gain.T,
        abs(float(across @ left_over)) / float(np.sqrt(spread)),
        np.array([p[2] for p in inside]),
    )


def object_size(left: LineOfSight, right: LineOfSight, place: StereoPoint) -> tuple[Array, Array]:
    """Measure an object across the line of sight.

    Returns width and height (2,), m, along the pictures' rows and columns, the mean of both cameras
    weighted by what each pixel is worth, and their standard uncertainties (2,), m.
    """
    lens = np.array([np.diag(left.lens), np.diag(right.lens)])
    slant = np.hypot(1.0, [left.xy, right.xy])  # a ball looks wider off the optical axis
    worth = place.depth[:, None] / lens / slant
    metres = (np.array([left.extent, right.extent]) - 2 * RIM_WIDTH) * worth
    weight = 1.0 / (worth * U_EXTENT) ** 2
    mean = (metres * weight).sum(axis=0) / weight.sum(axis=0)
    edges = 1.0 / weight.sum(axis=0)
    apart = ((metres[0] - metres[1]) / 2) ** 2  # the two cameras see different sides of it
    far = np.sqrt(np.trace(place.covariance + place.systematic)) / place.depth.mean()
    deep = mean.max() / 2 / place.depth.mean() / np.sqrt(3)  # its outline: nearer than its middle?
    uncertainty: Array = np.sqrt(edges + apart + mean**2 * (far**2 + deep**2))
    return mean, uncertainty


def _systematic_covariance(
    sights: tuple[LineOfSight, LineOfSight], point: Array, slope: Array, rig: Rig
) -> Array:
    """Covariance of both lines of sight from the rig's own and the pan readings', (4, 4)."""
    given = rig.covariance or Covariance((), np.zeros(0), np.zeros((0, 0)))
    names = [name.partition(".") for name in (*given.parameters, *PAN_READINGS)]
    moved = np.zeros((4, len(names)))
    for i, (side, sight) in enumerate(zip(SIDES, sights, strict=True)):
        rows, placed = slice(2 * i, 2 * i + 2), sight.placed
        known = [
            n for n, (head, _, key) in enumerate(names) if head == side and CAMERA_KEYS.match(key)
        ]
        keys = tuple(names[n][2] for n in known)
        places = placed.inside(point)[None], point[None], (sight.lens @ slope[rows])[None]
        pixels = camera_derivatives(keys, placed.camera, placed.pan, *places)[:, 0]
        moved[rows, known] = np.linalg.solve(sight.lens, pixels.T)
    pans = np.diag([(c.pan_standard_uncertainty or 0.0) ** 2 for c in (rig.left, rig.right)])
    return np.asarray(moved @ block_diag(covariance_in_si(given), pans) @ moved.T)
