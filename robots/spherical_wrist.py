"""A family: axes 4, 5 and 6 meet in one point; axes 2 and 3 are parallel.

The twists of joints 3, 4 and 5 are (90, -90, 90)° or (-90, 90, -90)°: the elbow offset a3 lies on
one or the other side of the forearm. With g = +1 or -1 for the two, and the forearm's line from
elbow to wrist centre L = hypot(a3, d4) at the angle γ = g · atan2(d4, a3) from the x axis of frame
3, both are solved by the same equations. Source: derived from the DH table; the OPW form of
Brandstötter, Angerer and Hofbaur (2014) covers the same arms.
"""

import numpy as np

from robots.arm import DhArm
from robots.closed_form import (
    ELBOW,
    SHOULDER,
    WRIST,
    Flags,
    Mask,
    Misfit,
    Needed,
    bend_to,
    table_mismatch,
    turn_to,
    turn_wrist,
)
from robots.transforms import Array

ALPHA_BY_SIDE = {1: (-90.0, 0.0, 90.0, -90.0, 90.0, 0.0), -1: (-90.0, 0.0, -90.0, 90.0, -90.0, 0.0)}
LENGTHS: Needed = {
    "a_mm": (None, None, None, 0.0, 0.0, 0.0),
    "d_mm": (None, None, None, None, 0.0, None),
}


def misfit(arm: DhArm) -> Misfit | None:
    """Name the first entry of the table that does not belong to this family, if any."""
    if arm.a[1] <= 0:
        return 2, "a_mm", float(arm.a[1] * 1000), "an upper arm longer than 0 is needed"
    if np.hypot(arm.a[2], arm.d[3]) == 0:
        return 4, "d_mm", 0.0, "a forearm longer than 0 is needed"
    return table_mismatch(arm, {**LENGTHS, "alpha_deg": ALPHA_BY_SIDE[elbow_side(arm)]})


def elbow_side(arm: DhArm) -> int:
    """On which side of the forearm the elbow offset lies: +1 or -1, by the sign of α3."""
    return 1 if arm.alpha[2] > 0 else -1


def forearm(arm: DhArm) -> tuple[float, float]:
    """Length of the line from elbow to wrist centre, m, and its angle γ in frame 3, rad."""
    length = float(np.hypot(arm.a[2], arm.d[3]))
    return length, elbow_side(arm) * float(np.arctan2(arm.d[3], arm.a[2]))


def reach(arm: DhArm) -> tuple[float, float]:
    """Least and greatest distance of the wrist centre from axis 2, m."""
    length, _ = forearm(arm)
    return abs(float(arm.a[1]) - length), float(arm.a[1]) + length


def solve(arm: DhArm, pose: Array, hold: Array) -> tuple[Array, Mask, Flags]:
    """Solve poses given as rows; see `closed_form.Family`."""
    g = elbow_side(arm)
    length, gamma = forearm(arm)
    a1, d1, d6 = float(arm.a[0]), float(arm.d[0]), float(arm.d[5])
    nx, ox, ax, px, ny, oy, ay, py, nz, oz, az, pz = pose[:12]

    wrist_x, wrist_y = px - d6 * ax, py - d6 * ay
    turned = turn_to(wrist_x, wrist_y, hold[0], float(arm.d[1] + arm.d[2]))
    along = wrist_x * turned.cosine + wrist_y * turned.sine - a1
    bent = bend_to(along, d1 - (pz - d6 * az), float(arm.a[1]), length)

    m = pose.shape[1]
    theta = np.empty((6, 2, 2, 2, m))  # joint, shoulder, elbow, wrist, pose
    theta[0] = turned.theta[:, None, None]
    theta[1, :, 0] = (bent.azimuth - bent.inner)[:, None]
    theta[1, :, 1] = (bent.azimuth + bent.inner)[:, None]
    theta[2, :, 0] = (bent.bend + gamma)[:, None]
    theta[2, :, 1] = (gamma - bent.bend)[:, None]

    # Q = R03ᵀ R; the flange's axes along the arm's plane and across it, (2, m), are enough
    pitch = theta[1, :, :, 0] + theta[2, :, :, 0]  # θ2 + θ3, (2, 2, m)
    c23, s23 = np.cos(pitch), np.sin(pitch)
    cosine, sine = turned.cosine, turned.sine
    n_along, o_along, a_along = (cosine * x + sine * y for x, y in ((nx, ny), (ox, oy), (ax, ay)))
    q21, q22, q23 = (g * (cosine * y - sine * x) for x, y in ((nx, ny), (ox, oy), (ax, ay)))
    q11 = c23 * n_along[:, None] - s23 * nz
    q12 = c23 * o_along[:, None] - s23 * oz
    q13 = c23 * a_along[:, None] - s23 * az
    q33 = g * (s23 * a_along[:, None] + c23 * az)

    entries = (q11, q12, q13, q21[:, None], q22[:, None], q23[:, None], q33)
    straight = turn_wrist(theta, g, entries, hold[3])
    flags = np.where(bent.merged, ELBOW, 0)[:, None, None] | np.where(turned.free, SHOULDER, 0)
    flags = flags | np.where(straight, WRIST, 0)[:, :, None]
    return theta, bent.exists[:, None, None] & turned.exists, flags.astype(np.uint8)
