"""A family: axes 4, 5 and 6 meet in one point, and axes 1 and 2 in another.

The twists are (-90, 90, -90, 90, -90, 0)°. Such are arms with a shoulder of two or three crossing
axes and, read from the flange to the base, those of seven joints whose last joint is given. The
distance from shoulder to wrist centre depends on θ3 alone. With (d2, a2) and (d4, a3) as the upper
arm and the forearm in the plane that axis 3 crosses, it is the law of cosines; θ2 then sets the
wrist's height along axis 1, and θ1 its azimuth. Source: derived from the DH table.
"""

import numpy as np

from robots.arm import DhArm
from robots.closed_form import (
    ELBOW,
    SHOULDER,
    TOL_COSINE,
    TOL_ELBOW,
    TOL_SHOULDER,
    TOL_SIDE,
    WRIST,
    Flags,
    Mask,
    Misfit,
    Needed,
    table_mismatch,
    turn_wrist,
)
from robots.transforms import Array

Triple = tuple[Array, Array, Array]

ALPHA = (-90.0, 90.0, -90.0, 90.0, -90.0, 0.0)
LENGTHS: Needed = {
    "a_mm": (0.0, None, None, 0.0, 0.0, 0.0),
    "d_mm": (None, None, None, None, 0.0, None),
}


def misfit(arm: DhArm) -> Misfit | None:
    """Name the first entry of the table that does not belong to this family, if any."""
    for joint, length in ((2, np.hypot(arm.a[1], arm.d[1])), (4, np.hypot(arm.a[2], arm.d[3]))):
        if length == 0:
            return joint, "d_mm", 0.0, "an upper arm and a forearm longer than 0 are needed"
    return table_mismatch(arm, {**LENGTHS, "alpha_deg": ALPHA})


def reach(arm: DhArm) -> tuple[float, float]:
    """Least and greatest distance of the wrist centre from the shoulder, m."""
    upper, fore = float(np.hypot(arm.a[1], arm.d[1])), float(np.hypot(arm.a[2], arm.d[3]))
    return float(np.hypot(upper - fore, arm.d[2])), float(np.hypot(upper + fore, arm.d[2]))


def solve(arm: DhArm, pose: Array, hold: Array) -> tuple[Array, Mask, Flags]:
    """Solve poses given as rows; see `closed_form.Family`."""
    d1, d6 = float(arm.d[0]), float(arm.d[5])
    nx, ox, ax, px, ny, oy, ay, py, nz, oz, az, pz = pose[:12]
    wrist = (px - d6 * ax, py - d6 * ay, pz - d6 * az - d1)

    theta = np.empty((6, 2, 2, 2, pose.shape[1]))  # joint, shoulder, elbow, wrist, pose
    theta3, exists, merged = _bend_elbow(arm, wrist)
    (theta1, c1, s1), (theta2, c2, s2), turned, free = _turn_shoulder(arm, wrist, theta3, hold)
    theta[0], theta[1] = theta1[:, :, None], theta2[:, :, None]
    theta[2] = theta3[:, None]

    # columns of R03; Q = R03ᵀ R
    c3, s3 = np.cos(theta3), np.sin(theta3)
    x = (c1 * c2 * c3 - s1 * s3, s1 * c2 * c3 + c1 * s3, -s2 * c3)
    y = (-c1 * s2, -s1 * s2, -c2)
    z = (-c1 * c2 * s3 - s1 * c3, -s1 * c2 * s3 + c1 * c3, s2 * s3)
    n, o, a = (nx, ny, nz), (ox, oy, oz), (ax, ay, az)
    entries = tuple(_dot(u, v) for u, v in ((x, n), (x, o), (x, a), (y, n), (y, o), (y, a), (z, a)))
    straight = turn_wrist(theta, -1, entries, hold[3])

    flags = np.where(straight, WRIST, 0) | np.where(merged, ELBOW, 0) | np.where(free, SHOULDER, 0)
    return theta, (exists & turned)[:, None], flags[:, :, None].astype(np.uint8)


def _bend_elbow(arm: DhArm, wrist: Triple) -> tuple[Array, Mask, Mask]:
    """θ3 (2, m) by the distance of the wrist centre; where it exists and where both are one."""
    upper, fore = np.hypot(arm.a[1], arm.d[1]), np.hypot(arm.a[2], arm.d[3])
    cosine = (_dot(wrist, wrist) - upper**2 - fore**2 - arm.d[2] ** 2) / (2 * upper * fore)
    exists = np.abs(cosine) <= 1 + TOL_COSINE
    cosine = np.clip(cosine, -1, 1)
    sine = np.sqrt((1 - cosine) * (1 + cosine))
    bend = np.arctan2(sine, cosine)
    stretched = np.arctan2(arm.d[1], arm.a[1]) - np.arctan2(arm.d[3], arm.a[2])
    return np.stack([stretched + bend, stretched - bend]), exists, exists & (sine < TOL_ELBOW)


def _turn_shoulder(
    arm: DhArm, wrist: Triple, theta3: Array, hold: Array
) -> tuple[tuple[Array, Array, Array], tuple[Array, Array, Array], Mask, Mask]:
    """θ1 and θ2 with their cosines and sines, (2, 2, m): shoulder, elbow, pose.

    Then where they exist, and where one of them is free.
    """
    angle = theta3 + np.arctan2(arm.d[3], arm.a[2])
    fore = np.hypot(arm.a[2], arm.d[3])
    # the wrist centre in frame 1 at θ2 = 0, with y along axis 2 turned to z
    vx, vy, vz = arm.a[1] + fore * np.cos(angle), -float(arm.d[2]), arm.d[1] + fore * np.sin(angle)
    x, y, height = wrist
    distance = np.hypot(x, y)
    exists = distance >= np.abs(vz) - TOL_SIDE
    along = np.sqrt(np.maximum((distance - vz) * (distance + vz), 0.0))
    across = np.stack([along, -along])
    first = _angle(x * across + y * vz, y * across - x * vz, distance < TOL_SHOULDER, hold[0])
    on_axis_2 = np.hypot(vx, vy) < TOL_SHOULDER
    second = _angle(across * vx - height * vy, -across * vy - height * vx, on_axis_2, hold[1])
    return first, second, exists, (distance < TOL_SHOULDER) | on_axis_2


def _angle(x: Array, y: Array, free: Mask, hold: Array) -> tuple[Array, Array, Array]:
    """The angle of (x, y), its cosine and its sine; where it is free, those of `hold`."""
    theta, length = np.arctan2(y, x), np.hypot(x, y)
    free = np.broadcast_to(free, x.shape) | (length == 0)
    length = np.where(free, 1.0, length)
    cosine, sine = x / length, y / length
    if free.any():
        theta[free] = np.broadcast_to(hold, x.shape)[free]
        cosine[free], sine[free] = np.cos(theta[free]), np.sin(theta[free])
    return theta, cosine, sine


def _dot(u: Triple, v: Triple) -> Array:
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]
