"""A family: axes 4, 5 and 6 meet in one point; axes 2 and 3 are parallel.

The twists of joints 3, 4 and 5 are (90, -90, 90)° or (-90, 90, -90)°: the elbow offset a3 lies on
one or the other side of the forearm. With g = +1 or -1 for the two, and the forearm's line from
elbow to wrist centre L = hypot(a3, d4) at the angle γ = g · atan2(d4, a3) from the x axis of frame
3, both are solved by the same equations. Source: derived from the DH table; the OPW form of
Brandstötter, Angerer and Hofbaur (2014) covers the same arms.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from robots.arm import DhArm
from robots.closed_form import (
    ELBOW,
    SHOULDER,
    WRIST,
    Answer,
    Misfit,
    Needed,
    bend_to,
    table_mismatch,
    turn_to,
    turn_wrist,
)
from robots.elementary import Number, cos, sin

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


def solve(arm: DhArm, pose: Sequence[Number], hold: Sequence[Number]) -> Iterator[Answer]:
    """Solve poses; see `closed_form.Family`."""
    g = elbow_side(arm)
    length, gamma = forearm(arm)
    (a1, a2), (d1, d2, d3, _, _, d6) = arm.a[:2].tolist(), arm.d.tolist()
    nx, ox, ax, px, ny, oy, ay, py, nz, oz, az, pz = pose[:12]
    x, y, z = px - d6 * ax, py - d6 * ay, pz - d6 * az  # of the wrist
    shoulders, free, exists = turn_to(x, y, hold[0], d2 + d3)
    for shoulder, (theta1, c1, s1) in enumerate(shoulders):
        bent = bend_to(x * c1 + y * s1 - a1, d1 - z, a2, length)
        # Q = R03ᵀ R; the flange's axes along the arm's plane and across it are enough
        n, o, a = (c1 * u + s1 * v for u, v in ((nx, ny), (ox, oy), (ax, ay)))
        q21, q22, q23 = (g * (c1 * v - s1 * u) for u, v in ((nx, ny), (ox, oy), (ax, ay)))
        for elbow, (theta2, bend) in enumerate(zip(bent.azimuths, bent.bends, strict=True)):
            theta3 = bend + gamma
            c23, s23 = cos(theta2 + theta3), sin(theta2 + theta3)
            q11, q12, q13 = c23 * n - s23 * nz, c23 * o - s23 * oz, c23 * a - s23 * az
            q33 = g * (s23 * a + c23 * az)
            wrists, straight = turn_wrist(g, (q11, q12, q13, q21, q22, q23, q33), hold[3])
            flags = ELBOW * bent.merged | SHOULDER * free | WRIST * straight
            for wrist, angles in enumerate(wrists):
                branch, theta = 4 * shoulder + 2 * elbow + wrist, (theta1, theta2, theta3, *angles)
                yield Answer(branch, theta, exists & bent.exists, flags)
