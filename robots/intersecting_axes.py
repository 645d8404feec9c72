"""A family: axes 4, 5 and 6 meet in one point, and axes 1 and 2 in another.

The twists are (-90, 90, -90, 90, -90, 0)°. Such are arms with a shoulder of two or three crossing
axes and, read from the flange to the base, those of seven joints whose last joint is given. The
distance from shoulder to wrist centre depends on θ3 alone. With (d2, a2) and (d4, a3) as the upper
arm and the forearm in the plane that axis 3 crosses, it is the law of cosines; θ2 then sets the
wrist's height along axis 1, and θ1 its azimuth. Source: derived from the DH table.
"""

import math
from collections.abc import Iterator, Sequence

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
    Answer,
    Misfit,
    Needed,
    Turn,
    angle_of,
    table_mismatch,
    turn_wrist,
)
from robots.elementary import Condition, Number, arctan2, clip, cos, sin, sqrt

Triple = tuple[Number, Number, Number]

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


def solve(arm: DhArm, pose: Sequence[Number], hold: Sequence[Number]) -> Iterator[Answer]:
    """Solve poses; see `closed_form.Family`."""
    d1, d6 = float(arm.d[0]), float(arm.d[5])
    nx, ox, ax, px, ny, oy, ay, py, nz, oz, az, pz = pose[:12]
    centre = (px - d6 * ax, py - d6 * ay, pz - d6 * az - d1)
    flange = ((nx, ny, nz), (ox, oy, oz), (ax, ay, az))
    bends, closes, merged = _bend_elbow(arm, centre)
    for elbow, theta3 in enumerate(bends):
        turns, exists, free = _turn_shoulder(arm, centre, theta3, hold)
        c3, s3 = cos(theta3), sin(theta3)
        for shoulder, ((theta1, c1, s1), (theta2, c2, s2)) in enumerate(turns):
            # columns of R03; Q = R03ᵀ R
            x = (c1 * c2 * c3 - s1 * s3, s1 * c2 * c3 + c1 * s3, -s2 * c3)
            y = (-c1 * s2, -s1 * s2, -c2)
            z = (-c1 * c2 * s3 - s1 * c3, -s1 * c2 * s3 + c1 * c3, s2 * s3)
            entries = (*(_dot(u, v) for u in (x, y) for v in flange), _dot(z, flange[2]))
            wrists, straight = turn_wrist(-1, entries, hold[3])
            flags = ELBOW * merged | SHOULDER * free | WRIST * straight
            for wrist, angles in enumerate(wrists):
                branch, theta = 4 * shoulder + 2 * elbow + wrist, (theta1, theta2, theta3, *angles)
                yield Answer(branch, theta, exists & closes, flags)


def _bend_elbow(arm: DhArm, wrist: Triple) -> tuple[tuple[Number, Number], Condition, Condition]:
    """Both θ3 by the distance of the wrist centre; where they exist and where both are one."""
    upper, fore = math.hypot(arm.a[1], arm.d[1]), math.hypot(arm.a[2], arm.d[3])
    d3 = float(arm.d[2])
    cosine = (_dot(wrist, wrist) - upper**2 - fore**2 - d3**2) / (2 * upper * fore)
    exists = abs(cosine) <= 1 + TOL_COSINE
    cosine = clip(cosine, -1.0, 1.0)
    sine = sqrt((1 - cosine) * (1 + cosine))
    bend = arctan2(sine, cosine)
    stretched = math.atan2(arm.d[1], arm.a[1]) - math.atan2(arm.d[3], arm.a[2])
    return (stretched + bend, stretched - bend), exists, exists & (sine < TOL_ELBOW)


def _turn_shoulder(
    arm: DhArm, wrist: Triple, theta3: Number, hold: Sequence[Number]
) -> tuple[tuple[tuple[Turn, Turn], tuple[Turn, Turn]], Condition, Condition]:
    """θ1 and θ2 of both shoulders, where they exist, and where one of them is free."""
    (_, a2, a3), (_, d2, d3, d4) = arm.a[:3].tolist(), arm.d[:4].tolist()
    angle, fore = theta3 + math.atan2(d4, a3), math.hypot(a3, d4)
    # the wrist centre in frame 1 at θ2 = 0, with y along axis 2 turned to z
    vx, vy, vz = a2 + fore * cos(angle), -d3, d2 + fore * sin(angle)
    x, y, height = wrist
    distance = sqrt(x * x + y * y)
    exists = distance >= abs(vz) - TOL_SIDE
    on_axis_1, on_axis_2 = distance < TOL_SHOULDER, sqrt(vx * vx + vy * vy) < TOL_SHOULDER
    along = sqrt(clip((distance - vz) * (distance + vz), 0.0, np.inf))
    facing, away = (
        (
            angle_of(x * across + y * vz, y * across - x * vz, hold[0], on_axis_1),
            angle_of(across * vx - height * vy, -across * vy - height * vx, hold[1], on_axis_2),
        )
        for across in (along, -along)
    )
    return (facing, away), exists, on_axis_1 | on_axis_2


def _dot(u: Triple, v: Triple) -> Number:
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]
