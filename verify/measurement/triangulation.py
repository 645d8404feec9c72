"""Triangulate points from two cameras' rays, and fit a rigid motion to point pairs.

Model, with optical centres a, b and ray directions u, w in the rig (m):

    point = ((a + s u) + (b + t w)) / 2,   n = u × w
    s = ((b - a) × w) · n / n²,   t = ((b - a) × u) · n / n²

    symbol  meaning                               unit
    s, t    depth of the nearest points on a ray  m (rays of unit depth)
    gap     distance of the two nearest points    m

It starts and checks the pose fit and is not the measurement: the midpoint does not minimise the
error in the images.
"""

import numpy as np

from verify.core.records import Array, rigid_transform
from verify.core.rig import Camera

MIN_SIN2 = 1e-18  # squared sine of the angle between rays; 1e-9 rad puts a point 1e8 m away
TOL_COLLINEAR = 1e-6  # second over first singular value: below, points lie on one line


def triangulate(
    left: Camera, right: Camera, pan_left: float, pan_right: float, left_px: Array, right_px: Array
) -> tuple[Array, Array]:
    """Find the points midway between pairs of rays, for any mounts and pan axes.

    Pans are readings of the bases, rad; `left_px` and `right_px` (..., 2), px, distortion included,
    are of the same points; the shapes broadcast. Gives points_rig (..., 3), m, and the distance
    between the two rays (...,), m; both are NaN where the rays are parallel or meet behind a
    camera.

    Source: the point nearest two skew lines, by Cramer's rule on their common perpendicular.
    """
    return ray_midpoints(*rays(left, pan_left, left_px), *rays(right, pan_right, right_px))


def rays(camera: Camera, pan: float, pixels: Array) -> tuple[Array, Array]:
    """Place a camera's lines of sight through pixels (..., 2), px, distortion included, in the rig.

    `pan`, rad, is its base's reading. Gives the optical centre (3,), m, and directions (..., 3), of
    unit depth in the camera.
    """
    rig_T_camera = camera.rig_T_camera(pan)
    xy = camera.normalise(np.asarray(pixels, dtype=float))
    sight = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
    return rig_T_camera[:3, 3], sight @ rig_T_camera[:3, :3].T


def ray_midpoints(
    center_a: Array, ray_a: Array, center_b: Array, ray_b: Array
) -> tuple[Array, Array]:
    """Find the points midway between rays (..., 3) from two centres (3,), and the gaps.

    Points (..., 3) and distances between the rays (...,) are NaN where the rays are parallel or
    where either would have to run backwards.
    """
    normal = np.cross(ray_a, ray_b)
    square = np.sum(normal * normal, axis=-1)
    lengths = np.sum(ray_a * ray_a, axis=-1) * np.sum(ray_b * ray_b, axis=-1)
    apart = center_b - center_a
    meets = square > MIN_SIN2 * lengths
    scale = 1 / np.where(meets, square, 1.0)
    along_a = np.sum(np.cross(apart, ray_b) * normal, axis=-1) * scale
    along_b = np.sum(np.cross(apart, ray_a) * normal, axis=-1) * scale
    meets = meets & (along_a > 0) & (along_b > 0)
    foot_a = center_a + along_a[..., None] * ray_a
    foot_b = center_b + along_b[..., None] * ray_b
    points = np.where(meets[..., None], (foot_a + foot_b) / 2, np.nan)
    gap = np.where(meets, np.linalg.norm(foot_b - foot_a, axis=-1), np.nan)
    return points, gap


def fit_rigid(points_a: Array, points_b: Array) -> Array:
    """Find the rigid motion a_T_b (4, 4) that best carries `points_b` (n, 3), m, onto `points_a`.

    The same points in the same order; by least squares, a proper rotation even for a mirrored set.
    Source: Umeyama, IEEE TPAMI 13(4), 1991, eqs. 38-43, without the scale.

    Raises:
        ValueError: fewer than three points, all on one line, or not finite.
    """
    if points_a.shape != points_b.shape or points_a.ndim != 2 or len(points_a) < 3:
        raise ValueError(f"needs three points or more, twice; got {len(points_a)}")
    mean_a, mean_b = points_a.mean(axis=0), points_b.mean(axis=0)
    centred_a, centred_b = points_a - mean_a, points_b - mean_b
    if not np.all(np.isfinite(centred_a + centred_b)):
        raise ValueError("needs finite points")
    for centred in (centred_a, centred_b):
        spread = np.linalg.svd(centred, compute_uv=False)
        if spread[1] <= TOL_COLLINEAR * spread[0]:
            raise ValueError("the points lie on one line: the turn about it is not determined")
    u, _, vt = np.linalg.svd(centred_a.T @ centred_b)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    a_R_b = (u * sign) @ vt
    return rigid_transform(a_R_b, mean_a - a_R_b @ mean_b)
