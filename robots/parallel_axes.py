"""A family: axes 2, 3 and 4 are parallel, and axes 5 and 6 meet.

The twists are (-90, 0, 0, 90, -90, 0)°. Offsets along axes 2, 3 and 4 are one, d2 + d3 + d4: how
far the arm's plane passes axis 1. Unlike a spherical wrist, axis 6 turning parallel to axes 2 to 4
(sin θ5 = 0) couples four joints: θ6 is free and the elbow moves with it. Source: Korayem et al.
(2018) with its misprints mended, derived again from the DH table.
"""

import numpy as np

from robots.arm import DhArm
from robots.closed_form import (
    ELBOW,
    SHOULDER,
    TOL_WRIST,
    WRIST,
    Flags,
    Mask,
    Misfit,
    Needed,
    bend_to,
    table_mismatch,
    turn_to,
)
from robots.transforms import Array

ALPHA = (-90.0, 0.0, 0.0, 90.0, -90.0, 0.0)
LENGTHS: Needed = {"a_mm": (None, None, None, None, 0.0, 0.0), "d_mm": (None,) * 6}


def misfit(arm: DhArm) -> Misfit | None:
    """Name the first entry of the table that does not belong to this family, if any."""
    for joint in (2, 3):
        if arm.a[joint - 1] <= 0:
            found = float(arm.a[joint - 1] * 1000)
            return joint, "a_mm", found, "a link longer than 0 is needed"
    return table_mismatch(arm, {**LENGTHS, "alpha_deg": ALPHA})


def reach(arm: DhArm) -> tuple[float, float]:
    """Least and greatest distance of axis 4 from axis 2, m."""
    return abs(float(arm.a[1] - arm.a[2])), float(arm.a[1] + arm.a[2])


def solve(arm: DhArm, pose: Array, hold: Array) -> tuple[Array, Mask, Flags]:
    """Solve poses given as rows; see `closed_form.Family`."""
    a1, a2, a3, a4 = arm.a[:4].tolist()
    d1, _, _, _, d5, d6 = arm.d.tolist()
    nx, ox, ax, px, ny, oy, ay, py, nz, oz, az, pz = pose[:12]

    turned = turn_to(px - d6 * ax, py - d6 * ay, hold[0], float(arm.d[1:4].sum()))
    cosine, sine = turned.cosine, turned.sine
    n_along, o_along, a_along, p_along = (
        cosine * x + sine * y for x, y in ((nx, ny), (ox, oy), (ax, ay), (px, py))
    )
    c5 = cosine * ay - sine * ax
    s5 = np.sqrt(a_along * a_along + az * az)

    # Axes (shoulder, wrist, pose) from here. θ234 turns axis 5 square to the flange's z.
    straight = s5 < TOL_WRIST
    some_straight = bool(straight.any())
    divisor = np.where(straight, 1.0, s5) if some_straight else s5
    s234, c234 = _both(az / divisor), _both(-a_along / divisor)
    theta234, theta5 = np.empty_like(s234), _both(np.arctan2(s5, c5))
    theta234[:, 0] = np.arctan2(az, -a_along)
    theta234[:, 1] = theta234[:, 0] + np.pi
    s5 = _both(s5)
    if some_straight:  # only θ234 ± θ6 is determined: hold θ6
        free = np.arctan2(-nz, n_along)[straight]
        theta6 = np.broadcast_to(hold[5], straight.shape)[straight]
        held = np.where(c5[straight] > 0, free - theta6, free - np.pi + theta6)
        c, s = np.cos(held), np.sin(held)
        lean = s * np.broadcast_to(az, straight.shape)[straight] - c * a_along[straight]
        turn = np.arctan2(lean, c5[straight])
        for wrist in (0, 1):
            for angles, value in ((theta234, held), (c234, c), (s234, s), (theta5, turn)):
                angles[:, wrist][straight] = value
            s5[:, wrist][straight] = np.sin(turn)

    lever = a4 - d6 * s5
    bent = bend_to(
        p_along[:, None] - lever * c234 - d5 * s234 - a1, d1 - pz - lever * s234 + d5 * c234, a2, a3
    )

    theta = np.empty((6, 2, 2, 2, pose.shape[1]))  # joint, shoulder, elbow, wrist, pose
    theta[0] = turned.theta[:, None, None]
    theta[1, :, 0], theta[1, :, 1] = bent.azimuth - bent.inner, bent.azimuth + bent.inner
    theta[2, :, 0], theta[2, :, 1] = bent.bend, -bent.bend
    theta[3] = theta234[:, None] - theta[1] - theta[2]
    theta[4] = theta5[:, None]
    # axis 5 is (C1 s234, S1 s234, c234): its share in n and o is sin θ6 and cos θ6, θ5 or not
    theta[5] = np.arctan2(
        -(s234 * n_along[:, None] + c234 * nz), -(s234 * o_along[:, None] + c234 * oz)
    )[:, None]
    if some_straight:
        for wrist in (0, 1):
            theta[5, :, :, wrist].swapaxes(0, 1)[:, straight] = theta6

    flags = np.where(bent.merged, ELBOW, 0)[:, None] | np.where(turned.free, SHOULDER, 0)
    flags = flags | np.where(straight, WRIST, 0)[:, None, None]
    return theta, (bent.exists & turned.exists)[:, None], flags.astype(np.uint8)


def _both(value: Array) -> Array:
    """Value for sin θ5 >= 0 and its negative for <= 0: (2, m) to (2, 2, m)."""
    both = np.empty((2, 2, value.shape[-1]))
    both[:, 0], both[:, 1] = value, -value
    return both
