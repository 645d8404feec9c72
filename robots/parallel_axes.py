"""A family: axes 2, 3 and 4 are parallel, and axes 5 and 6 meet.

The twists are (-90, 0, 0, 90, -90, 0)°. Offsets along axes 2, 3 and 4 are one, d2 + d3 + d4: how
far the arm's plane passes axis 1. Unlike a spherical wrist, axis 6 turning parallel to axes 2 to 4
(sin θ5 = 0) couples four joints: θ6 is free and the elbow moves with it. Source: Korayem et al.
(2018) with its misprints mended, derived again from the DH table.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from robots.arm import DhArm
from robots.closed_form import (
    ELBOW,
    SHOULDER,
    TOL_WRIST,
    WRIST,
    Answer,
    Misfit,
    Needed,
    bend_to,
    table_mismatch,
    turn_to,
)
from robots.elementary import Condition, Number, arctan2, cos, sin, some, sqrt, where

Triple = tuple[Number, Number, Number]
Wrist = tuple[Number, Number, Number, Number, Number, Number]

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


def solve(arm: DhArm, pose: Sequence[Number], hold: Sequence[Number]) -> Iterator[Answer]:
    """Solve poses; see `closed_form.Family`."""
    (a1, a2, a3, a4), (d1, d2, d3, d4, d5, d6) = arm.a[:4].tolist(), arm.d.tolist()
    nx, ox, ax, px, ny, oy, ay, py, nz, oz, az, pz = pose[:12]
    shoulders, free, exists = turn_to(px - d6 * ax, py - d6 * ay, hold[0], d2 + d3 + d4)
    for shoulder, (theta1, cosine, sine) in enumerate(shoulders):
        n, o, a, p = (cosine * x + sine * y for x, y in ((nx, ny), (ox, oy), (ax, ay), (px, py)))
        wrists, straight = _turn_wrist((n, o, a), (nz, oz, az), cosine * ay - sine * ax, hold[5])
        for wrist, (theta234, theta5, theta6, c234, s234, s5) in enumerate(wrists):
            lever = a4 - d6 * s5
            bent = bend_to(
                p - lever * c234 - d5 * s234 - a1, d1 - pz - lever * s234 + d5 * c234, a2, a3
            )
            flags = ELBOW * bent.merged | SHOULDER * free | WRIST * straight
            for elbow in (0, 1):
                theta2, theta3 = bent.azimuths[elbow], bent.bends[elbow]
                yield Answer(
                    4 * shoulder + 2 * elbow + wrist,
                    (theta1, theta2, theta3, theta234 - theta2 - theta3, theta5, theta6),
                    exists & bent.exists,
                    flags,
                )


def _turn_wrist(
    along: Triple, up: Triple, c5: Number, hold: Number
) -> tuple[tuple[Wrist, Wrist], Condition]:
    """Turn θ234 so that axis 5 is square to the flange's z: both ways, and where it is straight.

    `along` and `up` are the shares of the flange's axes in the arm's plane. A wrist is θ234, θ5 and
    θ6, the cosine and sine of θ234, and the sine of θ5.
    """
    (n, o, a), (nz, oz, az) = along, up
    s5 = sqrt(a * a + az * az)
    straight = s5 < TOL_WRIST
    some_straight = some(straight)
    divisor = where(straight, 1.0, s5) if some_straight else s5
    s234, c234 = az / divisor, -a / divisor
    # axis 5 is (C1 s234, S1 s234, c234): its share in n and o is sin θ6 and cos θ6, θ5 or not
    sine6, cosine6 = s234 * n + c234 * nz, s234 * o + c234 * oz
    theta234, theta5 = arctan2(az, -a), arctan2(s5, c5)
    one = theta234, theta5, arctan2(-sine6, -cosine6), c234, s234, s5
    other = theta234 + np.pi, -theta5, arctan2(sine6, cosine6), -c234, -s234, -s5
    if some_straight:  # only θ234 ± θ6 is determined: hold θ6
        free = arctan2(-nz, n)
        theta234 = where(c5 > 0, free - hold, free - np.pi + hold)
        c234, s234 = cos(theta234), sin(theta234)
        theta5 = arctan2(s234 * az - c234 * a, c5)
        held = theta234, theta5, hold, c234, s234, sin(theta5)
        one, other = where(straight, held, one), where(straight, held, other)
    return (one, other), straight
